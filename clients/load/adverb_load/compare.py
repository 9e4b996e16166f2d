"""Two reports side by side: differences, and whether they are larger than the noise between intervals."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_load.engine import FORMAT
from adverb_load.histogram import BUCKETS, LEAST, PER_OCTAVE, Histogram

__all__ = ["Comparison", "Difference", "compare", "lines_of_comparison", "read_report"]

F64 = npt.NDArray[np.float64]
Json = Mapping[str, Any]

RESAMPLES = 400
CONFIDENCE = (2.5, 97.5)
TIMES = {"lateness_s": "lateness", "response_s": "response", "latency_s": "latency"}
"""Series that are compared."""
MIDDLES = LEAST * 2.0 ** ((np.arange(BUCKETS) + 0.5) / PER_OCTAVE)


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure in both reports.

    Parameters
    ----------
    group, figure, unit : str
    before, after : float
    change : float
        Relative to before, per cent; positive is worse.
    low, high : float
        Bounds of the change, per cent: 95 % of resamples of the intervals of both runs.
    verdict : str
        ``worse``, ``better`` or ``noise``: both bounds on one side of 0, or not.
    """

    group: str
    figure: str
    unit: str
    before: float
    after: float
    change: float
    low: float
    high: float
    verdict: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """All differences, groups that only one report has, remarks, and those that exceed the limit."""

    differences: tuple[Difference, ...]
    missing: tuple[str, ...]
    remarks: tuple[str, ...]
    limit: float | None

    @property
    def failed(self) -> tuple[Difference, ...]:
        """Figures that are worse by more than the limit, beyond noise."""
        if self.limit is None:
            return ()
        return tuple(row for row in self.differences if row.verdict == "worse" and row.change > self.limit)

    def to_json(self) -> dict[str, Any]:
        """The comparison as a JSON object."""
        return asdict(self) | {"failed": [f"{row.group}: {row.figure}" for row in self.failed]}


