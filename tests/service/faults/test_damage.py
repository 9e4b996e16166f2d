"""Artifacts that are deleted or damaged on disk: they are never served, and reported; all others are served."""

import asyncio
import os
from dataclasses import replace
from pathlib import Path

import pytest
import structlog

from tests.service.catalog.conftest import OCTETS, PATIENCE_S, Kept, client_of, until
from tests.service.stream.conftest import open_stream
from verbs import library
from verbs.io import artifact

pytestmark = [pytest.mark.anyio]

ARM = {"adverbs": {"x": 0.4, "y": 0.3}}


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    """Files are checked often."""
    monkeypatch.setattr("service.store.notices.REREAD_S", 0.2)


@pytest.fixture
def server(tmp_path):
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    yield server
    server.stop()


def again(server):
    """Stop a server, and start another on its folder."""
    server.stop()
    return Kept(data=server.settings.data, refiners=0).start(PATIENCE_S)


async def file_of(server, client, verb, version=1):
    """File of a version."""
    listed = (await client.get(f"/v1/verbs/{verb}/versions")).json()["versions"]
    (sha256,) = (row["sha256"] for row in listed if row["version"] == version)
    return Path(server.settings.artifacts) / f"{sha256}.verb"


def flip(path):
    """Flip one bit in the middle of a file, in place."""
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        byte = file.read(1)[0]
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 1]))


def files_skipped(ready):
    return {row["file"]: row["problem"] for row in ready["skipped"]}


async def refused(client, method, path, **options):
    answer = await client.request(method, path, **options)
    assert (answer.status_code, answer.json()["code"]) == (500, "artifact_damaged"), answer.text
    return answer.json()["detail"]


async def posed(client, verb="arm3", **more):
    """Status of a pose."""
    found = (await client.get(f"/v1/verbs/{verb}")).json()
    adverbs = {row["name"]: (row["min"] + row["max"]) / 2 for row in found.get("adverbs", ())} or ARM["adverbs"]
    return (await client.post(f"/v1/verbs/{verb}/pose", json={"adverbs": adverbs, **more})).status_code


async def test_damage_before_the_start_is_reported_and_a_repair_is_served(tmp_path):
    damages = {"arm3": flip, "jump": os.unlink, "kick": lambda path: os.truncate(path, 100)}
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    async with client_of(server) as client:
        paths = {verb: await file_of(server, client, verb) for verb in damages}
    contents = {verb: path.read_bytes() for verb, path in paths.items()}
    for verb, damage in damages.items():
        damage(paths[verb])
    server = again(server)
    try:
        async with client_of(server) as client:
            ready = (await client.get("/readyz")).json()
            assert (ready["ready"], ready["verbs"]) == (True, len(library.names()) - len(damages))
            found = files_skipped(ready)
            problems = [problem.rpartition("… ")[2].partition(";")[0] for problem in found.values()]
            assert problems == ["is damaged", "is missing", "is damaged"]
            assert list(found) == [f"{verb} version 1" for verb in damages]
            assert str(tmp_path) not in str(found)
            for verb in damages:
                assert await posed(client, verb) == 404
                await refused(client, "GET", f"/v1/verbs/{verb}/versions/1")
            assert await posed(client, "reach") == 200
            for verb, path in paths.items():
                path.write_bytes(contents[verb])
            await until(client, "/readyz", lambda ready: ready["skipped"] == [])
            for verb in damages:
                assert await posed(client, verb) == 200
                assert (await client.get(f"/v1/verbs/{verb}/versions/1")).content == contents[verb]
    finally:
        server.stop()


async def test_a_served_file_that_changes_is_served_no_longer(server):
    async with client_of(server) as client, open_stream(server) as stream:
        await stream.open(1, "reach")
        path = await file_of(server, client, "arm3")
        content = path.read_bytes()
        flip(path)
        ready = await until(client, "/readyz", lambda ready: ready["skipped"])
        assert list(files_skipped(ready)) == ["arm3 version 1"]
        assert await posed(client) == 404
        assert "is damaged" in await refused(client, "GET", "/v1/verbs/arm3/versions/1")
        assert await posed(client, "reach") == 200
        await stream.poses(3, channel=1)
        upload = await client.post("/v1/verbs", content=content, headers={"Content-Type": OCTETS})
        assert (upload.status_code, upload.json()["version"]) == (201, 1)  # the same bytes repair the file
        await until(client, "/readyz", lambda ready: ready["skipped"] == [])
        assert path.read_bytes() == content
        assert await posed(client) == 200


async def test_a_served_file_that_is_deleted_stays_served_and_is_reported(server):
    async with client_of(server) as client:
        path = await file_of(server, client, "arm3")
        content = path.read_bytes()
        path.unlink()
        await until(client, "/readyz", lambda ready: "arm3 version 1" in files_skipped(ready))
        assert await posed(client) == 200
        assert "is missing" in await refused(client, "GET", "/v1/verbs/arm3/versions/1")
        path.write_bytes(content)
        await until(client, "/readyz", lambda ready: ready["skipped"] == [])


async def test_a_damaged_version_cannot_be_activated(server, tmp_path):
    other = tmp_path / "other.verb"
    artifact.save(replace(library.load("arm3"), description="another"), other)
    async with client_of(server) as client:
        upload = await client.post("/v1/verbs", content=other.read_bytes(), headers={"Content-Type": OCTETS})
        assert upload.json()["version"] == 2
        path = await file_of(server, client, "arm3")
        content = path.read_bytes()
        assert await posed(client, version=1) == 200  # and is cached
        flip(path)
        assert await posed(client, version=2) == 200
        assert await posed(client, version=1) == 500
        await refused(client, "POST", "/v1/verbs/arm3/versions/1/activate")
        assert (await client.get("/v1/verbs/arm3/versions")).json()["current"] == 2
        assert (await client.get("/readyz")).json()["skipped"] == []
        path.write_bytes(content)
        assert (await client.post("/v1/verbs/arm3/versions/1/activate")).status_code == 200
        assert await posed(client, version=1) == 200


async def test_another_version_ends_the_report_of_a_damaged_one(server, tmp_path):
    async with client_of(server) as client:
        flip(await file_of(server, client, "arm3"))
        await until(client, "/readyz", lambda ready: "arm3 version 1" in files_skipped(ready))
        other = tmp_path / "other.verb"
        artifact.save(replace(library.load("arm3"), description="another"), other)
        upload = await client.post("/v1/verbs", content=other.read_bytes(), headers={"Content-Type": OCTETS})
        assert upload.json()["version"] == 2
        assert (await client.get("/readyz")).json()["skipped"] == []
        assert await posed(client) == 200


async def test_a_report_is_logged_once(server):
    async with client_of(server) as client:
        path = await file_of(server, client, "arm3")
        with structlog.testing.capture_logs() as lines:
            flip(path)
            await until(client, "/readyz", lambda ready: ready["skipped"])
            for _ in range(3):
                refreshed = asyncio.run_coroutine_threadsafe(server.state.store_sync.refresh(), server.loop)
                await asyncio.wrap_future(refreshed)
        assert [line["event"] for line in lines].count("verb file skipped") == 1
