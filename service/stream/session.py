"""A client's session: its channels, its connection while it has one, and what waits to be sent.

Poses never wait: what cannot be sent now is dropped and counted. Text messages wait, in order, up to a bound.
"""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Coroutine, MutableMapping
from typing import TYPE_CHECKING, Any

import anyio
import orjson
from starlette.types import Send

from service.stream.packing import HEADER, OP_POSES, WIRE
from service.stream.transport import Sockets

if TYPE_CHECKING:
    from service.stream.channel import Channel
    from service.stream.ticker import Beat

__all__ = ["MAX_WAITING", "TAKEN_OVER", "TOO_SLOW", "Connection", "Session", "text"]

TOO_SLOW, TAKEN_OVER = 4008, 4009

MAX_WAITING = 256
"""Text messages that wait for a slow client, and one more for each channel; with another one it is cut off."""


def text(message: dict[str, Any]) -> str:
    """A text message as it is sent."""
    return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def _now(sending: Coroutine[Any, Any, None]) -> bool:
    """Run a ``send`` that may take effect at once or not at all; whether it did.

    The server's ``send`` waits for room before it writes anything. So it is taken one step: it ends there, having
    written everything, or it waits, having written nothing, and is dropped. A test holds uvicorn to that.
    """
    try:
        sending.send(None)
    except StopIteration:
        return True
    sending.close()
    return False


class Connection:
    """A WebSocket, seen from the side that sends.

    Parameters
    ----------
    send : callable
        ASGI's.
    scope : anyio.CancelScope
        Cancelled to end the connection; ``ending`` says with which code and why.
    socket : Sockets, optional
        A shorter way for poses.
    """

    def __init__(self, send: Send, scope: anyio.CancelScope, socket: Sockets | None = None) -> None:
        self._send, self._scope, self._socket, self.gone = send, scope, socket, False
        self.ending: tuple[int, str] | None = None
        self.waiting: deque[str] = deque()

    def end(self, code: int, reason: str) -> None:
        """End it; the endpoint that runs it sends the close frame."""
        if self.ending is None:
            self.ending = code, reason
            self._scope.cancel()

    def say(self, message: str, room: int) -> None:
        """Send a text message now, or after those that wait, which may be so many."""
        if len(self.waiting) >= room:
            self.end(TOO_SLOW, f"{room} messages wait to be read")
            return
        self.waiting.append(message)
        self.flush()

    def flush(self) -> bool:
        """Send what waits; whether nothing is left."""
        while self.waiting:
            if not self._try({"type": "websocket.send", "text": self.waiting[0]}):
                return False
            self.waiting.popleft()
        return True

    def post(self, message: bytes) -> bool:
        """Send a binary message now or not at all; whether it was sent."""
        if self.ending is not None or (self.waiting and not self.flush()):
            return False
        if self._socket is None:
            return self._try({"type": "websocket.send", "bytes": message})
        try:
            return self._socket.post(message)
        except ConnectionError:  # its endpoint will notice
            self.gone = True
            return False

    def _try(self, message: MutableMapping[str, Any]) -> bool:
        if self.ending is not None:
            return False
        try:
            return _now(self._send(message))  # type: ignore[arg-type]
        except Exception:  # in one of several ways; its endpoint will notice
            self.gone = True
            return False


class Session:
    """What outlives a connection.

    Parameters
    ----------
    beat : Beat
    slow_s : float
        How long a client may read nothing.
    """

    def __init__(self, beat: Beat, *, slow_s: float) -> None:
        self.id, self.beat, self._slow_s = secrets.token_urlsafe(16), beat, slow_s
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
        self.beat.changed()

    def detach(self, now_s: float) -> None:
        """Go on without a connection."""
        self.connection, self.lost_at = None, now_s
        self.beat.changed()

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
