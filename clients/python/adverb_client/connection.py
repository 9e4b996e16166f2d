"""The connection under a stream: connects, greets, reads, writes, pings, and comes back when it is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from urllib.parse import urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, InvalidURI, WebSocketException
from websockets.typing import Subprotocol

from adverb_client.backoff import Backoff
from adverb_client.errors import DecodeError, StreamClosed
from adverb_client.messages import Hello, read_text
from adverb_client.outbox import Outbox
from adverb_client.session import Session

__all__ = ["Link", "stream_url"]

SUBPROTOCOL = Subprotocol("adverb.v1")
RESUMED_ELSEWHERE = 4009
HOPELESS = (400, 401, 403, 404, 426)
"""Statuses of a handshake after which another try would end the same way."""
FIRST_PINGS, FIRST_PING_EVERY_S, PING_EVERY_S = 5, 0.1, 1.0
HELLO_WITHIN_S = 10.0
STEADY_S = 5.0
"""A connection that held so long counts as one; the next loss is a first one."""
LONGEST_DRAIN_S = 60.0
MAX_MESSAGE_BYTES = 64 * 2**20


def stream_url(url: str) -> str:
    """The address of a server's stream, from whatever address of it is at hand.

    Raises
    ------
    ValueError
        If it is no http or ws address.
    """
    parts = urlsplit(url)
    schemes = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
    if parts.scheme not in schemes or not parts.netloc:
        raise ValueError(f"{url!r} is no address of a server: http://…, https://…, ws://… or wss://…")
    path = parts.path if parts.path.rstrip("/") else "/v1/stream"
    return urlunsplit((schemes[parts.scheme], parts.netloc, path, parts.query, ""))


class Link:
    """Keeps a session connected until it is cancelled, or there is no hope.

    Parameters
    ----------
    url : str
    headers : mapping
        Of the handshake.
    session : Session
    outbox : Outbox
    backoff : Backoff
        Waits between two tries.
    give_up_s : float
        How long to try to come back.
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
        give_up_s: float,
        now: Callable[[], float],
    ) -> None:
        self.ready = asyncio.Event()
        self.failure = "not connected yet"
        self.wait_first_s = 0.0  # what a server that drains asks for
        self._url, self._headers, self._session, self._outbox = url, headers, session, outbox
        self._backoff, self._give_up_s, self._now = backoff, give_up_s, now
        self._close_code: int | None = None
        self._greeted = False
        self.socket: ClientConnection | None = None

    async def run(self) -> None:
        """Connect, again and again.

        Raises
        ------
        StreamClosed
            If there is no hope, after the session was told.
        """
        try:
            await self._keep()
        except StreamClosed as err:
            self._session.closed(err.detail, err.close_code, err)
            raise
        except asyncio.CancelledError:
            error = StreamClosed("the stream was closed by this client", 1000)
            self._session.closed(error.detail, 1000, error)
            raise
        except Exception as err:
            error = StreamClosed(f"the stream broke: {err!r}")
            self._session.closed(error.detail, None, error)
            raise error from err

    async def _keep(self) -> None:
        away_since_s = self._now()
        while True:
            began_s, self._greeted = self._now(), False
            try:
                await self._once()
            except (OSError, TimeoutError, WebSocketException) as err:
                self._fail(err)
            self._session.lost(self.failure, self._close_code, self._now())
            self._outbox.clear()
            if self._close_code == RESUMED_ELSEWHERE:
                raise StreamClosed("another connection has resumed this session", RESUMED_ELSEWHERE)
            if self._greeted:
                away_since_s = self._now()
                if away_since_s - began_s > STEADY_S:
                    self._backoff.succeeded()
            elif self.ready.is_set() and self._now() - away_since_s > self._give_up_s:
                raise StreamClosed(f"not back within {self._give_up_s:g} s: {self.failure}", self._close_code)
            asked_s, self.wait_first_s = min(self.wait_first_s, LONGEST_DRAIN_S), 0.0
            await asyncio.sleep(max(asked_s, self._backoff.next_s()))

    async def _once(self) -> None:
        """One connection, from the handshake until it is gone."""
        self._close_code = None
        async with connect(
            self._url,
            subprotocols=[SUBPROTOCOL],
            additional_headers=dict(self._headers),
            compression=None,  # poses do not compress, and 60 times a second it costs
            open_timeout=HELLO_WITHIN_S,
            ping_interval=5.0,
            ping_timeout=10.0,
            close_timeout=1.0,
            max_size=MAX_MESSAGE_BYTES,
        ) as socket:
            if socket.subprotocol != SUBPROTOCOL:
                raise StreamClosed(f"{self._url} does not speak {SUBPROTOCOL}")
            async with asyncio.timeout(HELLO_WITHIN_S):
                first = await socket.recv()
            self.socket = socket
            self._session.greeted(_hello(first), self._now())
            self._greeted = True
            self.ready.set()
            await self._talk(socket)

    async def _talk(self, socket: ClientConnection) -> None:
        async with asyncio.TaskGroup() as tasks:
            helpers = [tasks.create_task(self._write(socket)), tasks.create_task(self._ping())]
            try:
                async for content in socket:
                    self._session.received(content, self._now())
            except ConnectionClosed:
                pass
            finally:
                for helper in helpers:
                    helper.cancel()
        self._close_code = None if socket.close_code is None else int(socket.close_code)
        self.failure = f"the connection ended: {self._close_code} {socket.close_reason or ''}".strip()

    async def _write(self, socket: ClientConnection) -> None:
        try:
            while True:
                for message in await self._outbox.take():
                    await socket.send(message)
        except ConnectionClosed:
            return  # the reader knows

    async def _ping(self) -> None:
        """Learn the server's clock quickly, then keep an eye on it; and ask again for what was not ready."""
        for k in range(2**62):
            await asyncio.sleep(FIRST_PING_EVERY_S if k < FIRST_PINGS else PING_EVERY_S)
            self._session.ping(self._now())
            self._session.knock()

    def _fail(self, err: Exception) -> None:
        """Remember why a connection did not come about; give up where another try would end the same way."""
        self.failure = f"{type(err).__name__}: {err}".rstrip(": ")
        if isinstance(err, InvalidStatus) and err.response.status_code in HOPELESS:
            raise StreamClosed(f"{self._url}: {self.failure}") from err
        if isinstance(err, InvalidURI):
            raise StreamClosed(self.failure) from err
        if isinstance(err, ConnectionClosed) and err.rcvd is not None:
            self._close_code = int(err.rcvd.code)


def _hello(first: str | bytes) -> Hello:
    try:
        message = read_text(first) if isinstance(first, str) else None
    except DecodeError as err:
        raise StreamClosed(f"the server's first message cannot be read: {err.detail}") from err
    if not isinstance(message, Hello):
        raise StreamClosed("the server's first message is no hello")
    return message
