"""HTTP connections with bounds: the head of a request has a size and a time; its body and its response a slowest rate.

uvicorn closes a connection that is idle between two requests. It waits without end for the rest of a request and for a
client that does not read, and reads a head of any length.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
from contextlib import suppress
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

__all__ = ["HEAD_BYTES", "BoundedHttp"]

HEAD_BYTES = 64 * 1024
"""Longest head of a request: its first line and headers."""

BODY_BYTES_PER_S = 1_000
"""Slowest rate at which a body may arrive, and a response may be read, averaged over the times of `BoundedHttp`."""


class BoundedHttp(HttpToolsProtocol):
    """One HTTP connection.

    Attributes
    ----------
    patience_s : float
        Longest time for a head; interval over which the rate of a body is averaged.
    slow_s : float
        Interval over which the rate is averaged at which a client reads.
    """

    patience_s = 10.0
    slow_s = 30.0
    _timer: asyncio.TimerHandle | None = None
    _reading: asyncio.TimerHandle | None = None
    """Timer while the client has something to read."""
    _reading_head = True
    _upgraded = False
    _head_bytes = _body_bytes = _responses = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start waiting for the first head."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop()
        self._stop_reading()
        super().connection_lost(exc)

    def timeout_keep_alive_handler(self) -> None:
        """Close an idle connection, also of a client that has not received its last response."""
        if not self.transport.is_closing() and _unread(self.transport):
            self._reset()
        super().timeout_keep_alive_handler()

    def pause_writing(self) -> None:
        """Pause the response, for as long as the client reads."""
        super().pause_writing()
        self._expect_reading()

    def on_response_complete(self) -> None:
        """Go over to the next request, while the client reads the response."""
        super().on_response_complete()
        self._responses += 1
        self._expect_reading()

    def data_received(self, data: bytes) -> None:
        """Count the bytes of a head, parse, and wait for the rest of an incomplete request."""
        if self._reading_head:
            self._head_bytes += len(data)
        super().data_received(data)
        if self._upgraded:
            return
        if self._reading_head and self._head_bytes > HEAD_BYTES:
            self._refuse(b"431 Request Header Fields Too Large", b"the head of a request may have 65536 bytes")
        elif self._timer is None and (self._head_bytes or not self._reading_head):
            self._wait()

    def handle_websocket_upgrade(self) -> None:
        """Stop waiting: the connection has another protocol from now on."""
        self._stop()
        self._stop_reading()
        self._upgraded = True
        super().handle_websocket_upgrade()

    def on_headers_complete(self) -> None:
        """Go over to the body."""
        self._reading_head, self._head_bytes, self._body_bytes = False, 0, 0
        self._stop()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Count the bytes of a body; from its first part on it may not be slow."""
        self._body_bytes += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Go over to the next request."""
        self._reading_head = True
        self._stop()
        super().on_message_complete()

    def _wait(self) -> None:
        self._timer = self.loop.call_later(self.patience_s, self._late)

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _late(self) -> None:
        """Close a connection whose head is late, or whose body is slow while the server reads it."""
        self._timer = None
        if self._reading_head:
            self._refuse(b"408 Request Timeout", b"the request did not arrive in time")
            return
        slow = self._body_bytes < BODY_BYTES_PER_S * self.patience_s and not self.flow.read_paused
        if slow:
            self._refuse(b"408 Request Timeout", b"the body of the request arrives too slowly")
            return
        self._body_bytes = 0
        self._wait()

    def _refuse(self, status: bytes, reason: bytes) -> None:
        """Answer where no response has begun, and close the connection."""
        cycle: Any = self.cycle
        if not self.transport.is_closing() and (self._complete or not cycle.response_started):
            self.transport.write(
                b"HTTP/1.1 %s\r\ncontent-type: text/plain; charset=utf-8\r\ncontent-length: %d\r\n"
                b"connection: close\r\n\r\n%s" % (status, len(reason), reason)
            )
        self._stop()
        self.transport.close()
        self._expect_reading()

    def _expect_reading(self) -> None:
        """Watch the rate at which the client reads until nothing is left to be written."""
        if self._reading is None and _unwritten(self.transport):
            state = _unread(self.transport), self._responses
            self._reading = self.loop.call_later(self.slow_s, self._check_reading, *state)

    def _stop_reading(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
            self._reading = None

    def _check_reading(self, unread: int, responses: int) -> None:
        """Abort a connection whose client reads too slowly; closing it would wait for the client."""
        self._reading = None
        wrote = self._responses != responses or not (self.flow.write_paused or self._complete)
        slow = not wrote and unread - _unread(self.transport) < BODY_BYTES_PER_S * self.slow_s
        if slow and _unwritten(self.transport):
            self._reset()
        else:
            self._expect_reading()

    def _reset(self) -> None:
        """Close the connection and drop what is not sent, also in the kernel, which would hold it for minutes."""
        with suppress(OSError, AttributeError):  # a transport may have no socket
            connection = self.transport.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.transport.abort()

    @property
    def _complete(self) -> bool:
        cycle: Any = self.cycle
        return cycle is None or bool(cycle.response_complete)


def _unwritten(transport: asyncio.Transport) -> int:
    """Bytes that the transport holds; 0 of one that is closed, which uvloop reports by an error."""
    try:
        return transport.get_write_buffer_size()
    except RuntimeError:
        return 0


def _unread(transport: asyncio.Transport) -> int:
    """Bytes that the client has not received: in the transport, and where it is known in the kernel."""
    size = _unwritten(transport)
    if sys.platform == "linux":
        import fcntl
        import termios

        with suppress(OSError, AttributeError):
            queued = fcntl.ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
            size += int.from_bytes(queued, sys.byteorder)
    return size
