"""Cache of versions that are not current, loaded when a request names one."""

from __future__ import annotations

from collections import OrderedDict
from functools import partial

from service.catalog.catalog import Entry
from service.catalog.store_sync import StoreSync
from service.compute import run_in_thread
from verbs.errors import UnknownName
from verbs.io import artifact

__all__ = ["VersionCache"]

CACHED = 8
"""Versions that stay loaded."""


class VersionCache:
    """The most recently requested versions, at most :data:`CACHED` of all verbs together."""

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, int], Entry] = OrderedDict()

    async def get(self, sync: StoreSync | None, current: Entry, number: int | None) -> Entry:
        """A version of a verb, the current one where ``number`` is None; raises :class:`UnknownName`."""
        if number is None or number == current.version:
            return current
        if sync is None:
            raise UnknownName("version", str(number), (str(current.version),))
        key = current.verb.name, number
        found = self._entries.get(key)
        if found is None:
            found = self._entries[key] = await run_in_thread(partial(_load, sync, *key))
        self._entries.move_to_end(key)
        while len(self._entries) > CACHED:
            self._entries.popitem(last=False)
        return found


def _load(sync: StoreSync, name: str, number: int) -> Entry:
    versions = {version.number: version for version in sync.store.versions(name)}
    if number not in versions:
        raise UnknownName("version", str(number), [str(known) for known in sorted(versions)])
    path = sync.store.path(versions[number])
    return Entry.of_verb(artifact.load(path), path=path, version=number)
