"""Locks that show which workers are alive: each worker holds one as long as it runs, and others try to take it.

A lock is released with its process, so there are neither heartbeats nor time-outs. With SQLite it is a file beside the
database (one machine, a local disk); in PostgreSQL an advisory lock of a session, which a machine that vanishes loses
within about 25 s.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, LiteralString, Protocol

import psycopg
from sqlalchemy import make_url

from verbs.errors import OutOfRange

__all__ = ["FileLocks", "Lock", "Locks", "SessionLocks", "check_executor", "locks_of"]

_EXECUTOR = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")

_SPACE = 0x41645665
"""First half of the keys of advisory locks."""

_CONNECTION: dict[str, Any] = {
    "application_name": "adverb executor", "connect_timeout": 5,
    "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
}  # fmt: skip


class Lock(Protocol):
    """A lock that this process holds."""

    def ensure(self) -> bool:
        """Whether the lock was never lost; if its connection was, try to take it again. Called every second."""
        ...

    def release(self) -> None:
        """Release the lock."""
        ...


class Locks(Protocol):
    """Locks of executors, by their ids."""

    def acquire(self, executor_id: str) -> Lock | None:
        """Take the lock; None if another process holds it."""
        ...

    @contextmanager
    def try_lock(self, executor_id: str) -> Iterator[bool]:
        """Try to hold the lock during the context; yields whether it was free, so that its worker is dead."""
        ...

    def remove_stale(self) -> None:
        """Remove lock files of dead workers."""
        ...

    def close(self) -> None:
        """Close the connection for :meth:`try_lock`; acquired locks stay held."""
        ...


def locks_of(database_url: str) -> Locks:
    """The locks that belong to a database."""
    url = make_url(database_url)
    if url.get_backend_name() != "sqlite":
        return SessionLocks(url.set(drivername="postgresql").render_as_string(hide_password=False))
    assert url.database is not None  # the store has opened it
    return FileLocks(Path(url.database).parent)


def check_executor(executor_id: str) -> str:
    """Validate an executor id, which becomes part of a file name; raises :class:`OutOfRange`."""
    if _EXECUTOR.fullmatch(executor_id) is None:
        raise OutOfRange(f"executor id {executor_id!r:.80} is not 1 to 63 letters, digits, '.', '_' or '-'")
    return executor_id


class FileLocks:
    """Locks as files of a folder. A file is removed on release, so a lock counts only while its file exists."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def acquire(self, executor_id: str) -> FileLock | None:
        """See :class:`Locks`."""
        path = self.folder / f"exec-{check_executor(executor_id)}.lock"
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(descriptor)
                return None
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), path.stat()):
                    return FileLock(path, descriptor)
            os.close(descriptor)  # the file was removed between opening and locking it

    @contextmanager
    def try_lock(self, executor_id: str) -> Iterator[bool]:
        """See :class:`Locks`."""
        found = self.acquire(executor_id)
        try:
            yield found is not None
        finally:
            if found is not None:
                found.release()

    def remove_stale(self) -> None:
        """See :class:`Locks`."""
        for path in self.folder.glob("exec-*.lock"):
            with self.try_lock(path.stem.removeprefix("exec-")):
                pass  # releasing it removes the file

    def close(self) -> None:
        """See :class:`Locks`."""


class FileLock:
    """A locked file."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path, self._descriptor = path, descriptor

    def ensure(self) -> bool:
        """See :class:`Lock`."""
        return True

    def release(self) -> None:
        """See :class:`Lock`."""
        self._path.unlink(missing_ok=True)
        os.close(self._descriptor)


class SessionLocks:
    """Advisory locks of PostgreSQL sessions; needs direct connections, no pooler that shares sessions."""

    def __init__(self, url: str) -> None:
        self._url, self._trying = url, Session(url)

    def acquire(self, executor_id: str) -> SessionLock | None:
        """See :class:`Locks`."""
        found = SessionLock(Session(self._url), _key(executor_id))
        return found if found.take() else None

    @contextmanager
    def try_lock(self, executor_id: str) -> Iterator[bool]:
        """See :class:`Locks`."""
        key = _key(executor_id)
        found = self._trying.query("SELECT pg_try_advisory_lock(%s::int, %s::int)", key)
        try:
            yield found
        finally:
            if found:
                self._trying.query("SELECT pg_advisory_unlock(%s::int, %s::int)", key)

    def remove_stale(self) -> None:
        """See :class:`Locks`; sessions leave nothing behind."""

    def close(self) -> None:
        """See :class:`Locks`."""
        self._trying.close()


class SessionLock:
    """The lock of an executor in a session of its own."""

    def __init__(self, session: Session, key: tuple[int, int]) -> None:
        self._session, self._key = session, key

    def ensure(self) -> bool:
        """See :class:`Lock`."""
        if self._session.open:
            with suppress(psycopg.Error):
                return self._session.query("SELECT true")
        self.take()
        return False

    def take(self) -> bool:
        """Try to take the lock; returns whether it is held now."""
        if self._session.query("SELECT pg_try_advisory_lock(%s::int, %s::int)", self._key):
            return True
        self._session.close()
        return False

    def release(self) -> None:
        """See :class:`Lock`."""
        self._session.close()


class Session:
    """A connection that is opened on demand, and closed at the first failure."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._connection: psycopg.Connection[tuple[bool]] | None = None

    @property
    def open(self) -> bool:
        """Whether a connection is open."""
        return self._connection is not None

    def query(self, statement: LiteralString, key: tuple[int, int] | None = None) -> bool:
        """Execute a statement that returns one boolean; raises :class:`psycopg.Error`."""
        try:
            if self._connection is None:
                self._connection = psycopg.connect(self._url, autocommit=True, **_CONNECTION)
            row = self._connection.execute(statement, key).fetchone()
        except psycopg.Error:
            self.close()
            raise
        return row is not None and row[0]

    def close(self) -> None:
        """Close the connection, which releases its locks."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None


def _key(executor_id: str) -> tuple[int, int]:
    """The two halves of an executor's advisory lock."""
    return _SPACE, int.from_bytes(hashlib.sha256(check_executor(executor_id).encode()).digest()[:4], "big", signed=True)
