"""A small HTTP/1.1 client for an open loop: kept connections, exact times, and few allocations."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast
from urllib.parse import urlsplit

__all__ = ["Job", "Pool", "Reply", "ResponseParser", "request_bytes"]

MAX_HEAD = 65_536


@dataclass(frozen=True, slots=True)
class Reply:
    """A response: status, and body."""

    status: int
    body: bytes


@dataclass(slots=True, eq=False)
class Job:
    """A request and its times, seconds of ``time.monotonic``.

    Parameters
    ----------
    content : bytes
        The whole request.
    due_s : float
        When it was scheduled: latency counts from here.
    ended : callable
        Called once with the job, and a :class:`Reply` or a problem.
    sent_s, ended_s : float
        When it was written to a connection (NaN before), and when its response was complete.
    """

    content: bytes
    due_s: float
    ended: Callable[[Job, Reply | str], None]
    sent_s: float = float("nan")
    ended_s: float = float("nan")
    done: bool = False

    def end(self, found: Reply | str) -> None:
        """Report the end, once."""
        if not self.done:
            self.done, self.ended_s = True, time.monotonic()
            self.ended(self, found)


def request_bytes(method: str, url: str, path: str, headers: Mapping[str, str], body: bytes = b"") -> bytes:
    """A request as bytes."""
    lines = [f"{method} {path} HTTP/1.1", f"Host: {urlsplit(url).netloc}"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    if body or method == "POST":
        lines.append(f"Content-Length: {len(body)}")
    return "\r\n".join([*lines, "", ""]).encode("latin-1") + body


class ResponseParser:
    """Parses the responses of one connection; each is a :class:`Reply` and whether the connection stays open."""

    def __init__(self) -> None:
        self._rest = b""
        self._status, self._left, self._chunked, self._stays = 0, -1, False, True
        self._body: list[bytes] = []

    def feed(self, content: bytes) -> tuple[Reply, bool] | None:
        """Take received bytes; returns a complete response or None, raises ValueError for malformed bytes."""
        self._rest += content
        if self._left < 0 and not self._chunked and not self._head():
            return None
        if self._chunked:
            return self._chunks()
        if self._left > len(self._rest):
            self._left -= len(self._rest)
            self._body.append(self._rest)
            self._rest = b""
            return None
        self._body.append(self._rest[: self._left])
        self._rest = self._rest[self._left :]
        return self._finish()

    def _head(self) -> bool:
        head, end, rest = self._rest.partition(b"\r\n\r\n")
        if not end:
            if len(head) > MAX_HEAD:
                raise ValueError("a response whose head does not end")
            return False
        first, *lines = head.decode("latin-1").split("\r\n")
        fields = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        self._status = int(first.split(" ")[1])
        self._stays = fields.get("connection", "").lower() != "close"
        self._chunked = "chunked" in fields.get("transfer-encoding", "").lower()
        self._left = int(fields.get("content-length", 0))
        if self._status in (204, 304):
            self._left = 0
        self._rest = rest
        return True

    def _chunks(self) -> tuple[Reply, bool] | None:
        while True:
            size_text, end, rest = self._rest.partition(b"\r\n")
            if not end:
                return None
            size = int(size_text.split(b";")[0], 16)
            if len(rest) < size + 2:
                return None
            self._body.append(rest[:size])
            self._rest = rest[size + 2 :]
            if size == 0:
                return self._finish()

    def _finish(self) -> tuple[Reply, bool]:
        reply, stays = Reply(self._status, b"".join(self._body)), self._stays
        self._left, self._chunked, self._body = -1, False, []
        return reply, stays


class _Connection(asyncio.Protocol):
    """One kept connection; it has one request at a time."""

    def __init__(self, pool: Pool) -> None:
        self._pool, self._parser = pool, ResponseParser()
        self._transport: asyncio.Transport | None = None
        self.job: Job | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def send(self, job: Job) -> None:
        assert self._transport is not None
        self.job, job.sent_s = job, time.monotonic()
        self._transport.write(job.content)

    def data_received(self, data: bytes) -> None:
        try:
            found = self._parser.feed(data)
        except (ValueError, IndexError) as err:
            self._end(f"malformed response: {err}")
            self.abort()
            return
        if found is None or self.job is None:
            return
        reply, stays = found
        self._end(reply)
        if stays:
            self._pool.release(self)
        else:
            self.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end("connection lost")
        self._pool.lost(self)

    def _end(self, found: Reply | str) -> None:
        job, self.job = self.job, None
        if job is not None:
            job.end(found)

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()


class Pool:
    """Connections to one server.

    Parameters
    ----------
    url : str
        ``http://HOST:PORT`` or ``https://HOST:PORT``.
    limit : int
        Largest number of connections; further requests wait for one, and their latency includes the wait.
    timeout_s : float
        Longest time from the scheduled time to the response.
    """

    def __init__(self, url: str, *, limit: int, timeout_s: float) -> None:
        parts = urlsplit(url)
        secure = parts.scheme == "https"
        self._host, self._port = str(parts.hostname), parts.port or (443 if secure else 80)
        self._ssl = ssl.create_default_context() if secure else None
        self._limit, self._timeout_s = limit, timeout_s
        self._free: list[_Connection] = []
        self._open: set[_Connection] = set()
        self._opening = 0
        self._waiting: deque[Job] = deque()
        self._tasks: set[asyncio.Task[None]] = set()
        self.most = 0

    def submit(self, job: Job) -> None:
        """Send a request on a free connection, a new one, or the next that is free."""
        if self._free:
            self._send(self._free.pop(), job)
            return
        self._waiting.append(job)
        if len(self._open) + self._opening < self._limit:
            self._connect()

    @property
    def waiting(self) -> int:
        """Requests that have no connection yet."""
        return len(self._waiting)

    @property
    def running(self) -> int:
        """Requests that have been sent, without a response so far."""
        return sum(connection.job is not None for connection in self._open)

    def _send(self, connection: _Connection, job: Job) -> None:
        connection.send(job)

    def _connect(self) -> None:
        self._opening += 1
        task = asyncio.get_running_loop().create_task(self._connected())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connected(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(self._timeout_s):
                _, connection = await loop.create_connection(
                    lambda: _Connection(self), self._host, self._port, ssl=self._ssl
                )
        except (OSError, TimeoutError) as err:
            if self._waiting:
                self._waiting.popleft().end(f"connection failed: {type(err).__name__}")
            return
        finally:
            self._opening -= 1
        self._open.add(connection)
        self.most = max(self.most, len(self._open))
        self.release(connection)

    def release(self, connection: _Connection) -> None:
        """Use a connection for the next request."""
        while self._waiting:
            job = self._waiting.popleft()
            if not job.done:
                self._send(connection, job)
                return
        self._free.append(connection)

    def lost(self, connection: _Connection) -> None:
        """Forget a connection; open another one if requests wait."""
        self._open.discard(connection)
        if connection in self._free:
            self._free.remove(connection)
        if self._waiting and len(self._open) + self._opening < self._limit:
            self._connect()

    def expire(self, now_s: float) -> None:
        """End requests that are due for longer than the timeout."""
        latest_s = now_s - self._timeout_s
        for job in [job for job in self._waiting if job.due_s < latest_s]:
            job.end("timeout")
        self._waiting = deque(job for job in self._waiting if not job.done)
        for connection in list(self._open):
            job = connection.job  # type: ignore[assignment]
            if job is not None and job.due_s < latest_s:
                connection.job = None
                job.end("timeout")
                connection.abort()

    def close(self) -> None:
        """Close all connections; requests without a response end as ``unfinished``."""
        for job in self._waiting:
            job.end("unfinished")
        self._waiting.clear()
        for task in self._tasks:
            task.cancel()
        for connection in list(self._open):
            if connection.job is not None:
                job, connection.job = connection.job, None
                job.end("unfinished")
            connection.abort()
