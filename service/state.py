"""What one server process holds while it runs."""

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
from service.catalog.store_sync import Keeper
from service.catalog.version_cache import Past
from service.compute import Pool, aside
from service.errors import NotReady
from service.metrics import Metrics
from service.refinement.queue import Refinements
from service.refinement.scheduler import Watch
from service.refinement.usage import MAX_NOTED, Adverbs, Demand
from service.settings import Settings
from service.store.store import Store, StoreUnavailable
from service.stream import packing
from service.stream.hub import Hub
from service.upload.builder import Builder
from verbs.runtime.evaluate import Blend

__all__ = ["Serving", "Supervise"]

Supervise = Callable[[Settings], Coroutine[Any, Any, None]]

LATENESS_EVERY_S = 0.25

RETRY_S = (0.5, 10.0)
"""First and longest pause before a store that cannot be reached at the start is tried again, seconds."""

log = structlog.get_logger("adverb")


class Serving:
    """Settings, metrics, threads and the verbs; the catalog is replaced whole, never changed.

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
        self.demand = Demand(MAX_NOTED if settings.data is not None else 0)
        self.hub = Hub(settings, self.metrics, self.current, self.demand)
        self.builder = Builder()
        self.keeper: Keeper | None = None
        self.refinements: Refinements | None = None
        self._waiting = "verbs are being loaded and kernels compiled"
        self.past = Past()
        self.ready = anyio.Event()
        self._on_ready, self._supervise = on_ready, supervise

    def current(self) -> Catalog:
        """The verbs; raises :class:`NotReady` until they are loaded."""
        if self.catalog is None:
            raise NotReady(self._waiting, headers={"Retry-After": "1"})
        return self.catalog

    @property
    def problem(self) -> str | None:
        """What is wrong although verbs are served; None where nothing is."""
        if self.keeper is None or self.keeper.store.available:
            return None
        return "the database cannot be reached; verbs are served as they were, and changes wait until it is back"

    async def open(self) -> None:
        """Load verbs and warm kernels in a thread, say that requests are welcome, and follow the store for ever."""
        loaded = await self._load_patiently()
        log.info("ready", verbs=list(loaded.entries), skipped=len(loaded.skipped))
        self.offer(loaded)
        if self.keeper is None or self.refinements is None:
            return
        above, store = self.settings.refine_above, self.keeper.store
        watch = Watch(
            *(store, self.refinements, self.demand, self.metrics),
            refine_above=above,
            uploads=self.uploads,
            started_s=time.time(),
        )
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.keeper.follow(self.current, self.offer))
                group.create_task(watch.run())
                if self._supervise is not None:
                    group.create_task(self._supervise(self.settings))
                group.create_task(self.builder.run())
        finally:
            self.refinements.close()
            store.close()

    async def _load_patiently(self) -> Catalog:
        """The verbs; while the database is away it is tried again, with pauses that grow."""
        pause_s, longest_s = RETRY_S
        while True:
            try:
                return await aside(self._load)
            except StoreUnavailable as err:
                self._waiting = f"{err}; it is tried again and again"
                log.warning("store unavailable; trying again", problem=str(err), pause_s=pause_s)
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
            keeper = Keeper(store, settings.data)
            loaded = keeper.load()
        except BaseException:
            store.close()
            raise
        self.keeper, self.refinements = keeper, Refinements(settings.database, store)
        return loaded

    async def at(self, entry: Entry, version: int | None) -> Entry:
        """A version of a verb, kept ones too; raises :class:`verbs.errors.UnknownName`."""
        return await self.past.entry(self.keeper, entry, version)

    @property
    def uploads(self) -> Path:
        """Where uploads lie while they are read."""
        assert self.settings.data is not None  # who has no data folder takes no uploads
        return self.settings.data / "uploads"

    async def renew(self) -> None:
        """Serve what the store points to now, without waiting for its notice."""
        if self.keeper is not None:
            keeper, was = self.keeper, self.current()
            now = await aside(lambda: keeper.refresh(was))
            if now is not was:
                self.offer(now)

    def asked(self, entry: Entry, adverbs: Adverbs, blend: Blend, *, rows: int = 1) -> None:
        """Note what was answered; errors count where it was by the version that is served, and inside the domain."""
        current = self.catalog is not None and self.catalog.entries.get(entry.verb.name) is entry
        errors = np.where(blend.clamped, np.nan, blend.error) if current else None
        self.demand.ask(entry, adverbs, errors, rows=rows)

    def offer(self, catalog: Catalog) -> None:
        """Answer for these verbs from now on."""
        self.metrics.serving(catalog)
        self.catalog = catalog
        self.hub.offer(catalog)
        first = not self.ready.is_set()
        self.ready.set()
        if first and self._on_ready is not None:
            self._on_ready(catalog)

    async def watch_loop(self) -> None:
        """Measure, for ever, how late the event loop comes to a timer."""
        while True:
            due = anyio.current_time() + LATENESS_EVERY_S
            await anyio.sleep_until(due)
            self.metrics.loop_was_late(max(0.0, anyio.current_time() - due))
