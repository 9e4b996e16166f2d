"""The clock of the machine is set forward and back by hours or years while a server runs."""

import asyncio
import itertools
import time
from dataclasses import replace

import pytest

from service.access import keys
from service.metrics import Metrics
from service.refinement.scheduler import COLLECT_S, Scheduler
from service.refinement.usage import Usage
from service.store.drafts import Content
from service.store.store import Store
from tests.service.catalog.conftest import OCTETS, PATIENCE_S, Kept, client_of
from tests.service.stream.conftest import open_stream
from verbs import library
from verbs.io import artifact

POSE = {"adverbs": {"x": 0.4, "y": 0.3}}
HOUR_S, YEAR_S = 3600.0, 365 * 86400.0


class Clock:
    """The clock of this process, set forward or back; its monotonic clock stays."""

    def __init__(self, monkeypatch):
        self.offset_s, real, real_ns = 0.0, time.time, time.time_ns
        monkeypatch.setattr(time, "time", lambda: real() + self.offset_s)
        monkeypatch.setattr(time, "time_ns", lambda: real_ns() + int(1e9 * self.offset_s))


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


@pytest.mark.anyio
async def test_a_jump_disturbs_neither_streams_nor_changes(tmp_path, clock):
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    try:
        async with client_of(server) as client, open_stream(server) as stream:
            await stream.open(1, "reach")
            before = (await stream.poses(5))[-1]
            for number, offset_s in enumerate((6 * HOUR_S, -6 * HOUR_S, YEAR_S, 0.0)):
                clock.offset_s = offset_s
                frames = await stream.poses(20)
                stamps = [frame.time_ns for frame in (before, *frames)]
                assert all(0 < later - earlier < 5e9 for earlier, later in itertools.pairwise(stamps))
                assert [frame.sequence for frame in frames] == list(range(before.sequence + 1, before.sequence + 21))
                before = frames[-1]
                assert (await client.post("/v1/verbs/arm3/pose", json=POSE)).status_code == 200
                file = tmp_path / "next"
                artifact.save(replace(library.load("arm3"), description=f"number {number}"), file)
                upload = await client.post("/v1/verbs", content=file.read_bytes(), headers={"Content-Type": OCTETS})
                assert upload.json()["version"] == number + 2
            assert (await client.get("/readyz")).json()["skipped"] == []
    finally:
        server.stop()


@pytest.mark.anyio
async def test_limits_of_requests_end_although_the_clock_is_set_back(tmp_path, clock):
    server = Kept(data=tmp_path, rate_per_address="20/second", refiners=0).start(PATIENCE_S)
    try:
        async with client_of(server) as client:
            for offset_s in (0.0, -6 * HOUR_S, 6 * HOUR_S):
                clock.offset_s = offset_s
                sent = [client.post("/v1/verbs/arm3/pose", json=POSE) for _ in range(40)]
                limited = [answer for answer in await asyncio.gather(*sent) if answer.status_code == 429]
                assert limited
                assert all(int(answer.headers["retry-after"]) <= 1 for answer in limited)
                end = asyncio.get_running_loop().time() + PATIENCE_S
                while (await client.post("/v1/verbs/arm3/pose", json=POSE)).status_code == 429:
                    assert asyncio.get_running_loop().time() < end
                    await asyncio.sleep(0.1)
    finally:
        server.stop()


@pytest.fixture
def store(tmp_path, clock):
    store = Store.open(f"sqlite:///{tmp_path}/state.db", str(tmp_path / "artifacts"), clock=time.time)
    yield store
    store.close()


def scheduler_of(store, tmp_path):
    (tmp_path / "uploads").mkdir()
    return Scheduler(
        *(store, None, Usage(0), Metrics()), uploads=tmp_path / "uploads", refine_above=None, started_s=time.time()
    )


def fill(store, folder):
    """Eight versions of a verb, and a draft."""
    for number in range(8):
        file = folder / "file"
        file.write_text(str(number))
        store.publish("reach", file, author="ada", reason="test", quality={})
    store.drafts.add("d", Content("d", 1, 0, "{}", file, file, None), most=9, most_bytes=10**9)


def test_a_clock_that_is_set_forward_by_a_year_removes_nothing(store, tmp_path, clock):
    scheduler = scheduler_of(store, tmp_path)
    fill(store, tmp_path)
    now_s = time.time()
    scheduler.run_once([], now_s + YEAR_S, latest_s=now_s + 100.0)
    assert len(store.versions("reach")) == 8
    assert len(store.drafts.listed()) == 1
    scheduler.run_once([], now_s + 2 * YEAR_S, latest_s=now_s + 2 * YEAR_S)  # and with time it does
    assert len(store.versions("reach")) == 5
    assert store.drafts.listed() == []


def test_a_clock_that_is_set_back_does_not_stop_collections(store, tmp_path, clock):
    clock.offset_s = YEAR_S
    scheduler = scheduler_of(store, tmp_path)
    clock.offset_s = 0.0
    orphan = tmp_path / "artifacts" / f"{'0' * 64}.verb"
    orphan.write_bytes(b"left over")
    scheduler.run_once([], time.time() + 2 * COLLECT_S[1])
    assert not orphan.exists()


def test_keys_follow_the_clock(store, clock):
    key = store.keys.add("k", "0" * 64, name="", scopes=frozenset(keys.SCOPES), expires_at_s=time.time() + HOUR_S)
    assert key.valid_at(time.time())
    clock.offset_s = 2 * HOUR_S
    assert not key.valid_at(time.time())
    clock.offset_s = -2 * HOUR_S
    assert key.valid_at(time.time())
    store.keys.revoke("k")
    assert not store.keys.listed()[0].valid_at(time.time())  # a revoked key stays revoked
