"""What a run has recorded: faults, acknowledged changes, answers, outages and samples of processes."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from benchmarks.chaos.plan import Fault

__all__ = ["LATE_S", "Answer", "Changes", "Happened", "Ledger", "Outage", "Refined", "Sample", "Stall"]

LATE_S = 15.0
"""Time in which a change whose answer was lost may still take effect, seconds."""
EVENT_S = 6.0
"""Largest age of an event's time at its commit, seconds: it waits for locks of the database for up to 5 s."""


@dataclass(frozen=True, slots=True)
class Happened:
    """A fault as it happened; times from the start, seconds."""

    fault: Fault
    began_s: float
    ended_s: float
    pids: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """A request that did not succeed: its interval, what it was, and the problem (``503 not_ready``, ``ReadError``)."""

    began_s: float
    ended_s: float
    what: str
    problem: str


@dataclass(frozen=True, slots=True)
class Outage:
    """A stream without a connection, from its loss to the next pose message; ``resumed`` if its session continued."""

    stream: int
    began_s: float
    ended_s: float
    resumed: bool


@dataclass(frozen=True, slots=True)
class Stall:
    """A stream, or a channel of it, without a frame for too long; ``details`` tell what it did last."""

    stream: int
    at_s: float
    details: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Sample:
    """Memory and files of a process.

    Parameters
    ----------
    at_s, uptime_s : float
    kind : str
        ``parent``, ``server`` or ``worker``.
    pid : int
    rss_mib, own_mib : float
        Resident memory, and the part of it that no other process shares.
    files : int
    """

    at_s: float
    uptime_s: float
    kind: str
    pid: int
    rss_mib: float
    own_mib: float
    files: int


@dataclass(frozen=True, slots=True)
class Refined:
    """A version that a refinement published: its parent, and when it last became current, from the start, seconds.

    ``at_s`` is -inf for a version that was never current.
    """

    parent: int
    at_s: float


@dataclass(slots=True)
class Changes:
    """What may be current for a verb, from the answers that its author got.

    Parameters
    ----------
    possible : set of int or None
        Versions; None stands for a deleted verb.
    unsure : list of (float, int or None, bool)
        Time and target of changes whose answer was lost; the last is true for a publication, of unknown number.
    since_s : float
        When the last acknowledged change was requested.
    """

    possible: set[int | None] = field(default_factory=set)
    unsure: list[tuple[float, int | None, bool]] = field(default_factory=list)
    since_s: float = -math.inf

    def acknowledged(self, since_s: float, at_s: float, current: int | None) -> None:
        """A change that was requested and answered at these times succeeded.

        Only unanswered ones that are recent may come after it.
        """
        self.unsure = [row for row in self.unsure if row[0] > at_s - LATE_S]
        self.possible, self.since_s = {current}, since_s

    def allows(self, current: int | None, unacknowledged: set[int], refined: Mapping[int, Refined]) -> bool:
        """Whether a version may be current.

        Parameters
        ----------
        current : int or None
        unacknowledged : set of int
            Versions of authors without an answer.
        refined : mapping of int to Refined
            A refinement replaces only the version that it refined, and only if that is current. So one counts that
            became current after the last acknowledged change, and whose parent was allowed.
        """
        if not self.possible:
            return True
        targets = {target for _, target, publishes in self.unsure if not publishes}
        published = unacknowledged if any(publishes for *_, publishes in self.unsure) else set()
        allowed = self.possible | targets | published
        while current is not None and current not in allowed and current in refined:
            if refined[current].at_s < self.since_s - EVENT_S:
                return False
            current = refined[current].parent
        return current in allowed


@dataclass(slots=True)
class Ledger:
    """Record of a run."""

    start_s: float = field(default_factory=time.monotonic)
    faults: list[Happened] = field(default_factory=list)
    versions: dict[tuple[str, int], str] = field(default_factory=dict)
    """SHA-256 of each version that was acknowledged."""
    changes: dict[str, Changes] = field(default_factory=dict)
    jobs: dict[str, str] = field(default_factory=dict)
    """Verb of each refinement that was accepted."""
    done: Counter[str] = field(default_factory=Counter)
    """Operations and requests that succeeded, truncated connections, and actions of streams."""
    answers: list[Answer] = field(default_factory=list)
    outages: list[Outage] = field(default_factory=list)
    stalls: list[Stall] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Answers and messages that are not what the documents promise."""
    compared: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    """Number of poses whose measured value was computed again, and the largest difference, metres, by kind."""
    doubted: Counter[str] = field(default_factory=Counter)
    """Number of frames beyond the tolerance that no second frame of the same goal confirmed, by kind."""
    samples: list[Sample] = field(default_factory=list)
    down: list[tuple[float, float]] = field(default_factory=list)
    """Intervals in which no server ran: all were killed, and their restarts pause."""
    messages: int = 0
    gaps: int = 0
    dropped: int = 0
    _served_s: float = 0.0

    def now_s(self) -> float:
        """Seconds from the start."""
        return time.monotonic() - self.start_s

    def serves(self, at_s: float, *, running: bool) -> None:
        """At this time a server ran, or none; times are not more than some seconds apart."""
        if running:
            self._served_s = at_s
        elif self.down and self.down[-1][1] >= self._served_s:
            self.down[-1] = self.down[-1][0], at_s
        else:
            self.down.append((self._served_s, at_s))

    @property
    def last_down_s(self) -> float:
        """The last time at which no server ran."""
        return self.down[-1][1] if self.down else 0.0

    def of(self, verb: str) -> Changes:
        """What may be current for a verb."""
        return self.changes.setdefault(verb, Changes())

    def failed(self, began_s: float, what: str, problem: str) -> None:
        """A request did not succeed."""
        self.answers.append(Answer(began_s, self.now_s(), what, problem))

    def compare(self, kind: str, difference_m: float, count: int = 1) -> None:
        """Poses were computed again; NaN counts as infinite."""
        self.compared[kind] += count
        value = float("inf") if math.isnan(difference_m) else difference_m
        self.worst[kind] = max(self.worst.get(kind, 0.0), value)

    def fault(self, problem: str) -> None:
        """Something is wrong, wherever faults are."""
        if len(self.wrong) < 100:
            self.wrong.append(f"{self.now_s():.1f} s: {problem}")
