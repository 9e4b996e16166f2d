"""A client's session: its channels, its connection while it has one, and the count of what was sent and dropped."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

from service.stream.connection import TOO_SLOW, Connection, text
from service.stream.group import Group
from service.stream.messages import Open
from service.stream.packing import HEADER, OP_POSES, WIRE, Layout

__all__ = ["MAX_WAITING", "TAKEN_OVER", "Channel", "Session"]

TAKEN_OVER = 4009
"""Close code of a connection whose session another connection resumed."""

MAX_WAITING = 256
"""Text messages that wait for a slow client, and one more for each channel; with another one it is cut off."""


class Session:
    """What outlives a connection.

    Parameters
    ----------
    slow_s : float
        How long a client may read nothing.
    """

    def __init__(self, *, slow_s: float) -> None:
        self.id, self._slow_s = secrets.token_urlsafe(16), slow_s
        self.channels: dict[int, Channel] = {}
        self.connection: Connection | None = None
        self.lost_at: float | None = None
        self.sequence = self.dropped = 0
        self._stuck_since_ns: int | None = None

    @property
    def connected(self) -> bool:
        """Whether somebody listens."""
        return self.connection is not None

    def attach(self, connection: Connection) -> None:
        """Serve this connection, and no other any more."""
        if self.connection is not None:
            self.connection.end(TAKEN_OVER, "another connection resumed this session")
        self.connection, self.lost_at, self._stuck_since_ns = connection, None, None

    def detach(self, now_s: float) -> None:
        """Go on without a connection."""
        self.connection, self.lost_at = None, now_s

    def say(self, message: dict[str, Any]) -> None:
        """Send a text message, now or as soon as the client reads."""
        if self.connection is not None:
            self.connection.say(text(message), MAX_WAITING + len(self.channels))

    def post(self, message: memoryview, records: int, due_ns: int) -> bool:
        """Send a pose message now, or drop and count it; whether it was sent. Its first bytes become the header."""
        connection = self.connection
        if connection is None:
            self.dropped += 1
            return False
        sequence = self.sequence + 1 & 0xFFFFFFFF
        HEADER.pack_into(message, 0, OP_POSES, WIRE, records, sequence, due_ns, self.dropped & 0xFFFFFFFF)
        if connection.post(bytes(message)):
            self.sequence, self._stuck_since_ns = sequence, None
            return True
        self.dropped += 1
        if self._stuck_since_ns is None:
            self._stuck_since_ns = due_ns
        elif due_ns - self._stuck_since_ns > self._slow_s * 1e9:
            connection.end(TOO_SLOW, f"nothing was read for {self._slow_s:g} s")
        return False

    def lost(self, last_seq: int) -> None:
        """Count what was sent over a lost connection and never arrived."""
        self.dropped += max(0, self.sequence - last_seq)


@dataclass(slots=True, eq=False)
class Channel:
    """One character as one client sees it.

    Parameters
    ----------
    number : int
        The client's own.
    session : Session
    group : Group
    slot : int
        Its character in the group.
    fps : int
    layout : Layout
    asked : Open
        How it was opened: what `switch` keeps.
    flags : int
        Bits that its next record carries beside those of its frame.
    """

    number: int
    session: Session = field(repr=False)
    group: Group = field(repr=False)
    slot: int
    fps: int
    layout: Layout
    asked: Open
    flags: int = 0

    def head(self) -> int:
        """First word of its record, without encoding and what the frame tells."""
        return self.number | self.flags << 24
