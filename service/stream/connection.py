"""The sending side of a WebSocket, used by the engine's thread.

A socket has one writer. Where a connection is direct, that is the engine's thread: it writes pose messages, texts and
the control frames of the WebSocket library, in order, to a duplicate of the socket. Elsewhere (TLS, another server
program) the event loop writes, by ASGI's ``send``, what the engine's thread leaves in a queue.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Coroutine, MutableMapping
from typing import Any

import orjson
from starlette.types import Send

from service.stream.kernels import BY_LOOP, CLOSED, DIRECT

__all__ = ["BINARY", "TEXT", "TOO_SLOW", "Connection", "DirectConnection", "LoopConnection", "frame_head", "text"]

TOO_SLOW = 4008
"""Close code of a client that does not read."""

TEXT, BINARY = 0x81, 0x82
"""First bytes of the final frames of text and of binary messages (RFC 6455, section 5.2)."""

CLOSE_S = 5.0
"""Time in which a connection that is being closed may still send what waits."""

POLL_S = 0.005
"""Interval at which a connection whose client does not read is tried again."""

MAX_WAITING = 4_096
"""Waiting frames beyond which a connection is cut; text messages have a lower limit of their own."""


def text(message: dict[str, Any]) -> bytes:
    """JSON of a text message."""
    return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY)


def frame_head(first: int, size: int) -> bytes:
    """Frame header of a message of this length (RFC 6455, section 5.2)."""
    if size < 126:
        return bytes((first, size))
    if size < 65_536:
        return struct.pack("!BBH", first, 126, size)
    return struct.pack("!BBQ", first, 127, size)


class Connection(ABC):
    """A WebSocket's sending side.

    Parameters
    ----------
    loop : asyncio.AbstractEventLoop
    cancel : callable
        Called in the event loop when the server closes the connection; ``ending`` has code and reason then.

    Attributes
    ----------
    posted, handled : int
        Messages of the client that were handed to the engine, and of these the ones that it has handled.
    pending : deque
        What waits to be sent.
    lost : bool
        Whether the peer is gone.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, cancel: Callable[[], None]) -> None:
        self._loop, self._cancel = loop, cancel
        self.posted = self.handled = 0
        self.ending: tuple[int, str] | None = None
        self.lost = False
        self.pending: deque[bytes | MutableMapping[str, Any]] = deque()

    @property
    def backlog(self) -> int:
        """Messages of the client that are not handled yet."""
        return self.posted - self.handled

    @property
    @abstractmethod
    def mode(self) -> int:
        """How a pose message can be sent now; see :mod:`service.stream.kernels`."""

    def end(self, code: int, reason: str) -> None:
        """Close the connection; its endpoint sends the close frame."""
        if self.ending is None:
            self.ending = code, reason
            self._call(self._cancel)

    def send_text(self, message: bytes, limit: int) -> None:
        """Send a text message now or after what waits; closes the connection if ``limit`` items wait."""
        if self.ending is not None or self.lost:
            return
        if len(self.pending) >= limit:
            self.end(TOO_SLOW, f"{limit} messages are unread")
            return
        self._put_text(message)

    @abstractmethod
    def flush(self) -> bool:
        """Send what waits; return whether nothing is left."""

    def cut(self) -> None:
        """Send nothing more."""
        self.lost = True

    @abstractmethod
    def _put_text(self, message: bytes) -> None:
        """Send a text message after what waits."""

    def _call(self, function: Callable[[], None]) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function)


