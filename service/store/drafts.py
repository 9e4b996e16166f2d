"""Table of drafts, with their clips, motions and verbs as blobs; and what several tables need to refer to blobs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Select, delete, func, insert, select, update

from service.store import tables
from service.store.blobs import Blob, Blobs
from service.store.records import (
    Draft,
    DraftChanged,
    InvalidValue,
    StoreUnavailable,
    TooManyDrafts,
    UnknownDraft,
    check_text,
    check_verb,
)
from service.store.tables import Database

__all__ = ["MAX_DOCUMENT", "Content", "Drafts", "put_all", "used_blobs"]

MAX_DOCUMENT = 16 * 1024 * 1024
"""Longest document of a draft, characters."""

ATTEMPTS = 3
"""Attempts to write a row whose blobs are collected before it is written."""

_FIELDS = tuple(Draft.__slots__)


@dataclass(frozen=True, slots=True)
class Content:
    """What a revision of a draft consists of.

    Parameters
    ----------
    name : str
    clips, excluded : int
    document : str
        JSON.
    archive, motion : Path
        Files to copy.
    artifact : Path or None
    """

    name: str
    clips: int
    excluded: int
    document: str
    archive: Path
    motion: Path
    artifact: Path | None


class Drafts:
    """The table of drafts. All methods block; rows are written whole or not at all.

    Parameters
    ----------
    database : Database
    blobs : Blobs
    clock : callable
        Seconds since 1970, UTC.
    """

    def __init__(self, database: Database, blobs: Blobs, clock: Callable[[], float]) -> None:
        self._database, self._blobs, self._clock = database, blobs, clock

    def add(self, id: str, content: Content, *, most: int, most_bytes: int) -> Draft:
        """Add a draft as revision 1; raises :class:`TooManyDrafts` or :class:`InvalidValue`."""
        check_text("id", id, 32, empty=False)
        _check(content)
        with self._put(content) as (connection, blobs):
            self._database.lock_drafts(connection)
            row = self._row(id, 1, content, blobs, created_at_s=self._clock())
            table = tables.drafts
            query = select(func.count(), func.coalesce(func.sum(table.c.size_bytes), 0)).select_from(table)
            count, size = connection.execute(query).one()
            if count >= most:
                raise TooManyDrafts(most, "drafts")
            if size + row.size_bytes > most_bytes:
                raise TooManyDrafts(most_bytes, "bytes of drafts")
            connection.execute(insert(table).values(asdict(row) | {"document": content.document}))
        return row

    def change(self, id: str, revision: int, content: Content) -> Draft:
        """Replace a revision by the next; raises :class:`UnknownDraft` or :class:`DraftChanged`."""
        _check(content)
        table = tables.drafts
        with self._put(content) as (connection, blobs):
            before = _find(connection, id, lock=True)
            _expect(before, revision)
            row = self._row(id, revision + 1, content, blobs, created_at_s=before.created_at_s)
            values = asdict(row) | {"document": content.document}
            connection.execute(update(table).where(table.c.id == id).values(values))
        return row

    def get(self, id: str) -> Draft:
        """A draft; raises :class:`UnknownDraft`."""
        with self._database.transaction() as connection:
            return _find(connection, id)

    def read(self, id: str) -> tuple[Draft, str]:
        """A draft and its document; raises :class:`UnknownDraft`."""
        with self._database.transaction() as connection:
            draft = _find(connection, id)
            document = connection.execute(select(tables.drafts.c.document).where(tables.drafts.c.id == id))
            return draft, str(document.scalar_one())

    def listed(self) -> list[Draft]:
        """All drafts, the last changed first."""
        query = _select().order_by(tables.drafts.c.changed_at_s.desc(), tables.drafts.c.id)
        with self._database.transaction() as connection:
            return [Draft(*row) for row in connection.execute(query)]

    def delete(self, id: str, *, revision: int | None = None) -> None:
        """Delete a draft; raises :class:`UnknownDraft` or :class:`DraftChanged`."""
        with self._database.transaction(writes=True) as connection:
            _expect(_find(connection, id, lock=True), revision)
            connection.execute(delete(tables.drafts).where(tables.drafts.c.id == id))

    def remove(self, *, before_s: float) -> list[str]:
        """Remove drafts that were last changed before a time; returns ``"draft ID"`` of each."""
        table = tables.drafts
        with self._database.transaction(writes=True) as connection:
            old = list(connection.execute(select(table.c.id).where(table.c.changed_at_s < before_s)).scalars())
            gone = delete(table).where(table.c.id.in_(old), table.c.changed_at_s < before_s)
            connection.execute(gone)
        return [f"draft {id}" for id in old]

    def path(self, sha256: str) -> Path:
        """A local file with a blob of a draft; errors as of :meth:`service.store.store.Store.path`."""
        return self._blobs.path(sha256)

    @contextmanager
    def _put(self, content: Content) -> Iterator[tuple[Connection, list[Blob]]]:
        files = [content.archive, content.motion, *([content.artifact] if content.artifact else [])]
        with put_all(self._database, self._blobs, files, _ignore) as found:
            yield found

    def _row(self, id: str, revision: int, content: Content, blobs: Sequence[Blob], *, created_at_s: float) -> Draft:
        size = sum(blob.size_bytes for blob in blobs) + len(content.document)
        archive, motion, *rest = (str(blob.sha256) for blob in blobs)
        now_s = created_at_s if revision == 1 else self._clock()
        return Draft(
            id=id,
            revision=revision,
            name=content.name,
            clips=content.clips,
            excluded=content.excluded,
            archive=archive,
            motion=motion,
            artifact=rest[0] if rest else None,
            size_bytes=size,
            created_at_s=created_at_s,
            changed_at_s=now_s,
        )


@contextmanager
def put_all(
    database: Database, blobs: Blobs, files: Sequence[Path], at: Callable[[str], None]
) -> Iterator[tuple[Connection, list[Blob]]]:
    """Copy files into the storage, then open a transaction in which no blob can be removed.

    ``at`` is called with the name of each step before it. Raises :class:`StoreUnavailable`.
    """
    put: list[Blob] = []
    for _ in range(ATTEMPTS):
        put = [blobs.put(file, at) for file in files]
        at("transaction")
        with database.transaction(writes=True) as connection:
            database.lock_blobs(connection, removing=False)
            if all(blobs.has(str(blob.sha256)) for blob in put):  # an old one may have been collected just now
                yield connection, put
                return
    raise StoreUnavailable("the artifact was removed while it was published")


def used_blobs(connection: Connection) -> set[str]:
    """Hashes of the blobs to which rows refer."""
    versions, drafts = tables.versions.c, tables.drafts.c
    columns = (versions.sha256, versions.source_sha256, drafts.archive, drafts.motion, drafts.artifact)
    found: set[str] = set()
    for column in columns:
        found |= {sha256 for sha256 in connection.execute(select(column).distinct()).scalars() if sha256}
    return found


def _ignore(step: str) -> None:
    """Default of ``at``: do nothing."""


def _select() -> Select[Any]:
    return select(*(tables.drafts.c[name] for name in _FIELDS))


def _find(connection: Connection, id: str, *, lock: bool = False) -> Draft:
    query = _select().where(tables.drafts.c.id == id)
    row = connection.execute(query.with_for_update() if lock else query).one_or_none()
    if row is None:
        raise UnknownDraft(id)
    return Draft(*row)


def _expect(draft: Draft, revision: int | None) -> None:
    if revision is not None and draft.revision != revision:
        raise DraftChanged(draft.id, revision, draft.revision)


def _check(content: Content) -> None:
    check_verb(content.name)
    if len(content.document) > MAX_DOCUMENT:
        raise InvalidValue(f"the draft is described by {len(content.document)} characters; {MAX_DOCUMENT} are possible")
    check_text("document", content.document, MAX_DOCUMENT, empty=False)
