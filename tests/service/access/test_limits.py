"""Limits per key and per address, on requests, streams, channels and refinements."""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import subprocess
import time
from contextlib import AsyncExitStack, suppress

import pytest
from pydantic import ValidationError
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.access import limits as module
from service.access.access import Caller
from service.access.limits import Limits, address_of
from service.errors import TooManyRequests
from service.settings import Settings
from service.store.keys import open_keys
from tests.service.access.conftest import added, bearer
from tests.service.catalog.conftest import PATIENCE_S, ZIP, Kept, client_of, zipped_arm
from tests.service.conftest import app_of
from tests.service.conftest import client_of as client_of_app

ALICE = Caller("key a", "a", "", frozenset(("refine",)))


async def passed(limits: Limits, kind: str, name: str, times: int) -> int:
    """How many of so many requests of a key or an address pass."""
    refused = []
    for _ in range(times):
        try:
            await limits.request(kind, name)
        except TooManyRequests as err:
            refused.append(err)
    assert all(1 <= int(err.headers["Retry-After"]) <= 3_600 and err.extra["limit"] == 5 for err in refused)
    return times - len(refused)


@pytest.mark.anyio
async def test_each_key_and_each_address_has_its_own_count():
    by_key = Limits(Settings(rate_per_key="5/hour"))
    assert [await passed(by_key, "key", id, 8) for id in ("a", "b", "a")] == [5, 5, 0]
    assert await passed(by_key, "address", "1.1.1.1", 8) == 8
    by_address = Limits(Settings(rate_per_address="5/hour"))
    assert [await passed(by_address, "address", one, 8) for one in ("1.1.1.1", "2.2.2.2", "1.1.1.1")] == [5, 5, 0]
    assert await passed(by_address, "key", "a", 8) == 8


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("10.1.2.3", "10.1.2.3"),
        ("2001:db8:1:2:3::4", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::9", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::ffff:10.1.2.3", "10.1.2.3"),
        ("x:y:z", "x:y:z"),
        ("10.1.2.3:80", "10.1.2.3:80"),
        (":" * 1_000, ":" * 64),
        ("x" * 1_000, "x" * 64),
    ],
)
def test_an_ipv6_client_is_its_network(host, address):
    assert address_of({"client": (host, 1)}) == address


def test_requests_without_a_client_address_share_one_count():
    assert address_of({"client": None}) == address_of({})


@pytest.mark.anyio
async def test_requests_beyond_the_limit_are_answered_with_429(catalog):
    async with client_of_app(app_of(catalog, rate_per_address="3/minute")) as client:
        answers = [await client.get("/v1/verbs") for _ in range(5)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429, 429]
        refused = answers[-1]
        assert refused.json()["code"] == "too_many_requests"
        assert refused.json()["limit"] == 3
        assert 1 <= int(refused.headers["retry-after"]) <= 60
        assert (await client.get("/livez")).status_code == 429


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        (bearer("adv_0123456789abcdef_" + "A" * 43), 401),
        ({"Host": "stranger.example"}, 421),
        ({"Origin": "https://stranger.example"}, 403),
    ],
    ids=["no key", "wrong key", "wrong host", "foreign origin"],
)
async def test_refused_requests_count_for_their_address(catalog, headers, status):
    async with client_of_app(app_of(catalog, keys="required", rate_per_address="3/minute")) as client:
        answers = [(await client.post("/v1/verbs", headers=headers)).status_code for _ in range(5)]
    assert answers == [status] * 3 + [429] * 2


@pytest.mark.anyio
@pytest.mark.parametrize(("trusted", "statuses"), [(None, [200, 429, 429]), ("127.0.0.1", [200, 200, 429])])
async def test_a_client_states_its_address_only_through_a_trusted_proxy(serve, monkeypatch, trusted, statuses):
    monkeypatch.delenv("FORWARDED_ALLOW_IPS", raising=False)
    if trusted is not None:
        monkeypatch.setenv("FORWARDED_ALLOW_IPS", trusted)
    with serve(rate_per_address="1/hour") as server:
        async with client_of(server) as client:
            stated = ("10.0.0.1", "x:y:z", "x:y:z")
            answers = [await client.get("/v1/verbs", headers={"X-Forwarded-For": one}) for one in stated]
    assert [answer.status_code for answer in answers] == statuses


@pytest.mark.anyio
async def test_streams_and_channels_of_a_key_are_limited(tmp_path):
    store = open_keys(f"sqlite:///{tmp_path / 'state.db'}")
    alice, bob = added(store, "pose"), added(store, "pose")
    server = Kept(data=tmp_path, refiners=0, streams_per_key=2, channels_per_key=3).start(PATIENCE_S)
    try:
        async with AsyncExitStack() as stack:
            streams = [await stack.enter_async_context(connect(server.url, additional_headers=bearer(alice)))]
            streams += [await stack.enter_async_context(connect(server.url, additional_headers=bearer(alice)))]
            third = await stack.enter_async_context(connect(server.url, additional_headers=bearer(alice)))
            with pytest.raises(ConnectionClosed) as closed:
                await third.recv()
            assert closed.value.rcvd.code == 4029
            other = await stack.enter_async_context(connect(server.url, additional_headers=bearer(bob)))
            codes = []
            for number in range(4):
                stream = streams[number % 2]
                codes.append(await opened(stream, number))
            assert codes == ["opened", "opened", "opened", "too_many_channels"]
            assert await opened(other, 1) == "opened"
            await streams[0].send(json.dumps({"op": "close", "channel": 0}))
            assert await opened(streams[1], 9) == "opened"
            await streams[0].close()
            assert await eventually_opened(server, alice)
    finally:
        store.close()
        server.stop()


