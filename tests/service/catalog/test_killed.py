"""Servers that share a data folder, one of which is killed; workers that end with theirs, or cannot start."""

import asyncio
import os
import re
import signal
import subprocess
import time

import httpx
import pytest
from typer.testing import CliRunner

from service import cli  # noqa: F401 - makes the commands
from service.refinement.worker.locks import check_executor, locks_of
from service.run.restart import name_of
from tests.service.catalog.conftest import PATIENCE_S, ZIP, zipped_arm
from tests.warm import children, lives
from verbs import cli as library_cli
from verbs import library

pytestmark = [pytest.mark.anyio]


class Started:
    """`adverb serve` in a process of its own."""

    def __init__(self, warm, data, log):
        self.log = log
        environment = {**os.environ, "ADVERB_REFINERS": "1"}
        with log.open("wb") as file:
            self.process = warm.start("serve", "--port", "0", "--data", str(data), environment=environment, stderr=file)

    async def ready(self):
        found = await eventually(lambda: re.search(r"Adverb is ready on (http://\S+)", self.log.read_text()))
        self.worker = await eventually(lambda: children(self.process.pid, "adverb-refiner"))
        await eventually(lambda: "worker ready" in self.log.read_text())
        return httpx.AsyncClient(base_url=found[1], timeout=PATIENCE_S)

    def kill(self):
        """Kill the server, and with it its parent."""
        for pid in (self.process.pid, *children(self.process.pid, "adverb-server")):
            os.kill(pid, signal.SIGKILL)
        self.process.wait()


async def eventually(holds):
    """Wait until a function returns something true, and return it."""
    end = time.monotonic() + PATIENCE_S
    while not (found := holds()):
        assert time.monotonic() < end, "it did not happen in time"
        await asyncio.sleep(0.05)
    return found


async def test_a_server_that_is_killed_in_an_upload_leaves_nothing_half_done(warm, tmp_path):
    data, content = tmp_path / "data", zipped_arm(tmp_path / "source")
    data.mkdir()
    one, other = Started(warm, data, tmp_path / "one.log"), Started(warm, data, tmp_path / "other.log")
    try:
        async with await one.ready() as client, await other.ready() as beside:
            half = asyncio.create_task(client.post("/v1/verbs", content=slowly(content), headers={"Content-Type": ZIP}))
            await eventually(lambda: [path for path in (data / "uploads").iterdir() if path.stat().st_size])
            whole = asyncio.create_task(client.post("/v1/verbs", content=content, headers={"Content-Type": ZIP}))
            await eventually(lambda: any(path.stat().st_size == len(content) for path in (data / "uploads").iterdir()))
            one.kill()
            half.cancel()  # it would wait for its own end
            _, reply = await asyncio.gather(half, whole, return_exceptions=True)
            await eventually(lambda: not any(map(lives, one.worker)))
            assert all(map(lives, other.worker))
            await consistent(beside, published=None if isinstance(reply, httpx.HTTPError) else True)
            again = await beside.post("/v1/verbs", content=content, headers={"Content-Type": ZIP})
            assert again.status_code == 201, again.text
        one = Started(warm, data, tmp_path / "again.log")
        async with await one.ready() as client:
            await consistent(client, published=True)
            assert (await client.get("/readyz")).json()["skipped"] == []
    finally:
        one.process.end()
        other.process.end()


async def slowly(content):
    """The first half of an upload, which then stalls."""
    yield content[: len(content) // 2]
    await asyncio.sleep(PATIENCE_S)


async def consistent(client, *, published):
    """Every served verb and every version of it can be read; ``published`` is None if the reply was lost."""
    names = [row["name"] for row in (await client.get("/v1/verbs")).json()["verbs"]]
    assert set(names) - {"arm"} == set(library.names())
    assert published is None or ("arm" in names) == published
    for name in names:
        for row in (await client.get(f"/v1/verbs/{name}/versions")).json()["versions"]:
            assert len((await client.get(f"/v1/verbs/{name}/versions/{row['version']}")).content) == row["bytes"]


def refused(warm, *arguments, **environment):
    """Last line on standard error of a worker that fails to start."""
    own = {**os.environ, **environment}
    process = warm.start("worker", "--nice", "0", *arguments, environment=own, stderr=subprocess.PIPE)
    text = process.stderr.read().decode()
    assert process.wait(PATIENCE_S) == 1
    process.end()
    return text.splitlines()[-1]


def test_a_worker_with_a_used_name_is_refused(warm, tmp_path):
    locks = locks_of(f"sqlite:///{tmp_path}/state.db")
    lock = locks.acquire("mine")
    assert "another worker runs as 'mine'" in refused(warm, "--data", str(tmp_path), "--name", "mine")
    lock.release()
    locks.close()


def test_a_worker_without_a_database_is_refused(warm, tmp_path):
    (tmp_path / "state.db").write_bytes(b"not a database" * 1000)
    error = refused(warm, "--data", str(tmp_path), ADVERB_DATABASE_URL=f"sqlite:///{tmp_path}/state.db")
    assert error == "error: the store is unavailable: file is not a database"
    assert refused(warm, ADVERB_DATABASE_URL="mysql://somewhere/db", ADVERB_DATA=str(tmp_path)).startswith(
        "error: a database"
    )


def test_a_worker_without_a_folder_is_refused(tmp_path):
    result = CliRunner().invoke(library_cli.app, ["worker", "--data", str(tmp_path / "no")])
    assert result.exit_code == 1
    assert f"the data folder {tmp_path / 'no'} does not exist" in result.stderr


def test_workers_of_different_servers_have_different_names(monkeypatch):
    names = {check_executor(name_of(number)) for number in (0, 1)}
    monkeypatch.setattr("os.getpid", lambda: 1)
    names |= {check_executor(name_of(number)) for number in (0, 1)}
    assert len(names) == 4
    monkeypatch.setattr("platform.node", lambda: "_ü" * 200)
    assert check_executor(name_of(0)) == "server.1.0"
