"""A worker process: runs jobs of the queue, recovers those of dead workers, and ends on SIGTERM or SIGINT."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import psycopg
import structlog
from dbos import DBOS
from sqlalchemy.exc import SQLAlchemyError

from service.refinement import dbos_setup
from service.refinement.errors import ExecutorInUse
from service.refinement.worker.locks import Lock, Locks, check_executor, locks_of
from service.refinement.worker.reaper import Reaper
from service.refinement.worker.steps import STEP_S, JobSteps, transient
from service.store.records import StoreError, StoreUnavailable
from service.store.store import Store

__all__ = ["STOP_S", "Worker", "run"]

STOP_S = 10
"""Time for the current step to end on SIGTERM, seconds; after that another worker repeats it."""

TAKEN_S = 10.0
"""Longest wait for an earlier worker with the same id to end, seconds."""

RETRY_S, TRIES = 2.0, 43_200
"""Pause between attempts of a step while the database is unavailable, seconds, and their number: one day."""

CALM_S = 5.0
"""Pause of recovery after a lost connection, seconds: other workers may have lost their locks as well."""

ADOPT_S, REMOVE_OLD_S = 10.0, 3_600.0
"""Intervals of queueing lost and dropped jobs and of removing old ones, seconds."""

log = structlog.get_logger("adverb.worker")


def run(
    database_url: str,
    artifacts: str,
    *,
    executor_id: str,
    poll_s: float = 1.0,
    step_s: float = STEP_S,
    cache: Path | None = None,
    parent: int | None = None,
    report: Callable[[str], None],
) -> None:
    """Run jobs until SIGTERM or SIGINT.

    Parameters
    ----------
    database_url, artifacts : str
        Addresses of the store.
    executor_id : str
        Unique name of this worker, unchanged by a restart.
    poll_s : float
        Interval of checks for jobs of dead workers, seconds.
    step_s : float
        Shortest duration of a step, seconds.
    cache : Path, optional
        Local folder for copies of an object store's blobs.
    parent : int, optional
        Id of the server process that started the worker; the worker ends with it.
    report : callable
        Called once with a message when the worker is ready.

    Raises
    ------
    ExecutorInUse
        Another worker uses this id.
    StoreError
        The database or the artifacts cannot be used.
    """
    stopping = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    try:
        worker = Worker(database_url, artifacts, executor_id=executor_id, step_s=step_s, cache=cache)
        worker.start()
    except (SQLAlchemyError, psycopg.Error) as err:
        raise StoreUnavailable(f"the job queue cannot be reached ({type(err).__name__})") from err
    report(f"worker '{executor_id}' is ready")
    while not stopping.wait(poll_s) and parent in (None, os.getppid()):
        worker.check()
    if not worker.stop():
        os._exit(0)  # Python would wait for the running step; another worker repeats it


class Worker:
    """A worker; at most one per process, because DBOS is global.

    Parameters
    ----------
    database_url, artifacts : str
    executor_id : str
    step_s : float
    cache : Path, optional
    """

    def __init__(
        self,
        database_url: str,
        artifacts: str,
        *,
        executor_id: str,
        step_s: float = STEP_S,
        cache: Path | None = None,
    ) -> None:
        self._url, self._executor_id = database_url, check_executor(executor_id)
        self._store = Store.open(database_url, artifacts, cache=cache)
        self._steps = JobSteps(self._store, artifacts, step=_durably, cache=cache, step_s=step_s)
        dbos_setup.prepare(database_url)
        self._locks, self._client = locks_of(database_url), dbos_setup.connect(database_url)
        self._reaper = Reaper(
            *(self._store, self._client, self._locks, executor_id),
            artifacts=artifacts,
            cache=cache,
            running=self._steps.running,
        )
        self._lock: Lock | None = None
        self._tasks = (
            ("reap", self._reaper.reap, 0.0),
            ("adopt", self._reaper.adopt, ADOPT_S),
            ("requeue_dropped", self._reaper.requeue_dropped, ADOPT_S),
            ("remove_old", self._reaper.remove_old, REMOVE_OLD_S),
        )
        self._due = {name: 0.0 for name, _, _ in self._tasks}

    def start(self) -> None:
        """Take the executor's lock and start running jobs; raises :class:`ExecutorInUse`."""
        self._lock = _acquire(self._locks, self._executor_id)
        self._reaper.take_own()
        dbos_setup.configure_logging()
        DBOS(config=dbos_setup.config(self._url, self._executor_id))
        steps = self._steps

        @DBOS.workflow(name=dbos_setup.WORKFLOW, max_recovery_attempts=dbos_setup.RECOVERIES)
        def refine(job: str) -> dict[str, Any]:
            return steps.run(job)

        DBOS.launch()
        log.info("worker ready", executor=self._executor_id)

    def check(self) -> None:
        """Recover jobs of dead workers and remove old ones; failures are logged, and retried by the next check."""
        now_s = time.monotonic()
        try:
            if self._lock is not None and not self._lock.ensure():
                log.warning("executor's lock was lost", executor=self._executor_id)
                self._due["reap"] = now_s + CALM_S
            for name, task, every_s in self._tasks:
                if now_s >= self._due[name]:
                    task()
                    self._due[name] = now_s + every_s
        except (SQLAlchemyError, psycopg.Error, StoreError, OSError) as err:
            log.warning("cannot recover jobs of other workers", problem=type(err).__name__)
            self._due["reap"] = now_s + CALM_S

    def stop(self) -> bool:
        """Stop after the current step and put the job back into the queue; returns whether the step ended in time."""
        self._steps.stopping.set()
        DBOS.destroy(workflow_completion_timeout_sec=STOP_S - 2, destroy_registry=True)
        ended = _join_threads()
        try:
            handed_back = self._reaper.hand_back()
            log.info("worker ended", executor=self._executor_id, handed_back=handed_back)
        except SQLAlchemyError as err:  # others take the jobs over when the lock is free
            log.warning("jobs cannot be handed back", problem=type(err).__name__)
        if self._lock is not None:
            self._lock.release()
        self._locks.close()
        self._client.destroy()
        self._store.close()
        return ended


def _acquire(locks: Locks, executor_id: str) -> Lock:
    """Take the executor's lock; wait up to :data:`TAKEN_S` for an earlier worker."""
    deadline_s = time.monotonic() + TAKEN_S
    while True:
        lock = locks.acquire(executor_id)
        if lock is not None:
            return lock
        if time.monotonic() > deadline_s:
            raise ExecutorInUse(executor_id)
        time.sleep(0.1)


def _join_threads() -> bool:
    """Whether all job threads of DBOS end within a second; idle ones end at once."""
    deadline_s = time.monotonic() + 1.0
    threads = [thread for thread in threading.enumerate() if thread.name.startswith("dbos-executor")]
    for thread in threads:
        thread.join(max(0.0, deadline_s - time.monotonic()))
    return not any(thread.is_alive() for thread in threads)


def _durably(name: str, function: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """Run a step and store its result in DBOS; retry while the store is unavailable."""
    return DBOS.run_step(
        {
            "name": name,
            "retries_allowed": True,
            "interval_seconds": RETRY_S,
            "backoff_rate": 1.0,
            "max_attempts": TRIES,
            "should_retry": transient,
        },
        function,
        *arguments,
    )
