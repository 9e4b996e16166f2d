"""The store: versions of verbs, which of them is current, and who is told when that changes.

Publishing writes the artifact first and points to it last, so that a publisher may die at any step: readers see the
version whole or not at all. What it leaves behind is collected later. Nothing here reads what is inside an artifact.

All methods block, except :meth:`Store.changes`; call them from a thread where an event loop runs. Any thread may call.
"""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Callable, Mapping
from pathlib import Path
from typing import Any

from sqlalchemy import select

from service.store import tables
from service.store.blobs import Blobs, open_blobs
from service.store.jobs import Jobs, Traffic
from service.store.ledger import Change, Ledger, select_versions
from service.store.notices import notices
from service.store.records import (
    ArtifactMissing,
    BadAddress,
    Conflict,
    Event,
    InvalidValue,
    Job,
    JobEnded,
    JobExists,
    StoreError,
    StoreUnavailable,
    UnknownJob,
    UnknownVerb,
    UnknownVersion,
    Version,
    check_text,
    check_verb,
    json_text,
)
from service.store.tables import Database

__all__ = [
    "ORPHAN_S",
    "STEPS",
    "ArtifactMissing",
    "BadAddress",
    "Conflict",
    "Event",
    "InvalidValue",
    "Job",
    "JobEnded",
    "JobExists",
    "Store",
    "StoreError",
    "StoreUnavailable",
    "UnknownJob",
    "UnknownVerb",
    "UnknownVersion",
    "Version",
]

STEPS = ("write", "sync", "rename", "sync_folder", "transaction", "commit")
"""What publishing to a folder does, in order. A bucket has ``upload`` before ``transaction``."""

ORPHAN_S = 3600.0
"""Age at which a file that no row refers to belongs to nobody, seconds: its publisher is done or dead."""

ATTEMPTS = 3
"""How often a blob is written that a collector removes before the version is written down."""

BATCH = 1000
"""Blobs that are removed while publishers wait."""


def _nothing(step: str) -> None:
    """Nothing happens between steps."""


def _kept(version: Version, current: int | None, reason: str) -> str:
    """Detail of a job whose version was not activated."""
    return (
        f"kept as version {version.number}, not activated: version {current} is current, and the refinement started "
        f"from version {version.parent}; {reason}"
    )


