"""Clients that follow a refinement: their limits, their keys, and a database that is away."""

from __future__ import annotations

import json
from contextlib import asynccontextmanager

import pytest

from service.access import limits
from service.http.routes import refinements
from service.store.records import StoreUnavailable
from tests.service.access.conftest import added, bearer
from tests.service.catalog.conftest import PATIENCE_S, ZIP, Kept, client_of, zipped_arm
from tests.service.stream.conftest import eventually

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def following(server, folder, headers):
    """A client, and the route of a queued refinement, which no worker takes."""
    async with client_of(server) as client:
        client.headers.update(headers)
        made = await client.post("/v1/verbs", content=zipped_arm(folder / "arm"), headers={"Content-Type": ZIP})
        job = await client.post(f"/v1/verbs/{made.json()['verb']}/refinements", json={})
        yield client, f"/v1/refinements/{job.json()['id']}"


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    server = Kept(data=tmp_path_factory.mktemp("limited"), refiners=0, streams_per_address=1).start(PATIENCE_S)
    yield server
    server.stop()


def until_open(server, count):
    """Wait until so many followers are counted."""
    return eventually(lambda: server.state.limits._followers == count)


async def test_followers_are_limited_as_streams_are(limited, tmp_path, monkeypatch):
    async with following(limited, tmp_path, {}) as (client, route):
        async with client.stream("GET", f"{route}/events") as first:
            assert first.status_code == 200
            await until_open(limited, 1)
            second = await client.get(f"{route}/events")
            assert (second.status_code, second.json()["code"]) == (429, "too_many_streams")
            assert second.headers["retry-after"]
            monkeypatch.setattr(limits, "MAX_FOLLOWERS", 1)
            third = await client.get(f"{route}/events")
            assert (third.status_code, third.json()["code"]) == (503, "overloaded")
        await until_open(limited, 0)
        await client.delete(route)
        assert "event: end" in (await client.get(f"{route}/events")).text


async def test_a_follower_outlasts_an_outage_of_the_database(limited, tmp_path, monkeypatch):
    monkeypatch.setattr(refinements, "FOLLOW_S", 0.02)
    known = limited.state.refinements
    async with following(limited, tmp_path, {}) as (client, route):
        failed = []

        def away(id):
            failed.append(id)
            raise StoreUnavailable("away")

        async with client.stream("GET", f"{route}/events") as follower:
            lines = follower.aiter_lines()
            assert await anext(lines) == "event: progress"
            with monkeypatch.context() as outage:
                outage.setattr(known, "job", away)
                await eventually(lambda: len(failed) >= 3)
            await client.delete(route)
            rest = [line async for line in lines]
        assert "event: end" in rest
        assert json.loads(rest[-2].removeprefix("data: "))["state"] == "cancelled"


async def test_a_follower_with_a_revoked_key_gets_no_more(guarded, tmp_path, monkeypatch):
    monkeypatch.setattr(refinements, "FOLLOW_S", 0.02)
    async with following(guarded.server, tmp_path, bearer(guarded.keys["admin"])) as (client, route):
        key = added(guarded.store, "pose")
        async with client.stream("GET", f"{route}/events", headers=bearer(key)) as follower:
            lines = follower.aiter_lines()
            assert await anext(lines) == "event: progress"
            guarded.store.revoke(key.split("_")[1])
            assert "event: end" not in [line async for line in lines]
        await client.delete(route)
