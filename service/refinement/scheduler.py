"""What a server does beside answering, every few seconds and in a thread.

It tells the store what was asked of verbs, reads what became of refinements, starts some by itself, and collects what
nobody needs any more.
"""

from __future__ import annotations

import asyncio
import platform
import secrets
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import structlog

from service.compute import aside
from service.metrics import Metrics
from service.refinement.errors import AlreadyRunning
from service.refinement.job_spec import Asked
from service.refinement.queue import Refinements
from service.refinement.usage import Demand, Noted
from service.store.records import ENDED, StoreUnavailable, UnknownVerb
from service.store.store import ORPHAN_S, Job, Store

__all__ = ["LEAST_ANSWERS", "REST_S", "WHO", "Watch"]

LOOK_S = 2.0
"""Time between two looks, seconds."""

TELL_S = 5.0
"""Least time between two times that the store is told what was asked, seconds."""

COLLECT_S = (60.0, 3600.0)
"""Time from the start to the first collecting, and from one to the next, seconds."""

LEAST_ANSWERS = 100
"""Answers, those of ten minutes ago counted half, before their mean error says anything."""

REST_S = 3600.0
"""Time after a refinement of a verb ended, however it did, in which none is started unasked, seconds."""

WHO = "the server, for the error of its answers"

log = structlog.get_logger("adverb.watching")


class Watch:
    """Looks after a store on behalf of one server.

    Parameters
    ----------
    store : Store
    refinements : Refinements
    demand : Demand
    metrics : Metrics
    uploads : Path
        Folder of uploads that are being read; what a dead server left there is removed.
    refine_above : float, optional
        Mean error of a verb's answers, as a share of the diagonal, beyond which it is refined.
    started_s : float
        Now, seconds since 1970, UTC.
    """

    def __init__(
        self,
        store: Store,
        refinements: Refinements,
        demand: Demand,
        metrics: Metrics,
        *,
        uploads: Path,
        refine_above: float | None,
        started_s: float,
    ) -> None:
        self._store, self._refinements, self._demand, self._metrics = store, refinements, demand, metrics
        self._uploads, self._refine_above = uploads, refine_above
        self.server = f"{platform.node()[:100]}-{secrets.token_hex(4)}"
        self._untold: set[str] = set()
        self._tell_at_s, self._collect_at_s = started_s, started_s + COLLECT_S[0]

    async def run(self) -> None:
        """Look for ever. Whatever goes wrong here, answering goes on."""
        while True:
            noted = self._demand.take()
            try:
                await aside(partial(self.look, noted, time.time()))
            except StoreUnavailable as err:
                log.info("cannot look after the store", problem=str(err))
            except Exception as err:
                log.error("looking after the store failed", exc_info=err)
            await asyncio.sleep(LOOK_S)

    def look(self, noted: list[Noted], now_s: float) -> None:
        """Do what is due; raises :class:`StoreUnavailable`, and the next look does the rest."""
        self._untold |= set(self._demand.count(noted, now_s))
        self._follow()
        if now_s >= self._tell_at_s:
            self._tell(now_s)
            self._tell_at_s = now_s + TELL_S
        if self._refine_above is not None:
            self._refine(self._refine_above, now_s)
        if now_s >= self._collect_at_s:
            self._collect(now_s)
            self._collect_at_s = now_s + COLLECT_S[1]

    def _follow(self) -> None:
        """Tell metrics how refinements are doing."""
        running = [job for job in self._store.jobs(limit=1_000, unfinished=True) if job.state == "running"]
        ratios = {job.verb: float(job.progress.get("ratio", 0.0)) for job in running}
        self._metrics.refining(self._store.ended_jobs(), ratios)

    def _tell(self, now_s: float) -> None:
        """Tell the store where verbs are asked for."""
        for verb in sorted(self._untold):
            if seen := self._demand.observed.get(verb):
                self._store.put_traffic(verb, self.server, seen.told(), now_s)
            self._untold.discard(verb)

    def _collect(self, now_s: float) -> None:
        """Remove what nobody needs any more."""
        removed = self._store.collect(now_s=now_s)
        for path in self._uploads.iterdir():
            with suppress(FileNotFoundError):  # its upload is over
                if path.stat().st_mtime < now_s - ORPHAN_S:
                    path.unlink()
                    removed.append(f"upload {path.name}")
        if removed:
            log.info("collected", count=len(removed), removed=removed[:20])

    def _refine(self, above: float, now_s: float) -> list[Job]:
        """Start refinements of verbs whose answers are too far from what was asked."""
        started = []
        for verb, seen in self._demand.observed.items():
            if seen.answers < LEAST_ANSWERS or seen.error <= above:
                continue
            before = self._store.jobs(verb=verb, limit=1)
            if before and (before[0].state not in ENDED or now_s - before[0].updated_at_s < REST_S):
                continue
            with suppress(AlreadyRunning, UnknownVerb):  # another server was faster; or it was deleted
                job = self._refinements.start(verb, None, Asked(weighted_by_traffic=True, priority=100), WHO)
                log.info("refinement started", verb=verb, job=job.id, error=round(seen.error, 6), above=above)
                started.append(job)
        return started
