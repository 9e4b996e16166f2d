"""The queue of refinement jobs, for servers: start, list and cancel jobs. All methods block."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import structlog
from dbos import DBOSClient, EnqueueOptions
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from service.refinement import dbos_setup
from service.refinement.errors import AlreadyRunning
from service.refinement.job_spec import RefinementSpec
from service.store.records import ENDED, Job, JobEnded, StoreUnavailable, UnknownVerb
from service.store.store import Store

__all__ = ["Refinements", "enqueue"]

log = structlog.get_logger("adverb.refinement")

MAX_LISTED = 100
"""Newest jobs of a verb that are searched for an unfinished one."""


def enqueue(client: DBOSClient, job: Job) -> None:
    """Add a job to the queue; a job that is queued already is left alone."""
    options: EnqueueOptions = {
        "workflow_name": dbos_setup.WORKFLOW,
        "queue_name": dbos_setup.QUEUE,
        "workflow_id": job.id,
        "app_version": dbos_setup.VERSION,
        "priority": int(job.request["priority"]),
    }
    client.enqueue(options, job.id)


class Refinements:
    """Refinement jobs of a store; workers run them.

    Parameters
    ----------
    database_url : str
        Database of the store.
    store : Store
    """

    def __init__(self, database_url: str, store: Store) -> None:
        self._url, self._store = database_url, store
        self._client: DBOSClient | None = None
        self._lock = threading.Lock()

    def start(
        self,
        verb: str,
        version: int | None,
        spec: RefinementSpec | Mapping[str, Any],
        author: str,
        *,
        force: bool = False,
    ) -> Job:
        """Queue a refinement of a version of a verb, by default of the current one.

        Parameters
        ----------
        verb : str
        version : int or None
        spec : RefinementSpec or mapping
        author : str
            Author of the job, up to 200 characters.
        force : bool
            Whether to queue it even if another job of the verb is unfinished.

        Raises
        ------
        AlreadyRunning
            Another job of the verb is queued or running.
        UnknownVerb, UnknownVersion
            There is no such verb or version.
        UnknownName, OutOfRange
            A parameter is unknown or out of range.
        StoreUnavailable
            The database cannot be reached. A job that was stored before the failure is queued by a worker.
        """
        spec = spec if isinstance(spec, RefinementSpec) else RefinementSpec.from_json(spec)
        number = self._number(verb, version)
        if not force:
            self._refuse_second(verb)
        job = self._add(verb, number, spec, author)
        if not force:
            self._refuse_second(verb, job)
        with self._connected() as client:
            enqueue(client, job)
        log.info("refinement queued", job=job.id, verb=verb, version=number, author=author)
        return job

    def cancel(self, id: str, *, author: str) -> Job:
        """Cancel a job: immediately if it is queued, else before its next step. An ended job is unchanged.

        Raises :class:`UnknownJob` or :class:`StoreUnavailable`.
        """
        job = self._store.job(id)
        if job.state in ENDED:
            return job
        try:
            cancelled = self._store.cancel_job(id, detail=f"cancelled by {author}", author=author)
        except JobEnded:  # it ended meanwhile
            return self._store.job(id)
        if job.state == "queued":
            with self._connected() as client:
                client.cancel_workflow(id)
        log.info("refinement cancelled", job=id, verb=job.verb, author=author)
        return cancelled

    def job(self, id: str) -> Job:
        """A job; raises :class:`UnknownJob`."""
        return self._store.job(id)

    def jobs(self, *, verb: str | None = None, limit: int = 100) -> list[Job]:
        """The newest jobs, of one verb or all, newest first."""
        return self._store.jobs(verb=verb, limit=limit)

    def close(self) -> None:
        """Close every connection to the queue."""
        with self._lock:
            if self._client is not None:
                self._client.destroy()
            self._client = None

    def _number(self, verb: str, version: int | None) -> int:
        """Number of an existing version, by default the current one."""
        if version is not None:
            return self._store.version(verb, version).number
        current = self._store.current()
        if verb not in current:
            raise UnknownVerb(verb, current)
        return current[verb].number

    def _add(self, verb: str, number: int, spec: RefinementSpec, author: str) -> Job:
        """Store a new job."""
        now_s = time.time()
        job = Job(
            id=uuid.uuid4().hex, verb=verb, state="queued", request=spec.to_json() | {"author": author}, progress={},
            reaps=0, version_before=number, version_after=None, detail="", created_at_s=now_s, updated_at_s=now_s,
        )  # fmt: skip
        self._store.add_job(job, author=author)
        return job

    def _refuse_second(self, verb: str, new: Job | None = None) -> None:
        """Raise :class:`AlreadyRunning` if another job of the verb is unfinished; the older of two new ones wins."""
        for job in self._store.jobs(verb=verb, limit=MAX_LISTED):
            if job.state in ENDED or (new and (job.created_at_s, job.id) >= (new.created_at_s, new.id)):
                continue
            if new:
                with suppress(JobEnded):  # it was cancelled meanwhile
                    self._store.update_job(new.id, state="cancelled", detail=f"job {job.id} started first")
            raise AlreadyRunning(verb, job.id)

    @contextmanager
    def _connected(self) -> Iterator[DBOSClient]:
        """A client of the queue, which is created if missing; connection failures raise :class:`StoreUnavailable`."""
        try:
            with self._lock:
                if self._client is None:
                    dbos_setup.prepare(self._url)
                    self._client = dbos_setup.connect(self._url)
            yield self._client
        except (DBAPIError, PoolTimeout) as err:
            raise StoreUnavailable(f"the job queue cannot be reached ({type(err).__name__})") from err
