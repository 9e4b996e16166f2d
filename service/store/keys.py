"""Table of API keys, of which only hashes are stored."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, func, insert, select, update

from service.store import tables
from service.store.records import Key, TooManyKeys, UnknownKey, check_text
from service.store.tables import Database

__all__ = ["MAX_KEYS", "Keys", "open_keys"]

MAX_KEYS = 10_000
"""Largest number of keys that are neither revoked nor expired."""


class Keys:
    """The table of keys. All methods block; errors include :class:`StoreUnavailable`.

    Parameters
    ----------
    database : Database
    clock : callable
        Seconds since 1970, UTC.
    """

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        self._database, self._clock = database, clock

    def add(self, id: str, sha256: str, *, name: str, scopes: frozenset[str], expires_at_s: float | None) -> Key:
        """Add a key; raises :class:`TooManyKeys` or :class:`InvalidValue`."""
        check_text("name", name, 100)
        key = Key(id, name, scopes, sha256, self._clock(), expires_at_s)
        with self._database.transaction(writes=True) as connection:
            revision = self._next_revision(connection)
            if sum(row.valid_at(self._clock()) for row in _select(connection)) >= MAX_KEYS:
                raise TooManyKeys(MAX_KEYS)
            values = {name: getattr(key, name) for name in Key.__slots__}
            values |= {"scopes": " ".join(sorted(scopes)), "revision": revision}
            connection.execute(insert(tables.keys).values(values))
        return key

    def revoke(self, id: str) -> Key:
        """Revoke a key; one that is revoked already is returned unchanged. Raises :class:`UnknownKey`."""
        with self._database.transaction(writes=True) as connection:
            revision = self._next_revision(connection)
            found = [key for key in _select(connection) if key.id == id]
            if not found:
                raise UnknownKey(id)
            if found[0].revoked_at_s is None:
                change = update(tables.keys).where(tables.keys.c.id == id)
                connection.execute(change.values(revoked_at_s=self._clock(), revision=revision))
            return next(key for key in _select(connection) if key.id == id)

    def listed(self) -> list[Key]:
        """All keys, the oldest first."""
        with self._database.transaction() as connection:
            return _select(connection)

    def changed(self, since: int) -> tuple[int, list[Key]] | None:
        """Revision of the table and all keys, if they changed since a revision; else None."""
        with self._database.transaction() as connection:
            revision = _revision(connection)
            return None if revision == since else (revision, _select(connection))

    def close(self) -> None:
        """Close the database; for keys of :func:`open_keys`."""
        self._database.close()

    def _next_revision(self, connection: Connection) -> int:
        self._database.lock_keys(connection)
        return _revision(connection) + 1


def open_keys(database_url: str, *, timeout_s: float = 5.0) -> Keys:
    """The keys of a database, which is created or upgraded where necessary.

    Raises :class:`BadAddress`, :class:`StoreError` for a newer database, or :class:`StoreUnavailable`.
    """
    database = Database(database_url, timeout_s=timeout_s)
    try:
        database.prepare()
    except BaseException:
        database.close()
        raise
    return Keys(database)


def _revision(connection: Connection) -> int:
    return int(connection.execute(select(func.coalesce(func.max(tables.keys.c.revision), 0))).scalar_one())


def _select(connection: Connection) -> list[Key]:
    columns = [tables.keys.c[name] for name in Key.__slots__]
    query = select(*columns).order_by(tables.keys.c.created_at_s, tables.keys.c.id)
    rows: list[dict[str, Any]] = [dict(row._mapping) for row in connection.execute(query)]
    return [Key(**row | {"scopes": frozenset(row["scopes"].split())}) for row in rows]
