"""A client's session: its channels, its connection while it has one, and the count of what was sent and dropped."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.errors import ServiceError, UnknownChannel
from service.stream import kernels
from service.stream.connection import TOO_SLOW, Connection, DirectConnection, text
from service.stream.group import Form, Group
from service.stream.interest import Interest
from service.stream.kernels import CLOSED, U16, Lines
from service.stream.vmc import Sender
from service.wire import Layout
from verbs.conventions import F32, I64
from verbs.errors import VerbError

__all__ = ["MAX_PENDING", "TAKEN_OVER", "Channel", "LineTable", "Session"]

TAKEN_OVER = 4009
"""Close code of a connection whose session another connection resumed."""

MAX_PENDING = 256
"""Pending text messages of a slow client, plus one for each channel, beyond which its connection is closed."""

PUBLIC_CHARACTERS = 8

MAX_ADVERB = 1e9
"""Largest magnitude of an adverb."""


class LineTable:
    """Columns of all sessions, see :class:`service.stream.kernels.Lines`; a session has one row."""

    def __init__(self) -> None:
        self.lines = Lines(*(np.zeros(16, np.int64) for _ in Lines._fields))
        self._free = list(range(15, -1, -1))

    def take(self) -> int:
        """A row of zeros."""
        if not self._free:
            had = len(self.lines.mode)
            self.lines = Lines(*(np.concatenate([column, np.zeros_like(column)]) for column in self.lines))
            self._free = list(range(2 * had - 1, had - 1, -1))
        row = self._free.pop()
        for column in self.lines:
            column[row] = 0
        return row

    def give_back(self, row: int) -> None:
        """Free a row."""
        self.lines.mode[row] = CLOSED
        self._free.append(row)


@dataclass(slots=True, eq=False)
class Channel:
    """One character of a client.

    Parameters
    ----------
    number : int
        Chosen by the client.
    session : Session
    group : Group
    slot : int
        Slot of its character in the group.
    fps : int
    layout : Layout
    form : Form
        What the client asked its records to be; `switch` keeps it.
    events : bool
        Whether its keytimes are reported.
    support : bool
        Whether its records have the support by the examples.
    changes : bool
        Whether its record is sent where it differs from the one before only.
    priority : float
        Weight where the session has a byte budget.
    vmc : Sender or None
        Where its poses are sent to in addition.
    flags : int
        Flags of its next record, in addition to those of the frame.
    """

    number: int
    session: Session = field(repr=False)
    group: Group = field(repr=False)
    slot: int
    fps: int
    layout: Layout
    form: Form
    events: bool = True
    support: bool = False
    changes: bool = False
    priority: float = 1.0
    vmc: Sender | None = None
    flags: int = 0

    def head(self) -> int:
        """First word of its record, without the encoding and the flags of the frame."""
        return self.number | self.flags << 24

    @property
    def rests(self) -> bool:
        """Whether its character may rest."""
        return self.changes and self.session.interest is None and self.vmc is None

    def wake(self) -> None:
        """Bring its character up to date, if it rests, and send a record in the next tick."""
        if self.changes:
            self.group.rest.wake(self.slot, 1.0 / self.fps)
            self.session.fresh.add(self.number)

    def remove(self) -> None:
        """Remove its character."""
        self.group.rest.forget(self.slot)
        self.group.characters.remove(self.slot)


class Session:
    """State of a client that outlives its connection.

    Parameters
    ----------
    table : LineTable
    slow_s : float
        Longest time for which a client may read nothing.
    caller : str
        Id of the client's key; empty without.

    Attributes
    ----------
    arranged : dict
        How its messages are laid out, by the rates that are due together; see :mod:`service.stream.plan`.
    rates : Counter
        Number of channels of each fps.
    interest : Interest or None
        Priorities and budget, where the client has set a budget.
    fresh : set of int
        Channels whose next record is sent also if it does not differ.
    thinned : int
        Number of channels whose records are sent where they differ only.
    """

    def __init__(self, table: LineTable, *, slow_s: float, caller: str = "") -> None:
        self.caller = caller
        self.id, self._slow_s, self._table = secrets.token_urlsafe(16), slow_s, table
        self.row = table.take()
        self.channels: dict[int, Channel] = {}
        self.rates: Counter[int] = Counter()
        self.connection: Connection | None = None
        self.lost_at: float | None = None
        self.interest: Interest | None = None
        self.arranged: dict[frozenset[int], Any] = {}
        self.fresh: set[int] = set()
        self.thinned = 0
        self._aims: list[tuple[Group, I64, I64]] | None = None
        self._unread: tuple[int, int] | None = None

    # ── connection ───────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def public_id(self) -> str:
        """First characters of its id, for the log: with the whole id a stranger could resume the session."""
        return self.id[:PUBLIC_CHARACTERS]

    @property
    def connected(self) -> bool:
        """Whether the session has a connection."""
        return self.connection is not None

    @property
    def sequence(self) -> int:
        """Number of its last pose message."""
        return int(self._table.lines.sequence[self.row])

    @property
    def dropped(self) -> int:
        """Pose messages that were due and not sent, or sent and lost."""
        return int(self._table.lines.dropped[self.row])

    def attach(self, connection: Connection) -> None:
        """Use a connection, and close the one before."""
        if self.connection is not None:
            self.connection.end(TAKEN_OVER, "another connection resumed this session")
        self.connection, self.lost_at, self._unread = connection, None, None
        self.forget_sent()
        if isinstance(connection, DirectConnection):
            self._table.lines.socket[self.row] = connection.descriptor
        self.refresh()

    def detach(self, now_s: float) -> None:
        """Continue without a connection."""
        self.connection, self.lost_at = None, now_s
        self._table.lines.mode[self.row] = CLOSED

    def end(self) -> None:
        """Free its row; it is not used any more."""
        self.connection = None
        self._table.give_back(self.row)

    def refresh(self) -> bool:
        """Note whether pose messages can be sent now; return whether something waits to be sent."""
        if self.connection is None:
            return False
        self._table.lines.mode[self.row] = self.connection.mode
        return bool(self.connection.pending)

    def send_text(self, message: dict[str, Any]) -> None:
        """Send a text message, now or as soon as the client reads."""
        if self.connection is not None:
            self.connection.send_text(text(message), MAX_PENDING + len(self.channels))
            self.refresh()

    def send_error(self, channel: int | None, code: str, detail: str) -> None:
        """Send an error message."""
        self.send_text({"op": "error", "channel": channel, "code": code, "detail": detail})

    def was_dropped(self, due_ns: int) -> None:
        """Note that a message could not be sent; closes the connection of a client that does not read."""
        if self._unread is None or self._unread[0] != self.sequence:
            self._unread = self.sequence, due_ns
        elif self.connection is not None and due_ns - self._unread[1] > self._slow_s * 1e9:
            self.connection.end(TOO_SLOW, f"the client read nothing for {self._slow_s:g} s")

    def forget_sent(self) -> None:
        """Send the next record of each channel, since one before may not have arrived."""
        if self.thinned:
            for number, channel in self.channels.items():
                if channel.changes:
                    channel.group.rest.hurry(channel.slot)
                    self.fresh.add(number)

    def count_dropped(self, messages: int) -> None:
        """Count messages that were due and not sent, or sent over a lost connection and not received."""
        self._table.lines.dropped[self.row] += messages

    # ── channels ─────────────────────────────────────────────────────────────────────────────────────────────────

    def channel(self, number: int) -> Channel:
        """A channel; raises :class:`UnknownChannel`."""
        found = self.channels.get(number)
        if found is None:
            raise UnknownChannel(f"channel {number} is not open")
        return found

    def changed(self) -> None:
        """Discard what was derived from the channels."""
        self.arranged.clear()
        self._aims = None

    def aim(
        self, channels: U16, values: F32, *, whole: bool, report: Callable[[int, ServiceError | VerbError], None]
    ) -> None:
        """Set the goals of characters.

        Parameters
        ----------
        channels : (rows,) uint16
        values : (rows · D,) float32
        whole : bool
            Whether one wrong row rejects all of them; otherwise it is left out.
        report : callable
            Called with the channel and the error of each wrong row, or of the first one of a message.
        """
        width, start = len(values) // len(channels), 0
        while start < len(channels):
            wrong = self._aim(channels[start:], values[start * width :], width, whole=whole)
            if wrong < 0:
                return
            start += wrong
            number = int(channels[start])
            try:
                self.channel(number).group.check(values[start * width : (start + 1) * width])
            except (ServiceError, VerbError) as err:
                report(number, err)
            if whole:
                return
            start += 1

    def _aim(self, channels: U16, values: F32, width: int, *, whole: bool) -> int:
        """Set goals up to the first wrong row, or none if there is one in a ``whole`` message; that row, or -1."""
        groups = self._by_group()
        if len(groups) == 1 and groups[0][0].characters.goals.shape[1] == width:
            group, numbers, slots = groups[0]
            return int(kernels.aim(numbers, slots, channels, values, MAX_ADVERB, whole, group.characters.goals))
        rows = values.reshape(-1, width)
        fine = np.zeros(len(channels), np.bool_)
        found_in = []
        for group, numbers, slots in groups:
            if group.characters.goals.shape[1] == width:
                at = np.minimum(np.searchsorted(numbers, channels), len(numbers) - 1)
                found = numbers[at] == channels
                found_in.append((group, found, slots[at]))
                fine |= found
        fine &= np.all(np.abs(rows) <= MAX_ADVERB, axis=1)  # NaN compares false
        wrong = -1 if fine.all() else int(np.argmin(fine))
        count = len(channels) if wrong < 0 else 0 if whole else wrong
        for group, found, slots in found_in:
            chosen = np.flatnonzero(found[:count])
            group.characters.goals[slots[chosen]] = rows[chosen]
        return wrong

    def _by_group(self) -> list[tuple[Group, I64, I64]]:
        """Groups of the session, with channel numbers, rising, and slots."""
        if self._aims is None:
            by_group: dict[Group, list[tuple[int, int]]] = {}
            for number in sorted(self.channels):
                channel = self.channels[number]
                by_group.setdefault(channel.group, []).append((number, channel.slot))
            self._aims = [(group, *np.array(rows, np.int64).T.copy()) for group, rows in by_group.items()]
        return self._aims
