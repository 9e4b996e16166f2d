"""Takes jobs over from workers that died, and puts jobs into the queue that never got there."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import structlog
from dbos import DBOSClient, WorkflowStatus

from service.refinement import engine
from service.refinement.queue import enqueue
from service.refinement.worker.locks import Locks
from service.refinement.worker.scratch import Scratch
from service.store.records import ENDED, JobEnded, UnknownJob
from service.store.store import Store

__all__ = ["MOST_REAPS", "ORPHANED_S", "Reaper"]

MOST_REAPS = 3
"""How often a job may lose its worker before it is given up: it may well be what kills them."""

ORPHANED_S = 10.0
"""Time without news after which a job that nobody works on is seen to, seconds."""

LISTED = 100
"""Newest jobs that are looked through, and most that are tidied up at a time."""

KEPT_S = 7 * 86_400.0
"""How long the queue remembers the steps of a job that has ended, seconds; the store's row of it stays."""

IN_HAND = ("ENQUEUED", "DELAYED", "PENDING")
"""States of the queue in which a job will go on by itself."""

log = structlog.get_logger("adverb.worker")


class Reaper:
    """Looks after the jobs of dead workers.

    Parameters
    ----------
    store : Store
    client : DBOSClient
    locks : Locks
    executor_id : str
        Of this worker.
    artifacts : str
    cache : Path, optional
    clock : callable
        Seconds since 1970, UTC.
    """

    def __init__(
        self,
        store: Store,
        client: DBOSClient,
        locks: Locks,
        executor_id: str,
        *,
        artifacts: str,
        cache: Path | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._store, self._client, self._locks, self.executor_id = store, client, locks, executor_id
        self._artifacts, self._cache, self._clock = artifacts, cache, clock

    def round(self) -> list[str]:
        """Take over what dead workers left; returns the jobs. To be done every second."""
        left = defaultdict(list)
        for status in self._pending():
            if status.executor_id not in (None, self.executor_id):
                left[str(status.executor_id)].append(status.workflow_id)
        taken = []
        for executor_id in sorted(left):
            with self._locks.tried(executor_id) as dead:
                if dead:
                    taken += [self.take(status.workflow_id) for status in self._pending(executor_id)]
        return taken

    def take_own(self) -> list[str]:
        """Take over what an earlier life of this worker left; to be done before DBOS starts, for it does not count."""
        return [self.take(status.workflow_id) for status in self._pending(self.executor_id)]

    def take(self, job: str) -> str:
        """Put a job back into the queue, or give it up where that happened too often; returns its id."""
        try:
            ended = self._store.job(job).state in ENDED
            reaps = 0 if ended else self._store.count_reap(job)
        except UnknownJob:
            ended, reaps = True, 0
        if not ended and reaps < MOST_REAPS:
            log.warning("job taken over", job=job, reaps=reaps, executor=self.executor_id)
            self._client.resume_workflow(job, queue_name=engine.QUEUE)
            return job
        self._client.cancel_workflow(job)
        if not ended:
            log.error("job given up", job=job, reaps=reaps)
            detail = f"given up: its worker died {reaps} times, so the job itself may be what kills it"
            with suppress(JobEnded):  # its user cancelled it by now
                self._store.update_job(job, state="given_up", detail=detail)
        Scratch(self._artifacts, job, cache=self._cache).clear()
        return job

    def hand_back(self) -> list[str]:
        """Put what this worker leaves unfinished back into the queue, without counting it; returns the jobs."""
        jobs = [status.workflow_id for status in self._pending(self.executor_id)]
        for job in jobs:
            self._client.resume_workflow(job, queue_name=engine.QUEUE)
        return jobs

    def adopt(self) -> list[str]:
        """See to jobs that their users wait for and nobody works on; returns them. To be done now and then.

        Their server died between writing them down and queueing them, or the queue was lost: they are queued. Or they
        failed while the store could not be told: now it is.
        """
        before_s = self._clock() - ORPHANED_S
        waiting = [
            job for job in self._store.jobs(limit=LISTED) if job.state not in ENDED and job.updated_at_s < before_s
        ]
        if not waiting:
            return []
        ids = [job.id for job in waiting]
        statuses = self._client.list_workflows(workflow_ids=ids, load_input=False, load_output=False)
        known = {status.workflow_id: str(status.status) for status in statuses}
        adopted = [job for job in waiting if known.get(job.id) not in IN_HAND]
        for job in adopted:
            if self._store.job(job.id).state in ENDED:  # it has ended between the two questions
                continue
            log.warning("job adopted", job=job.id, status=known.get(job.id))
            if job.id not in known:
                enqueue(self._client, job)
                continue
            with suppress(JobEnded):
                self._store.update_job(job.id, state="failed", detail="it failed while the database was away")
        return [job.id for job in adopted]

    def tidy(self) -> int:
        """Remove the steps of jobs that ended long ago from the queue's tables; returns of how many."""
        before = datetime.fromtimestamp(self._clock() - KEPT_S, UTC).isoformat()
        old = self._client.list_workflows(
            name=engine.WORKFLOW, completed_before=before, limit=LISTED, load_input=False, load_output=False
        )
        for status in old:
            Scratch(self._artifacts, status.workflow_id, cache=self._cache).clear()  # a late worker may have left some
        self._client.delete_workflows([status.workflow_id for status in old])
        self._locks.tidy()
        return len(old)

    def _pending(self, executor_id: str | None = None) -> list[WorkflowStatus]:
        """Jobs that a worker runs, or all workers do."""
        return self._client.list_workflows(
            status="PENDING", name=engine.WORKFLOW, executor_id=executor_id, load_input=False, load_output=False
        )
