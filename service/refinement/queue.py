"""What servers do with refinement jobs: start, look, cancel. All methods block; call them from a thread."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from dbos import DBOSClient, EnqueueOptions
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from service.refinement import engine
from service.refinement.errors import AlreadyRunning
from service.refinement.job_spec import Asked
from service.store.records import ENDED, Job, JobEnded, StoreUnavailable, UnknownVerb
from service.store.store import Store

__all__ = ["Refinements", "enqueue"]

LISTED = 100
"""Newest jobs of a verb among which one that runs is looked for."""


def enqueue(client: DBOSClient, job: Job) -> None:
    """Put a job into the queue; nothing happens where it was there before."""
    options: EnqueueOptions = {
        "workflow_name": engine.WORKFLOW,
        "queue_name": engine.QUEUE,
        "workflow_id": job.id,
        "app_version": engine.VERSION,
        "priority": int(job.request["priority"]),
    }
    client.enqueue(options, job.id)


class Refinements:
    """Refinement jobs, as servers see them; nothing is computed here.

    Parameters
    ----------
    database_url : str
        The store's.
    store : Store
    """

    def __init__(self, database_url: str, store: Store) -> None:
        self._url, self._store = database_url, store
        self._client: DBOSClient | None = None
        self._lock = threading.Lock()

    def start(
        self, verb: str, version: int | None, asked: Asked | Mapping[str, Any], author: str, *, force: bool = False
    ) -> Job:
        """Queue a refinement of a version of a verb, by default of the current one.

        Parameters
        ----------
        verb : str
        version : int or None
        asked : Asked or mapping
        author : str
            Who requests it, for the record.
        force : bool
            Whether to do so although the verb is being refined.

        Raises
        ------
        AlreadyRunning
            The verb is being refined.
        UnknownVerb, UnknownVersion
            There is no such verb or version.
        UnknownName, OutOfRange
            Something is asked for that there is not.
        StoreUnavailable
            The database cannot be reached. Where the job was written down before, a worker finds it.
        """
        asked = asked if isinstance(asked, Asked) else Asked.of(asked)
        number = self._number(verb, version)
        if not force:
            self._refuse_second(verb)
        job = self._added(verb, number, asked, author)
        if not force:
            self._refuse_second(verb, job)
        with self._reached() as client:
            enqueue(client, job)
        return job

    def cancel(self, id: str, *, author: str = "") -> Job:
        """Cancel a job: at once where it is queued, else before its next step. One that has ended stays as it is.

        Raises :class:`UnknownJob` or :class:`StoreUnavailable`.
        """
        job = self._store.job(id)
        if job.state in ENDED:
            return job
        by = f" by {author}" if author else ""
        try:
            cancelled = self._store.update_job(id, state="cancelled", detail=f"cancelled{by}")
        except JobEnded:  # its last step was faster
            return self._store.job(id)
        if job.state == "queued":
            with self._reached() as client:
                client.cancel_workflow(id)
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
        """Number of a version that there is."""
        if version is not None:
            return self._store.version(verb, version).number
        current = self._store.current()
        if verb not in current:
            raise UnknownVerb(verb, current)
        return current[verb].number

    def _added(self, verb: str, number: int, asked: Asked, author: str) -> Job:
        """A new job, written down."""
        now_s = time.time()
        job = Job(
            id=uuid.uuid4().hex, verb=verb, state="queued", request=asked.as_dict() | {"author": author}, progress={},
            reaps=0, version_before=number, version_after=None, detail="", created_at_s=now_s, updated_at_s=now_s,
        )  # fmt: skip
        self._store.add_job(job)
        return job

    def _refuse_second(self, verb: str, mine: Job | None = None) -> None:
        """Raise :class:`AlreadyRunning` where another job of a verb lives; of two new ones the older wins."""
        for job in self._store.jobs(verb=verb, limit=LISTED):
            if job.state in ENDED or (mine and (job.created_at_s, job.id) >= (mine.created_at_s, mine.id)):
                continue
            if mine:
                with suppress(JobEnded):  # somebody cancelled it by then
                    self._store.update_job(mine.id, state="cancelled", detail=f"job {job.id} was faster")
            raise AlreadyRunning(verb, job.id)

    @contextmanager
    def _reached(self) -> Iterator[DBOSClient]:
        """The queue, made where it is not there; failures to reach it are :class:`StoreUnavailable`."""
        try:
            with self._lock:
                if self._client is None:
                    engine.prepare(self._url)
                    self._client = engine.connect(self._url)
            yield self._client
        except (DBAPIError, PoolTimeout) as err:
            raise StoreUnavailable(f"the queue of jobs cannot be reached ({type(err).__name__})") from err
