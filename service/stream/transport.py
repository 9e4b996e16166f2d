"""uvicorn WebSocket protocol with a fast path for incoming adverbs, whose socket the engine's thread may write.

ASGI's ``receive`` costs a coroutine, a dictionary, a queue and several copies for each message, and the library's
parser more than that. Messages of adverbs at the front of a read are decoded by one compiled call instead, while no
earlier message waits. The endpoint finds the protocol at ``scope["extensions"][TRANSPORT]``; under another server it is
missing, and ``send`` and ``receive`` are used.

This is the only file that touches private parts of uvicorn and websockets; ``tests/service/stream/test_transport.py``
fails when they change.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from uvicorn._types import ASGISendEvent
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode
from websockets.http11 import Request
from websockets.protocol import State

from service.stream import kernels
from service.stream.kernels import INCOMPLETE, MAX_FRAME, MORE, U16
from service.wire import OP_MANY
from verbs.conventions import F32

__all__ = ["TRANSPORT", "StreamProtocol", "Writer"]

TRANSPORT = "adverb.transport"

UNSENT_BYTES = 16_384
"""Unsent bytes that uvicorn and the kernel keep of one connection."""

_CHANNELS, _VALUES = np.empty(MAX_FRAME // 8, np.uint16), np.empty(MAX_FRAME // 4, np.float32)
_RESULT = np.empty(5, np.int64)
"""Results of the last scan; the event loop's thread alone uses them."""


class Writer(Protocol):
    """What writes a socket in place of its transport; called in the event loop's thread."""

    def write(self, data: bytes) -> None:
        """Send bytes of whole frames."""

    def close(self) -> None:
        """Close the connection after what was written."""


