"""Periodic work of a server on the store, in a thread.

Stores usage, updates the metrics of refinements, starts refinements of verbs with large errors, and removes old
versions, artifacts and uploads.
"""

from __future__ import annotations

import asyncio
import math
import platform
import secrets
import shutil
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import structlog

from service.compute import run_in_own_thread
from service.metrics import Metrics
from service.refinement.errors import AlreadyRunning
from service.refinement.job_spec import RefinementSpec
from service.refinement.queue import Refinements
from service.refinement.usage import Record, Usage
from service.store.records import ENDED, StoreUnavailable, UnknownVerb
from service.store.store import ORPHAN_S, Job, Store

__all__ = ["AUTHOR", "MIN_ANSWERS", "REST_S", "Scheduler"]

INTERVAL_S = 2.0
"""Pause between two runs, seconds."""

STORE_USAGE_S = 5.0
"""Shortest interval at which usage is stored, seconds."""

COLLECT_S = (60.0, 3600.0)
"""Time from the start to the first collection, and interval of collections, seconds."""

MIN_ANSWERS = 100
"""Smallest number of poses, with a half-life of ten minutes, whose mean error starts a refinement."""

REST_S = 3600.0
"""Time after the end of a refinement in which the scheduler starts no other of the same verb, seconds."""

AUTHOR = "the server, for the error of its poses"
"""Author of refinements that the scheduler starts."""

log = structlog.get_logger("adverb.scheduler")


class Scheduler:
    """Periodic tasks of one server on its store.

    Parameters
    ----------
    store : Store
    refinements : Refinements
    usage : Usage
    metrics : Metrics
    uploads : Path
        Folder of uploads that are being read; files and folders older than an hour are removed.
    drafts_s : float
        Time after its last change at which a draft is removed, seconds.
    refine_above : float, optional
        Mean error of a verb's poses, as a share of the diagonal, above which it is refined.
    started_s : float
        Seconds since 1970, UTC.
    """

    def __init__(
        self,
        store: Store,
        refinements: Refinements,
        usage: Usage,
        metrics: Metrics,
        *,
        uploads: Path,
        drafts_s: float = 30 * 86400.0,
        refine_above: float | None,
        started_s: float,
    ) -> None:
        self._store, self._refinements, self._usage, self._metrics = store, refinements, usage, metrics
        self._uploads, self._drafts_s, self._refine_above = uploads, drafts_s, refine_above
        self.server = f"{platform.node()[:100]}-{secrets.token_hex(4)}"
        self._changed: set[str] = set()
        self._store_usage_at_s, self._collect_at_s = started_s, started_s + COLLECT_S[0]
        self._started_s, self._started_monotonic_s = started_s, time.monotonic()

    async def run(self) -> None:
        """Run the tasks until cancelled; failures are logged and do not stop the server."""
        while True:
            records = self._usage.take()
            try:
                latest_s = self._started_s + time.monotonic() - self._started_monotonic_s
                await run_in_own_thread(partial(self.run_once, records, time.time(), latest_s=latest_s))
            except StoreUnavailable as err:
                log.info("store unavailable; scheduled tasks wait", problem=str(err))
            except Exception as err:
                log.error("scheduled task failed", exc_info=err)
            await asyncio.sleep(INTERVAL_S)

    def run_once(self, records: list[Record], now_s: float, *, latest_s: float = math.inf) -> None:
        """Run the tasks that are due; raises :class:`StoreUnavailable`, and the next run does the rest.

        What is collected is old at ``latest_s`` too, the time without the jumps of the clock since the start: one that
        is set forward by mistake removes nothing.
        """
        self._changed |= set(self._usage.count(records, now_s))
        self._update_metrics()
        if _due(self._store_usage_at_s, now_s, STORE_USAGE_S):
            self._store_usage(now_s)
            self._store_usage_at_s = now_s + STORE_USAGE_S
        if self._refine_above is not None:
            self._refine(self._refine_above, now_s)
        if _due(self._collect_at_s, now_s, COLLECT_S[1]):
            self._collect(min(now_s, latest_s))
            self._collect_at_s = now_s + COLLECT_S[1]

    def _update_metrics(self) -> None:
        """Set the metrics of refinements."""
        running = [job for job in self._store.jobs(limit=1_000, unfinished=True) if job.state == "running"]
        ratios = {job.verb: float(job.progress.get("ratio", 0.0)) for job in running}
        self._metrics.set_refinements(self._store.ended_jobs(), ratios)

    def _store_usage(self, now_s: float) -> None:
        """Store the usage of verbs that changed."""
        for verb in sorted(self._changed):
            if usage := self._usage.verbs.get(verb):
                self._store.put_usage(verb, self.server, usage.to_json(), now_s)
            self._changed.discard(verb)

    def _collect(self, now_s: float) -> None:
        """Remove old versions, drafts, artifacts and uploads."""
        removed = self._store.collect(now_s=now_s, drafts_s=self._drafts_s)
        for path in self._uploads.iterdir():
            with suppress(FileNotFoundError):  # its upload has ended meanwhile
                if path.stat().st_mtime < now_s - ORPHAN_S:
                    if path.is_dir():
                        shutil.rmtree(path)
                    else:
                        path.unlink()
                    removed.append(f"upload {path.name}")
        if removed:
            log.info("collected", count=len(removed), removed=removed[:20])

    def _refine(self, above: float, now_s: float) -> list[Job]:
        """Start refinements of verbs whose mean error is above a limit."""
        started = []
        for verb, usage in self._usage.verbs.items():
            if usage.answers < MIN_ANSWERS or usage.error <= above:
                continue
            before = self._store.jobs(verb=verb, limit=1)
            if before and (before[0].state not in ENDED or now_s - before[0].updated_at_s < REST_S):
                continue
            with suppress(AlreadyRunning, UnknownVerb):  # started by another server, or deleted
                job = self._refinements.start(
                    verb, None, RefinementSpec(weighted_by_traffic=True, priority=100), AUTHOR
                )
                log.info("refinement started", verb=verb, job=job.id, error=round(usage.error, 6), above=above)
                started.append(job)
        return started


def _due(at_s: float, now_s: float, interval_s: float) -> bool:
    """Whether something is due that happens once in an interval; also if the clock was set back by more than that."""
    return not at_s - interval_s <= now_s < at_s
