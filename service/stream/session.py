"""A client's session: its channels, its connection while it has one, and the count of what was sent and dropped."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

from service.stream.connection import TOO_SLOW, Connection, text
from service.stream.group import Group
from service.stream.messages import Open
from service.wire import HEADER, OP_POSES, WIRE, Layout

__all__ = ["MAX_PENDING", "TAKEN_OVER", "Channel", "Session"]

TAKEN_OVER = 4009
"""Close code of a connection whose session another connection resumed."""

MAX_PENDING = 256
"""Pending text messages of a slow client, plus one for each channel, beyond which its connection is closed."""


class Session:
    """State of a client that outlives its connection.

    Parameters
    ----------
    slow_s : float
        Longest time for which a client may read nothing.
    """

    def __init__(self, *, slow_s: float) -> None:
        self.id, self._slow_s = secrets.token_urlsafe(16), slow_s
        self.channels: dict[int, Channel] = {}
        self.connection: Connection | None = None
        self.lost_at: float | None = None
        self.sequence = self.dropped = 0
        self._unread_since_ns: int | None = None

    @property
    def connected(self) -> bool:
        """Whether the session has a connection."""
        return self.connection is not None

    def attach(self, connection: Connection) -> None:
        """Use a connection, and close the one before."""
        if self.connection is not None:
            self.connection.end(TAKEN_OVER, "another connection resumed this session")
        self.connection, self.lost_at, self._unread_since_ns = connection, None, None

    def detach(self, now_s: float) -> None:
        """Continue without a connection."""
        self.connection, self.lost_at = None, now_s

    def send_text(self, message: dict[str, Any]) -> None:
        """Send a text message, now or as soon as the client reads."""
        if self.connection is not None:
            self.connection.send_text(text(message), MAX_PENDING + len(self.channels))

    def send_poses(self, message: memoryview, records: int, due_ns: int) -> bool:
        """Write the header and send a pose message, or drop and count it; return whether it was sent."""
        connection = self.connection
        if connection is None:
            self.dropped += 1
            return False
        sequence = self.sequence + 1 & 0xFFFFFFFF
        HEADER.pack_into(message, 0, OP_POSES, WIRE, records, sequence, due_ns, self.dropped & 0xFFFFFFFF)
        if connection.send_binary(bytes(message)):
            self.sequence, self._unread_since_ns = sequence, None
            return True
        self.dropped += 1
        if self._unread_since_ns is None:
            self._unread_since_ns = due_ns
        elif due_ns - self._unread_since_ns > self._slow_s * 1e9:
            connection.end(TOO_SLOW, f"the client read nothing for {self._slow_s:g} s")
        return False

    def count_lost(self, last_seq: int) -> None:
        """Count messages that were sent over a lost connection and did not arrive."""
        self.dropped += max(0, self.sequence - last_seq)


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
    request : Open
        How it was opened; `switch` keeps its options.
    flags : int
        Flags of its next record, in addition to those of the frame.
    """

    number: int
    session: Session = field(repr=False)
    group: Group = field(repr=False)
    slot: int
    fps: int
    layout: Layout
    request: Open
    flags: int = 0

    def head(self) -> int:
        """First word of its record, without the encoding and the flags of the frame."""
        return self.number | self.flags << 24
