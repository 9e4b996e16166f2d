"""Earlier versions can be evaluated by number."""

import asyncio
import threading
from types import SimpleNamespace

import httpx
import pytest

from service.catalog import version_cache
from service.catalog.version_cache import MAX_LOADING, EntryCache
from service.errors import Overloaded
from service.store.records import ArtifactDamaged
from tests.service.catalog.test_versions import PATIENCE_S, ZIP, Kept, zipped_arm

pytestmark = [pytest.mark.anyio]

POSE = {"adverbs": {"x": 0.4, "y": 0.3}, "phase": 0.5}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    server = Kept(data=tmp_path_factory.mktemp("past"), refiners=0).start(PATIENCE_S)
    yield server
    server.stop()


async def test_an_earlier_version_serves_poses_sequences_and_maps(kept, tmp_path):
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{kept.port}", timeout=PATIENCE_S) as client:
        for name in ("first", "second"):
            sent = zipped_arm(tmp_path / name, name)
            answer = await client.post("/v1/verbs", content=sent, headers={"Content-Type": ZIP})
            assert answer.status_code == 201, answer.text
        now = (await client.get("/v1/verbs/arm")).json()["version"]
        assert now == 2
        poses = {}
        for number in (1, 2, None):
            requested = POSE | ({} if number is None else {"version": number})
            poses[number] = (await client.post("/v1/verbs/arm/pose", json=requested)).json()
            assert poses[number]["version"] == (number or now)
        assert poses[1]["rotations"] == poses[2]["rotations"]
        reply = await client.post("/v1/verbs/arm/sequence", json={"adverbs": POSE["adverbs"], "version": 1})
        assert reply.json()["version"] == 1
        many = await client.post("/v1/verbs/arm/poses", json={"items": [POSE], "version": 1})
        assert many.json()["version"] == 1
        assert (await client.get("/v1/verbs/arm/quality", params={"version": 1, "nodes": 5})).json()["version"] == 1
        none = await client.post("/v1/verbs/arm/pose", json=POSE | {"version": 9})
        assert (none.status_code, none.json()["code"], none.json()["known"]) == (404, "unknown_version", ["1", "2"])


@pytest.fixture
def loads(monkeypatch):
    """Versions that were loaded, in order; an entry here has a file and a version only."""
    done = []

    def of_verb(verb, *, path, version):
        done.append(version)
        return SimpleNamespace(path=path, version=version)

    monkeypatch.setattr(version_cache.artifact, "load", lambda path: path.read_text())
    monkeypatch.setattr(version_cache.Entry, "of_verb", of_verb)
    return done


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "one.verb"
    path.write_text("one")
    return path


async def test_requests_for_one_version_share_its_loading(loads, file):
    cache = EntryCache(2)
    found = await asyncio.gather(*(cache.get(("arm", 1), lambda: file) for _ in range(50)))
    assert loads == [1]
    assert all(entry is found[0] for entry in found)
    for number in (2, 3):
        await cache.get(("arm", number), lambda: file)
    await cache.get(("arm", 3), lambda: file)
    await cache.get(("arm", 1), lambda: file)
    assert loads == [1, 2, 3, 1]  # two stay


async def test_too_many_versions_at_once_are_refused(loads, file):
    cache, opened = EntryCache(2), threading.Event()

    def find():
        assert opened.wait(20.0)
        return file

    tasks = [asyncio.create_task(cache.get(("arm", number), find)) for number in range(MAX_LOADING)]
    await asyncio.sleep(0)
    tasks[0].cancel()  # the others wait for the same
    with pytest.raises(Overloaded):
        await cache.get(("arm", MAX_LOADING), find)
    opened.set()
    found = await asyncio.gather(*tasks, return_exceptions=True)
    assert isinstance(found[0], asyncio.CancelledError)
    assert [entry.version for entry in found[1:]] == list(range(1, MAX_LOADING))
    assert sorted(loads) == list(range(MAX_LOADING))


async def test_a_file_that_changes_is_checked_again(loads, file):
    cache = EntryCache(2)

    def find():
        if file.read_text() == "bad":
            raise ArtifactDamaged("0" * 64, "is damaged")
        return file

    first = await cache.get(("arm", 1), find)
    file.write_text("bad")
    for _ in range(2):
        with pytest.raises(ArtifactDamaged):
            await cache.get(("arm", 1), find)
    file.write_text("good")
    assert await cache.get(("arm", 1), find) is not first
    assert loads == [1, 1]