class StreamProtocol(WebSocketsSansIOProtocol):
    """One connection.

    Attributes
    ----------
    on_adverbs : callable, optional
        Called with channels (rows,), adverbs (rows · D,), and whether they came in one message.
    idle : callable
        Whether adverbs may be handled on arrival, since no earlier message waits.
    """

    on_adverbs: Callable[[U16, F32, bool], None] | None = None
    idle: Callable[[], bool] = staticmethod(lambda: False)
    _requested = _fragmented = False
    _held = b""
    _left = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Limit the write buffers to :data:`UNSENT_BYTES`."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=UNSENT_BYTES)

    def handle_connect(self, event: Request) -> None:
        """Add the protocol to the scope."""
        super().handle_connect(event)
        if self.response.status_code == 101:
            self.scope["extensions"][TRANSPORT] = self  # type: ignore[assignment]

    async def send(self, message: ASGISendEvent) -> None:
        """Send; a handshake that was refused with a response is complete, which uvicorn would log as an error."""
        await super().send(message)
        if self.initial_response is not None and self.close_sent:
            self.handshake_complete = True

    # ── writing ──────────────────────────────────────────────────────────────────────────────────────────────────

    def duplicate(self) -> socket.socket | None:
        """Duplicate of the connection's socket, or None where the transport has to write (TLS, Windows).

        Its number stays this connection's until the duplicate is closed, whatever the event loop closes meanwhile.
        """
        found = self.transport.get_extra_info("socket")
        if sys.platform == "win32" or found is None or self.transport.get_extra_info("ssl_object") is not None:
            return None
        try:
            copy = socket.socket(fileno=os.dup(found.fileno()))
        except OSError:  # too many open files: the transport can still write
            return None
        copy.setblocking(False)
        return copy

    async def hand_over(self, writer: Writer) -> None:
        """Let a writer send everything from now on, once the transport has sent what it has."""
        pause = 0.0
        while self.transport.get_write_buffer_size() and not self.transport.is_closing():
            await asyncio.sleep(pause)
            pause = min(pause + 0.001, 0.1)
        self.transport = _WrittenElsewhere(self.transport, writer)  # type: ignore[assignment]

    def close_transport(self) -> None:
        """Close the transport itself; its writer has finished."""
        if isinstance(self.transport, _WrittenElsewhere):
            self.transport = self.transport.inner
        self.transport.close()

    def shutdown(self) -> None:
        """Close the connection, since the server stops; one that is closing already gets no second close frame."""
        if self.handshake_complete and not self.close_sent and self.conn.state is not State.OPEN:
            self.stop_keepalive()
            self.transport.close()
            return
        super().shutdown()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let the writer close its socket."""
        super().connection_lost(exc)
        if isinstance(self.transport, _WrittenElsewhere):
            self.transport.close()

    # ── reading ──────────────────────────────────────────────────────────────────────────────────────────────────

    def data_received(self, data: bytes) -> None:
        """Decode adverbs at the front of received bytes, and parse the rest."""
        if not self._requested:  # the handshake
            self._requested = True
            super().data_received(data)
            return
        if self._held:
            data, self._held = self._held + data, b""
        at = given = 0
        if self._left:  # of a frame that an earlier read began
            at = min(self._left, len(data))
            self._left -= at
        direct = self.on_adverbs is not None
        while at < len(data):
            if direct and not self._fragmented:
                if given < at:
                    super().data_received(data[given:at])
                    given = at
                direct = self._idle()
                if direct:
                    at = given = self._decode(data, at)
                    if self._held or at == len(data):
                        return
            at = self._pass(data, at)
        if given < len(data) - len(self._held):
            super().data_received(data[given : len(data) - len(self._held)])

    def _idle(self) -> bool:
        return self.queue.empty() and not self.close_sent and not self.disconnected and self.idle()

    def _decode(self, data: bytes, at: int) -> int:
        """Hand on the adverbs at the front of ``data[at:]``; return where the rest begins."""
        received = np.frombuffer(data, np.uint8)
        while True:
            kernels.scan(received, at, _CHANNELS, _VALUES, _RESULT)
            at, rows, width, op, ended = _RESULT.tolist()
            if rows:
                assert self.on_adverbs is not None
                values = _VALUES[: rows * width].copy()
                self.on_adverbs(_CHANNELS[:rows].copy(), values, op == OP_MANY)
            if ended == INCOMPLETE:
                self._held = data[at:]
            if ended != MORE:
                return int(at)

    def _pass(self, data: bytes, at: int) -> int:
        """Follow a frame that the library parses; return where the next one begins, or hold an incomplete header."""
        left = len(data) - at
        size, head = (data[at + 1] & 0x7F, 2) if left >= 2 else (0, 2)
        if left >= 2 and size >= 126:
            wide = 2 if size == 126 else 8
            head += wide
            size = int.from_bytes(data[at + 2 : at + head], "big")
        if left >= 2 and data[at + 1] & 0x80:
            head += 4
        if left < head:
            self._held = data[at:]
            return len(data)
        if data[at] & 0x0F <= 2:
            self._fragmented = not data[at] & 0x80
        end = at + head + size
        self._left = max(end - len(data), 0)
        return min(end, len(data))

    def send_receive_event_to_app(self) -> None:
        """Queue a complete message; text that is not UTF-8 closes the connection without a log entry."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                if self.conn.state is State.OPEN:  # else a close frame came in the same read, and is answered
                    self.conn.send_close(CloseCode.INVALID_DATA, "text must be UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()


class _WrittenElsewhere:
    """A transport whose bytes a writer sends."""

    def __init__(self, inner: asyncio.Transport, writer: Writer) -> None:
        self.inner, self._writer, self._closed = inner, writer, False

    def write(self, data: bytes) -> None:
        """Send bytes after what the writer has."""
        if data and not self._closed:
            self._writer.write(bytes(data))

    def close(self) -> None:
        """Close the connection after what was written."""
        if not self._closed:
            self._closed = True
            self._writer.close()

    def is_closing(self) -> bool:
        """Whether it is closing or closed."""
        return self._closed or self.inner.is_closing()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)
