"""How the messages of a tick are arranged: offsets of records in one buffer, and the rows that are stepped together.

The arrangement of one session depends on its own channels only, and is kept until these change. A plan joins those of
all sessions, as arrays: channels of one group and rate stand together, whichever session they belong to.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from service.stream import rest
from service.stream.connection import BINARY, DirectConnection, frame_head
from service.stream.group import Group
from service.stream.session import Channel, Session
from service.wire import HEADER, HEADER_WORDS, OP_POSES, U8, U32, WIRE, Targets
from verbs.conventions import F64, I64

__all__ = ["Budgeted", "Part", "Plan", "Sent", "Thinned", "make"]

MAX_ARRANGED = 32
"""Arrangements of a session that are kept: one for each of its rates alone, and for some that are due together."""

MOVING = (2, 3)
"""Words of a record that change with time alone: phase and seconds."""

Flags = npt.NDArray[np.bool_]

HEAD_WORDS = 3
"""Words before each message, of which its WebSocket header takes the last 2, 4 or 10 bytes."""


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Channels of one session, one group and one rate; offsets count from the start of the session's message."""

    channels: list[Channel]
    slots: I64
    targets: Targets
    wanted: I64
    ranks: I64
    """Ranks of the channels among all of the message."""


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """What was sent last of the records of one message.

    Parameters
    ----------
    words : (W,) uint32
        The records; phase and time count for nothing.
    at_s : (R,) float64
        When, on the monotonic clock.
    starts : (R,) int64
        First word of each record.
    always : (R,) bool
        Records that are sent in every tick.
    """

    words: U32
    at_s: F64
    starts: I64
    always: Flags

    @classmethod
    def of(cls, channels: list[Channel]) -> Sent | None:
        """Nothing is sent yet; None where all records are sent in every tick."""
        if not any(channel.changes for channel in channels):
            return None
        sizes = np.array([channel.layout.words for channel in channels], np.int64)
        return cls(
            np.zeros(int(sizes.sum()), np.uint32),
            np.full(len(channels), -np.inf),
            np.cumsum(sizes) - sizes,
            np.array([not channel.changes for channel in channels]),
        )

    def choose(self, words: U32, due_s: float, fresh: Flags, stepped: Flags) -> Flags:
        """Which records (R,) to send, among those that were ``stepped`` (R,)."""
        differs = words != self.words
        for moving in MOVING:
            differs[self.starts + moving] = False
        differ = np.logical_or.reduceat(differs, self.starts)
        return (differ | self.always | fresh | (due_s - self.at_s >= rest.KEY_S)) & stepped


@dataclass(frozen=True, slots=True, eq=False)
class Thinned:
    """A message whose records are sent only where they differ from those sent last."""

    index: int
    session: Session
    numbers: I64
    sizes: I64
    sent: Sent
    records: slice
    """Its records among those of the tick."""


