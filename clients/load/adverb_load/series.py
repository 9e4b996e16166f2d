"""Values over the time of a run: one histogram for each interval."""

from __future__ import annotations

from array import array
from collections import Counter
from typing import Any

import numpy as np

from adverb_load.histogram import Histogram

__all__ = ["Counts", "Series"]

FLUSH = 65_536
"""Values that are kept before they are sorted into histograms."""


class Series:
    """Values with the time to which they belong; those outside the window are ignored.

    Parameters
    ----------
    interval_s : float
    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self._seconds = 0.0
        self._when, self._values = array("d"), array("d")
        self._parts: dict[int, Histogram] = {}
        self._start_s = float("inf")

    def window(self, start_s: float, seconds: float) -> None:
        """Begin the window; earlier values are forgotten."""
        self._start_s, self._seconds = start_s, seconds
        self._when, self._values, self._parts = array("d"), array("d"), {}

    def add(self, when_s: float, value: float) -> None:
        """Add a value."""
        if when_s >= self._start_s:
            self._when.append(when_s)
            self._values.append(value)
            if len(self._when) >= FLUSH:
                self._flush()

    def _flush(self) -> None:
        if not self._when:
            return
        since_s = np.frombuffer(self._when, np.float64) - self._start_s
        values = np.frombuffer(self._values, np.float64)
        numbers = (since_s / self.interval_s).astype(np.int64)
        numbers[since_s >= self._seconds] = -1
        for number in np.unique(numbers[numbers >= 0]).tolist():
            self._parts.setdefault(number, Histogram()).add(values[numbers == number])
        del since_s, values  # a buffer that is in use cannot grow
        self._when, self._values = array("d"), array("d")

    def parts(self, seconds: float) -> list[Histogram]:
        """A histogram for each interval of the first seconds of the window."""
        self._flush()
        count = max(1, round(seconds / self.interval_s))
        return [self._parts.get(number, Histogram()) for number in range(count)]

    def whole(self, seconds: float) -> Histogram:
        """All values of the first seconds of the window."""
        whole = Histogram()
        for part in self.parts(seconds):
            whole.merge(part)
        return whole

    def to_json(self, seconds: float) -> list[dict[str, Any]]:
        """The histograms of :meth:`parts`."""
        return [part.to_json() for part in self.parts(seconds)]


class Counts:
    """Events by name, in total and for each interval of the window.

    Parameters
    ----------
    interval_s : float
    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self._start_s, self._seconds = float("inf"), 0.0
        self._parts: Counter[tuple[str, int]] = Counter()

    def window(self, start_s: float, seconds: float) -> None:
        """Begin the window; earlier counts are forgotten."""
        self._start_s, self._seconds, self._parts = start_s, seconds, Counter()

    def add(self, when_s: float, name: str, count: int = 1) -> None:
        """Count events of one instant, if it is in the window."""
        since_s = when_s - self._start_s
        if 0.0 <= since_s < self._seconds and count:
            self._parts[name, int(since_s / self.interval_s)] += count

    def total(self, name: str) -> int:
        """Events of a name in the window."""
        return sum(count for (other, _), count in self._parts.items() if other == name)

    def names(self) -> list[str]:
        """Names of all events, sorted."""
        return sorted({name for name, _ in self._parts})

    def parts(self, name: str, seconds: float) -> list[int]:
        """Events of a name in each interval."""
        return [self._parts[name, number] for number in range(max(1, round(seconds / self.interval_s)))]
