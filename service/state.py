"""State of one server process."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import anyio
import numpy as np
import structlog

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog, Entry
from service.catalog.store_sync import StoreSync
from service.catalog.version_cache import VersionCache
from service.compute import Pool, run_in_thread
from service.errors import NotReady
from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import Scheduler
from service.refinement.usage import MAX_RECORDED, Adverbs, Usage
from service.settings import Settings
from service.store.store import Store, StoreUnavailable
from service.stream import packing
from service.stream.hub import Hub
from service.upload.builder import Builder
from verbs.runtime.evaluate import Blend

__all__ = ["ServerState", "Supervise"]

Supervise = Callable[[Settings], Coroutine[Any, Any, None]]

LATENESS_EVERY_S = 0.25

RETRY_S = (0.5, 10.0)
"""First and longest pause between attempts to reach the store at the start, seconds."""

log = structlog.get_logger("adverb")


class ServerState:
    """Settings, metrics, threads and verbs of a server; the catalog is replaced whole, never changed.

    Parameters
    ----------
    settings : Settings
    on_ready : callable, optional
        Called with the catalog once requests can be answered.
    supervise : callable, optional
        Keeps worker processes running until cancelled; started once verbs are loaded, where there is a store.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        on_ready: Callable[[Catalog], None] | None = None,
        supervise: Supervise | None = None,
    ) -> None:
        self.settings, self.metrics = settings, Metrics()
        self.pool = Pool(threads=settings.compute_threads, max_waiting=settings.max_waiting)
        self.catalog: Catalog | None = None
        self.usage = Usage(MAX_RECORDED if settings.data is not None else 0)
        self.hub = Hub(settings, self.metrics, self.current, self.usage)
        self.builder = Builder()
        self.store_sync: StoreSync | None = None
        self.refinements: Refinements | None = None
        self._waiting = "verbs are being loaded and kernels compiled"
        self.version_cache = VersionCache()
        self.ready = anyio.Event()
        self._on_ready, self._supervise = on_ready, supervise

    def current(self) -> Catalog:
        """The verbs; raises :class:`NotReady` until they are loaded."""
        if self.catalog is None:
            raise NotReady(self._waiting, headers={"Retry-After": "1"})
        return self.catalog

    @property
    def problem(self) -> str | None:
        """Why the server is degraded; None if it is not."""
        if self.store_sync is None or self.store_sync.store.available:
            return None
        return "the database cannot be reached; verbs are served as they were, and changes wait until it is back"

    async def run(self) -> None:
        """Load verbs and warm kernels in a thread, then keep the catalog in step with the store until cancelled."""
        loaded = await self._load_with_retry()
        log.info("ready", verbs=list(loaded.entries), skipped=len(loaded.skipped))
        self.set_catalog(loaded)
        if self.store_sync is None or self.refinements is None:
            return
        above, store = self.settings.refine_above, self.store_sync.store
        scheduler = Scheduler(
            *(store, self.refinements, self.usage, self.metrics),
            refine_above=above,
            uploads=self.uploads,
            started_s=time.time(),
        )
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.store_sync.follow(self.current, self.set_catalog))
                group.create_task(scheduler.run())
                if self._supervise is not None:
                    group.create_task(self._supervise(self.settings))
                group.create_task(self.builder.run())
        finally:
            self.refinements.close()
            store.close()

    async def _load_with_retry(self) -> Catalog:
        """Load the verbs; retry with growing pauses while the database cannot be reached."""
        pause_s, longest_s = RETRY_S
        while True:
            try:
                return await run_in_thread(self._load)
            except StoreUnavailable as err:
                self._waiting = f"{err}; it is tried again"
                log.warning("store unavailable; retrying", problem=str(err), pause_s=pause_s)
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, longest_s)

    def _load(self) -> Catalog:
        packing.warm()
        settings = self.settings
        if settings.data is None:
            return catalogs.load(None)
        self.uploads.mkdir(parents=True, exist_ok=True)
        store = Store.open(settings.database, settings.artifacts)
        try:
            sync = StoreSync(store, settings.data)
            loaded = sync.load()
        except BaseException:
            store.close()
            raise
        self.store_sync, self.refinements = sync, Refinements(settings.database, store)
        return loaded

    async def version(self, entry: Entry, number: int | None) -> Entry:
        """A version of a verb, by default the current one; raises :class:`verbs.errors.UnknownName`."""
        return await self.version_cache.get(self.store_sync, entry, number)

    @property
    def uploads(self) -> Path:
        """Folder of uploads that are being read."""
        assert self.settings.data is not None  # a server without a data folder takes no uploads
        return self.settings.data / "uploads"

    async def refresh(self) -> None:
        """Read the current versions from the store now, without waiting for its notice."""
        if self.store_sync is not None:
            sync, was = self.store_sync, self.current()
            now = await run_in_thread(lambda: sync.refresh(was))
            if now is not was:
                self.set_catalog(now)

    def record_usage(self, entry: Entry, adverbs: Adverbs, blend: Blend, *, rows: int = 1) -> None:
        """Record requested adverbs; errors count for the current version, inside the domain."""
        current = self.catalog is not None and self.catalog.entries.get(entry.verb.name) is entry
        errors = np.where(blend.clamped, np.nan, blend.error) if current else None
        self.usage.record(entry, adverbs, errors, rows=rows)

    def set_catalog(self, catalog: Catalog) -> None:
        """Serve these verbs from now on."""
        self.metrics.set_verbs(catalog)
        self.catalog = catalog
        self.hub.set_catalog(catalog)
        first = not self.ready.is_set()
        self.ready.set()
        if first and self._on_ready is not None:
            self._on_ready(catalog)

    async def measure_lateness(self) -> None:
        """Measure how late the event loop runs timers, until cancelled."""
        while True:
            due = anyio.current_time() + LATENESS_EVERY_S
            await anyio.sleep_until(due)
            self.metrics.observe_lateness(max(0.0, anyio.current_time() - due))
