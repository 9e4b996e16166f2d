"""Rows of one verb within a transaction of :class:`service.store.store.Store`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update
from sqlalchemy.sql import ColumnElement

from service.store import tables
from service.store.blobs import Blob
from service.store.records import Conflict, Event, UnknownVerb, UnknownVersion, Version
from service.store.tables import Database

__all__ = ["Change", "Ledger", "kept_detail", "select_events", "select_versions"]


@dataclass(frozen=True, slots=True)
class Change:
    """Author, reason and time (seconds since 1970, UTC) of a change."""

    author: str
    reason: str
    at_s: float


class Ledger:
    """The rows of one verb in one transaction.

    Parameters
    ----------
    database : Database
    connection : Connection
        In a transaction.
    verb : str
    """

    def __init__(self, database: Database, connection: Connection, verb: str) -> None:
        self._database, self._connection, self.verb = database, connection, verb

    def lock(self) -> int:
        """Lock the verb for changes; returns its highest version number so far, 0 for a new verb."""
        made = self._database.insert(tables.verbs).values(name=self.verb, last=0).on_conflict_do_nothing()
        self._connection.execute(made)
        query = select(tables.verbs.c.last).where(tables.verbs.c.name == self.verb).with_for_update()
        return int(self._connection.execute(query).scalar_one())

    def current(self) -> int | None:
        """Number of the current version."""
        query = select(tables.pointers.c.number).where(tables.pointers.c.verb == self.verb)
        return self._connection.execute(query).scalar()

    def expect(self, expected: int | None) -> None:
        """Raise :class:`Conflict` if another version is current than expected; 0 expects none."""
        found = self.current() or 0
        if expected is not None and expected != found:
            raise Conflict(self.verb, expected, found)

    def versions(self) -> list[Version]:
        """Every version, oldest first."""
        return self._select(tables.versions.c.verb == self.verb)

    def find(self, sha256: str, parent: int | None) -> Version | None:
        """The version with this artifact and parent, if it was published before."""
        table = tables.versions
        found = self._select(table.c.verb == self.verb, table.c.sha256 == sha256, table.c.parent == parent)
        return found[-1] if found else None

    def add(self, version: Version) -> None:
        """Add the row of a version, and make its number the highest."""
        row = asdict(version) | {"quality": json.dumps(version.quality, separators=(",", ":"))}
        self._connection.execute(insert(tables.versions).values(row))
        self._connection.execute(
            update(tables.verbs).where(tables.verbs.c.name == self.verb).values(last=version.number)
        )

    def set_current(self, number: int | None) -> None:
        """Make a version current, or none."""
        table = tables.pointers
        if number is None:
            self._connection.execute(delete(table).where(table.c.verb == self.verb))
            return
        made = self._database.insert(table).values(verb=self.verb, number=number)
        self._connection.execute(made.on_conflict_do_update(index_elements=["verb"], set_={"number": number}))

    def add_blob(
        self,
        blob: Blob,
        source: Blob | None,
        quality: Mapping[str, Any],
        change: Change,
        *,
        parent: int | None,
        expected: int | None,
        activate: bool,
        activate_if: int | None,
    ) -> Version:
        """Add a version for a blob, unless it was published before, and activate it; see ``Store.publish``."""
        last, sha256 = self.lock(), str(blob.sha256)
        if activate_if is not None:
            current = self.current()
            if current is None:
                raise self.unknown_verb()
            activate = activate and current == activate_if
        version = self.find(sha256, parent)
        if version is not None:
            if source is not None and version.source_sha256 is None:
                version = self._with_source(version, str(source.sha256))
            if activate:
                self.activate(version, change, expected=expected)
            return version
        self.expect(expected)
        if parent is not None:
            self.version(parent)
        version = Version(
            verb=self.verb,
            number=last + 1,
            sha256=sha256,
            size_bytes=blob.size_bytes,
            author=change.author,
            reason=change.reason,
            quality=dict(quality),
            created_at_s=change.at_s,
            parent=parent,
            source_sha256=None if source is None else source.sha256,
        )
        self.add(version)
        if activate:
            self.set_current(version.number)
        self.add_event("publish", version.number, change)
        return version

    def _with_source(self, version: Version, sha256: str) -> Version:
        """Store the source of a version that was published without one."""
        table = tables.versions
        row = update(table).where(table.c.verb == self.verb, table.c.number == version.number)
        self._connection.execute(row.values(source_sha256=sha256))
        return replace(version, source_sha256=sha256)

    def activate(self, version: Version, change: Change, *, expected: int | None) -> None:
        """Make an existing version current, unless it is already; raises :class:`Conflict`."""
        if self.current() == version.number:
            return
        self.expect(expected)
        self.set_current(version.number)
        self.add_event("activate", version.number, change)

    def add_event(self, kind: str, number: int, change: Change) -> None:
        """Add an event to the history, and notify the servers."""
        event = Event(self.verb, kind, number, self.current(), change.author, change.reason, change.at_s)
        self._connection.execute(insert(tables.events).values(asdict(event)))
        self._database.notify(self._connection, self.verb)

    def history(self, limit: int) -> list[Event]:
        """The newest events, newest last."""
        return [event for _, event in select_events(self._connection, limit=limit, verb=self.verb)][::-1]

    def _deleted_before(self, at_s: float) -> bool:
        """Whether the last change of the current version was a deletion before a time."""
        kinds = ("publish", "activate", "delete")
        table = tables.events
        query = select(table.c.kind, table.c.at_s).where(table.c.verb == self.verb, table.c.kind.in_(kinds))
        last = self._connection.execute(query.order_by(table.c.id.desc()).limit(1)).one_or_none()
        return last is not None and last.kind == "delete" and last.at_s < at_s

    def check_exists(self) -> None:
        """Raise :class:`UnknownVerb` if the verb was never published."""
        found = self._connection.execute(select(tables.verbs.c.name).where(tables.verbs.c.name == self.verb)).scalar()
        if found is None:
            raise self.unknown_verb()

    def unknown_verb(self) -> UnknownVerb:
        """An error that lists the served verbs."""
        names = select(tables.pointers.c.verb).order_by(tables.pointers.c.verb)
        return UnknownVerb(self.verb, self._connection.execute(names).scalars())

    def version(self, number: int) -> Version:
        """One version; raises :class:`UnknownVerb` or :class:`UnknownVersion`."""
        self.check_exists()
        table = tables.versions
        found = self._select(table.c.verb == self.verb, table.c.number == number)
        if not found:
            numbers = select(table.c.number).where(table.c.verb == self.verb).order_by(table.c.number)
            raise UnknownVersion(self.verb, number, self._connection.execute(numbers).scalars())
        return found[0]

    def collect(self, *, keep: int, before_s: float) -> list[int]:
        """Remove old versions; returns their numbers. See :meth:`service.store.store.Store.collect`."""
        if self._deleted_before(before_s):
            keep = 0
        versions, jobs = self.versions(), tables.jobs
        running = select(jobs.c.version_before).where(jobs.c.verb == self.verb, jobs.c.state.in_(("queued", "running")))
        kept = {self.current(), *self._connection.execute(running).scalars()}
        kept |= {version.number for version in versions[max(0, len(versions) - keep) :]}
        gone = [row.number for row in versions if row.number not in kept and row.created_at_s < before_s]
        table = tables.versions
        self._connection.execute(delete(table).where(table.c.verb == self.verb, table.c.number.in_(gone)))
        return gone

    def _select(self, *where: ColumnElement[bool]) -> list[Version]:
        return select_versions(self._connection, *where)


def select_events(
    connection: Connection,
    *,
    limit: int,
    before: int | None = None,
    verb: str | None = None,
    author: str | None = None,
) -> list[tuple[int, Event]]:
    """Events with their numbers, newest first; see :meth:`service.store.store.Store.events`."""
    table = tables.events
    query = select(table.c.id, *(table.c[name] for name in Event.__slots__)).order_by(table.c.id.desc()).limit(limit)
    if before is not None:
        query = query.where(table.c.id < before)
    if verb is not None:
        query = query.where(table.c.verb == verb)
    if author is not None:
        query = query.where(table.c.author == author)
    return [(number, Event(*row)) for number, *row in connection.execute(query)]


def select_versions(connection: Connection, *where: ColumnElement[bool]) -> list[Version]:
    """Versions that match conditions, ordered by verb and number."""
    columns = [tables.versions.c[name] for name in Version.__slots__]
    query = select(*columns).where(*where).order_by(tables.versions.c.verb, tables.versions.c.number)
    rows: list[dict[str, Any]] = [dict(row._mapping) for row in connection.execute(query)]
    return [Version(**row | {"quality": json.loads(row["quality"])}) for row in rows]


def kept_detail(version: Version, current: int | None, reason: str) -> str:
    """Detail of a job whose version was not activated."""
    return (
        f"kept as version {version.number}, not activated: version {current} is current, and the refinement started "
        f"from version {version.parent}; {reason}"
    )
