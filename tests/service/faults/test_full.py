"""A disk that is full, and a folder that cannot be written: changes are refused, poses and streams continue."""

import asyncio
import os
import re
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from tests.service.catalog.conftest import OCTETS, PATIENCE_S, ZIP, Kept, client_of, until, zipped_arm
from tests.service.stream.conftest import open_stream
from verbs import library

pytestmark = [pytest.mark.anyio]

POSE = {"adverbs": {"x": 0.4, "y": 0.3}}
SIZE = "24m"
"""Size of the disk: the built-in verbs take some 8 MB of it."""

ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts file systems")


@contextmanager
def mounted(folder, *options):
    """A small disk of its own."""
    folder.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", folder]
    made = subprocess.run(command, check=False, capture_output=True)
    if made.returncode:
        pytest.skip(f"no file system can be mounted: {made.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.fixture
def disk(tmp_path):
    with mounted(tmp_path / "disk", f"size={SIZE}") as folder:
        yield folder


def fill(folder, left=0):
    """Write until nothing more fits, or a number of bytes; return the file."""
    path = folder / "filler"
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(64 * 1024))
        except OSError:
            pass
        if left:
            file.truncate(max(0, file.tell() - left))
    return path


def temporary(data):
    """Files that nothing refers to."""
    found = list((data / "uploads").rglob("*"))
    return found + [path for path in (data / "artifacts").rglob("*") if path.name.startswith(".")]


async def unavailable(client, method, path, reason="No space left|full", **options):
    """A change is refused with a reason, and may be repeated."""
    answer = await client.request(method, path, **options)
    assert (answer.status_code, answer.json()["code"]) == (503, "store_unavailable"), answer.text
    assert re.search(reason, answer.json()["detail"]), answer.text
    assert int(answer.headers["retry-after"]) > 0


@ROOT
async def test_a_full_disk_refuses_changes_and_nothing_is_half_published(disk, tmp_path):
    server = Kept(data=disk, refiners=0).start(PATIENCE_S)
    source, content = zipped_arm(tmp_path / "source"), Path(library.__file__).with_name("arm3.verb").read_bytes()
    zipped, octets = {"headers": {"Content-Type": ZIP}}, {"headers": {"Content-Type": OCTETS}}
    try:
        async with client_of(server) as client, open_stream(server) as stream:
            await stream.open(1, "reach")
            draft = (await client.post("/v1/drafts", content=source, **zipped)).json()
            publish = f"/v1/drafts/{draft['id']}/publish"
            before = (await client.get("/v1/verbs")).json(), (await client.get("/v1/drafts")).json()
            audit = (await client.get("/v1/audit")).json()
            filler = fill(disk)
            for _ in range(2):
                await unavailable(client, "POST", "/v1/verbs", content=content, **octets)
                await unavailable(client, "POST", "/v1/verbs", content=source, **zipped)
                await unavailable(client, "POST", "/v1/drafts", content=source, **zipped)
                await unavailable(client, "POST", publish, json={})
                await unavailable(client, "POST", "/v1/verbs/arm3/refinements", json={"max_pseudo": 5})
            assert temporary(disk) == []
            assert before == ((await client.get("/v1/verbs")).json(), (await client.get("/v1/drafts")).json())
            assert audit == (await client.get("/v1/audit")).json()
            assert (await client.get("/readyz")).json()["skipped"] == []
            assert (await client.post("/v1/verbs/arm3/pose", json=POSE)).status_code == 200
            await stream.poses(5, channel=1)
            filler.unlink()
            assert (await client.post("/v1/verbs", content=source, **zipped)).status_code == 201
            assert (await client.post(publish, json={})).status_code == 201
    finally:
        server.stop()


@ROOT
async def test_an_upload_that_fits_in_part_leaves_nothing(disk, tmp_path):
    server = Kept(data=disk, refiners=0).start(PATIENCE_S)
    source = zipped_arm(tmp_path / "source")
    try:
        async with client_of(server) as client:
            statuses = []
            for blocks in range(0, 200, 4):
                filler = fill(disk, left=4096 * blocks)
                answer = await client.post("/v1/verbs", content=source, headers={"Content-Type": ZIP})
                assert answer.status_code in (201, 503), answer.text
                assert temporary(disk) == []
                filler.unlink()
                statuses.append(answer.status_code)
                served = [row["name"] for row in (await client.get("/v1/verbs")).json()["verbs"]]
                assert ("arm" in served) == (201 in statuses)
                if 201 in statuses:
                    break
            assert statuses[-1] == 201
            assert len(statuses) > 3
            listed = (await client.get("/v1/verbs/arm/versions")).json()["versions"]
            assert [row["version"] for row in listed] == [1]
            assert len((await client.get("/v1/verbs/arm/versions/1")).content) == listed[0]["bytes"]
    finally:
        server.stop()