class Store:
    """Versions of verbs in a database and their artifacts in a folder or bucket; see :meth:`open`."""

    def __init__(self, database: Database, blobs: Blobs, *, clock: Callable[[], float] = time.time) -> None:
        self._database, self._blobs, self._clock = database, blobs, clock
        self._jobs, self._traffic = Jobs(database, clock), Traffic(database)

    @classmethod
    def open(
        cls,
        database_url: str,
        artifacts: str,
        *,
        cache: Path | None = None,
        timeout_s: float = 5.0,
        clock: Callable[[], float] = time.time,
    ) -> Store:
        """Open a store and make its tables and folders where they are not there.

        Parameters
        ----------
        database_url : str
            ``sqlite:////absolute/state.db`` or ``postgresql://…``.
        artifacts : str
            A folder, ``file://…``, or a bucket: ``s3://bucket/prefix`` with keys and endpoint from the environment.
        cache : Path, optional
            Folder for copies of a bucket's blobs; the user's cache folder unless it is given.
        timeout_s : float
            Longest wait for a connection, a lock or a statement, seconds.
        clock : callable
            Seconds since 1970, UTC.

        Raises
        ------
        BadAddress
            An address is of an unknown kind, or needs a package that is not installed.
        StoreUnavailable
            The database or the folder cannot be reached.
        """
        blobs = open_blobs(artifacts, cache=cache)
        database = Database(database_url, timeout_s=timeout_s)
        try:
            database.prepare()
        except BaseException:
            database.close()
            raise
        return cls(database, blobs, clock=clock)

    @property
    def available(self) -> bool:
        """Whether the last contact with the database worked."""
        return self._database.available

    def close(self) -> None:
        """Close every connection; later calls raise :class:`StoreUnavailable`, and :meth:`changes` ends."""
        self._database.close()

    def current(self) -> dict[str, Version]:
        """The verbs that are served, and the version that each points to, in order of names."""
        versions, pointers = tables.versions.c, tables.pointers.c
        pointed = select(pointers.verb).where(pointers.verb == versions.verb, pointers.number == versions.number)
        with self._database.transaction() as connection:
            return {version.verb: version for version in select_versions(connection, pointed.exists())}

    def versions(self, verb: str) -> list[Version]:
        """Every version of a verb that was not collected, oldest first; raises :class:`UnknownVerb`."""
        with self._database.transaction() as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.require()
            return ledger.versions()

    def version(self, verb: str, number: int) -> Version:
        """One version; raises :class:`UnknownVerb` or :class:`UnknownVersion`."""
        with self._database.transaction() as connection:
            return Ledger(self._database, connection, verb).pick(number)

    def history(self, verb: str, *, limit: int = 1000) -> list[Event]:
        """What was done to a verb, newest last; raises :class:`UnknownVerb`."""
        with self._database.transaction() as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.require()
            return ledger.history(limit)

    def publish(
        self,
        verb: str,
        artifact: Path,
        *,
        author: str,
        reason: str,
        quality: Mapping[str, Any],
        parent: int | None = None,
        expected: int | None = None,
        activate: bool = True,
        activate_if: int | None = None,
        ends: str | None = None,
        at: Callable[[str], None] = _nothing,
    ) -> Version:
        """Publish an artifact as a verb's next version.

        Publishing the same bytes with the same parent again gives the version that there is, so a publisher that
        does not know whether it succeeded asks again.

        Parameters
        ----------
        verb : str
        artifact : Path
            Copied; whether it is a verb was checked before.
        author, reason : str
            Up to 200 and 2000 characters for the history.
        quality : mapping
            JSON values, up to 1 MB.
        parent : int, optional
            Version that it was refined from.
        expected : int, optional
            Number that the verb must point to; 0 for none.
        activate : bool
            Whether the verb points to it from now on.
        activate_if : int, optional
            Activate the new version only where the verb points to this one; otherwise it is kept, and not activated.
        ends : str, optional
            Refinement job that is ``published`` in the same transaction. Its detail is ``reason``, and states where the
            version was not activated.
        at : callable
            Told the name of each step before it is done, see :data:`STEPS`.

        Raises
        ------
        Conflict
            The verb points to another version than expected.
        UnknownVerb
            With ``activate_if``: the verb was deleted.
        UnknownVersion
            There is no such parent.
        UnknownJob, JobEnded
            There is no such job, or it has ended (it may have been cancelled): nothing is published.
        InvalidValue
            A name, text or JSON value cannot be kept.
        ArtifactError
            The artifact cannot be read.
        StoreUnavailable
            The database or the place for artifacts cannot be reached in time.
        """
        check_verb(verb)
        json_text("quality", quality)
        change = self._change(author, reason)
        for _ in range(ATTEMPTS):
            blob = self._blobs.put(artifact, at)
            at("transaction")
            with self._database.transaction(writes=True) as connection:
                self._database.hold_blobs(connection, removing=False)
                if not self._blobs.has(str(blob.sha256)):
                    continue  # it was there before, old and referred to by nobody, and was collected just now
                ledger = Ledger(self._database, connection, verb)
                version = ledger.enter(
                    *(blob, quality, change),
                    parent=parent,
                    expected=expected,
                    activate=activate,
                    activate_if=activate_if,
                )
                if ends is not None:
                    current = ledger.current()
                    detail = reason if current == version.number else _kept(version, current, reason)
                    changes = {"state": "published", "version_after": version.number, "detail": detail}
                    self._jobs.write(connection, ends, changes)
                at("commit")
            return version
        raise StoreUnavailable("the artifact does not stay where it is written")

    def activate(self, verb: str, number: int, *, author: str, reason: str, expected: int | None = None) -> Version:
        """Point a verb to one of its versions; one that was deleted is served again.

        Raises :class:`UnknownVerb`, :class:`UnknownVersion`, :class:`Conflict` where it points to another version than
        ``expected`` (0 for none), or :class:`InvalidValue`. Nothing happens where it points there already.
        """
        change = self._change(author, reason)
        with self._database.transaction(writes=True) as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.require()
            ledger.lock()
            version = ledger.pick(number)
            ledger.turn(version, change, expected=expected)
            return version

    def delete(self, verb: str, *, author: str, reason: str, expected: int | None = None) -> None:
        """Stop serving a verb. Its versions stay for roll-back until they are collected, and numbers go on.

        Raises :class:`UnknownVerb` where it is not served, :class:`Conflict` or :class:`InvalidValue`.
        """
        change = self._change(author, reason)
        with self._database.transaction(writes=True) as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.require()
            ledger.lock()
            number = ledger.current()
            if number is None:
                raise ledger.unknown()
            ledger.expect(expected)
            ledger.point(None)
            ledger.note("delete", number, change)

    def path(self, version: Version) -> Path:
        """A local file with a version's artifact, checked against its hash; it can be mapped and never changes.

        Raises :class:`ArtifactMissing` where the version was collected meanwhile or its blob is damaged, and
        :class:`StoreUnavailable` where the artifacts cannot be reached.
        """
        return self._blobs.path(version.sha256)

    def collect(self, *, keep: int = 5, younger_s: float = 7 * 86400.0, now_s: float) -> list[str]:
        """Remove what nothing needs any more; any process may do so at any time, several at once too.

        A verb keeps its current version, its ``keep`` newest, every version younger than ``younger_s``, and those that
        queued or running jobs refine. A verb that was deleted longer ago than that keeps only the last two kinds.
        Blobs, cached copies and temporary files go when no version refers to them and they are older than an hour.
        Counted traffic goes when its server said nothing for ``younger_s``. A file that is mapped stays readable.

        Parameters
        ----------
        keep : int
        younger_s : float
        now_s : float
            Seconds since 1970, UTC.

        Returns
        -------
        removed : list of str
            ``"reach 3"`` for a version, else names of files.

        Raises
        ------
        StoreUnavailable
            The database or the artifacts cannot be reached; what was removed until then is gone.
        """
        removed: list[str] = []
        with self._database.transaction() as connection:
            verbs = connection.execute(select(tables.verbs.c.name).order_by(tables.verbs.c.name)).scalars().all()
        for verb in verbs:
            with self._database.transaction(writes=True) as connection:
                ledger = Ledger(self._database, connection, verb)
                ledger.lock()
                removed += [f"{verb} {number}" for number in ledger.collect(keep=keep, before_s=now_s - younger_s)]
        removed += self._traffic.forget(before_s=now_s - younger_s)
        return removed + self._collect_files(now_s - ORPHAN_S)

    def _collect_files(self, before_s: float) -> list[str]:
        """Remove files that no version refers to and that did not change since an instant; returns their names."""
        removed: list[str] = []
        for place in filter(None, (self._blobs, self._blobs.cache)):
            old = [blob for blob in place.listing() if blob.modified_at_s < before_s]
            for start in range(0, len(old), BATCH):
                with self._database.transaction(writes=True) as connection:
                    self._database.hold_blobs(connection, removing=True)
                    used = set(connection.execute(select(tables.versions.c.sha256).distinct()).scalars())
                    gone = [blob for blob in old[start : start + BATCH] if blob.sha256 not in used]
                    place.remove(gone)
                removed += [blob.name if place is self._blobs else f"cached {blob.name}" for blob in gone]
        return removed

    def changes(self) -> AsyncGenerator[None, None]:
        """Yield once at the start, and then whenever the verbs' pointers may have changed; at least every 3 s.

        A database that cannot be reached is tried again and again, see :attr:`available`. Close the iterator
        (``contextlib.aclosing``) or cancel its task to end it.
        """
        return notices(self._database)

    def put_traffic(self, verb: str, server: str, cells: Mapping[str, Any], now_s: float) -> None:
        """Keep what clients asked of a verb, as one server counted it, in place of what it said before.

        Raises :class:`InvalidValue` where it is more than 1 MB of JSON.
        """
        self._traffic.put(verb, server, cells, now_s)

    def traffic(self, verb: str, *, not_before_s: float) -> list[Mapping[str, Any]]:
        """What each server counted that said something since, newest first."""
        return self._traffic.since(verb, not_before_s=not_before_s)

    def add_job(self, job: Job) -> None:
        """Write a refinement job down; raises :class:`JobExists` or :class:`InvalidValue`."""
        self._jobs.add(job)

    def job(self, id: str) -> Job:
        """A refinement job; raises :class:`UnknownJob`."""
        return self._jobs.get(id)

    def jobs(self, *, verb: str | None = None, limit: int = 100, unfinished: bool = False) -> list[Job]:
        """The newest refinement jobs, of one verb or all, newest first; all of them, or only those that go on."""
        return self._jobs.newest(verb=verb, limit=limit, unfinished=unfinished)

    def ended_jobs(self) -> dict[tuple[str, str], int]:
        """How many refinement jobs ended, by verb and state."""
        return self._jobs.ended()

    def update_job(self, id: str, **changes: Any) -> Job:
        """Change ``state``, ``progress``, ``version_before``, ``version_after`` or ``detail`` of a job.

        Raises :class:`UnknownJob`, :class:`InvalidValue`, or :class:`JobEnded` where it ended in another state: the
        first to end a job decides, whoever comes second learns it.
        """
        return self._jobs.update(id, changes)

    def count_reap(self, id: str) -> int:
        """Count that another worker took a job over; returns how often that was. Raises :class:`UnknownJob`."""
        return self._jobs.reap(id)

    def _change(self, author: str, reason: str) -> Change:
        check_text("author", author, 200, empty=False)
        check_text("reason", reason, 2000)
        return Change(author, reason, self._clock())
