"""Earlier versions can be evaluated by number."""

import httpx
import pytest

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