def read_report(path: Path) -> dict[str, Any]:
    """A report from a file; raises OSError or ValueError."""
    try:
        found = json.loads(path.read_text("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as err:
        raise ValueError(f"{path}: not JSON: {err}") from err
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise ValueError(f"{path}: not a report of adverb load ({FORMAT})")
    return found


def compare(before: Json, after: Json, *, fail_over: float | None = None, seed: int = 1) -> Comparison:
    """Compare two reports of adverb load, group by group.

    The noise is that between intervals: those of each run are drawn again, with replacement, and every figure is
    computed from the drawn ones.

    Parameters
    ----------
    before, after : mapping
        Reports.
    fail_over : float, optional
        Per cent by which a figure may be worse.
    seed : int
        Of the resamples.

    Raises
    ------
    ValueError
        If a report is malformed.
    """
    rng = np.random.default_rng(seed)
    differences: list[Difference] = []
    try:
        groups = [{row["name"]: row for row in (*one["streams"], *one["requests"])} for one in (before, after)]
        for name in groups[0]:
            if name in groups[1]:
                differences += _group(name, groups[0][name], groups[1][name], rng)
    except (KeyError, TypeError) as err:
        raise ValueError(f"a malformed report: {err}") from err
    missing = tuple(sorted(set(groups[0]) ^ set(groups[1])))
    return Comparison(tuple(differences), missing, tuple(_remarks(before, after)), fail_over)


def _remarks(before: Json, after: Json) -> Iterator[str]:
    if before["profile"] != after["profile"]:
        yield "the profiles differ"
    if before["client"]["system"] != after["client"]["system"] or before["client"]["cores"] != after["client"]["cores"]:
        yield "the runs are from different machines"
    for name, one in (("A", before), ("B", after)):
        if one["interrupted"]:
            yield f"{name} was interrupted after {one['seconds']:g} s"
        if one["seconds"] / one["interval_s"] < 10:
            yield f"{name} has few intervals: the noise is a rough estimate"


def _group(name: str, before: Json, after: Json, rng: np.random.Generator) -> Iterator[Difference]:
    for series, figure in TIMES.items():
        if series in before["series"] and series in after["series"]:
            tables = [_table(one["series"][series]) for one in (before, after)]
            for percent in (50.0, 99.0):
                yield from _percentile(name, f"{figure} p{percent:g}", tables, percent, rng)
    for count, figure in (("frames", "frames"), ("ended", "responses")):
        rows = [np.array(one["per_interval"].get(count, []), np.float64) for one in (before, after)]
        if rows[0].size and rows[1].size:
            yield from _difference(name, f"{figure} per interval", "", rows, _mean, rng, more_is_worse=False)
    lost = [_lost(one) for one in (before, after)]
    if any(row.any() for row in lost):
        yield from _difference(name, "lost or failed per interval", "", lost, _mean, rng, more_is_worse=True)


def _lost(one: Json) -> F64:
    rows = one["per_interval"]
    if "scheduled" in rows:
        return np.array(rows["scheduled"], np.float64) - np.array(rows["good"], np.float64)
    return np.array(rows["dropped"], np.float64) + np.array(rows["skipped"], np.float64)


def _table(parts: Sequence[Json]) -> F64:
    """Counts (intervals, buckets)."""
    return np.stack([Histogram.of_json(part).counts for part in parts]).astype(np.float64)


def _percentile(
    name: str, figure: str, tables: Sequence[F64], percent: float, rng: np.random.Generator
) -> Iterator[Difference]:
    if all(table.sum() for table in tables):

        def of(tables: F64) -> F64:
            """Percentiles (R,) of counts (R, buckets)."""
            summed = np.cumsum(tables, axis=1)
            ranks = (percent / 100.0 - 1e-9) * summed[:, -1:]
            return np.asarray(1e3 * MIDDLES[np.argmax(summed >= ranks, axis=1)])

        yield from _difference(name, figure, "ms", tables, of, rng, more_is_worse=True)


def _mean(sums: F64) -> F64:
    return np.asarray(sums)


def _difference(
    group: str, figure: str, unit: str, rows: Sequence[F64], of: Any, rng: np.random.Generator, *, more_is_worse: bool
) -> Iterator[Difference]:
    """The difference of a figure of mean rows, with its bounds by bootstrap over intervals."""
    values, drawn = [], []
    for row in rows:
        table = row.reshape(len(row), -1)
        picked = rng.multinomial(len(table), np.full(len(table), 1.0 / len(table)), RESAMPLES)
        values.append(float(of(table.mean(axis=0)[None]).ravel()[0]))
        drawn.append(of(picked @ table / len(table)).ravel())
    sign = 1.0 if more_is_worse else -1.0
    change = sign * _relative(np.array(values[:1]), np.array(values[1:]))[0]
    bounds = np.percentile(sign * _relative(drawn[0], drawn[1]), CONFIDENCE)
    low, high = float(bounds[0]), float(bounds[1])
    verdict = "worse" if low > 0.0 else "better" if high < 0.0 else "noise"
    yield Difference(group, figure, unit, values[0], values[1], float(change), low, high, verdict)


def _relative(before: F64, after: F64) -> F64:
    """Change in per cent; 100 where something appears that was 0."""
    base = np.where(before > 0.0, before, np.maximum(after, 1e-300))
    return np.asarray(np.where((before <= 0.0) & (after <= 0.0), 0.0, 100.0 * (after - before) / base))


def lines_of_comparison(found: Comparison) -> list[str]:
    """The comparison for a terminal."""
    lines = [f"{'':<34}{'A':>10}{'B':>10}   change (95 % of resamples), positive is worse"]
    group = ""
    for row in found.differences:
        if row.group != group:
            group = row.group
            lines.append(group)
        label = f"  {row.figure}{', ' + row.unit if row.unit else ''}"
        bounds = f"{row.change:+7.1f} %  ({row.low:+.1f} to {row.high:+.1f})"
        mark = " over the limit" if row in found.failed else ""
        lines.append(f"{label:<34}{_short(row.before):>10}{_short(row.after):>10}   {bounds:<34}{row.verdict}{mark}")
    lines += [f"only one report has {name}" for name in found.missing]
    return lines + [f"note: {text}" for text in found.remarks]


def _short(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.4g}"
