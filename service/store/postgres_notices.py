"""Notices of changed versions by LISTEN. Imported only if PostgreSQL is used."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

import psycopg

from service.store.postgres import CHANNEL, CONNECT_S, NoAnswer, bounded
from service.store.tables import Database

__all__ = ["listen"]

BACK_OFF_S = (0.1, 1.0)
"""First and longest pause before reconnecting, seconds."""


class _Listener(psycopg.AsyncConnection[Any]):
    async def wait(self, gen: Any, *args: Any, **options: Any) -> Any:
        if "timeout" in options:  # waiting for notices
            return await super().wait(gen, *args, **options)
        try:
            return await super().wait(bounded(gen, CONNECT_S), *args, **options)
        except NoAnswer:
            self.pgconn.finish()
            raise


async def listen(database: Database, reread_s: float) -> AsyncGenerator[None, None]:
    """Yield at the start, at each notice, after ``reread_s`` without one, and when the connection changes."""
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
                    if not found:  # detects a connection that was lost silently
                        await connection.execute("SELECT 1")
                        database.available = True
            finally:
                await connection.close()
        except (psycopg.Error, OSError):
            database.available = False
        yield
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, longest_s)
