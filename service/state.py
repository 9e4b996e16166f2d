"""State of one server process."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import anyio
import numpy as np
import structlog

from service import packing
from service.access.access import Access
from service.access.limits import Limits
from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog, Entry
from service.catalog.store_sync import StoreSync, load_with_retry
from service.catalog.version_cache import VersionCache
from service.compute import Pool
from service.errors import NotReady
from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import Scheduler
from service.refinement.usage import MAX_RECORDED, Adverbs, Usage
from service.settings import Settings
from service.store.store import Store, StoreUnavailable
from service.stream import kernels
from service.stream.hub import Hub
from service.upload.builder import Builder, Sandboxes
from service.upload.drafts import Drafts
from service.upload.spawned import Spawned
from service.upload.uploads import Uploads
from verbs.runtime.evaluate import Blend

__all__ = ["ServerState", "Supervise"]

Supervise = Callable[[Settings], Coroutine[Any, Any, None]]

log = structlog.get_logger("adverb")


class ServerState:
    """State of a server process; the catalog is replaced as a whole, never changed.

    Parameters
    ----------
    settings : Settings
    on_ready : callable, optional
        Called with the catalog when the server is ready.
    supervise : callable, optional
        Keeps worker processes running until cancelled; started with the store once verbs are loaded, unless a parent
        process does so.
    sandboxes : Sandboxes, optional
        Starts the processes that build uploads; by default new programs.

    Attributes
    ----------
    metrics : Metrics
    pool : Pool
        Threads for long evaluations.
    catalog : Catalog or None
        The served verbs; None until they are loaded.
    access : Access
        Who may use the server.
    limits : Limits
        How much a caller may do.
    version_cache : VersionCache
        Versions that are not current.
    usage : Usage
    hub : Hub
        All streams.
    ready : anyio.Event
        Set when verbs are loaded.
    store_sync : StoreSync or None
        Connection of catalog and store; None without a data folder, as are the next three.
    refinements : Refinements or None
        The queue of jobs.
    uploads : Uploads or None
    drafts : Drafts or None
    """

    def __init__(
        self,
        settings: Settings,
        *,
        on_ready: Callable[[Catalog], None] | None = None,
        supervise: Supervise | None = None,
        sandboxes: Sandboxes | None = None,
    ) -> None:
        self.settings, self.metrics = settings, Metrics()
        self.pool = Pool(threads=settings.compute_threads, max_waiting=settings.max_waiting)
        self.catalog: Catalog | None = None
        self.version_cache = VersionCache()
        self.usage = Usage(MAX_RECORDED if settings.data is not None else 0)
        self.access, self.limits = Access(settings, public=settings.public), Limits(settings)
        self.hub = Hub(settings, self.metrics, self.current, self.usage)
        self.ready = anyio.Event()
        self.store_sync: StoreSync | None = None
        self.refinements: Refinements | None = None
        self.uploads: Uploads | None = None
        self.drafts: Drafts | None = None
        self._builder = Builder(sandboxes or Spawned())
        self._waiting_for = "verbs are being loaded and kernels compiled"
        self._on_ready, self._supervise = on_ready, supervise

    def current(self) -> Catalog:
        """The served verbs; raises :class:`NotReady` until they are loaded."""
        if self.catalog is None:
            raise NotReady(self._waiting_for, headers={"Retry-After": "1"})
        return self.catalog

    async def version(self, entry: Entry, number: int | None) -> Entry:
        """A version of a verb, by default the current one; raises :class:`verbs.errors.UnknownName`."""
        return await self.version_cache.get(self.store_sync, entry, number)

    @property
    def problem(self) -> str | None:
        """Why the server is degraded; None if it is not."""
        if self.store_sync is None or self.store_sync.store.available:
            return None
        return "the database cannot be reached; loaded verbs are served, and changes fail until it is available again"

    def record_usage(self, entry: Entry, adverbs: Adverbs, blend: Blend, *, rows: int = 1) -> None:
        """Record requested adverbs; errors count for the current version, inside the domain."""
        current = self.catalog is not None and self.catalog.entries.get(entry.verb.name) is entry
        errors = blend.error if current else None
        if errors is not None and blend.clamped.any():
            errors = np.where(blend.clamped, np.nan, errors)
        self.usage.record(entry, adverbs, errors, rows=rows)

    def set_catalog(self, catalog: Catalog) -> None:
        """Serve the verbs of a catalog from now on."""
        self.metrics.set_verbs(catalog)
        self.catalog = catalog
        self.hub.set_catalog(catalog)
        first = not self.ready.is_set()
        self.ready.set()
        if first and self._on_ready is not None:
            self._on_ready(catalog)

    async def run(self) -> None:
        """Load verbs and warm kernels in a thread, then run the tasks of the store until cancelled."""
        await self._load_first()  # keeps no reference to what it loads, since versions are replaced
        if self.store_sync is not None and self.refinements is not None and self.uploads is not None:
            await self._run_tasks(self.store_sync, self.refinements, self.uploads)

    async def _load_first(self) -> None:
        loaded = await load_with_retry(self._load, self._wait_for_store)
        log.info("ready", verbs=list(loaded.entries), skipped=len(loaded.skipped))
        self.set_catalog(loaded)

    async def _run_tasks(self, sync: StoreSync, refinements: Refinements, uploads: Uploads) -> None:
        scheduler = Scheduler(
            *(sync.store, refinements, self.usage, self.metrics),
            refine_above=self.settings.refine_above,
            uploads=uploads.folder,
            drafts_s=86400.0 * self.settings.draft_days,
            started_s=time.time(),
        )
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(sync.follow())
                group.create_task(self.access.follow())
                group.create_task(scheduler.run())
                if self._supervise is not None:
                    group.create_task(self._supervise(self.settings))
                group.create_task(self._builder.run())
        finally:
            await self.limits.close()
            refinements.close()
            sync.store.close()

    def _load(self) -> Catalog:
        """Warm kernels, open the store, and load the verbs."""
        packing.warm()
        kernels.warm()
        settings = self.settings
        if settings.data is None:
            return catalogs.load(None)
        store = Store.open(settings.database, settings.artifacts)
        try:
            sync = StoreSync(store, settings.data, current=self.current, set_catalog=self.set_catalog)
            uploads = Uploads(settings.data / "uploads", self._builder, sync)
            drafts = Drafts(uploads.folder, self._builder, sync, settings)
            self.access.load(store.keys)
            loaded = sync.load()
        except BaseException:
            store.close()
            raise
        self.store_sync, self.refinements = sync, Refinements(settings.database, store)
        self.uploads, self.drafts = uploads, drafts
        return loaded

    def _wait_for_store(self, err: StoreUnavailable) -> None:
        """Report the failed attempt to load to clients."""
        self._waiting_for = f"{err}; it is tried again"
