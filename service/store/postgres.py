"""Connections to PostgreSQL that do not wait for ever. Imported only where PostgreSQL is used.

PostgreSQL's own time-outs do not help where the server is frozen, and TCP's not where only its process is.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Generator
from typing import TYPE_CHECKING, Any, TypeVar

import psycopg
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import URL

if TYPE_CHECKING:
    from service.store.tables import Database

__all__ = ["CHANNEL", "listen", "make_engine"]

CHANNEL = "adverb_versions"
"""Channel of notices; the payload is the verb's name."""

CONNECT_S = 2
"""Longest wait for a connection, whole seconds."""

BACK_OFF_S = (0.1, 1.0)
"""First and longest pause before a lost server is listened to again, seconds."""

Result = TypeVar("Result")


class _Silence(psycopg.OperationalError):
    """The server did not say anything for too long."""


def _bounded(steps: Generator[Any, Any, Result], patience_s: float) -> Generator[Any, Any, Result]:
    """The driver's steps, as long as the server answers: the driver looks in ten times a second while it waits."""
    deadline_s = time.monotonic() + patience_s
    try:
        wanted = next(steps)
        while True:
            ready = yield wanted
            if not ready and time.monotonic() > deadline_s:
                raise _Silence(f"the database does not answer within {patience_s:g} s")
            wanted = steps.send(ready)
    except StopIteration as end:
        result: Result = end.value
        return result


class _Connection(psycopg.Connection[Any]):
    patience_s = 5.0

    def wait(self, gen: Any, *args: Any, **options: Any) -> Any:
        try:
            return super().wait(_bounded(gen, self.patience_s), *args, **options)
        except _Silence:
            self.pgconn.finish()  # whatever it says later is nobody's answer
            raise


class _Listener(psycopg.AsyncConnection[Any]):
    async def wait(self, gen: Any, *args: Any, **options: Any) -> Any:
        if "timeout" in options:  # it waits for notices
            return await super().wait(gen, *args, **options)
        try:
            return await super().wait(_bounded(gen, CONNECT_S), *args, **options)
        except _Silence:
            self.pgconn.finish()
            raise


def make_engine(url: URL, *, timeout_s: float, connections: int) -> Engine:
    """An engine with a small pool whose statements and locks take no longer than said, in seconds."""
    millis = int(1000 * timeout_s)
    engine = create_engine(
        url, pool_size=connections, max_overflow=0, pool_timeout=timeout_s, pool_pre_ping=True, hide_parameters=True
    )

    @event.listens_for(engine, "do_connect")
    def _connect(dialect: object, record: object, args: Any, options: dict[str, Any]) -> _Connection:
        options = options | {"connect_timeout": CONNECT_S, "tcp_user_timeout": millis}
        connection = _Connection.connect(*args, **options)
        connection.patience_s = timeout_s
        return connection

    @event.listens_for(engine, "connect")
    def _tune(connection: _Connection, record: object) -> None:
        connection.execute(f"SET lock_timeout = {8 * millis // 10}")  # the shorter, the clearer its message
        connection.execute(f"SET statement_timeout = {9 * millis // 10}")
        connection.execute(f"SET idle_in_transaction_session_timeout = {millis}")
        connection.commit()

    return engine


async def listen(database: Database, reread_s: float) -> AsyncGenerator[None, None]:
    """Yield at the start, at each notice, after a while of silence, and whenever the server was lost or found."""
    pause_s, longest_s = BACK_OFF_S
    arguments = database.arguments() | {"connect_timeout": CONNECT_S, "autocommit": True}
    while not database.closed:
        try:
            connection = await _Listener.connect(**arguments)
            try:
                await connection.execute(f"LISTEN {CHANNEL}")
                database.available, pause_s = True, BACK_OFF_S[0]
                yield
                while not database.closed:
                    found = [notice async for notice in connection.notifies(timeout=reread_s, stop_after=1)]
                    yield
                    if not found:  # a connection may be lost in silence; asking shows it
                        await connection.execute("SELECT 1")
                        database.available = True
            finally:
                await connection.close()
        except (psycopg.Error, OSError):
            database.available = False
        yield
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, longest_s)
