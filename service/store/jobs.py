"""Tables of refinement jobs and of usage."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from service.store import tables
from service.store.ledger import Change, Ledger
from service.store.records import (
    ENDED,
    STATES,
    InvalidValue,
    Job,
    JobEnded,
    JobExists,
    UnknownJob,
    check_text,
    check_verb,
    json_text,
)
from service.store.tables import Database

__all__ = ["Jobs", "UsageTable"]

_CHANGEABLE = frozenset({"state", "progress", "version_before", "version_after", "detail"})


class Jobs:
    """The table of refinement jobs.

    Parameters
    ----------
    database : Database
    clock : callable
        Seconds since 1970, UTC.
    """

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database, self._clock = database, clock

    def add(self, job: Job, *, author: str | None = None) -> None:
        """Add a job, with an event where an author is given; raises :class:`JobExists` if its id is taken."""
        check_verb(job.verb)
        check_text("id", job.id, 200, empty=False)
        values = {name: getattr(job, name) for name in Job.__slots__} | {"request": json_text("request", job.request)}
        values |= _checked({"state": job.state, "progress": job.progress, "detail": job.detail})
        try:
            with self._database.transaction(writes=True) as connection:
                connection.execute(insert(tables.jobs).values(values))
                if author is not None:
                    self._add_event(connection, "refine", job, author)
        except IntegrityError as err:
            raise JobExists(job.id) from err

    def get(self, id: str) -> Job:
        """Get a job; raises :class:`UnknownJob`."""
        with self._database.transaction() as connection:
            return _find(connection, id)

    def newest(self, *, verb: str | None, limit: int, unfinished: bool) -> list[Job]:
        """The newest jobs, newest first."""
        table = tables.jobs
        query = select(table).order_by(table.c.created_at_s.desc(), table.c.id.desc()).limit(max(0, limit))
        if verb is not None:
            query = query.where(table.c.verb == verb)
        if unfinished:
            query = query.where(table.c.state.not_in(ENDED))
        with self._database.transaction() as connection:
            return [_job(row) for row in connection.execute(query)]

    def ended(self) -> dict[tuple[str, str], int]:
        """Number of ended jobs by verb and state."""
        table = tables.jobs
        query = select(table.c.verb, table.c.state, func.count()).where(table.c.state.in_(ENDED))
        with self._database.transaction() as connection:
            rows = connection.execute(query.group_by(table.c.verb, table.c.state))
            return {(verb, state): count for verb, state, count in rows}

    def update(self, id: str, changes: Mapping[str, Any]) -> Job:
        """Change fields of a job; raises :class:`UnknownJob`, or :class:`JobEnded` if its state is final."""
        with self._database.transaction(writes=True) as connection:
            return self.write(connection, id, changes)

    def cancel(self, id: str, *, detail: str, author: str) -> Job:
        """Cancel a job, with an event; errors as of :meth:`update`."""
        with self._database.transaction(writes=True) as connection:
            job = self.write(connection, id, {"state": "cancelled", "detail": detail})
            self._add_event(connection, "cancel", job, author)
        return job

    def _add_event(self, connection: Connection, kind: str, job: Job, author: str) -> None:
        """Record who started or cancelled a job."""
        check_text("author", author, 200, empty=False)
        change = Change(author, f"refinement {job.id}", self._clock())
        Ledger(self._database, connection, job.verb).add_event(kind, job.version_before or 0, change)

    def write(self, connection: Connection, id: str, changes: Mapping[str, Any]) -> Job:
        """Change fields of a job in the caller's transaction."""
        values = _checked(changes) | {"updated_at_s": self._clock()}
        found = _find(connection, id, lock=True)
        if found.state in ENDED and values.get("state", found.state) != found.state:
            raise JobEnded(id, found.state)
        connection.execute(update(tables.jobs).where(tables.jobs.c.id == id).values(values))
        return _find(connection, id)

    def reap(self, id: str) -> int:
        """Increment the number of times that a job was taken over; returns it."""
        with self._database.transaction(writes=True) as connection:
            count = _find(connection, id, lock=True).reaps + 1
            values = {"reaps": count, "updated_at_s": self._clock()}
            connection.execute(update(tables.jobs).where(tables.jobs.c.id == id).values(values))
        return count


class UsageTable:
    """The table of usage: the cells of each verb that each server counted.

    Parameters
    ----------
    database : Database
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    def put(self, verb: str, server: str, cells: Mapping[str, Any], now_s: float) -> None:
        """Store the cells of a verb from a server, in place of its earlier ones."""
        check_verb(verb)
        check_text("server", server, 200, empty=False)
        values = {"cells": json_text("cells", cells), "at_s": float(now_s)}
        write = self._database.insert(tables.traffic).values(verb=verb, server=server, **values)
        with self._database.transaction(writes=True) as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["verb", "server"], set_=values))

    def since(self, verb: str, *, not_before_s: float) -> list[Mapping[str, Any]]:
        """Cells of every server that stored some since a time, newest first."""
        table = tables.traffic
        query = select(table.c.cells).where(table.c.verb == verb, table.c.at_s >= not_before_s)
        with self._database.transaction() as connection:
            texts = connection.execute(query.order_by(table.c.at_s.desc(), table.c.server)).scalars()
            return [json.loads(text) for text in texts]

    def remove(self, *, before_s: float) -> list[str]:
        """Remove rows that were last stored before a time; returns a description of each."""
        table = tables.traffic
        with self._database.transaction(writes=True) as connection:
            removed = delete(table).where(table.c.at_s < before_s).returning(table.c.verb, table.c.server)
            return sorted(f"usage of {verb} at {server}" for verb, server in connection.execute(removed))


def _checked(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Validate changes and encode them as columns; raises :class:`InvalidValue`."""
    values = dict(changes)
    if not values.keys() <= _CHANGEABLE:
        wrong = ", ".join(sorted(values.keys() - _CHANGEABLE))
        raise InvalidValue(f"{wrong} of a job cannot change; these can: {', '.join(sorted(_CHANGEABLE))}")
    if values.get("state", "queued") not in STATES:
        raise InvalidValue(f"{values['state']!r:.40} is not a state of a job: {', '.join(sorted(STATES))}")
    if "progress" in values:
        values["progress"] = json_text("progress", values["progress"])
    if "detail" in values:
        check_text("detail", values["detail"], 10_000)
    return values


def _find(connection: Connection, id: str, *, lock: bool = False) -> Job:
    query = select(tables.jobs).where(tables.jobs.c.id == id)
    row = connection.execute(query.with_for_update() if lock else query).first()
    if row is None:
        raise UnknownJob(id)
    return _job(row)


def _job(row: Row[Any]) -> Job:
    values = dict(row._mapping)
    return Job(**values | {name: json.loads(values[name]) for name in ("request", "progress")})
