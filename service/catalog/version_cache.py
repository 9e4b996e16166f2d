"""Caches of verbs that the catalog does not serve: earlier versions, and drafts."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from pathlib import Path

from service.catalog.catalog import Entry
from service.catalog.store_sync import StoreSync
from service.compute import run_in_thread
from service.errors import Overloaded
from verbs.errors import UnknownName
from verbs.io import artifact

__all__ = ["MAX_LOADING", "EntryCache", "VersionCache"]

CACHED = 8
"""Versions that stay loaded."""

MAX_LOADING = 16
"""Largest number of entries of a cache that are loaded or wait for it; further requests are refused."""

Key = tuple[str, int]
Stamp = tuple[int, int, int]


class EntryCache:
    """The most recently used entries; each is loaded once for all who wait for it, one after the other.

    A cached entry is loaded again once its file has changed, since the file is mapped.

    Parameters
    ----------
    size : int
        Largest number of cached entries.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._entries: OrderedDict[Key, tuple[Entry, Stamp | None]] = OrderedDict()
        self._loading: dict[Key, asyncio.Task[Entry]] = {}
        self._turn = asyncio.Lock()

    async def get(self, key: Key, find: Callable[[], Path]) -> Entry:
        """An entry.

        Parameters
        ----------
        key : tuple of str and int
            The number is the version of the entry.
        find : callable
            Returns the file of the artifact, checked against its hash; called in a thread. Its errors are raised.

        Raises
        ------
        Overloaded
            Too many others are being loaded.
        """
        found = self._entries.get(key)
        if found is not None:
            if _stamp(found[0].path) == found[1]:
                self._entries.move_to_end(key)
                return found[0]
            del self._entries[key]
        task = self._loading.get(key)
        if task is None:
            if len(self._loading) >= MAX_LOADING:
                raise Overloaded(f"{MAX_LOADING} versions are being loaded", headers={"Retry-After": "1"})
            task = self._loading[key] = asyncio.create_task(self._load(key, find))
            task.add_done_callback(partial(self._loaded, key))
        return await asyncio.shield(task)  # a cancelled request does not stop what others wait for

    async def _load(self, key: Key, find: Callable[[], Path]) -> Entry:
        path = await run_in_thread(find)

        def load() -> tuple[Entry, Stamp | None]:
            stamp = _stamp(path)
            return Entry.of_verb(artifact.load(path), path=path, version=key[1]), stamp

        async with self._turn:  # not while the store is searched, which may take seconds
            entry, _ = self._entries[key] = await run_in_thread(load)
        while len(self._entries) > self._size:
            self._entries.popitem(last=False)
        return entry

    def _loaded(self, key: Key, task: asyncio.Task[Entry]) -> None:
        del self._loading[key]
        if not task.cancelled():
            task.exception()  # counts as retrieved where every request was cancelled


class VersionCache:
    """The most recently requested versions, at most :data:`CACHED` of all verbs together."""

    def __init__(self) -> None:
        self._entries = EntryCache(CACHED)

    async def get(self, sync: StoreSync | None, current: Entry, number: int | None) -> Entry:
        """A version of a verb, the current one where ``number`` is None.

        Raises :class:`UnknownName`, and the errors of :meth:`EntryCache.get` and :meth:`Store.path`.
        """
        if number is None or number == current.version:
            return current
        if sync is None:
            raise UnknownName("version", str(number), (str(current.version),))
        key = current.verb.name, number
        return await self._entries.get(key, partial(_find, sync, *key))


def _stamp(path: Path) -> Stamp | None:
    """What changes with a file's content; None where it cannot be read."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _find(sync: StoreSync, name: str, number: int) -> Path:
    versions = {version.number: version for version in sync.store.versions(name)}
    if number not in versions:
        raise UnknownName("version", str(number), [str(known) for known in sorted(versions)])
    return sync.store.path(versions[number])
