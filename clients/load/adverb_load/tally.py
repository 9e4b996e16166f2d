"""What is counted: how late messages come, what is missing, and whose fault it is."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

__all__ = ["Clock", "Lateness", "Tally", "Track", "lateness_of"]

WRAP = 1 << 32
MAX_PROBLEMS = 8
"""Problems that are kept word for word; all are counted."""


class Clock:
    """How far the server's clock is ahead of this machine's, by pings.

    The quickest ping is believed: it is wrong by half its round trip at most.
    """

    def __init__(self) -> None:
        self.round_trip_ns: int | None = None
        self.offset_ns = 0

    def add(self, sent_ns: int, arrived_ns: int, server_time_ns: int) -> None:
        """Count a ping: two times of this machine, and the server's in between."""
        took = arrived_ns - sent_ns
        if took >= 0 and (self.round_trip_ns is None or took < self.round_trip_ns):
            self.round_trip_ns = took
            self.offset_ns = server_time_ns - (sent_ns + arrived_ns) // 2


@dataclass(slots=True)
class Track:
    """The numbering of one session's messages.

    Parameters
    ----------
    sequence, dropped : int
        Of the last message.
    """

    sequence: int = 0
    dropped: int = 0

    def step(self, sequence: int, dropped: int) -> tuple[int, int]:
        """Take the next message; how many are missing without being reported, and how many more are reported.

        A number that was there before counts as one that is missing.
        """
        ahead = (sequence - self.sequence) % WRAP
        more = (dropped - self.dropped) % WRAP
        self.sequence, self.dropped = sequence, dropped
        if ahead == 1:
            return 0, more
        if ahead == 0 or ahead > WRAP // 2:
            return 1, more
        return max(0, ahead - 1 - more), more


@dataclass(slots=True)
class Tally:
    """Counts of a whole run. Lateness and loss count for ticks within the window, faults always.

    Parameters
    ----------
    start_ns, stop_ns : int
        The window, on the server's clock.
    late_ns : array of int64
        Arrival on this machine's clock minus due time on the server's.
    delivered, records, payload_bytes : int
        Messages, poses and their bytes, heads included.
    dropped : int
        Messages that the server said it did not send.
    messages, gaps, decoded, wrong : int
        All messages; those missing without being reported; those that were read in full, and what was wrong.
    problems : list of str
        The first few things that were wrong.
    codes, closes, ops : Counter
        Error codes, close codes, text messages by ``op``.
    """

    start_ns: int = 0
    stop_ns: int = 0
    late_ns: array[int] = field(default_factory=lambda: array("q"))
    delivered: int = 0
    records: int = 0
    payload_bytes: int = 0
    dropped: int = 0
    messages: int = 0
    gaps: int = 0
    decoded: int = 0
    wrong: int = 0
    problems: list[str] = field(default_factory=list)
    codes: Counter[str] = field(default_factory=Counter)
    closes: Counter[int] = field(default_factory=Counter)
    ops: Counter[str] = field(default_factory=Counter)

    def window(self, start_ns: int, stop_ns: int) -> None:
        """Count what is due from here to there, and nothing from before."""
        self.start_ns, self.stop_ns, self.late_ns = start_ns, stop_ns, array("q")
        self.delivered = self.records = self.payload_bytes = self.dropped = 0

    def message(self, due_ns: int, now_ns: int, records: int, payload_bytes: int) -> None:
        """Count a pose message."""
        self.messages += 1
        if self.start_ns <= due_ns < self.stop_ns:
            self.late_ns.append(now_ns - due_ns)
            self.delivered += 1
            self.records += records
            self.payload_bytes += payload_bytes

    def lost(self, due_ns: int, missing: int, reported: int) -> None:
        """Count messages that did not come."""
        self.gaps += missing
        if missing:
            self.note(f"{missing} messages are missing and were not reported")
        if self.start_ns <= due_ns < self.stop_ns:
            self.dropped += reported

    def fault(self, problem: str) -> None:
        """Count something that a decoder refuses."""
        self.wrong += 1
        self.note(problem)

    def note(self, problem: str) -> None:
        """Keep a problem, if there is room."""
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(problem)


@dataclass(frozen=True, slots=True)
class Lateness:
    """Arrival minus due time, milliseconds."""

    p50: float
    p95: float
    p99: float
    max: float


def lateness_of(late_ns: array[int], offset_ns: int) -> Lateness:
    """Quantiles of lateness; NaN where nothing came.

    Parameters
    ----------
    late_ns : array of int64
        As in :class:`Tally`.
    offset_ns : int
        What to add to a time of this machine to have the server's.
    """
    if not late_ns:
        return Lateness(*[float("nan")] * 4)
    late_ms = (np.frombuffer(late_ns, np.int64) + offset_ns) * 1e-6
    return Lateness(*np.quantile(late_ms, [0.5, 0.95, 0.99, 1.0]).round(3).tolist())
