"""Drafts of one server: made and changed in sandboxes, kept in the store, evaluated from memory."""

from __future__ import annotations

import hashlib
import secrets
import shutil
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import orjson

from service.catalog.catalog import Entry
from service.catalog.store_sync import StoreSync
from service.catalog.version_cache import EntryCache
from service.compute import run_in_own_thread, run_in_thread
from service.errors import DraftChanged, DraftNotBuilt, NoSource
from service.settings import Settings
from service.store.blobs import translated
from service.store.drafts import Content
from service.store.records import Conflict, Draft, UnknownVerb, Version
from service.upload.builder import Builder
from service.upload.uploads import receive
from verbs import library

__all__ = ["Drafts"]

CACHED = 4
"""Verbs of drafts that stay loaded."""


class Drafts:
    """Drafts of one server.

    Parameters
    ----------
    folder : Path
        Folder for the files of tasks while they run.
    builder : Builder
    sync : StoreSync
    settings : Settings
    """

    def __init__(self, folder: Path, builder: Builder, sync: StoreSync, settings: Settings) -> None:
        self._folder, self._builder, self._sync, self._settings = folder, builder, sync, settings
        self._store = sync.store.drafts
        self._entries = EntryCache(CACHED)

    @property
    def limit(self) -> int:
        """Largest number of drafts."""
        return self._settings.max_drafts

    @property
    def lifetime_s(self) -> float:
        """Time after its last change at which a draft is removed, seconds."""
        return 86400.0 * self._settings.draft_days

    async def create(self, chunks: AsyncIterator[bytes], request: Mapping[str, Any]) -> tuple[Draft, str]:
        """Make a draft of a zip of clips; return it with its document.

        Raises
        ------
        BadUpload
            No clip can be used, or an option is wrong.
        Overloaded
            Too many uploads are received or built.
        TooManyDrafts, StoreUnavailable
            See :meth:`service.store.drafts.Drafts.add`.
        """
        async with self._task({**request, "revision": 1}) as folder:
            await receive(chunks, folder / "upload")
            content = await self._perform("create", folder, archive=None, motion=None)
            limits = {"most": self.limit, "most_bytes": self._settings.max_drafts_bytes}
            draft = await run_in_thread(partial(self._store.add, secrets.token_hex(8), content, **limits))
        return draft, content.document

    async def change(self, id: str, expected: int | None, change: Mapping[str, Any]) -> tuple[Draft, str]:
        """Change a draft, and build its verb again; return its next revision with the document.

        Raises
        ------
        InvalidDraft
            Values cannot be stored; nothing is changed.
        UnknownDraft, DraftChanged, StoreUnavailable
            See :meth:`service.store.drafts.Drafts.change`.
        """
        draft, document = await run_in_thread(partial(self._store.read, id))
        _expect(draft, expected)
        archive, motion = await run_in_thread(lambda: (self._path(draft.archive), self._path(draft.motion)))
        async with self._task({"revision": draft.revision + 1, "archive": str(archive), "change": change}) as folder:
            await run_in_own_thread(partial(_write, folder, "draft.json", document.encode()))
            content = await self._perform("change", folder, archive=archive, motion=motion)
            changed = await run_in_thread(partial(self._store.change, id, draft.revision, content))
        return changed, content.document

    async def publish(
        self, id: str, expected: int | None, name: str | None, *, author: str
    ) -> tuple[Version, tuple[str, ...]]:
        """Publish the verb of a draft as ``POST /v1/verbs`` would its source; return the version and warnings.

        Raises :class:`DraftNotBuilt` where its clips make no verb, and the errors of :meth:`change`.
        """
        draft, document = await run_in_thread(partial(self._store.read, id))
        _expect(draft, expected)
        archive = await run_in_thread(partial(self._path, draft.archive))
        async with self._task({"archive": str(archive), "name": name}) as folder:
            await run_in_own_thread(partial(_write, folder, "draft.json", document.encode()))
            answer = await self._builder.perform("publish", folder)
            version = await self._publish(folder, answer, author=author, reason=f"draft {id}", expected=None)
        return version, tuple(answer["warnings"])

    async def add_example(
        self, verb: str, chunks: AsyncIterator[bytes], request: Mapping[str, Any], *, expected: int | None, author: str
    ) -> tuple[Version, tuple[str, ...], Mapping[str, Any]]:
        """Publish a verb with one more example; return the version, warnings, and the example.

        Raises
        ------
        NoSource
            No source of the verb is stored.
        BadUpload, InvalidDraft
            The clip or an option is invalid.
        UnknownVerb, Conflict, StoreUnavailable
            See :meth:`service.store.store.Store.publish`.
        """
        source, number = await run_in_thread(partial(self._source, verb, expected))
        async with self._task({**request, "source": str(source)}) as folder:
            await receive(chunks, folder / "upload")
            answer = await self._builder.perform("example", folder)
            reason = f"example {answer['example']['name']}"
            version = await self._publish(folder, answer, author=author, reason=reason, expected=number)
        return version, tuple(answer["warnings"]), answer["example"]

    async def entry(self, id: str) -> Entry:
        """The verb of a draft, prepared for evaluation; its version is the revision.

        Raises :class:`DraftNotBuilt`, :class:`service.store.records.UnknownDraft`, or an error of
        :meth:`EntryCache.get` or :meth:`service.store.drafts.Drafts.path`.
        """
        draft = await run_in_thread(partial(self._store.get, id))
        if draft.artifact is None:
            raise DraftNotBuilt(f"the clips of draft '{id}' make no verb; its 'problem' states why")
        return await self._entries.get((id, draft.revision), partial(self._path, draft.artifact))

    async def read(self, id: str) -> tuple[Draft, str]:
        """A draft and its document; raises :class:`service.store.records.UnknownDraft`."""
        return await run_in_thread(partial(self._store.read, id))

    async def listed(self) -> list[Draft]:
        """All drafts, the last changed first."""
        return await run_in_thread(self._store.listed)

    async def motion(self, id: str) -> Path:
        """File with the motions of a draft's clips; raises :class:`service.store.records.UnknownDraft`."""
        return await run_in_thread(lambda: self._path(self._store.get(id).motion))

    async def delete(self, id: str, expected: int | None) -> None:
        """Delete a draft; raises :class:`UnknownDraft` or :class:`DraftChanged`."""
        await run_in_thread(partial(self._store.delete, id, revision=expected))

    def _path(self, sha256: str) -> Path:
        return self._store.path(sha256)

    def _source(self, verb: str, expected: int | None) -> tuple[Path, int]:
        """Archive or folder of the current version's source, and the number of that version."""
        store = self._sync.store
        served = store.current()
        if verb not in served:
            raise UnknownVerb(verb, served)
        current = served[verb]
        if expected not in (None, current.number):
            raise Conflict(verb, int(expected or 0), current.number)
        path = store.source(current)
        if path is None and verb in library.names():
            built = Path(library.__file__).with_name(f"{verb}.verb")
            if hashlib.sha256(built.read_bytes()).hexdigest() == current.sha256:
                path = library.source(verb)
        if path is None:
            raise NoSource(f"no source of verb '{verb}' is stored; upload it as a zip of its source first")
        return path, current.number

    @asynccontextmanager
    async def _task(self, request: Mapping[str, Any]) -> AsyncIterator[Path]:
        """A place for a task, and a folder for its files; raises :class:`Overloaded` where no place is free."""
        folder = self._folder / secrets.token_hex(8)
        with self._builder.place():
            try:
                await run_in_own_thread(partial(_write, folder, "request.json", orjson.dumps(request)))
                yield folder
            finally:
                await run_in_own_thread(partial(shutil.rmtree, folder, ignore_errors=True))

    async def _perform(self, task: str, folder: Path, *, archive: Path | None, motion: Path | None) -> Content:
        """Do a task, and return what it wrote; files that it did not write are as before."""
        answer = await self._builder.perform(task, folder)

        def content() -> Content:
            written = {name: path if (path := folder / name).exists() else None for name in _FILES}
            packed, moved = written["archive.zip"] or archive, written["motion.bin"] or motion
            assert packed is not None  # the task that creates a draft writes both
            assert moved is not None
            counts = int(answer["clips"]), int(answer["excluded"])
            text = (folder / "draft.json").read_text("utf-8")
            return Content(str(answer["name"]), *counts, text, packed, moved, written["verb.verb"])

        return await run_in_thread(content)

    async def _publish(
        self, folder: Path, answer: Mapping[str, Any], *, author: str, reason: str, expected: int | None
    ) -> Version:
        return await self._sync.publish(
            str(answer["verb"]),
            folder / "verb.verb",
            author=author,
            reason=reason,
            quality=answer["quality"],
            expected=expected,
            source=folder / "source.zip",
        )


_FILES = ("archive.zip", "motion.bin", "verb.verb")


def _write(folder: Path, name: str, content: bytes) -> None:
    """Write a file of a task; the folder is created with the first."""
    with translated("files of drafts cannot be written"):
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)


def _expect(draft: Draft, revision: int | None) -> None:
    """Raise the error of the store before any work is done."""
    if revision is not None and revision != draft.revision:
        problem = f"draft '{draft.id}' has revision {draft.revision}, not {revision}: read it again"
        raise DraftChanged(problem, current=draft.revision)
