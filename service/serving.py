"""What one server process holds while it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import anyio
import structlog
from starlette.requests import Request

from service import catalog as catalogs
from service.building.builder import Builder
from service.catalog import Catalog, Entry
from service.children import supervise
from service.compute import Pool, aside
from service.errors import NotReady
from service.keeping import Keeper
from service.metrics import Metrics
from service.middleware import SCOPE_KEY, Trace
from service.past import Past
from service.settings import Settings
from service.store.store import Store
from service.stream import packing
from service.stream.hub import Hub
from service.worker.queue import Refinements

__all__ = ["Serving", "served", "serving_of", "trace_of"]

LATENESS_EVERY_S = 0.25

log = structlog.get_logger("adverb")


class Serving:
    """Settings, metrics, threads and the verbs; the catalog is replaced whole, never changed.

    Parameters
    ----------
    settings : Settings
    on_ready : callable, optional
        Called with the catalog once requests can be answered.
    """

    def __init__(self, settings: Settings, *, on_ready: Callable[[Catalog], None] | None = None) -> None:
        self.settings, self.metrics = settings, Metrics()
        self.pool = Pool(threads=settings.compute_threads, max_waiting=settings.max_waiting)
        self.catalog: Catalog | None = None
        self.hub = Hub(settings, self.metrics, self.current)
        self.builder = Builder()
        self.keeper: Keeper | None = None
        self.refinements: Refinements | None = None
        self.past = Past()
        self.ready = anyio.Event()
        self._on_ready = on_ready

    def current(self) -> Catalog:
        """The verbs; raises :class:`NotReady` until they are loaded."""
        if self.catalog is None:
            raise NotReady("verbs are being loaded and kernels compiled", headers={"Retry-After": "1"})
        return self.catalog

    async def open(self) -> None:
        """Load verbs and warm kernels in a thread, say that requests are welcome, and follow the store for ever."""
        loaded = await aside(self._load)
        log.info("ready", verbs=list(loaded.entries), skipped=len(loaded.skipped))
        self.offer(loaded)
        if self.keeper is not None:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.keeper.follow(self.current, self.offer))
                group.create_task(supervise(self.settings))
                group.create_task(self.builder.run())

    def _load(self) -> Catalog:
        packing.warm()
        settings = self.settings
        if settings.data is None:
            return catalogs.load(None)
        self.uploads.mkdir(parents=True, exist_ok=True)
        store = Store.open(settings.database, settings.artifacts)
        self.refinements = Refinements(settings.database, store)
        self.keeper = Keeper(store, settings.data)
        return self.keeper.load()

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


def serving_of(request: Request) -> Serving:
    """What the app of a request holds."""
    serving: Serving = request.scope["app"].state.serving
    return serving


def trace_of(request: Request) -> Trace:
    """What is told about a request."""
    trace: Trace = request.scope[SCOPE_KEY]
    return trace


def served(request: Request, name: str) -> tuple[Serving, Entry]:
    """The verb that a request is about; from here on its name may be a label."""
    serving = serving_of(request)
    entry = serving.current().entry(name)
    trace_of(request).verb = entry.verb.name
    return serving, entry
