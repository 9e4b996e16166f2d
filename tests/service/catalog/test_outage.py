"""Outages of the database, at the start and later: loaded verbs are served, the rest resumes afterwards."""

import asyncio
import time

import httpx
import pytest

from tests.service.catalog.conftest import PATIENCE_S, Kept, client_of, until
from tests.service.refinement.conftest import database
from tests.service.stream.conftest import open_stream
from verbs import library

pytestmark = [pytest.mark.anyio]

AWAY_S = 10.0
LONG = {"max_pseudo": 700, "target_error": 1e-6}
ARM = {"adverbs": {"x": 0.4, "y": 0.3}}


async def answered(client, path, status):
    """Wait until a route returns a status; returns the response."""
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            answer = await client.get(path)
            if answer.status_code == status:
                return answer
        except httpx.ConnectError:  # it does not listen yet
            answer = None
        assert time.monotonic() < end, answer and answer.text
        await asyncio.sleep(0.05)


async def test_a_server_waits_for_its_database_at_the_start(postgres, tmp_path):
    server = Kept(data=tmp_path, database_url=database(postgres), refiners=0)
    postgres.stop()
    try:
        server.thread.start()
        async with client_of(server) as client:
            assert (await answered(client, "/livez", 200)).json() == {"live": True}
            waiting = (await answered(client, "/readyz", 503)).json()
            assert waiting["code"] == "not_ready"
            while "tried again" not in waiting["detail"]:
                waiting = (await answered(client, "/readyz", 503)).json()
            assert "the store is unavailable" in waiting["detail"]
            assert str(tmp_path) not in waiting["detail"]
            postgres.start()
            ready = (await answered(client, "/readyz", 200)).json()
            assert (ready["verbs"], ready["degraded"], ready["problem"], ready["skipped"]) == (
                len(library.names()),
                False,
                None,
                [],
            )
            assert (await client.get("/v1/verbs/arm3/versions")).json()["current"] == 1
    finally:
        server.stop()


async def test_an_outage_of_the_database_interrupts_neither_poses_nor_streams(postgres, tmp_path):
    server = Kept(data=tmp_path, database_url=database(postgres), refiners=1).start(PATIENCE_S)
    try:
        async with client_of(server) as client, open_stream(server) as stream:
            await stream.open(1, "reach")
            reading = asyncio.create_task(stream.until("version", channel=1))
            job = (await client.post("/v1/verbs/reach/refinements", json=LONG)).json()
            where = f"/v1/refinements/{job['id']}"
            running = await until(client, where, lambda row: row["progress"].get("pseudo", 0) > 0)
            assert running["progress"]["pseudo"] < LONG["max_pseudo"], "the job must still run when the database stops"
            postgres.stop()
            began, frames = time.monotonic(), len(stream.frames)
            await meanwhile(client)
            requested = sum([await posed(client) for _ in range(20)])
            await asyncio.sleep(max(0.0, AWAY_S - (time.monotonic() - began)))
            streamed = len(stream.frames) - frames
            postgres.start()
            await until(client, "/readyz", lambda row: not row["degraded"])
            ended = await until(client, where, lambda row: row["version_after"] is not None)
            await asyncio.wait_for(reading, PATIENCE_S)
            await stream.poses(3)
            listed = (await client.get("/v1/verbs/reach/versions")).json()
    finally:
        server.stop()
    assert (ended["state"], ended["progress"]["pseudo"]) == ("published", LONG["max_pseudo"])
    assert (listed["current"], [row["version"] for row in listed["versions"]]) == (2, [2, 1])
    sent = [frame.sequence for frame in stream.frames]
    assert sent == list(range(1, len(sent) + 1))
    assert streamed > 10 * AWAY_S
    assert requested == 20


async def meanwhile(client):
    """Check the responses during the outage."""
    degraded = await until(client, "/readyz", lambda row: row["degraded"])
    assert degraded["ready"]
    assert degraded["verbs"] == len(library.names())
    assert degraded["problem"].startswith("the database cannot be reached")
    for method, path in (
        ("GET", "/v1/verbs/arm3/versions"),
        ("POST", "/v1/verbs/arm3/versions/1/activate"),
        ("DELETE", "/v1/verbs/arm3"),
        ("GET", "/v1/refinements"),
        ("POST", "/v1/verbs/arm3/refinements"),
    ):
        answer = await client.request(method, path, json={} if path.endswith("refinements") else None)
        assert (answer.status_code, answer.json()["code"]) == (503, "store_unavailable"), path
        assert int(answer.headers["retry-after"]) > 0


async def posed(client):
    """Whether a pose is answered."""
    return (await client.post("/v1/verbs/arm3/pose", json=ARM)).status_code == 200
