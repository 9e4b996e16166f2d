"""One worker process: takes jobs from the queue, looks after those of dead workers, and ends when it is asked to."""

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

from service.refinement import engine
from service.refinement.errors import ExecutorInUse
from service.refinement.worker.locks import Hold, Locks, check_executor, locks_of
from service.refinement.worker.reaper import Reaper
from service.refinement.worker.steps import STEP_S, Work, transient
from service.store.records import StoreError, StoreUnavailable
from service.store.store import Store

__all__ = ["LEAVE_S", "Worker", "run"]

LEAVE_S = 10
"""Time for the current step to end when the worker is asked to stop, seconds; after that another worker repeats it."""

TAKEN_S = 10.0
"""How long a worker waits for an earlier one of its id to end."""

RETRY_S, TRIES = 2.0, 43_200
"""How a step waits for a database that went away: a day long."""

CALM_S = 5.0
"""Time after a lost connection in which nobody is taken for dead: the others may have lost theirs as well."""

ADOPT_S, TIDY_S = 10.0, 3_600.0
"""How often to look for jobs that nobody works on, and to remove what is known of old ones."""

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
    say: Callable[[str], None],
) -> None:
    """Work until SIGTERM or SIGINT.

    Parameters
    ----------
    database_url, artifacts : str
        The store's.
    executor_id : str
        Name of this worker, the same after a restart and no other's.
    poll_s : float
        How often to look for jobs of dead workers, seconds.
    step_s : float
        Least time of a step, seconds.
    cache : Path, optional
        Local folder for what an object store keeps.
    parent : int, optional
        Process without which the worker ends too: that of a server which started it.
    say : callable
        Told, once, that the worker is ready.

    Raises
    ------
    ExecutorInUse
        Another worker runs under this id.
    StoreError
        The database or the artifacts cannot be used.
    """
    asked_to_stop = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        asked_to_stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    try:
        worker = Worker(database_url, artifacts, executor_id=executor_id, step_s=step_s, cache=cache)
        worker.start()
    except (SQLAlchemyError, psycopg.Error) as err:
        raise StoreUnavailable(f"the queue of jobs cannot be reached ({type(err).__name__})") from err
    say(f"worker '{executor_id}' is ready")
    while not asked_to_stop.wait(poll_s) and parent in (None, os.getppid()):
        worker.look()
    if not worker.stop():
        os._exit(0)  # a step cannot be interrupted, and Python would wait for it; another worker repeats it


class Worker:
    """A worker; there can be one to a process, for DBOS keeps what it knows in the module.

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
        self._work = Work(self._store, artifacts, step=_durably, cache=cache, step_s=step_s)
        engine.prepare(database_url)
        self._locks, self._client = locks_of(database_url), engine.connect(database_url)
        self._reaper = Reaper(
            self._store, self._client, self._locks, executor_id, artifacts=artifacts, cache=cache
        )  # fmt: skip
        self._hold: Hold | None = None
        self._tasks = (
            ("round", self._reaper.round, 0.0),
            ("adopt", self._reaper.adopt, ADOPT_S),
            ("tidy", self._reaper.tidy, TIDY_S),
        )
        self._due = {name: 0.0 for name, _, _ in self._tasks}

    def start(self) -> None:
        """Take the executor's lock and the first job; raises :class:`ExecutorInUse`."""
        self._hold = _held(self._locks, self._executor_id)
        self._reaper.take_own()
        engine.quiet()
        DBOS(config=engine.config(self._url, self._executor_id))
        work = self._work

        @DBOS.workflow(name=engine.WORKFLOW, max_recovery_attempts=engine.RECOVERIES)
        def refine(job: str) -> dict[str, Any]:
            return work.run(job)

        DBOS.launch()
        log.info("worker ready", executor=self._executor_id)

    def look(self) -> None:
        """Take over what dead workers left. What goes wrong is logged: the next look may do better."""
        now_s = time.monotonic()
        try:
            if self._hold is not None and not self._hold.held():
                log.warning("executor's lock was lost", executor=self._executor_id)
                self._due["round"] = now_s + CALM_S
            for name, task, every_s in self._tasks:
                if now_s >= self._due[name]:
                    task()
                    self._due[name] = now_s + every_s
        except (SQLAlchemyError, psycopg.Error, StoreError, OSError) as err:
            log.warning("cannot look after other workers' jobs", problem=type(err).__name__)
            self._due["round"] = now_s + CALM_S

    def stop(self) -> bool:
        """End after the current step, and hand the job back; returns whether the step ended in time."""
        self._work.leaving.set()
        DBOS.destroy(workflow_completion_timeout_sec=LEAVE_S - 2, destroy_registry=True)
        ended = _ended()
        try:
            handed_back = self._reaper.hand_back()
            log.info("worker ended", executor=self._executor_id, handed_back=handed_back)
        except SQLAlchemyError as err:  # then others find the job when they find the lock free
            log.warning("jobs cannot be handed back", problem=type(err).__name__)
        if self._hold is not None:
            self._hold.release()
        self._locks.close()
        self._client.destroy()
        self._store.close()
        return ended


def _held(locks: Locks, executor_id: str) -> Hold:
    """The executor's lock, for which an earlier worker may take its time."""
    deadline_s = time.monotonic() + TAKEN_S
    while True:
        hold = locks.hold(executor_id)
        if hold is not None:
            return hold
        if time.monotonic() > deadline_s:
            raise ExecutorInUse(executor_id)
        time.sleep(0.1)


def _ended() -> bool:
    """Whether every thread of DBOS that runs jobs ends within a second; idle ones do so at once."""
    deadline_s = time.monotonic() + 1.0
    threads = [thread for thread in threading.enumerate() if thread.name.startswith("dbos-executor")]
    for thread in threads:
        thread.join(max(0.0, deadline_s - time.monotonic()))
    return not any(thread.is_alive() for thread in threads)


def _durably(name: str, function: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """Run a step, whose result DBOS keeps; while the store is away it is tried again and again."""
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