@ROOT
async def test_a_refinement_waits_for_space_and_then_ends(disk):
    server = Kept(data=disk, refiners=1).start(PATIENCE_S)
    try:
        async with client_of(server) as client:
            request = {"max_pseudo": 300, "target_error": 1e-6}
            job = (await client.post("/v1/verbs/reach/refinements", json=request)).json()
            where = f"/v1/refinements/{job['id']}"
            await until(client, where, lambda row: row["progress"].get("pseudo", 0) > 0)
            filler = fill(disk)
            stopped = (await client.get(where)).json()
            assert stopped["progress"]["pseudo"] < request["max_pseudo"], "the job must still run when the disk is full"
            end = asyncio.get_running_loop().time() + 3.0  # longer than a step of the job
            while asyncio.get_running_loop().time() < end:
                assert (await client.post("/v1/verbs/arm3/pose", json=POSE)).status_code == 200
                assert (await client.get(where)).json()["state"] == "running"
                await asyncio.sleep(0.1)
            filler.unlink()
            ended = await until(client, where, lambda row: row["state"] not in ("queued", "running"))
            assert (ended["state"], ended["version_after"]) == ("published", 2), ended
            await until(client, "/v1/verbs/reach", lambda verb: verb["version"] == 2)
    finally:
        server.stop()


@ROOT
async def test_a_folder_that_becomes_read_only_refuses_changes(tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    with mounted(data / "artifacts", "size=64m") as artifacts, mounted(data / "uploads", "size=64m") as uploads:
        server = Kept(data=data, refiners=0).start(PATIENCE_S)
        content = Path(library.__file__).with_name("arm3.verb").read_bytes()
        octets, draft = {"headers": {"Content-Type": OCTETS}}, zipped_arm(tmp_path / "source")
        try:
            async with client_of(server) as client, open_stream(server) as stream:
                await stream.open(1, "reach")
                for folder in (artifacts, uploads):
                    remount(folder, "ro")
                    await unavailable(client, "POST", "/v1/verbs", "Read-only file system", content=content, **octets)
                await unavailable(
                    client, "POST", "/v1/drafts", "Read-only", content=draft, headers={"Content-Type": ZIP}
                )
                assert (await client.post("/v1/verbs/arm3/pose", json=POSE)).status_code == 200
                await stream.poses(5, channel=1)
                for folder in (artifacts, uploads):
                    remount(folder, "rw")
                assert (await client.post("/v1/verbs", content=content, **octets)).status_code == 201
                assert temporary(data) == []
        finally:
            server.stop()


@ROOT
async def test_a_server_waits_for_a_data_folder_that_it_can_write(tmp_path):
    with mounted(tmp_path / "disk", "size=64m") as data:
        Kept(data=data, refiners=0).start(PATIENCE_S).stop()
        remount(data, "ro")
        server = Kept(data=data, refiners=0)
        server.thread.start()
        try:
            async with client_of(server) as client:
                waiting = await answered(client, "/readyz", 503)
                while "tried again" not in waiting["detail"]:
                    waiting = await answered(client, "/readyz", 503)
                assert waiting["code"] == "not_ready"
                assert re.search("readonly|read-only|unable to open", waiting["detail"])
                remount(data, "rw")
                assert (await answered(client, "/readyz", 200))["ready"]
        finally:
            server.stop()


def remount(folder, mode):
    """Make a disk read-only or writable; refused while a removed file is open, as in a process that ends."""
    end = time.monotonic() + PATIENCE_S
    while subprocess.run(["mount", "-o", f"remount,{mode}", folder], check=False, capture_output=True).returncode:
        assert time.monotonic() < end
        time.sleep(0.05)


async def answered(client, path, status):
    """JSON of a route, once it has a status."""
    end = asyncio.get_running_loop().time() + PATIENCE_S
    while True:
        try:
            answer = await client.get(path)
            if answer.status_code == status:
                return answer.json()
        except httpx.ConnectError:  # it does not listen yet
            answer = None
        assert asyncio.get_running_loop().time() < end, answer and answer.text
        await asyncio.sleep(0.05)
