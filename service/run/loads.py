"""Loads of the server processes of one machine, in memory that they share, and which of them accepts a connection.

A process writes its own row only: whenever its load changes, and every :data:`REFRESH_S`. A row that is older than
:data:`STALE_S` is that of a process that has ended or is busy, and does not count.
"""

from __future__ import annotations

import mmap
import time

__all__ = ["FEW", "NO_ROOM", "PART", "REFRESH_S", "STALE_S", "Loads"]

REFRESH_S = 0.05
"""Interval at which a process writes its row, seconds."""

STALE_S = 0.5
"""Age from which a row does not count, seconds."""

FEW, PART = 4, 16
"""A process accepts while its load is at most the least, :data:`FEW` and one :data:`PART` of the least: requests that
come at the same time are then accepted by several processes."""

NO_ROOM = 2**40
"""Load of a process that has no verbs yet, or as many streams as it may have."""

_WORDS = 8
"""Numbers of a row, which fills a cache line: the load, and when it was written, ns."""


class Loads:
    """Load of each process; made before the processes are forked.

    Parameters
    ----------
    count : int
        Number of processes.
    """

    def __init__(self, count: int) -> None:
        self._rows = range(0, count * _WORDS, _WORDS)
        self._words = memoryview(mmap.mmap(-1, count * _WORDS * 8)).cast("q")

    def write(self, number: int, load: int) -> None:
        """Write the load of a process."""
        row = self._rows[number]
        self._words[row], self._words[row + 1] = load, time.monotonic_ns()

    def clear(self, number: int) -> None:
        """Count a process no more, until it writes its load again."""
        self._words[self._rows[number] + 1] = 0

    def accepts(self, number: int) -> bool:
        """Whether a process may accept a connection, since no other has much less load; true for one at least."""
        row, since_ns = self._rows[number], time.monotonic_ns() - int(STALE_S * 1e9)
        others = [self._words[one] for one in self._rows if one != row and self._words[one + 1] > since_ns]
        least = min(others, default=NO_ROOM)
        return self._words[row] <= least + FEW + least // PART
