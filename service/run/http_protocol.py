"""HTTP connections with bounds: the head of a request has a size and a time, its body a slowest rate.

uvicorn closes a connection that is idle between two requests. It waits without end for the rest of a request, and reads
a head of any length.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

__all__ = ["HEAD_BYTES", "BoundedHttp"]

HEAD_BYTES = 64 * 1024
"""Longest head of a request: its first line and headers."""

BODY_BYTES_PER_S = 1_000
"""Slowest rate at which a body may arrive, averaged over :attr:`BoundedHttp.patience_s`."""


class BoundedHttp(HttpToolsProtocol):
    """One HTTP connection.

    Attributes
    ----------
    patience_s : float
        Longest time for a head; interval over which the rate of a body is averaged.
    """

    patience_s = 10.0
    _timer: asyncio.TimerHandle | None = None
    _reading_head = True
    _upgraded = False
    _head_bytes = _body_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start waiting for the first head."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop()
        super().connection_lost(exc)

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
        if not self.transport.is_closing() and (cycle is None or cycle.response_complete or not cycle.response_started):
            self.transport.write(
                b"HTTP/1.1 %s\r\ncontent-type: text/plain; charset=utf-8\r\ncontent-length: %d\r\n"
                b"connection: close\r\n\r\n%s" % (status, len(reason), reason)
            )
        self._stop()
        self.transport.close()
