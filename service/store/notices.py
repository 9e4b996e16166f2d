"""When pointers may have changed: a poll of the file on SQLite, LISTEN on PostgreSQL, a while of silence on both."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from collections.abc import AsyncGenerator, Callable
from contextlib import closing, suppress
from pathlib import Path

from service.store.tables import Database

__all__ = ["REREAD_S", "notices"]

REREAD_S = 3.0
"""Longest silence, seconds: a notice can be lost, so pointers are read again anyway."""

POLL_S = 0.1
"""Time between two looks at a SQLite file, seconds."""

BACK_OFF_S = 1.0
"""Pause before a file that cannot be read is tried again, seconds."""


def notices(database: Database) -> AsyncGenerator[None, None]:
    """Yield at the start, and whenever pointers may have changed since; it ends when the database is closed.

    A database that cannot be reached is tried again and again; ``database.available`` says how it went.
    """
    if database.sqlite:
        return _poll(database)
    from service.store.postgres_notices import listen

    return listen(database, REREAD_S)


async def _poll(database: Database) -> AsyncGenerator[None, None]:
    loop, news, stop = asyncio.get_running_loop(), asyncio.Event(), threading.Event()

    def tell() -> None:
        try:
            loop.call_soon_threadsafe(news.set)
        except RuntimeError:  # the loop is gone, and nobody listens any more
            stop.set()

    thread = threading.Thread(target=_watch, args=(database, stop, tell), name="adverb-notices", daemon=True)
    thread.start()
    try:
        while not database.closed:
            with suppress(TimeoutError):
                async with asyncio.timeout(REREAD_S):
                    await news.wait()
            news.clear()
            yield
    finally:
        stop.set()


def _watch(database: Database, stop: threading.Event, tell: Callable[[], None]) -> None:
    """Look at the file until told to stop; tell of the first look, and of every change of the last event."""
    while not (stop.is_set() or database.closed):
        with suppress(sqlite3.Error):
            address = Path(str(database.url.database)).as_uri() + "?mode=rw"  # it is not made anew where it is gone
            with closing(sqlite3.connect(address, uri=True, timeout=1.0, isolation_level=None)) as connection:
                seen = stamp = None
                while not (stop.is_set() or database.closed):
                    found = connection.execute("PRAGMA data_version").fetchone()
                    database.available = True
                    if found != stamp:  # somebody wrote, perhaps only about jobs
                        latest = connection.execute("SELECT max(id) FROM adverb_events").fetchone()
                        if latest != seen:
                            tell()
                        stamp, seen = found, latest
                    stop.wait(POLL_S)
        if not (stop.is_set() or database.closed):
            database.available = False
            tell()
            stop.wait(BACK_OFF_S)
