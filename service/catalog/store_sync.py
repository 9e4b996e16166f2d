"""The served side of the store: files go in at the start, pointers are watched, a new catalog comes out.

All of it runs in threads: databases and disks take their time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType

import structlog

from service.catalog.catalog import Catalog, Entry, Skipped, files_of, skipped
from service.compute import run_in_thread
from service.store.records import Conflict, StoreError, StoreUnavailable, UnknownVerb, Version
from service.store.store import Store
from verbs.errors import VerbError
from verbs.io import artifact

__all__ = ["StoreSync"]

FILES = "a file"
"""Who published what was found as a file."""

ATTEMPTS = 5

log = structlog.get_logger("adverb.catalog")


class StoreSync:
    """Keeps a catalog in step with a store.

    Parameters
    ----------
    store : Store
    data : Path
        Folder whose ``*.verb`` files are published at the start, where the store has never seen them.
    """

    def __init__(self, store: Store, data: Path) -> None:
        self.store, self._data = store, data
        self._wrong: dict[str, Skipped] = {}

    def load(self) -> Catalog:
        """Publish files that are new, then load what the store points to; raises StoreUnavailable."""
        self._wrong = {}
        for path in files_of(self._data):
            try:
                self._publish(path)
            except StoreUnavailable:
                raise
            except (VerbError, StoreError, OSError) as err:
                self._wrong[path.name] = skipped(path, err)
        return self.refresh(Catalog())

    def refresh(self, catalog: Catalog) -> Catalog:
        """A catalog of what the store points to now; the same one where nothing changed. Raises StoreUnavailable."""
        entries = dict(catalog.entries)
        pointers = self.store.current()
        for name in [name for name in entries if name not in pointers]:
            del entries[name]
        for name, version in pointers.items():
            known = entries.get(name)
            if known is None or known.version != version.number:
                self._update(entries, name, version)
        wrong = tuple(self._wrong.values())
        if entries == catalog.entries and wrong == catalog.skipped:
            return catalog
        return Catalog(MappingProxyType(dict(sorted(entries.items()))), wrong)

    def _update(self, entries: dict[str, Entry], name: str, version: Version) -> None:
        """Load one version; where it cannot be loaded, what was served goes on being served."""
        try:
            path = self.store.path(version)
            entries[name] = Entry.of_verb(artifact.load(path), path=path, version=version.number)
            self._wrong.pop(_label(version), None)
        except (VerbError, StoreError, OSError) as err:
            if isinstance(err, StoreUnavailable) and name not in entries:
                raise  # there is nothing to go on with
            self._wrong[_label(version)] = skipped(Path(_label(version)), err)

    def _publish(self, path: Path) -> None:
        """Publish a file that the store has never had; one that it had, and that was replaced since, stays replaced."""
        verb = artifact.load(path)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        quality = _figures(verb.quality)
        for _ in range(ATTEMPTS):
            current = self.store.current().get(verb.name)
            if digest in self._digests(verb.name):
                return
            with suppress(Conflict):  # another server published meanwhile; look again
                expected = current.number if current else 0
                self.store.publish(verb.name, path, author=FILES, reason=path.name, quality=quality, expected=expected)
                log.info("file published", verb=verb.name, file=path.name)
                return

    def _digests(self, name: str) -> set[str]:
        try:
            return {version.sha256 for version in self.store.versions(name)}
        except UnknownVerb:
            return set()

    async def follow(self, current: Callable[[], Catalog], set_catalog: Callable[[Catalog], None]) -> None:
        """Offer a new catalog, for ever, whenever pointers change."""
        away = False
        async for _ in self.store.changes():
            was = current()
            try:
                now = await run_in_thread(partial(self.refresh, was))
            except StoreError as err:
                if not away:
                    log.warning("store unavailable; verbs are served as they were", problem=str(err))
                away = True
                continue
            if away:
                log.info("store is back")
            away = False
            if now is not was:
                set_catalog(now)


def _label(version: Version) -> str:
    return f"{version.verb} version {version.number}"


def _figures(quality: Mapping[str, object]) -> dict[str, object]:
    return dict(quality)
