"""One WebSocket to a server, as an asyncio protocol: fast enough for tens of thousands of messages a second."""

from __future__ import annotations

import asyncio
import random
import socket
import ssl
import time
from collections.abc import Mapping
from typing import Any, Protocol, cast
from urllib.parse import urlsplit

from adverb_load import frames

__all__ = ["SUBPROTOCOL", "Listener", "WebSocket", "connect"]

SUBPROTOCOL = "adverb.v1"
LOST = 1006
"""Close code of a connection that ended without a close frame."""

MAX_RESPONSE = 16_384
FULL = 1 << 18
"""Unsent bytes at which a sender should hold back."""


class Listener(Protocol):
    """Receiver of messages; times are those of ``time.monotonic_ns``."""

    def text(self, content: bytes, now_ns: int) -> None:
        """A text message."""

    def binary(self, content: bytes, now_ns: int) -> None:
        """A binary message."""

    def closed(self, code: int, reason: str) -> None:
        """The connection is closed; code 1006 without a close frame."""


class WebSocket(asyncio.Protocol):
    """A connection.

    Parameters
    ----------
    listener : Listener
    request, key : bytes
        The opening request and its key.
    rng : random.Random
        Source of masks.
    """

    def __init__(self, listener: Listener, request: bytes, key: bytes, rng: random.Random) -> None:
        self._listener, self._request, self._key, self._rng = listener, request, key, rng
        self._parser = frames.Parser()
        self._response: bytes | None = b""
        self._ending: tuple[int, str] | None = None
        self._transport: asyncio.Transport | None = None
        loop = asyncio.get_running_loop()
        self.ready: asyncio.Future[None] = loop.create_future()
        self.gone = asyncio.Event()
        self.received = 0

    # ── asyncio ──────────────────────────────────────────────────────────────────────────────────────────────────

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the opening request."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's transport has no declared type
        self._transport.write(self._request)

    def data_received(self, data: bytes) -> None:
        """Parse received bytes."""
        now_ns = time.monotonic_ns()
        self.received += len(data)
        try:
            if self._response is not None:
                data = self._handshake(data)
            for opcode, payload in self._parser.feed(data):
                if opcode == frames.BINARY:
                    self._listener.binary(payload, now_ns)
                elif opcode == frames.TEXT:
                    self._listener.text(payload, now_ns)
                else:
                    self._control(opcode, payload)
        except frames.FrameError as err:
            self._fail(err)

    def connection_lost(self, exc: Exception | None) -> None:
        """Report the end of the connection."""
        if not self.ready.done():
            self.ready.set_exception(frames.FrameError("the connection ended before it was a WebSocket"))
            self.ready.exception()
        self.gone.set()
        self._listener.closed(*(self._ending or (LOST, "")))

    # ── public methods ───────────────────────────────────────────────────────────────────────────────────────────

    @property
    def alive(self) -> bool:
        """Whether messages can be sent."""
        return self.ready.done() and not self.gone.is_set() and self._ending is None

    @property
    def full(self) -> bool:
        """Whether too many bytes are unsent; a sender should hold back."""
        return self._transport is None or self._transport.get_write_buffer_size() > FULL

    def send(self, opcode: int, *payloads: bytes) -> None:
        """Send messages, in one write."""
        key = self._rng.randbytes(4)
        self.write(b"".join([frames.frame(opcode, payload, key) for payload in payloads]))

    def write(self, content: bytes) -> None:
        """Send raw bytes, which need not be frames."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(content)

    def close(self, code: int = 1000) -> None:
        """Send a close frame; the server closes the connection."""
        self._ending = self._ending or (code, "closed here")
        self.write(frames.close_frame(code, self._rng.randbytes(4)))

    def abort(self) -> None:
        """Abort the connection without a close frame."""
        if self._transport is not None:
            self._transport.abort()

    def read(self, *, on: bool) -> None:
        """Resume or pause reading."""
        if self._transport is None or self._transport.is_closing():
            return
        if on:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _handshake(self, data: bytes) -> bytes:
        """Parse the response to the opening request; returns the bytes after it."""
        response, end, rest = ((self._response or b"") + data).partition(b"\r\n\r\n")
        if not end:
            self._response = response
            if len(response) > MAX_RESPONSE:
                raise frames.FrameError(f"the server's response is longer than {MAX_RESPONSE} bytes")
            return b""
        frames.accepted(response, self._key, SUBPROTOCOL)
        self._response = None
        self.ready.set_result(None)
        return rest

    def _control(self, opcode: int, payload: bytes) -> None:
        if opcode == frames.PING:
            self.send(frames.PONG, payload)
        elif opcode == frames.CLOSE:
            closing = self._ending is not None
            self._ending = self._ending or frames.close_code(payload)
            if not closing:
                self.write(frames.frame(frames.CLOSE, payload[:2], self._rng.randbytes(4)))
            if self._transport is not None:
                self._transport.close()

    def _fail(self, err: frames.FrameError) -> None:
        if not self.ready.done():
            self.ready.set_exception(err)
        self._ending = LOST, str(err)
        self.abort()


async def connect(
    url: str,
    listener: Listener,
    rng: random.Random,
    *,
    timeout_s: float = 10.0,
    headers: Mapping[str, str] | None = None,
    receive_buffer: int | None = None,
) -> WebSocket:
    """Open a WebSocket; raises :class:`frames.FrameError`, OSError or TimeoutError.

    ``receive_buffer`` is the size of the kernel's buffer, bytes; with a small one, a pause is noticed soon.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("ws", "wss") or not parts.hostname:
        raise ValueError(f"'{url}' is not the address of a stream; expected ws://HOST:PORT/v1/stream")
    secure = parts.scheme == "wss"
    host, port, key = parts.hostname, parts.port or (443 if secure else 80), rng.randbytes(16)
    opening = frames.request(host, port, parts.path or "/", key, SUBPROTOCOL, headers)
    context = ssl.create_default_context() if secure else None
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(timeout_s):
        place: dict[str, Any] = {"host": host, "port": port}
        if receive_buffer is not None:
            place = {"sock": await _buffered(host, port, receive_buffer)}
            if secure:
                place["server_hostname"] = host
        _, found = await loop.create_connection(lambda: WebSocket(listener, opening, key, rng), ssl=context, **place)
        try:
            await found.ready
        except asyncio.CancelledError:
            found.abort()
            raise
    return found


async def _buffered(host: str, port: int, receive_buffer: int) -> socket.socket:
    """A connected socket with a small receive buffer, which has to be set before the connection."""
    loop = asyncio.get_running_loop()
    family, kind, number, _, address = (await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM))[0]
    made = socket.socket(family, kind, number)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    made.setblocking(False)
    try:
        await loop.sock_connect(made, address)
    except BaseException:
        made.close()
        raise
    return made
