"""Versions that are kept but not served by default, loaded when somebody asks for one."""

from __future__ import annotations

from collections import OrderedDict
from functools import partial

from service.catalog.catalog import Entry
from service.catalog.store_sync import Keeper
from service.compute import aside
from verbs.errors import UnknownName
from verbs.io import artifact

__all__ = ["Past"]

KEPT = 8


class Past:
    """The versions that were asked for last."""

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, int], Entry] = OrderedDict()

    async def entry(self, keeper: Keeper | None, current: Entry, number: int | None) -> Entry:
        """A version of a verb; raises :class:`UnknownName` with the ones that there are."""
        if number is None or number == current.version:
            return current
        if keeper is None:
            raise UnknownName("version", str(number), (str(current.version),))
        key = current.verb.name, number
        found = self._entries.get(key)
        if found is None:
            found = self._entries[key] = await aside(partial(_load, keeper, *key))
        self._entries.move_to_end(key)
        while len(self._entries) > KEPT:
            self._entries.popitem(last=False)
        return found


def _load(keeper: Keeper, name: str, number: int) -> Entry:
    versions = {version.number: version for version in keeper.store.versions(name)}
    if number not in versions:
        raise UnknownName("version", str(number), [str(known) for known in sorted(versions)])
    path = keeper.store.path(versions[number])
    return Entry.of_verb(artifact.load(path), path=path, version=number)