class DirectConnection(Connection):
    """A connection whose socket the engine's thread writes.

    Parameters
    ----------
    loop, cancel
        See :class:`Connection`.
    connection : socket.socket
        Duplicate of the transport's socket; closed by :meth:`close`.
    close_transport : callable
        Called in the event loop when everything is sent.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        cancel: Callable[[], None],
        connection: socket.socket,
        close_transport: Callable[[], None],
    ) -> None:
        super().__init__(loop, cancel)
        self._socket, self._close_transport = connection, close_transport
        self.descriptor = connection.fileno()
        self._close_by_s: float | None = None
        self._sized = 0

    @property
    def mode(self) -> int:
        """:data:`DIRECT` where nothing waits."""
        return CLOSED if self.pending or self.lost or self.ending is not None else DIRECT

    def fit(self, size: int) -> None:
        """Limit what the kernel keeps unsent to two messages of a length, so that a slow client gets fresh poses."""
        if size > self._sized and hasattr(socket, "TCP_NOTSENT_LOWAT") and not self.lost:
            self._sized = size
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 2 * size)

    def write(self, data: bytes) -> None:
        """Send bytes of whole frames, now or after what waits."""
        if self.lost:
            return
        if len(self.pending) >= MAX_WAITING:
            self.cut()
            return
        self.pending.append(data)
        self.flush()

    def keep(self, rest: bytes) -> None:
        """Keep the rest of a frame that was sent in part; nothing else is sent before it."""
        self.pending.appendleft(rest)

    def flush(self) -> bool:
        """Send what waits; return whether nothing is left. Closes the socket after that, or after :data:`CLOSE_S`."""
        while self.pending and not self.lost:
            data = self.pending[0]
            assert isinstance(data, bytes)
            try:
                sent = self._socket.send(data)
            except BlockingIOError:
                break
            except OSError:  # its endpoint detects it too
                self.cut()
                break
            if sent < len(data):
                self.pending[0] = data[sent:]
                break
            self.pending.popleft()
        if self._close_by_s is not None and (not self.pending or time.monotonic() > self._close_by_s):
            self.cut()
        return not self.pending

    def close(self) -> None:
        """Close the socket once everything is sent, and the transport after it."""
        if self._close_by_s is None:
            self._close_by_s = time.monotonic() + CLOSE_S
            self.flush()

    def _put_text(self, message: bytes) -> None:
        self.write(frame_head(TEXT, len(message)) + message)

    def cut(self) -> None:
        """Close the socket now."""
        if self._socket.fileno() >= 0:
            self.lost = True
            self.pending.clear()
            self._socket.close()
            self._call(self._close_transport)


class LoopConnection(Connection):
    """A connection that the event loop writes.

    Parameters
    ----------
    loop, cancel
        See :class:`Connection`.
    send : callable
        ASGI's.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, cancel: Callable[[], None], send: Send) -> None:
        super().__init__(loop, cancel)
        self._send, self._delivering, self._has_pose = send, False, False

    @property
    def mode(self) -> int:
        """:data:`BY_LOOP` where no pose message waits."""
        return CLOSED if self._has_pose or self.lost or self.ending is not None else BY_LOOP

    def post(self, message: bytes) -> None:
        """Send a pose message after what waits."""
        self._has_pose = True
        self._put({"type": "websocket.send", "bytes": message})

    def flush(self) -> bool:
        """Whether nothing is left; the event loop sends."""
        return not self.pending

    def _put_text(self, message: bytes) -> None:
        self._put({"type": "websocket.send", "text": message.decode()})

    def _put(self, message: MutableMapping[str, Any]) -> None:
        self.pending.append(message)
        if not self._delivering:
            self._delivering = True
            self._call(self._deliver)

    def _deliver(self) -> None:
        self._delivering = False
        while self.pending and not self.lost:
            message = self.pending[0]
            assert not isinstance(message, bytes)
            try:
                if not _run_once(self._send(message)):  # type: ignore[arg-type]
                    self._delivering = True
                    self._loop.call_later(POLL_S, self._deliver)
                    return
            except Exception:  # of one of several kinds; its endpoint detects it too
                self.lost = True
                return
            self.pending.popleft()
            self._has_pose = self._has_pose and "bytes" not in message


def _run_once(sending: Coroutine[Any, Any, None]) -> bool:
    """Run a ``send`` coroutine for one step; return whether it finished.

    uvicorn's ``send`` waits for buffer space before it writes anything. After one step it either has written the whole
    message and finished, or has written nothing and is closed here. A test checks that uvicorn behaves so.
    """
    try:
        sending.send(None)
    except StopIteration:
        return True
    sending.close()
    return False
