"""The WebSocket of a stream: connects, reads, writes, pings, and reconnects when the connection is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from urllib.parse import urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, InvalidURI, WebSocketException
from websockets.typing import Subprotocol

from adverb_client.backoff import Backoff
from adverb_client.errors import DecodeError, StreamClosed
from adverb_client.messages import Hello, parse_message
from adverb_client.outbox import Outbox
from adverb_client.session import Session

__all__ = ["Connection", "stream_url"]

SUBPROTOCOL = Subprotocol("adverb.v1")
RESUMED_ELSEWHERE = 4009
FATAL_STATUSES = (400, 401, 403, 404, 426)
"""HTTP statuses of a handshake after which no further attempt is made."""
FIRST_PINGS, FIRST_PING_EVERY_S, PING_EVERY_S = 5, 0.1, 1.0
HELLO_TIMEOUT_S = 10.0
STABLE_AFTER_S = 5.0
"""After a connection of this length, reconnection delays start again at the first."""
MAX_DRAIN_WAIT_S = 60.0
MAX_MESSAGE_BYTES = 64 * 2**20


STREAM = "/v1/stream"


def stream_url(url: str) -> str:
    """The WebSocket address of a server's stream, from its HTTP or WebSocket address, which may have a path.

    A WebSocket address with a path is used as it is.

    Raises
    ------
    ValueError
        If the URL is no HTTP or WebSocket address.
    """
    parts = urlsplit(url)
    schemes = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
    if parts.scheme not in schemes or not parts.netloc:
        raise ValueError(f"{url!r} is not the address of a server; expected http://…, https://…, ws://… or wss://…")
    path = parts.path.rstrip("/")
    if not path or (parts.scheme.startswith("http") and not path.endswith(STREAM)):
        path += STREAM
    return urlunsplit((schemes[parts.scheme], parts.netloc, path, parts.query, ""))


class Connection:
    """Keeps a session connected until it is cancelled or a reconnection is impossible.

    Parameters
    ----------
    url : str
    headers : mapping
        Of the handshake.
    session : Session
    outbox : Outbox
    backoff : Backoff
        Delays between attempts.
    reconnect_timeout_s : float
        How long to try to reconnect, seconds.
    now : callable
        A monotonic clock, seconds.
    """

    def __init__(
        self,
        url: str,
        headers: Mapping[str, str],
        session: Session,
        outbox: Outbox,
        *,
        backoff: Backoff,
        reconnect_timeout_s: float,
        now: Callable[[], float],
    ) -> None:
        self.ready = asyncio.Event()
        self.failure = "not connected yet"
        self.drain_wait_s = 0.0  # the delay that a draining server requests
        self._url, self._headers, self._session, self._outbox = url, headers, session, outbox
        self._backoff, self._reconnect_timeout_s, self._now = backoff, reconnect_timeout_s, now
        self._close_code: int | None = None
        self._connected = False
        self.socket: ClientConnection | None = None

    async def run(self) -> None:
        """Connect, and reconnect after every loss.

        Raises
        ------
        StreamClosed
            If a reconnection is impossible; the session is closed first.
        """
        try:
            await self._reconnect_forever()
        except StreamClosed as err:
            self._session.close(err.detail, err.close_code, err)
            raise
        except asyncio.CancelledError:
            error = StreamClosed("the stream was closed by this client", 1000)
            self._session.close(error.detail, 1000, error)
            raise
        except Exception as err:
            error = StreamClosed(f"the stream failed: {err!r}")
            self._session.close(error.detail, None, error)
            raise error from err

    async def _reconnect_forever(self) -> None:
        disconnected_at_s = self._now()
        while True:
            began_s, self._connected = self._now(), False
            try:
                await self._connect_once()
            except (OSError, TimeoutError, WebSocketException) as err:
                self._fail(err)
            self._session.disconnected(self.failure, self._close_code, self._now())
            self._outbox.clear()
            if self._close_code == RESUMED_ELSEWHERE:
                raise StreamClosed("another connection has resumed this session", RESUMED_ELSEWHERE)
            if self._connected:
                disconnected_at_s = self._now()
                if disconnected_at_s - began_s > STABLE_AFTER_S:
                    self._backoff.reset()
            elif self.ready.is_set() and self._now() - disconnected_at_s > self._reconnect_timeout_s:
                raise StreamClosed(
                    f"no reconnection within {self._reconnect_timeout_s:g} s: {self.failure}", self._close_code
                )
            drain_s, self.drain_wait_s = min(self.drain_wait_s, MAX_DRAIN_WAIT_S), 0.0
            await asyncio.sleep(max(drain_s, self._backoff.next_s()))

    async def _connect_once(self) -> None:
        """One connection, from the handshake to its end."""
        self._close_code = None
        async with connect(
            self._url,
            subprotocols=[SUBPROTOCOL],
            additional_headers=dict(self._headers),
            compression=None,  # poses hardly compress, and it costs CPU time in each frame
            open_timeout=HELLO_TIMEOUT_S,
            ping_interval=5.0,
            ping_timeout=10.0,
            close_timeout=1.0,
            max_size=MAX_MESSAGE_BYTES,
        ) as socket:
            if socket.subprotocol != SUBPROTOCOL:
                raise StreamClosed(f"{self._url} does not support {SUBPROTOCOL}")
            async with asyncio.timeout(HELLO_TIMEOUT_S):
                first = await socket.recv()
            self.socket = socket
            self._session.connected(_hello(first), self._now())
            self._connected = True
            self.ready.set()
            await self._serve(socket)

    async def _serve(self, socket: ClientConnection) -> None:
        async with asyncio.TaskGroup() as tasks:
            workers = [tasks.create_task(self._write(socket)), tasks.create_task(self._ping())]
            try:
                async for content in socket:
                    self._session.receive(content, self._now())
            except ConnectionClosed:
                pass
            finally:
                for worker in workers:
                    worker.cancel()
        self._close_code = None if socket.close_code is None else int(socket.close_code)
        self.failure = f"the connection ended: {self._close_code} {socket.close_reason or ''}".strip()

    async def _write(self, socket: ClientConnection) -> None:
        try:
            while True:
                for message in await self._outbox.take():
                    await socket.send(message)
        except ConnectionClosed:
            return  # the reader reports it

    async def _ping(self) -> None:
        """Estimate the server's clock, quickly at first, and retry channels that were not ready."""
        for k in range(2**62):
            await asyncio.sleep(FIRST_PING_EVERY_S if k < FIRST_PINGS else PING_EVERY_S)
            self._session.ping(self._now())
            self._session.retry_not_ready()

    def _fail(self, err: Exception) -> None:
        """Record why a connection failed; end the stream where a further attempt cannot succeed."""
        self.failure = f"{type(err).__name__}: {err}".rstrip(": ")
        if isinstance(err, InvalidStatus) and err.response.status_code in FATAL_STATUSES:
            raise StreamClosed(f"{self._url}: {self.failure}") from err
        if isinstance(err, InvalidURI):
            raise StreamClosed(self.failure) from err
        if isinstance(err, ConnectionClosed) and err.rcvd is not None:
            self._close_code = int(err.rcvd.code)


def _hello(first: str | bytes) -> Hello:
    try:
        message = parse_message(first) if isinstance(first, str) else None
    except DecodeError as err:
        raise StreamClosed(f"the server's first message is malformed: {err.detail}") from err
    if not isinstance(message, Hello):
        raise StreamClosed("the server's first message is not `hello`")
    return message
