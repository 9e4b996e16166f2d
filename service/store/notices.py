"""Notices of changed versions: polling with SQLite, LISTEN with PostgreSQL, and a periodic one with both."""

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
"""Longest interval of notices, seconds; a lost notice delays a change by no more."""

POLL_S = 0.1
"""Polling interval of a SQLite file, seconds."""

BACK_OFF_S = 1.0
"""Pause after a failed read of the file, seconds."""


def notices(database: Database) -> AsyncGenerator[None, None]:
    """Yield at the start, and whenever current versions may have changed, until the database is closed.

    Retries while the database cannot be reached, and updates ``database.available``.
    """
    if database.sqlite:
        return _poll(database)
    from service.store.postgres_notices import listen

    return listen(database, REREAD_S)


async def _poll(database: Database) -> AsyncGenerator[None, None]:
    loop, changed, stop = asyncio.get_running_loop(), asyncio.Event(), threading.Event()

    def notify() -> None:
        try:
            loop.call_soon_threadsafe(changed.set)
        except RuntimeError:  # the event loop has ended
            stop.set()

    thread = threading.Thread(target=_poll_file, args=(database, stop, notify), name="adverb-notices", daemon=True)
    thread.start()
    try:
        while not database.closed:
            with suppress(TimeoutError):
                async with asyncio.timeout(REREAD_S):
                    await changed.wait()
            changed.clear()
            yield
    finally:
        stop.set()


def _poll_file(database: Database, stop: threading.Event, notify: Callable[[], None]) -> None:
    """Poll the file until ``stop`` is set; notify at the first read, and whenever the last event changes."""
    while not (stop.is_set() or database.closed):
        with suppress(sqlite3.Error):
            address = Path(str(database.url.database)).as_uri() + "?mode=rw"  # does not create a missing file
            with closing(sqlite3.connect(address, uri=True, timeout=1.0, isolation_level=None)) as connection:
                seen = stamp = None
                while not (stop.is_set() or database.closed):
                    found = connection.execute("PRAGMA data_version").fetchone()
                    database.available = True
                    if found != stamp:  # a write, perhaps only of jobs
                        latest = connection.execute("SELECT max(id) FROM adverb_events").fetchone()
                        if latest != seen:
                            notify()
                        stamp, seen = found, latest
                    stop.wait(POLL_S)
        if not (stop.is_set() or database.closed):
            database.available = False
            notify()
            stop.wait(BACK_OFF_S)
