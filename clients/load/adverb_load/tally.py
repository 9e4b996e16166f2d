"""Counters of a load: lateness of messages, missing messages, faults."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from adverb_client import Clock

__all__ = ["Lateness", "Tally", "Track", "lateness_of", "offset_ns_of"]

WRAP = 1 << 32
MAX_PROBLEMS = 8
"""Number of problems whose text is kept; all are counted."""


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
        """Count the next message; returns the numbers of messages missing unreported and newly reported.

        A repeated sequence number counts as one missing message.
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
    """Counters of a run. Lateness and loss count for ticks within the window, faults always.

    Parameters
    ----------
    start_ns, stop_ns : int
        The window, on the server's clock.
    late_ns : array of int64
        Arrival on this machine's clock minus due time on the server's.
    delivered, records, payload_bytes : int
        Messages, poses and their bytes, including headers.
    dropped : int
        Messages that the server reports as dropped.
    messages, gaps, decoded, wrong : int
        All messages; those missing unreported; those decoded in full; number of faults.
    problems : list of str
        Texts of the first few faults.
    codes, closes, ops : Counter
        Error codes, close codes, text messages by kind.
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
        """Start a window of due times; earlier counts are reset."""
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
        """Count missing messages."""
        self.gaps += missing
        if missing:
            self.note(f"{missing} messages are missing and were not reported")
        if self.start_ns <= due_ns < self.stop_ns:
            self.dropped += reported

    def fault(self, problem: str) -> None:
        """Count a message that is malformed or implausible."""
        self.wrong += 1
        self.note(problem)

    def note(self, problem: str) -> None:
        """Keep the text of a problem, up to a limit."""
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(problem)


@dataclass(frozen=True, slots=True)
class Lateness:
    """Arrival minus due time, milliseconds."""

    p50: float
    p95: float
    p99: float
    max: float


def offset_ns_of(clock: Clock) -> int:
    """Server's clock minus this machine's, ns; 0 before the first pong."""
    return round(clock.offset_s * 1e9) if clock.known else 0


def lateness_of(late_ns: array[int], offset_ns: int) -> Lateness:
    """Quantiles of lateness; NaN without messages.

    Parameters
    ----------
    late_ns : array of int64
        As in :class:`Tally`.
    offset_ns : int
        Server's clock minus this machine's.
    """
    if not late_ns:
        return Lateness(*[float("nan")] * 4)
    late_ms = (np.frombuffer(late_ns, np.int64) + offset_ns) * 1e-6
    return Lateness(*np.quantile(late_ms, [0.5, 0.95, 0.99, 1.0]).round(3).tolist())
