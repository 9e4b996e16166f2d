"""The store: versions of verbs, their artifacts, the current version of each verb, refinement jobs and usage.

Publishing writes the artifact first and its row last, so that a publisher may die at any step: readers see a version
whole or not at all, and leftover files are collected later. The content of artifacts is never read here.

All methods except :meth:`Store.changes` block, and are thread-safe.
"""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Callable, Mapping
from pathlib import Path
from typing import Any

from sqlalchemy import select

from service.store import tables
from service.store.blobs import Blobs, open_blobs
from service.store.drafts import Drafts, put_all, used_blobs
from service.store.jobs import Jobs, UsageTable
from service.store.keys import Keys
from service.store.ledger import Change, Ledger, kept_detail, select_events, select_versions
from service.store.notices import notices
from service.store.records import (
    ArtifactDamaged,
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
    "ArtifactDamaged",
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
"""Steps of publishing to a folder, in order. A bucket has ``upload`` before ``transaction``."""

ORPHAN_S = 3600.0
"""Age at which a file without a row is removed, seconds: its publisher has finished or died."""

BATCH = 1000
"""Largest number of blobs that are removed in one transaction, while publishers wait."""


def _ignore(step: str) -> None:
    """Default of ``at``: do nothing."""


class Store:
    """Versions of verbs in a database and their artifacts in a folder or bucket; see :meth:`open`."""

    def __init__(self, database: Database, blobs: Blobs, *, clock: Callable[[], float] = time.time) -> None:
        self._database, self._blobs, self._clock = database, blobs, clock
        self._jobs, self._usage = Jobs(database, clock), UsageTable(database)
        self._apart = database.apart()  # keys are read whatever other calls wait for
        self.drafts, self.keys = Drafts(database, blobs, clock), Keys(self._apart, clock)

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
        """Open a store; missing tables and folders are created, older tables upgraded.

        Parameters
        ----------
        database_url : str
            ``sqlite:////absolute/state.db`` or ``postgresql://…``.
        artifacts : str
            Folder, ``file://…``, or bucket: ``s3://bucket/prefix`` with keys and endpoint from the environment.
        cache : Path, optional
            Folder for copies of a bucket's blobs; by default the user's cache folder.
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

    @classmethod
    def existing(cls, database_url: str, artifacts: str, *, cache: Path) -> Store:
        """Open a store that exists, with tables of this layout, without a change to either.

        ``cache`` is a folder that exists. Errors are those of :meth:`open`.
        """
        return cls(Database(database_url, timeout_s=5.0), open_blobs(artifacts, cache=cache, create=False))

    @property
    def available(self) -> bool:
        """Whether the last contact with the database worked."""
        return self._database.available

    def close(self) -> None:
        """Close every connection; later calls raise :class:`StoreUnavailable`, and :meth:`changes` ends."""
        self._database.close()
        self._apart.close()

    def current(self) -> dict[str, Version]:
        """The current version of each served verb, in order of names."""
        versions, pointers = tables.versions.c, tables.pointers.c
        pointed = select(pointers.verb).where(pointers.verb == versions.verb, pointers.number == versions.number)
        with self._database.transaction() as connection:
            return {version.verb: version for version in select_versions(connection, pointed.exists())}

    def versions(self, verb: str) -> list[Version]:
        """All versions of a verb, oldest first; raises :class:`UnknownVerb`."""
        with self._database.transaction() as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.check_exists()
            return ledger.versions()

    def version(self, verb: str, number: int) -> Version:
        """One version; raises :class:`UnknownVerb` or :class:`UnknownVersion`."""
        with self._database.transaction() as connection:
            return Ledger(self._database, connection, verb).version(number)

    def events(
        self, *, limit: int, before: int | None = None, verb: str | None = None, author: str | None = None
    ) -> list[tuple[int, Event]]:
        """Events with their numbers, newest first; optionally of one verb, of one author, or before a number."""
        with self._database.transaction() as connection:
            return select_events(connection, limit=limit, before=before, verb=verb, author=author)

    def history(self, verb: str, *, limit: int = 1000) -> list[Event]:
        """Events of a verb, newest last; raises :class:`UnknownVerb`."""
        with self._database.transaction() as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.check_exists()
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
        source: Path | None = None,
        at: Callable[[str], None] = _ignore,
    ) -> Version:
        """Publish an artifact as a verb's next version.

        Publishing the same bytes with the same parent again returns the existing version, so a publisher that does not
        know whether it succeeded can repeat the call.

        Parameters
        ----------
        verb : str
        artifact : Path
            File to copy; the caller has validated it.
        author, reason : str
            Up to 200 and 2000 characters.
        quality : mapping
            JSON values, up to 1 MB.
        parent : int, optional
            Version that it was refined from.
        expected : int, optional
            Number that must be current; 0 for none.
        activate : bool
            Whether to make the version current.
        activate_if : int, optional
            Make the new version current only if this one is; otherwise the new one is kept without being activated.
        ends : str, optional
            Refinement job that becomes ``published`` in the same transaction. Its detail is ``reason``, and states if
            the version was not activated.
        source : Path, optional
            Archive of the verb's source, kept as long as the version.
        at : callable
            Called with the name of each step before it, see :data:`STEPS`.

        Raises
        ------
        Conflict
            Another version is current than expected.
        UnknownVerb
            With ``activate_if``: the verb was deleted.
        UnknownVersion
            The parent does not exist.
        UnknownJob, JobEnded
            The job does not exist or has ended, perhaps by cancellation: nothing is published.
        InvalidValue
            A name, text or JSON value cannot be stored.
        ArtifactError
            The artifact cannot be read.
        StoreUnavailable
            The database or the artifacts cannot be reached in time.
        """
        check_verb(verb)
        json_text("quality", quality)
        change = self._change(author, reason)
        with put_all(self._database, self._blobs, (artifact, *([source] if source else [])), at) as (connection, blobs):
            ledger = Ledger(self._database, connection, verb)
            version = ledger.add_blob(
                *(blobs[0], blobs[1] if source else None, quality, change),
                parent=parent,
                expected=expected,
                activate=activate,
                activate_if=activate_if,
            )
            if ends is not None:
                current = ledger.current()
                detail = reason if current == version.number else kept_detail(version, current, reason)
                changes = {"state": "published", "version_after": version.number, "detail": detail}
                self._jobs.write(connection, ends, changes)
            at("commit")
        return version

    def activate(self, verb: str, number: int, *, author: str, reason: str, expected: int | None = None) -> Version:
        """Make one of a verb's versions current, also of a deleted verb; does nothing if it is current already.

        Raises :class:`UnknownVerb`, :class:`UnknownVersion`, :class:`Conflict` if another version is current than
        ``expected`` (0 for none), :class:`InvalidValue`, or an error of :meth:`path`: what cannot be served is not made
        current.
        """
        change = self._change(author, reason)
        self.path(self.version(verb, number))
        with self._database.transaction(writes=True) as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.check_exists()
            ledger.lock()
            version = ledger.version(number)
            ledger.activate(version, change, expected=expected)
            return version

    def delete(self, verb: str, *, author: str, reason: str, expected: int | None = None) -> None:
        """Stop serving a verb. Its versions stay for roll-back until they are collected, and numbers are not reused.

        Raises :class:`UnknownVerb` if it is not served, :class:`Conflict` or :class:`InvalidValue`.
        """
        change = self._change(author, reason)
        with self._database.transaction(writes=True) as connection:
            ledger = Ledger(self._database, connection, verb)
            ledger.check_exists()
            ledger.lock()
            number = ledger.current()
            if number is None:
                raise ledger.unknown_verb()
            ledger.expect(expected)
            ledger.set_current(None)
            ledger.add_event("delete", number, change)

    def path(self, version: Version) -> Path:
        """A local file with a version's artifact, checked against its hash; it never changes and can be mapped.

        Raises :class:`ArtifactMissing` if the blob is missing, :class:`ArtifactDamaged` if it is damaged, and
        :class:`StoreUnavailable` if the artifacts cannot be reached.
        """
        return self._blobs.path(version.sha256)

    def source(self, version: Version) -> Path | None:
        """A local file with the archive of a version's source; errors as of :meth:`path`.

        A refined version has the source of the version that it was refined from. None where none is stored.
        """
        found = {row.number: row for row in self.versions(version.verb)}
        row: Version | None = version
        while row is not None and row.source_sha256 is None:
            row = found.get(row.parent or 0)
        return None if row is None or row.source_sha256 is None else self._blobs.path(row.source_sha256)

    def collect(
        self, *, keep: int = 5, younger_s: float = 7 * 86400.0, drafts_s: float = 30 * 86400.0, now_s: float
    ) -> list[str]:
        """Remove old versions, drafts, files and usage; several processes may do so at the same time.

        A verb keeps its current version, its ``keep`` newest, every version younger than ``younger_s``, and those that
        queued or running jobs refine. A verb that was deleted longer ago than that keeps only the last two kinds.
        Blobs, cached copies and temporary files are removed when no version refers to them and they are older than an
        hour; mapped files stay readable. Usage is removed when its server stored none for ``younger_s``.

        Parameters
        ----------
        keep : int
        younger_s, drafts_s : float
            Drafts that were not changed for ``drafts_s`` are removed.
        now_s : float
            Seconds since 1970, UTC.

        Returns
        -------
        removed : list of str
            ``"reach 3"`` for a version, ``"draft ID"``, else names of files.

        Raises
        ------
        StoreUnavailable
            The database or the artifacts cannot be reached; removals until then are final.
        """
        removed: list[str] = []
        with self._database.transaction() as connection:
            verbs = connection.execute(select(tables.verbs.c.name).order_by(tables.verbs.c.name)).scalars().all()
        for verb in verbs:
            with self._database.transaction(writes=True) as connection:
                ledger = Ledger(self._database, connection, verb)
                ledger.lock()
                removed += [f"{verb} {number}" for number in ledger.collect(keep=keep, before_s=now_s - younger_s)]
        removed += self._usage.remove(before_s=now_s - younger_s) + self.drafts.remove(before_s=now_s - drafts_s)
        return removed + self._collect_files(now_s - ORPHAN_S)

    def _collect_files(self, before_s: float) -> list[str]:
        """Remove files without a version that were last modified before a time; returns their names."""
        removed: list[str] = []
        for place in filter(None, (self._blobs, self._blobs.cache)):
            old = [blob for blob in place.listing() if blob.modified_at_s < before_s]
            for start in range(0, len(old), BATCH):
                with self._database.transaction(writes=True) as connection:
                    self._database.lock_blobs(connection, removing=True)
                    used = used_blobs(connection)
                    gone = [blob for blob in old[start : start + BATCH] if blob.sha256 not in used]
                    place.remove(gone)
                removed += [blob.name if place is self._blobs else f"cached {blob.name}" for blob in gone]
        return removed

    def changes(self) -> AsyncGenerator[None, None]:
        """Yield at the start, and whenever current versions may have changed; at least every 3 s.

        Retries while the database cannot be reached, see :attr:`available`. Close the iterator
        (``contextlib.aclosing``) or cancel its task to end it.
        """
        return notices(self._database)

    def put_usage(self, verb: str, server: str, cells: Mapping[str, Any], now_s: float) -> None:
        """Store the usage cells of a verb from one server, in place of its earlier ones.

        Raises :class:`InvalidValue` if they are more than 1 MB of JSON.
        """
        self._usage.put(verb, server, cells, now_s)

    def usage(self, verb: str, *, not_before_s: float) -> list[Mapping[str, Any]]:
        """Usage cells of each server that stored some since a time, newest first."""
        return self._usage.since(verb, not_before_s=not_before_s)

    def add_job(self, job: Job, *, author: str | None = None) -> None:
        """Add a refinement job, with an event where an author is given; raises JobExists or :class:`InvalidValue`."""
        self._jobs.add(job, author=author)

    def job(self, id: str) -> Job:
        """Get a refinement job; raises :class:`UnknownJob`."""
        return self._jobs.get(id)

    def jobs(self, *, verb: str | None = None, limit: int = 100, unfinished: bool = False) -> list[Job]:
        """The newest refinement jobs of one verb or of all, newest first; optionally only unfinished ones."""
        return self._jobs.newest(verb=verb, limit=limit, unfinished=unfinished)

    def ended_jobs(self) -> dict[tuple[str, str], int]:
        """Number of ended refinement jobs by verb and state."""
        return self._jobs.ended()

    def update_job(self, id: str, **changes: Any) -> Job:
        """Change ``state``, ``progress``, ``version_before``, ``version_after`` or ``detail`` of a job.

        Raises :class:`UnknownJob`, :class:`InvalidValue`, or :class:`JobEnded` if it has ended in another state: the
        first final state of a job stays.
        """
        return self._jobs.update(id, changes)

    def cancel_job(self, id: str, *, detail: str, author: str) -> Job:
        """Cancel a job, with an event; errors as of :meth:`update_job`."""
        return self._jobs.cancel(id, detail=detail, author=author)

    def count_reap(self, id: str) -> int:
        """Increment the number of times that a job was taken over, and return it; raises :class:`UnknownJob`."""
        return self._jobs.reap(id)

    def _change(self, author: str, reason: str) -> Change:
        check_text("author", author, 200, empty=False)
        check_text("reason", reason, 2000)
        return Change(author, reason, self._clock())
