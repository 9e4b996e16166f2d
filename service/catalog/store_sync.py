"""Keeps the served catalog in step with the store: publishes files at the start, follows changes, makes changes.

Methods without ``async`` block; the others run them in threads, as databases and disks take their time.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import structlog

from service.catalog.catalog import Catalog, Entry, Skipped, files_of, problem_of, skipped
from service.compute import run_in_own_thread, run_in_thread
from service.store.records import ArtifactDamaged, Conflict, StoreError, StoreUnavailable, UnknownVerb, Version
from service.store.store import Store
from verbs.errors import VerbError
from verbs.io import artifact

__all__ = ["StoreSync", "load_with_retry"]

FILES = "a file"
"""Author of versions that are published from files."""

ATTEMPTS = 5
"""Attempts to publish a file while other servers publish the same verb."""

RETRY_S = (0.5, 10.0)
"""First and longest pause between attempts to reach the store at the start, seconds."""

log = structlog.get_logger("adverb.catalog")


class StoreSync:
    """Keeps a catalog in step with a store.

    Parameters
    ----------
    store : Store
    data : Path
        Folder whose ``*.verb`` files are published at the start, unless the store has had them before.
    current : callable
        Returns the served catalog.
    set_catalog : callable
        Called on the event loop with a new catalog.
    """

    def __init__(
        self, store: Store, data: Path, *, current: Callable[[], Catalog], set_catalog: Callable[[Catalog], None]
    ) -> None:
        self.store, self._data = store, data
        self._current, self._set_catalog = current, set_catalog
        self._files: list[Skipped] = []
        self._versions: dict[str, Skipped] = {}
        self._refreshing = asyncio.Lock()

    def load(self) -> Catalog:
        """Publish new files, then load the current versions; raises :class:`StoreUnavailable`."""
        self._files = []
        for path in files_of(self._data):
            try:
                self._publish_file(path)
            except StoreUnavailable:
                raise
            except (VerbError, StoreError, OSError) as err:
                self._files.append(skipped(path, err))
        return self.read(Catalog())

    def read(self, catalog: Catalog) -> Catalog:
        """A catalog of the store's current versions; the given one if nothing changed.

        Files of served versions are checked too: one that was changed after it was mapped is not served any more.
        Raises :class:`StoreUnavailable`.
        """
        entries = dict(catalog.entries)
        versions = self.store.current()
        for name in [name for name in entries if name not in versions]:
            del entries[name]
        problems = {name: err for name, version in versions.items() if (err := self._update(entries, name, version))}
        self._versions = {name: self._reported(versions[name], err) for name, err in problems.items()}
        not_served = (*self._files, *self._versions.values())
        if entries == catalog.entries and not_served == catalog.skipped:
            return catalog
        return Catalog(MappingProxyType(dict(sorted(entries.items()))), not_served)

    async def refresh(self) -> None:
        """Serve the store's current versions now, without waiting for a notice; raises :class:`StoreError`.

        One at a time: an earlier reading that ends later would bring back what was deleted meanwhile.
        """
        async with self._refreshing:
            before = self._current()
            catalog = await run_in_own_thread(partial(self.read, before))
            if catalog is not before:
                self._set_catalog(catalog)

    async def follow(self) -> None:
        """Serve the store's current versions whenever they change, until cancelled."""
        unavailable = False
        async for _ in self.store.changes():
            try:
                await self.refresh()
            except StoreError as err:
                if not unavailable:
                    log.warning("store unavailable; loaded verbs are still served", problem=str(err))
                unavailable = True
                continue
            if unavailable:
                log.info("store available again")
            unavailable = False

    async def publish(self, verb: str, path: Path, **options: Any) -> Version:
        """Publish an artifact and serve it; options and errors are those of :meth:`Store.publish`."""
        version = await run_in_thread(partial(self.store.publish, verb, path, **options))
        log.info("version published", verb=verb, version=version.number, author=version.author)
        await self.refresh()
        return version

    async def activate(self, verb: str, number: int, **options: Any) -> Version:
        """Make a version current and serve it; options and errors are those of :meth:`Store.activate`."""
        version = await run_in_thread(partial(self.store.activate, verb, number, **options))
        log.info("version activated", verb=verb, version=number, author=options.get("author"))
        await self.refresh()
        return version

    async def delete(self, verb: str, **options: Any) -> None:
        """Stop serving a verb; options and errors are those of :meth:`Store.delete`."""
        await run_in_thread(partial(self.store.delete, verb, **options))
        log.info("verb deleted", verb=verb, author=options.get("author"))
        await self.refresh()

    def _update(self, entries: dict[str, Entry], name: str, version: Version) -> Exception | None:
        """Check one version, and load it unless it is served; return why it cannot be loaded.

        What is served stays so: an earlier version, or a mapped file that was deleted. A mapped file that was changed
        does not.
        """
        known = entries.get(name)
        served = known is not None and known.version == version.number
        try:
            path = self.store.path(version)
            if not served:
                entries[name] = Entry.of_verb(artifact.load(path), path=path, version=version.number)
        except (VerbError, StoreError, OSError) as err:
            if isinstance(err, StoreUnavailable) and known is None:
                raise  # there is no earlier version to serve
            if isinstance(err, StoreUnavailable) and served:
                return None  # the file cannot be checked now, for example without a free descriptor
            if served and isinstance(err, ArtifactDamaged):
                del entries[name]
            return err
        return None

    def _reported(self, version: Version, err: Exception) -> Skipped:
        """The report of a version that cannot be loaded; logged once."""
        before = self._versions.get(version.verb)
        label = f"{version.verb} version {version.number}"
        same = before is not None and (before.file, before.problem) == (label, problem_of(err))
        return before if before is not None and same else skipped(Path(label), err)

    def _publish_file(self, path: Path) -> None:
        """Publish a file unless the store has had it before; a version that replaced it stays current."""
        verb = artifact.load(path)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        quality = dict(verb.quality)
        for _ in range(ATTEMPTS):
            current = self.store.current().get(verb.name)
            if digest in self._digests(verb.name):
                return
            with suppress(Conflict):  # another server has published meanwhile
                expected = current.number if current else 0
                self.store.publish(verb.name, path, author=FILES, reason=path.name, quality=quality, expected=expected)
                log.info("file published", verb=verb.name, file=path.name)
                return

    def _digests(self, name: str) -> set[str]:
        try:
            return {version.sha256 for version in self.store.versions(name)}
        except UnknownVerb:
            return set()


async def load_with_retry(load: Callable[[], Catalog], on_failure: Callable[[StoreUnavailable], None]) -> Catalog:
    """Load a catalog in a thread; retry with growing pauses while the store is unavailable.

    Parameters
    ----------
    load : callable
    on_failure : callable
        Called with the error of each failed attempt.
    """
    pause_s, longest_s = RETRY_S
    while True:
        try:
            return await run_in_own_thread(load)
        except StoreUnavailable as err:
            log.warning("store unavailable; retrying", problem=str(err), pause_s=pause_s)
            on_failure(err)
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, longest_s)
