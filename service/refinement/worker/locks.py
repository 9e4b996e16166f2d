"""Which workers live: each holds a lock for as long as it does, and the others try it.

Nothing has to be written while a job runs, and no time-out has to be longer than the longest pause: a lock falls with
its process. With SQLite it is a file beside the database (one machine, a local disk); in PostgreSQL an advisory lock of
a session, which a machine that vanishes loses within about 25 s.
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

__all__ = ["FileLocks", "Hold", "Locks", "SessionLocks", "check_executor", "locks_of"]

_EXECUTOR = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")

_SPACE = 0x41645665
"""First half of the keys of advisory locks."""

_CONNECTION: dict[str, Any] = {
    "application_name": "adverb executor", "connect_timeout": 5,
    "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
}  # fmt: skip


class Hold(Protocol):
    """A lock that this process holds."""

    def held(self) -> bool:
        """Whether it did all the time; asked every second, takes the lock again where it was lost with a connection."""
        ...

    def release(self) -> None:
        """Let go."""
        ...


class Locks(Protocol):
    """Locks of executors, by their ids."""

    def hold(self, executor_id: str) -> Hold | None:
        """Take the lock until it is released; None where another process holds it."""
        ...

    @contextmanager
    def tried(self, executor_id: str) -> Iterator[bool]:
        """Try the lock, and keep it for as long as the context lasts: yields whether its worker is dead."""
        ...

    def tidy(self) -> None:
        """Remove what dead workers left of their locks."""
        ...

    def close(self) -> None:
        """Close what trying locks needed; locks that are held are another matter."""
        ...


def locks_of(database_url: str) -> Locks:
    """The locks that belong to a database."""
    url = make_url(database_url)
    if url.get_backend_name() != "sqlite":
        return SessionLocks(url.set(drivername="postgresql").render_as_string(hide_password=False))
    assert url.database is not None  # the store has opened it
    return FileLocks(Path(url.database).parent)


def check_executor(executor_id: str) -> str:
    """The id, where it may be one; it becomes a part of a file name."""
    if _EXECUTOR.fullmatch(executor_id) is None:
        raise OutOfRange(f"executor id {executor_id!r:.80} is not 1 to 63 letters, digits, '.', '_' or '-'")
    return executor_id


class FileLocks:
    """Locks as files of a folder, removed by whoever lets go: a lock on a file that is gone excludes nobody."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def hold(self, executor_id: str) -> FileHold | None:
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
                    return FileHold(path, descriptor)
            os.close(descriptor)  # it was removed between opening and locking: another one counts now

    @contextmanager
    def tried(self, executor_id: str) -> Iterator[bool]:
        """See :class:`Locks`."""
        found = self.hold(executor_id)
        try:
            yield found is not None
        finally:
            if found is not None:
                found.release()

    def tidy(self) -> None:
        """See :class:`Locks`."""
        for path in self.folder.glob("exec-*.lock"):
            with self.tried(path.stem.removeprefix("exec-")):
                pass  # letting go removes it

    def close(self) -> None:
        """See :class:`Locks`."""


class FileHold:
    """A locked file."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path, self._descriptor = path, descriptor

    def held(self) -> bool:
        """See :class:`Hold`."""
        return True

    def release(self) -> None:
        """See :class:`Hold`."""
        self._path.unlink(missing_ok=True)
        os.close(self._descriptor)


class SessionLocks:
    """Advisory locks of PostgreSQL sessions; needs direct connections, no pooler that shares sessions."""

    def __init__(self, url: str) -> None:
        self._url, self._trials = url, Session(url)

    def hold(self, executor_id: str) -> SessionHold | None:
        """See :class:`Locks`."""
        found = SessionHold(Session(self._url), _key(executor_id))
        return found if found.take() else None

    @contextmanager
    def tried(self, executor_id: str) -> Iterator[bool]:
        """See :class:`Locks`."""
        key = _key(executor_id)
        found = self._trials.ask("SELECT pg_try_advisory_lock(%s::int, %s::int)", key)
        try:
            yield found
        finally:
            if found:
                self._trials.ask("SELECT pg_advisory_unlock(%s::int, %s::int)", key)

    def tidy(self) -> None:
        """See :class:`Locks`; a session leaves nothing."""

    def close(self) -> None:
        """See :class:`Locks`."""
        self._trials.close()


class SessionHold:
    """An executor's lock, or the wish to have it."""

    def __init__(self, session: Session, key: tuple[int, int]) -> None:
        self._session, self._key = session, key

    def held(self) -> bool:
        """See :class:`Hold`."""
        if self._session.open:
            with suppress(psycopg.Error):
                return self._session.ask("SELECT true")
        self.take()
        return False

    def take(self) -> bool:
        """Try to take the lock; returns whether it has it now."""
        if self._session.ask("SELECT pg_try_advisory_lock(%s::int, %s::int)", self._key):
            return True
        self._session.close()
        return False

    def release(self) -> None:
        """See :class:`Hold`."""
        self._session.close()


class Session:
    """A connection of its own, opened when it is needed, and given up at the first failure."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._connection: psycopg.Connection[tuple[bool]] | None = None

    @property
    def open(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._connection is not None

    def ask(self, question: LiteralString, key: tuple[int, int] | None = None) -> bool:
        """A question's one answer; raises :class:`psycopg.Error` where the server does not give it."""
        try:
            if self._connection is None:
                self._connection = psycopg.connect(self._url, autocommit=True, **_CONNECTION)
            row = self._connection.execute(question, key).fetchone()
        except psycopg.Error:
            self.close()
            raise
        return row is not None and row[0]

    def close(self) -> None:
        """Close it, and let go of every lock that was taken through it."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None


def _key(executor_id: str) -> tuple[int, int]:
    """The two halves of an executor's advisory lock."""
    return _SPACE, int.from_bytes(hashlib.sha256(check_executor(executor_id).encode()).digest()[:4], "big", signed=True)
