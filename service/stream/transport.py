"""uvicorn's WebSockets with short buffers, and a short way for what comes and goes all the time.

ASGI's ``send`` and ``receive`` cost a coroutine, a dictionary, a queue and several copies a message. Pose messages
and binary adverbs go past them, where nothing else is under way. Whoever serves a connection finds this at
``scope["extensions"][SOCKET]``; under another server it is not there, and ``send`` and ``receive`` do.
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

__all__ = ["SOCKET", "Sockets"]

SOCKET = "adverb.socket"

UNSENT_BYTES = 16_384
"""Unsent bytes beyond which poses are dropped, unless one message is longer: what waits is old when it is read."""

TURN = 32
"""Messages of one read that are heard at once; with more, others get a turn."""

_BINARY = 0x82  # a whole binary message in one frame


class Sockets(WebSocketsSansIOProtocol):
    """One connection.

    Attributes
    ----------
    hear : callable, optional
        Given a binary message as it comes; False where it must wait its turn.
    """

    hear: Callable[[bytes], bool] | None = None
    _heard = _room = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Keep at most :data:`UNSENT_BYTES` here, and as much in the kernel."""
        super().connection_made(transport)
        self._make_room(UNSENT_BYTES)

    def handle_connect(self, event: Request) -> None:
        """Let the endpoint find this."""
        super().handle_connect(event)
        if self.response.status_code == 101:
            self.scope["extensions"][SOCKET] = self  # type: ignore[assignment]

    def post(self, message: bytes) -> bool:
        """Write a binary message now or not at all; whether it was written.

        Raises
        ------
        ConnectionError
            The connection is over.
        """
        if not self.writable.is_set():
            return False
        if self.close_sent or self.disconnected or self.conn.state is not State.OPEN:
            raise ConnectionError("the connection is over")
        size = len(message)
        if size > self._room:
            self._make_room(size)
        self.transport.write(_head(size) + message)
        return True

    def data_received(self, data: bytes) -> None:
        """Read what came."""
        self._heard = 0
        super().data_received(data)

    def handle_bytes(self, event: Frame) -> None:
        """Hand a binary message on, without a detour where nothing comes before it."""
        if event.fin and self.hear is not None and self._heard < TURN and self.queue.empty():
            self._heard += 1
            if self.hear(bytes(event.data)):
                return
        super().handle_bytes(event)

    def send_receive_event_to_app(self) -> None:
        """Hand a whole message on; text that is not UTF-8 ends its connection, and is not worth a line in the log."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.send_close(CloseCode.INVALID_DATA, "text must be UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def _make_room(self, size: int) -> None:
        """Take a message of this length whole: one that is cut waits for the next turn of the event loop."""
        self._room = size
        self.transport.set_write_buffer_limits(high=size)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            connection = self.transport.get_extra_info("socket")
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 2 * size)


def _head(size: int) -> bytes:
    """What stands before a message of this length; RFC 6455, section 5.2."""
    if size < 126:
        return bytes((_BINARY, size))
    if size < 65_536:
        return struct.pack("!BBH", _BINARY, 126, size)
    return struct.pack("!BBQ", _BINARY, 127, size)
