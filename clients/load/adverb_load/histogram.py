"""Histograms with logarithmic buckets, as of HdrHistogram: a fixed relative precision over fourteen decades."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["BUCKETS", "PERCENTILES", "PRECISION", "Histogram"]

F64 = npt.NDArray[np.float64]

LEAST = 1e-9
"""Values at or below this are in the first bucket: a nanosecond, a nanometre."""

PER_OCTAVE = 64
BUCKETS = 48 * PER_OCTAVE
PRECISION = 2.0 ** (0.5 / PER_OCTAVE) - 1.0
"""Largest relative difference between a value and the middle of its bucket: 0.0054."""

PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9)


class Histogram:
    """Counts of positive values.

    A percentile is the middle of the bucket with its rank, so it is within :data:`PRECISION` of the exact one; the
    smallest and the largest value are exact. Values that are not finite are ignored.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(BUCKETS, np.int64)
        self.total, self.sum = 0, 0.0
        self.min, self.max = math.inf, -math.inf

    def add(self, values: F64 | Iterable[float]) -> None:
        """Count values (N,)."""
        given = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.float64)
        given = given[np.isfinite(given)]
        if not given.size:
            return
        steps = np.log2(np.maximum(given, LEAST) / LEAST) * PER_OCTAVE
        self.counts += np.bincount(np.minimum(steps.astype(np.int64), BUCKETS - 1), minlength=BUCKETS)
        self.total += given.size
        self.sum += float(given.sum())
        self.min, self.max = min(self.min, float(given.min())), max(self.max, float(given.max()))

    def merge(self, other: Histogram) -> None:
        """Add the counts of another histogram."""
        self.counts += other.counts
        self.total, self.sum = self.total + other.total, self.sum + other.sum
        self.min, self.max = min(self.min, other.min), max(self.max, other.max)

    def percentile(self, percent: float) -> float:
        """The smallest value that ``percent`` of the values do not exceed; NaN without values."""
        if not self.total:
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * self.total - 1e-9))
        if rank == self.total:
            return self.max
        bucket = int(np.searchsorted(np.cumsum(self.counts), rank))
        middle = LEAST * math.pow(2.0, (bucket + 0.5) / PER_OCTAVE)
        return min(max(middle, self.min), self.max)

    @property
    def mean(self) -> float:
        """Mean of the values, exact; NaN without values."""
        return self.sum / self.total if self.total else math.nan

    def summary(self, scale: float = 1.0) -> dict[str, float | int | None]:
        """Count, mean, percentiles and maximum, multiplied by a factor; None where there is no value."""
        found = {"mean": self.mean, **{f"p{percent:g}": self.percentile(percent) for percent in PERCENTILES}}
        found["max"] = self.max if self.total else math.nan
        rounded = {name: None if math.isnan(value) else float(f"{value * scale:.4g}") for name, value in found.items()}
        return {"count": self.total, **rounded}

    def to_json(self) -> dict[str, Any]:
        """Buckets that are not empty, with sum, minimum and maximum."""
        filled = np.flatnonzero(self.counts)
        limits = {"min": self.min, "max": self.max} if self.total else {}
        return {"buckets": filled.tolist(), "counts": self.counts[filled].tolist(), "sum": self.sum, **limits}

    @classmethod
    def of_json(cls, fields: Mapping[str, Any]) -> Histogram:
        """The histogram of :meth:`to_json`; raises ValueError if it is none."""
        found = cls()
        try:
            buckets, counts = np.array(fields["buckets"], np.int64), np.array(fields["counts"], np.int64)
            if buckets.shape != counts.shape or ((buckets < 0) | (buckets >= BUCKETS) | (counts < 0)).any():
                raise ValueError("buckets and counts do not fit")
            found.counts[buckets] = counts
            found.total, found.sum = int(counts.sum()), float(fields["sum"])
            if found.total:
                found.min, found.max = float(fields["min"]), float(fields["max"])
        except (KeyError, TypeError, OverflowError) as err:
            raise ValueError(f"not a histogram: {err}") from err
        return found
