"""uvicorn WebSocket protocol with small write buffers and a fast path for binary messages.

ASGI's ``send`` and ``receive`` cost a coroutine, a dictionary, a queue and several copies for each message. Pose
messages and binary adverbs bypass them when no other message is pending. The endpoint finds the protocol at
``scope["extensions"][TRANSPORT]``; under another server it is missing, and ``send`` and ``receive`` are used.

This is the only file that touches private parts of uvicorn and websockets; ``tests/service/stream/test_transport.py``
fails when they change.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.http11 import Request
from websockets.protocol import State

__all__ = ["TRANSPORT", "StreamProtocol"]

TRANSPORT = "adverb.transport"

UNSENT_BYTES = 16_384
"""Unsent bytes beyond which pose messages are dropped, so that a slow client receives fresh poses."""

MAX_DIRECT = 32
"""Messages of one read that are handled immediately; further ones go through the event loop."""

_BINARY = 0x82  # final frame of a binary message


class StreamProtocol(WebSocketsSansIOProtocol):
    """One connection.

    Attributes
    ----------
    on_binary : callable, optional
        Called with a binary message on arrival; returns False if the message has to be queued.
    """

    on_binary: Callable[[bytes], bool] | None = None
    _handled = _buffer = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Limit the write buffer to :data:`UNSENT_BYTES`, and the kernel's to twice as much."""
        super().connection_made(transport)
        self._set_buffer(UNSENT_BYTES)

    def handle_connect(self, event: Request) -> None:
        """Add the protocol to the scope."""
        super().handle_connect(event)
        if self.response.status_code == 101:
            self.scope["extensions"][TRANSPORT] = self  # type: ignore[assignment]

    def send_binary(self, message: bytes) -> bool:
        """Write a binary message if the buffer has room; return whether it was written.

        Raises
        ------
        ConnectionError
            The connection is closed.
        """
        if not self.writable.is_set():
            return False
        if self.close_sent or self.disconnected or self.conn.state is not State.OPEN:
            raise ConnectionError("the connection is closed")
        size = len(message)
        if size > self._buffer:
            self._set_buffer(size)
        self.transport.write(_head(size) + message)
        return True

    def data_received(self, data: bytes) -> None:
        """Parse received bytes."""
        self._handled = 0
        super().data_received(data)

    def handle_bytes(self, event: Frame) -> None:
        """Handle a binary message immediately if no other message is queued, else queue it."""
        if event.fin and self.on_binary is not None and self._handled < MAX_DIRECT and self.queue.empty():
            self._handled += 1
            if self.on_binary(bytes(event.data)):
                return
        super().handle_bytes(event)

    def send_receive_event_to_app(self) -> None:
        """Queue a complete message; text that is not UTF-8 closes the connection without a log entry."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.send_close(CloseCode.INVALID_DATA, "text must be UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def _set_buffer(self, size: int) -> None:
        """Make room for a whole message of this length, since the rest of a partial one waits for the event loop."""
        self._buffer = size
        self.transport.set_write_buffer_limits(high=size)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            connection = self.transport.get_extra_info("socket")
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 2 * size)


def _head(size: int) -> bytes:
    """Frame header of a message of this length (RFC 6455, section 5.2)."""
    if size < 126:
        return bytes((_BINARY, size))
    if size < 65_536:
        return struct.pack("!BBH", _BINARY, 126, size)
    return struct.pack("!BBQ", _BINARY, 127, size)