@dataclass(frozen=True, slots=True, eq=False)
class _Arranged:
    """The message of one session."""

    pieces: dict[tuple[Group, int], _Piece]
    words: int
    numbers: I64
    sizes: I64
    """Words of each record."""
    sent: Sent | None
    """Where some channels send changes only."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Characters of one group and one rate, and where their records are written.

    Parameters
    ----------
    group : Group
    fps : int
    channels : list of Channel
    slots : (B,) int64
    targets : Targets
    wanted : (B,) int64
        Whether events of a character are reported.
    supported : (S,) int64
        Rows whose records have the support by the examples.
    records : (B,) int64
        Numbers of their records among those of the tick.
    may_rest : (B,) bool or None
        Whose records are sent where they differ only; None where none are.
    vmc : (V,) int64
        Rows whose poses are sent to receivers of VMC in addition.
    """

    group: Group
    fps: int
    channels: list[Channel]
    slots: I64
    targets: Targets
    wanted: I64
    supported: I64
    records: I64
    may_rest: Flags | None
    vmc: I64

    def only(self, rows: I64) -> Part:
        """The part without the other rows; ``rows`` rise."""
        if len(rows) == len(self.slots):
            return self
        return Part(
            self.group, self.fps, [self.channels[row] for row in rows.tolist()], self.slots[rows],
            self.targets.only(rows), self.wanted[rows], np.flatnonzero(np.isin(rows, self.supported)),
            self.records[rows], None, np.flatnonzero(np.isin(rows, self.vmc)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Budgeted:
    """A message of which only some records are sent.

    Parameters
    ----------
    index : int
        Number of the message.
    session : Session
    numbers : (R,) int64
    sizes : (R,) int64
        Words of each record.
    pieces : list of (part, row, ranks)
        Where the records stand: a part, the first row of the session in it, and the ranks of its records.
    """

    index: int
    session: Session
    numbers: I64
    sizes: I64
    pieces: list[tuple[Part, int, I64]]

    def priorities(self) -> F64:
        """Priorities (R,) of the channels."""
        found = np.empty(len(self.numbers))
        for part, row, ranks in self.pieces:
            found[ranks] = [channel.priority for channel in part.channels[row : row + len(ranks)]]
        return found

    def positions(self) -> F64:
        """Positions (R, 3) of the characters."""
        found = np.zeros((len(self.numbers), 3))
        for part, row, ranks in self.pieces:
            state = part.group.characters.state[part.slots[row : row + len(ranks)]]
            found[ranks, 0], found[ranks, 2] = state["x"], state["z"]
        return found


@dataclass(slots=True, eq=False)
class Plan:
    """All messages of one tick.

    Parameters
    ----------
    parts : list of Part
    sessions : list of Session
        Of each message.
    starts, heads, sizes, rows : (M,) int64
        See :func:`service.stream.kernels.send_messages`.
    words : (W,) uint32
    budgeted : list of Budgeted
    thinned : list of Thinned
    stepped : (R,) bool
        Records whose characters the tick stepped; kept where some messages are thinned.
    cost_s : float
        Time that the last ticks took to prepare, seconds.
    """

    parts: list[Part]
    sessions: list[Session]
    starts: I64
    heads: I64
    sizes: I64
    rows: I64
    words: U32
    budgeted: list[Budgeted] = field(default_factory=list)
    thinned: list[Thinned] = field(default_factory=list)
    stepped: Flags = field(default_factory=lambda: np.zeros(0, np.bool_))
    cost_s: float = 0.0

    @property
    def data(self) -> U8:
        """The buffer as bytes."""
        return self.words.view(np.uint8)

    def set_message(self, index: int, records: int, size: int) -> None:
        """Write the parts of a message's headers that do not change from tick to tick; size 0: nothing is due."""
        head = frame_head(BINARY, size)
        start = 4 * int(self.starts[index])
        self.heads[index], self.sizes[index] = len(head), size
        if size:
            self.data[start - len(head) : start] = np.frombuffer(head, np.uint8)
            HEADER.pack_into(self.data.data, start, OP_POSES, WIRE, records, 0, 0, 0)

    def _records(self, thinned: Thinned) -> U32:
        """The words of the records of a message, without its header."""
        start = int(self.starts[thinned.index]) + HEADER_WORDS
        return self.words[start : start + len(thinned.sent.words)]

    def awake(self, step_s: dict[int, float]) -> list[Part]:
        """The parts without characters that rest, of a tick with steps by fps; notes which are ``stepped``."""
        if not self.thinned and all(part.may_rest is None for part in self.parts):
            return self.parts
        self.stepped[:] = False
        found = []
        for part in self.parts:
            awake = part
            if part.may_rest is not None:
                awake = part.only(part.group.rest.choose(part.slots, part.may_rest, part.wanted, step_s[part.fps]))
            self.stepped[awake.records] = True
            if len(awake.slots):
                found.append(awake)
        return found

    def clear(self) -> list[Thinned]:
        """Empty the thinned messages; return those with characters that are stepped, cleared of the tick before."""
        found = []
        for thinned in self.thinned:
            if self.sizes[thinned.index]:
                self.set_message(thinned.index, 0, 0)
            if self.stepped[thinned.records].any():
                self._records(thinned)[:] = 0
                found.append(thinned)
        return found

    def thin(self, thinned: Thinned, due_s: float) -> None:
        """Keep the records of a message that are to be sent, without gaps."""
        words, sent, session = self._records(thinned), thinned.sent, thinned.session
        fresh = np.isin(thinned.numbers, list(session.fresh)) if session.fresh else np.zeros(len(sent.at_s), np.bool_)
        keep = sent.choose(words, due_s, fresh, self.stepped[thinned.records])
        session.fresh.difference_update(thinned.numbers[keep].tolist())
        mask = np.repeat(keep, thinned.sizes)
        kept = words[mask]
        sent.words[mask], sent.at_s[keep] = kept, due_s
        words[: len(kept)] = kept
        count = int(np.count_nonzero(keep))
        self.set_message(thinned.index, count, 4 * (HEADER_WORDS + len(kept)) if count else 0)


def make(sessions: Iterable[Session], rates: frozenset[int]) -> Plan:
    """Arrange the messages of the sessions' channels whose rates are due."""
    chosen = [session for session in sessions if not rates.isdisjoint(session.rates)]
    arranged = [_arranged(session, rates) for session in chosen]
    lengths = np.array([HEAD_WORDS + one.words for one in arranged], np.int64)
    starts = np.cumsum(lengths) - lengths + HEAD_WORDS
    count = len(chosen)
    plan = Plan(
        [], chosen, starts, np.zeros(count, np.int64), np.zeros(count, np.int64),
        np.array([session.row for session in chosen], np.int64), np.zeros(int(lengths.sum()), np.uint32),
    )  # fmt: skip
    largest = 0
    for index, one in enumerate(arranged):
        plan.set_message(index, len(one.numbers), 4 * one.words)
        connection = chosen[index].connection
        if isinstance(connection, DirectConnection):
            connection.fit(4 * one.words)
        largest = max(largest, one.words)
    by_key: dict[tuple[Group, int], list[int]] = {}
    for index, one in enumerate(arranged):
        for key in one.pieces:
            by_key.setdefault(key, []).append(index)
    budgeted = {
        index: Budgeted(index, session, one.numbers, one.sizes, [])
        for index, (session, one) in enumerate(zip(chosen, arranged, strict=True))
        if session.interest is not None and session.connected
    }
    firsts = np.cumsum([0, *(len(one.numbers) for one in arranged)])
    plan.stepped = np.ones(int(firsts[-1]), np.bool_)
    for key, indices in by_key.items():
        pieces = [arranged[index].pieces[key] for index in indices]
        bases = [int(starts[index]) if chosen[index].connected else -1 for index in indices]
        part = _part(key, pieces, bases, firsts[indices])
        plan.parts.append(part)
        row = 0
        for index, piece in zip(indices, pieces, strict=True):
            if index in budgeted:
                budgeted[index].pieces.append((part, row, piece.ranks))
            row += len(piece.slots)
    plan.budgeted = list(budgeted.values())
    plan.thinned = [
        Thinned(index, session, one.numbers, one.sizes, one.sent, slice(firsts[index], firsts[index + 1]))
        for index, (session, one) in enumerate(zip(chosen, arranged, strict=True))
        if one.sent is not None and session.connected and session.interest is None
    ]
    return plan


def _part(key: tuple[Group, int], pieces: list[_Piece], bases: list[int], firsts: I64) -> Part:
    """Join pieces whose messages start at these words and records; a word of -1: their records are not written."""
    group, fps = key
    counts = [len(piece.slots) for piece in pieces]
    at = np.concatenate([piece.targets.at + base if base >= 0 else np.full(count, -1) for piece, base, count
                         in zip(pieces, bases, counts, strict=True)])  # fmt: skip
    joined = Targets.joined([piece.targets for piece in pieces])._replace(at=at.astype(np.int64))
    channels = [channel for piece in pieces for channel in piece.channels]
    return Part(
        group,
        fps,
        channels,
        np.concatenate([piece.slots for piece in pieces]),
        joined,
        np.concatenate([piece.wanted for piece in pieces]),
        np.flatnonzero([channel.support for channel in channels]),
        np.concatenate([piece.ranks + first for piece, first in zip(pieces, firsts.tolist(), strict=True)]),
        np.array([channel.rests for channel in channels]) if any(channel.changes for channel in channels) else None,
        np.flatnonzero([channel.vmc is not None for channel in channels]),
    )


def _arranged(session: Session, rates: frozenset[int]) -> _Arranged:
    """Arrangement of a session's message, kept until its channels change."""
    own = rates.intersection(session.rates)
    found: _Arranged | None = session.arranged.get(own)
    if found is None:
        if len(session.arranged) >= MAX_ARRANGED:
            session.arranged.clear()
        found = session.arranged[own] = _arrange(session, own)
    return found


def _arrange(session: Session, rates: frozenset[int]) -> _Arranged:
    channels = [session.channels[number] for number in sorted(session.channels)]
    channels = [channel for channel in channels if channel.fps in rates]
    by_key: dict[tuple[Group, int], list[tuple[Channel, int, int]]] = {}
    word = HEADER_WORDS
    for rank, channel in enumerate(channels):
        by_key.setdefault((channel.group, channel.fps), []).append((channel, word, rank))
        word += channel.layout.words
    return _Arranged(
        {key: _piece(rows) for key, rows in by_key.items()},
        word,
        np.array([channel.number for channel in channels], np.int64),
        np.array([channel.layout.words for channel in channels], np.int64),
        Sent.of(channels),
    )


def _piece(rows: list[tuple[Channel, int, int]]) -> _Piece:
    channels = [channel for channel, _, _ in rows]
    return _Piece(
        channels,
        np.array([channel.slot for channel in channels], np.int64),
        Targets.of(
            [channel.layout for channel in channels],
            [at for _, at, _ in rows],
            [channel.head() for channel in channels],
        ),
        np.array([channel.events for channel in channels], np.int64),
        np.array([rank for _, _, rank in rows], np.int64),
    )