async def opened(stream, number: int) -> str:
    """Answer to the opening of a channel: its ``op``, or the code of the error."""
    await stream.send(json.dumps({"op": "open", "channel": number, "verb": "arm3", "play": False}))
    async with asyncio.timeout(PATIENCE_S):
        while True:
            message = await stream.recv()
            if isinstance(message, str) and json.loads(message)["op"] in ("opened", "error"):
                return json.loads(message).get("code", "opened")


async def eventually_opened(server, key: str) -> bool:
    """Whether a stream can be opened again once another one is closed."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            async with connect(server.url, additional_headers=bearer(key)) as stream:
                try:
                    await stream.recv()
                except ConnectionClosed:
                    await asyncio.sleep(0.05)
                    continue
                return True


@pytest.mark.anyio
async def test_the_budget_of_refinements_is_limited(tmp_path):
    (tmp_path / "data").mkdir()
    server = Kept(data=tmp_path / "data", refiners=0, refine_s_per_day=100).start(PATIENCE_S)
    try:
        async with client_of(server) as client:
            made = await client.post("/v1/verbs", content=zipped_arm(tmp_path / "a"), headers={"Content-Type": ZIP})
            route = f"/v1/verbs/{made.json()['verb']}/refinements"
            job = await client.post(route, json={"budget_s": 60})
            assert job.status_code == 202, job.text
            second = await client.post(route, json={"budget_s": 20})
            assert second.status_code == 409
            await client.delete(f"/v1/refinements/{job.json()['id']}")
            answer = await client.post(route, json={"budget_s": 60})
            assert answer.status_code == 429
            assert "seconds of refinement per day" in answer.json()["detail"]
            assert (await client.post(route, json={"budget_s": 40})).status_code == 202  # what is left
    finally:
        server.stop()


async def started(limits: Limits, *budgets_s: float, fails: bool = False) -> list[bool]:
    """Which refinements with these budgets may be started."""
    found = []
    for budget_s in budgets_s:
        with suppress(RuntimeError):
            try:
                async with limits.refinement(ALICE, "", budget_s):
                    found.append(True)
                    if fails:
                        raise RuntimeError("not started")
            except TooManyRequests:
                found.append(False)
    return found


@pytest.mark.anyio
async def test_budgets_of_refinements_that_are_refused_or_fail_are_not_counted():
    limits = Limits(Settings(refine_s_per_day=100))
    assert await started(limits, 60, 60, 30, 10, 1) == [True, False, True, True, False]
    limits = Limits(Settings(refine_s_per_day=100))
    assert await started(limits, 90, 90, fails=True) == [True, True]
    assert await started(limits, 90, 90) == [True, False]


@pytest.mark.parametrize("rate", ["many", "5", "5/fortnight", "/second", "-1/second"])
def test_a_wrong_rate_is_named(rate):
    with pytest.raises(ValidationError, match="is not a rate"):
        Settings(rate_per_key=rate)


@pytest.fixture(scope="module")
def redis(tmp_path_factory):
    """Address of a Redis server."""
    program = shutil.which("redis-server")
    if program is None:
        pytest.skip("redis-server is not installed (Debian package redis-server)")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    folder = tmp_path_factory.mktemp("redis")
    options = ["--port", str(port), "--bind", "127.0.0.1", "--save", "", "--dir", str(folder)]
    process = subprocess.Popen([program, *options], stdout=subprocess.DEVNULL)
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            break
        except OSError:
            assert time.monotonic() < end
            time.sleep(0.05)
    yield f"redis://127.0.0.1:{port}", process
    process.kill()
    process.wait()


@pytest.mark.anyio
async def test_processes_count_together_in_redis_and_alone_without_it(redis, monkeypatch):
    address, process = redis
    settings = Settings(rate_per_key="5/hour", rate_storage=address, refine_s_per_day=100)
    first, second = Limits(settings), Limits(settings)
    assert await started(first, 90, fails=True) == [True]
    assert await started(first, 60, 60) == [True, False]
    assert await started(second, 60, 30, 10, 1) == [False, True, True, False]
    assert await passed(first, "key", "a", 3) + await passed(second, "key", "a", 8) == 5
    process.kill()
    process.wait()
    monkeypatch.setattr(module, "RETRY_STORAGE_S", 60.0)
    assert await passed(first, "key", "a", 8) == 5  # requests continue, counted by this process alone
    await first.close()
    await second.close()
