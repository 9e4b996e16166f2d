"""The schedule of a run: faults, operations and streams, all drawn from one seed before anything starts.

The same seed gives the same schedule. What the processes do between two entries of it is up to the machine.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "CUT", "DATABASE", "FAULTS", "NETWORK", "OWN", "PUBLISHED", "SERVERS", "WORKERS", "Fault", "Operation", "Plan",
    "StreamPlan",
]  # fmt: skip

SERVERS = ("kill server", "kill all servers", "stop server")
WORKERS = ("kill worker", "stop worker")
NETWORK = ("cut streams",)
DATABASE = ("stop database", "freeze database")
"""Kinds of faults. ``kill`` is SIGKILL, ``stop`` of a process SIGTERM. ``cut`` resets connections of some clients. The
database is stopped as by a crash, and frozen by SIGSTOP."""

FAULTS = (
    "kill server", "kill server", "kill server", "kill all servers", "stop server",
    "kill worker", "kill worker", "stop worker", "stop database", "freeze database", "cut streams",
)  # fmt: skip
"""One deck of faults; decks are shuffled, so that every kind occurs early."""

CUT = 10
"""One stream of this number loses its connection when streams are cut."""
FIRST_FAULT_S = 10.0
GAP_S = (9.0, 17.0)
"""Shortest and longest time between the end of a fault and the next fault, seconds."""
LAST_FAULT_S = 5.0
"""No fault ends later than this before the end of the run, seconds."""
STOPPED_S, FROZEN_S = (2.0, 10.0), (2.0, 8.0)
"""Shortest and longest time of a stopped and of a frozen database, seconds."""

OWN = ("chaos-0", "chaos-1", "chaos-2")
"""Verbs that one author each publishes, activates, refines and deletes."""
PUBLISHED = ("reach", "punch", "board")
"""Built-in verbs that are streamed while an author publishes, activates and refines versions of them."""

_OF_OWN = ("upload verb", "upload verb", "upload source", "roll back", "roll forward", "refine", "delete")
_OF_PUBLISHED = ("upload verb", "upload verb", "roll back", "roll forward", "refine")
PAUSE_S = (3.0, 9.0)
"""Shortest and longest time between two operations of an author, seconds."""

_STREAMED = ("reach", "punch", "kick", "board", "jump", "lift", "arm3", "walk", "jog", "locomotion", "mood")
_MEASURED = ("reach", "punch", "kick")
"""Verbs whose adverbs are the position of a joint, so that clients can check a pose."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Parameters
    ----------
    at_s : float
        From the start, seconds.
    kind : str
        One of :data:`FAULTS`.
    pick : int
        Which of the processes that live then, in order of ids, modulo their number.
    seconds : float
        How long the database is away; 0 for processes.
    """

    at_s: float
    kind: str
    pick: int = 0
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Kind and length."""
        return f"{self.kind} for {self.seconds:.1f} s" if self.seconds else self.kind


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation of an author, at its time or when the author's operation before has ended.

    Parameters
    ----------
    at_s : float
    author : int
        0 to 2 for :data:`OWN`; 3 for :data:`PUBLISHED`.
    verb, kind : str
    pick : int
        Chooses among versions, or parameters of a refinement.
    """

    at_s: float
    author: int
    verb: str
    kind: str
    pick: int


@dataclass(frozen=True, slots=True)
class StreamPlan:
    """One stream: all its channels play one verb.

    Parameters
    ----------
    verb, encoding : str
    fps, channels : int
    held : bool
        Whether it rests at the effector's keytime, so that each pose can be compared with its goal.
    seed : int
        Of the client's own actions.
    """

    verb: str
    encoding: str
    fps: int
    channels: int
    held: bool
    seed: int


@dataclass(frozen=True, slots=True)
class Plan:
    """A whole run."""

    seed: int
    seconds: float
    faults: tuple[Fault, ...]
    operations: tuple[Operation, ...]
    streams: tuple[StreamPlan, ...]

    @classmethod
    def of(cls, seed: int, seconds: float, streams: int, kinds: Sequence[str] = FAULTS) -> Plan:
        """The schedule of a seed.

        Parameters
        ----------
        seed : int
        seconds : float
            Length of the run.
        streams : int
        kinds : sequence of str
            The deck of faults.
        """
        faults, operations, clients = (random.Random(f"{seed} {part}") for part in ("faults", "authors", "streams"))
        return cls(
            seed,
            seconds,
            tuple(_faults(faults, seconds, kinds)),
            tuple(_operations(operations, seconds)),
            tuple(_stream(clients, number) for number in range(streams)),
        )

    def lines(self) -> list[str]:
        """The schedule as text."""
        faults = [f"  {row.at_s:7.1f} s  {row.name}" for row in self.faults]
        kinds = Counter(row.kind for row in self.operations)
        encodings = Counter(row.encoding for row in self.streams)
        return [
            f"schedule of seed {self.seed}: {self.seconds:g} s, {len(self.faults)} faults, "
            f"{len(self.operations)} operations of authors, {len(self.streams)} streams",
            *faults,
            f"operations: {', '.join(f'{kind} {count}' for kind, count in sorted(kinds.items()))}",
            f"streams: {', '.join(f'{name} {count}' for name, count in sorted(encodings.items()))}; "
            f"{sum(row.channels for row in self.streams)} channels, "
            f"{sum(row.fps for row in self.streams)} messages/s, {sum(row.held for row in self.streams)} held",
        ]


def _faults(rng: random.Random, seconds: float, kinds: Sequence[str]) -> list[Fault]:
    found: list[Fault] = []
    at_s = FIRST_FAULT_S
    deck: list[str] = []
    while True:
        deck = deck or rng.sample(list(kinds), len(kinds))
        kind = deck.pop()
        lengths = {"stop database": STOPPED_S, "freeze database": FROZEN_S}
        length_s = round(rng.uniform(*lengths[kind]), 1) if kind in lengths else 0.0
        if at_s + length_s > seconds - LAST_FAULT_S:
            return found
        found.append(Fault(round(at_s, 1), kind, rng.randrange(1 << 16), length_s))
        at_s += length_s + rng.uniform(*GAP_S)


def _operations(rng: random.Random, seconds: float) -> list[Operation]:
    found = []
    for author in range(len(OWN) + 1):
        at_s, kinds = rng.uniform(0.5, PAUSE_S[0]), _OF_OWN if author < len(OWN) else _OF_PUBLISHED
        first = True
        while at_s < seconds:
            verb = OWN[author] if author < len(OWN) else rng.choice(PUBLISHED)
            kind = "upload verb" if first else rng.choice(kinds)
            found.append(Operation(round(at_s, 2), author, verb, kind, rng.randrange(1 << 16)))
            at_s, first = at_s + rng.uniform(*PAUSE_S), False
    return sorted(found, key=lambda row: (row.at_s, row.author))


def _stream(rng: random.Random, number: int) -> StreamPlan:
    """A third of the streams rest at the keytime, in the encodings that have a pose."""
    held = number % 3 == 0
    return StreamPlan(
        verb=rng.choice(_MEASURED if held else _STREAMED),
        encoding=rng.choice(("f32", "f32", "q48", "q32") if held else ("f32", "q48", "q32", "weights")),
        fps=rng.choice((8, 10, 10, 12, 20)),
        channels=rng.choice((1, 1, 1, 2, 4)),
        held=held,
        seed=rng.getrandbits(32),
    )
