"""Takes over jobs of dead workers, and queues jobs that were stored but never queued."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Collection
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import structlog
from dbos import DBOSClient, WorkflowStatus

from service.refinement import dbos_setup
from service.refinement.queue import enqueue
from service.refinement.worker.locks import Locks
from service.refinement.worker.scratch import Scratch
from service.store.records import ENDED, JobEnded, UnknownJob
from service.store.store import Store

__all__ = ["MAX_REAPS", "ORPHANED_S", "Reaper"]

MAX_REAPS = 3
"""Number of lost workers after which a job is given up, as it may be the cause."""

ORPHANED_S = 10.0
"""Age of the last update after which an unfinished job is checked, seconds."""

MAX_LISTED = 100
"""Number of newest jobs that are checked, and of old jobs that are removed, at a time."""

KEPT_S = 7 * 86_400.0
"""Age at which the queue's rows of an ended job are removed, seconds; the store's row stays."""

ACTIVE = ("ENQUEUED", "DELAYED", "PENDING")
"""States of the queue in which a job is queued or running."""

log = structlog.get_logger("adverb.worker")


class Reaper:
    """Recovers jobs of dead workers and jobs that are missing from the queue.

    Parameters
    ----------
    store : Store
    client : DBOSClient
    locks : Locks
    executor_id : str
        Name of this worker.
    artifacts : str
    cache : Path, optional
    running : collection of str
        Jobs that this process runs now.
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
        running: Collection[str] = (),
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._store, self._client, self._locks, self.executor_id = store, client, locks, executor_id
        self._artifacts, self._cache, self._running, self._clock = artifacts, cache, running, clock
        self._dropped: set[str] = set()  # own jobs that did not run at the last check

    def reap(self) -> list[str]:
        """Take over the jobs of dead workers; returns their ids. Called every second."""
        pending = defaultdict(list)
        for status in self._pending():
            if status.executor_id not in (None, self.executor_id):
                pending[str(status.executor_id)].append(status.workflow_id)
        taken = []
        for executor_id in sorted(pending):
            with self._locks.try_lock(executor_id) as dead:
                if dead:
                    taken += [self.take(status.workflow_id) for status in self._pending(executor_id)]
        return taken

    def take_own(self) -> list[str]:
        """Take over the jobs that this worker left when it last ended; call before DBOS starts."""
        return [self.take(status.workflow_id) for status in self._pending(self.executor_id)]

    def take(self, job: str) -> str:
        """Put a job back into the queue, or give it up after :data:`MAX_REAPS`; returns its id."""
        try:
            ended = self._store.job(job).state in ENDED
            reaps = 0 if ended else self._store.count_reap(job)
        except UnknownJob:
            ended, reaps = True, 0
        if not ended and reaps < MAX_REAPS:
            log.warning("job taken over", job=job, reaps=reaps, executor=self.executor_id)
            self._client.resume_workflow(job, queue_name=dbos_setup.QUEUE)
            return job
        self._client.cancel_workflow(job)
        if not ended:
            log.error("job given up", job=job, reaps=reaps)
            detail = f"given up: its worker died {reaps} times, and the job may be the cause"
            with suppress(JobEnded):  # it was cancelled meanwhile
                self._store.update_job(job, state="given_up", detail=detail)
        Scratch(self._artifacts, job, cache=self._cache).clear()
        return job

    def hand_back(self) -> list[str]:
        """Put this worker's unfinished jobs back into the queue, without counting; returns their ids."""
        jobs = [status.workflow_id for status in self._pending(self.executor_id)]
        for job in jobs:
            self._client.resume_workflow(job, queue_name=dbos_setup.QUEUE)
        return jobs

    def requeue_dropped(self) -> list[str]:
        """Put jobs back into the queue that this worker took and does not run; returns their ids.

        The queue drops a job whose start it cannot record while the database is away, and leaves it to this worker. A
        job that has just been taken does not run yet, so it has to be found by two calls, some seconds apart.
        """
        own = {status.workflow_id for status in self._pending(self.executor_id)}
        dropped = own - set(self._running)
        again, self._dropped = sorted(dropped & self._dropped), dropped
        for job in again:
            log.warning("dropped job queued again", job=job, executor=self.executor_id)
            self._client.resume_workflow(job, queue_name=dbos_setup.QUEUE)
        return again

    def adopt(self) -> list[str]:
        """Queue or end unfinished jobs that are not in the queue; returns their ids.

        Their server died between storing and queueing them, or the queue was lost: they are queued. Jobs that failed
        while the store could not be reached are marked as failed.
        """
        before_s = self._clock() - ORPHANED_S
        waiting = [
            job for job in self._store.jobs(limit=MAX_LISTED) if job.state not in ENDED and job.updated_at_s < before_s
        ]
        if not waiting:
            return []
        ids = [job.id for job in waiting]
        statuses = self._client.list_workflows(workflow_ids=ids, load_input=False, load_output=False)
        known = {status.workflow_id: str(status.status) for status in statuses}
        adopted = [job for job in waiting if known.get(job.id) not in ACTIVE]
        for job in adopted:
            if self._store.job(job.id).state in ENDED:  # it ended between the two queries
                continue
            log.warning("job adopted", job=job.id, status=known.get(job.id))
            if job.id not in known:
                enqueue(self._client, job)
                continue
            with suppress(JobEnded):
                self._store.update_job(job.id, state="failed", detail="failed while the database could not be reached")
        return [job.id for job in adopted]

    def remove_old(self) -> int:
        """Remove the queue's rows of jobs that ended long ago; returns the number of jobs."""
        before = datetime.fromtimestamp(self._clock() - KEPT_S, UTC).isoformat()
        old = self._client.list_workflows(
            name=dbos_setup.WORKFLOW, completed_before=before, limit=MAX_LISTED, load_input=False, load_output=False
        )
        for status in old:
            Scratch(self._artifacts, status.workflow_id, cache=self._cache).clear()  # blobs that a late worker wrote
        self._client.delete_workflows([status.workflow_id for status in old])
        self._locks.remove_stale()
        return len(old)

    def _pending(self, executor_id: str | None = None) -> list[WorkflowStatus]:
        """Running jobs of one worker, or of all."""
        return self._client.list_workflows(
            status="PENDING", name=dbos_setup.WORKFLOW, executor_id=executor_id, load_input=False, load_output=False
        )
