"""Connections to PostgreSQL with time-outs on the client's side. Imported only if PostgreSQL is used.

PostgreSQL's own time-outs do not apply while the server is frozen, and those of TCP not while only its process is.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any, TypeVar

import psycopg
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import URL

from service.store.records import BadAddress

__all__ = ["CHANNEL", "CONNECT_S", "NoAnswer", "bounded", "make_engine"]

CHANNEL = "adverb_versions"
"""Channel of notices; the payload is the verb's name."""

CONNECT_S = 2
"""Longest wait for a connection, whole seconds."""

Result = TypeVar("Result")


class NoAnswer(psycopg.OperationalError):
    """The server did not answer in time."""


def bounded(steps: Generator[Any, Any, Result], timeout_s: float) -> Generator[Any, Any, Result]:
    """Wrap a wait of the driver with a time-out; the driver polls ten times a second."""
    deadline_s = time.monotonic() + timeout_s
    try:
        wanted = next(steps)
        while True:
            ready = yield wanted
            if not ready and time.monotonic() > deadline_s:
                raise NoAnswer(f"the database does not answer within {timeout_s:g} s")
            wanted = steps.send(ready)
    except StopIteration as end:
        result: Result = end.value
        return result


class _Connection(psycopg.Connection[Any]):
    timeout_s = 5.0

    def wait(self, gen: Any, *args: Any, **options: Any) -> Any:
        try:
            return super().wait(bounded(gen, self.timeout_s), *args, **options)
        except NoAnswer:
            self.pgconn.finish()  # a late answer must not be read as that of the next statement
            raise


def _check_encoding(connection: psycopg.Connection[Any]) -> None:
    """Raise :class:`BadAddress` for a database that cannot store every text."""
    encoding = connection.info.parameter_status("server_encoding")
    if encoding != "UTF8":
        name = connection.info.dbname
        raise BadAddress(
            f"the PostgreSQL database '{name}' has the encoding {encoding}, and Adverb needs UTF8: make another with "
            f"CREATE DATABASE adverb ENCODING 'UTF8' TEMPLATE template0, and name it in ADVERB_DATABASE_URL"
        )


def make_engine(url: URL, *, timeout_s: float, connections: int) -> Engine:
    """An engine with a small pool, and time-outs for statements and locks, seconds."""
    millis = int(1000 * timeout_s)
    engine = create_engine(
        url, pool_size=connections, max_overflow=0, pool_timeout=timeout_s, pool_pre_ping=True, hide_parameters=True
    )

    @event.listens_for(engine, "do_connect")
    def _connect(dialect: object, record: object, args: Any, options: dict[str, Any]) -> _Connection:
        options = options | {"connect_timeout": CONNECT_S, "tcp_user_timeout": millis}
        connection = _Connection.connect(*args, **options)
        try:
            _check_encoding(connection)
        except BadAddress:
            connection.close()
            raise
        connection.timeout_s = timeout_s
        return connection

    @event.listens_for(engine, "connect")
    def _tune(connection: _Connection, record: object) -> None:
        connection.execute(f"SET lock_timeout = {8 * millis // 10}")  # the shortest, since its message is the clearest
        connection.execute(f"SET statement_timeout = {9 * millis // 10}")
        connection.execute(f"SET idle_in_transaction_session_timeout = {millis}")
        connection.commit()

    return engine
