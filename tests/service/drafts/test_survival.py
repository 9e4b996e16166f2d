"""Drafts outlive their server; a server that is killed while it makes one leaves nothing of it; captured motion."""

import asyncio
import io
import zipfile

import numpy as np
import pytest

from tests.service.catalog.conftest import ZIP
from tests.service.catalog.test_killed import Started, eventually, slowly
from tests.service.drafts.conftest import NAME, created
from tests.service.upload.test_building import contents
from verbs.authoring.fit import build
from verbs.proposal.propose import propose, write
from verbs.runtime.evaluate import Evaluator

pytestmark = pytest.mark.anyio


async def test_a_draft_survives_a_server_that_is_killed(warm, reaches, tmp_path, anyio_backend):
    data = tmp_path / "data"
    data.mkdir()
    one = Started(warm, data, tmp_path / "one.log")
    other = None
    try:
        async with await one.ready() as client:
            made = await created(client, reaches, name=NAME)
            url = f"/v1/drafts/{made['id']}"
            changed = (await client.patch(url, json={"clips": {"reach_1": {"excluded": True}}})).json()
            goal = {"adverbs": {"x": -0.2, "y": 1.2, "z": 0.4}, "phase": 0.5}
            pose = (await client.post(f"{url}/pose", json=goal)).json()
            motion = (await client.get(f"{url}/motion")).content
            half = asyncio.create_task(
                client.post("/v1/drafts", content=slowly(reaches), headers={"Content-Type": ZIP})
            )
            await eventually(lambda: any(p.stat().st_size for p in (data / "uploads").glob("*/upload")))
            one.kill()
            half.cancel()
            await asyncio.gather(half, return_exceptions=True)
        other = Started(warm, data, tmp_path / "other.log")
        async with await other.ready() as client:
            assert [row["id"] for row in (await client.get("/v1/drafts")).json()["drafts"]] == [made["id"]]
            assert (await client.get(url)).json() == changed
            assert (await client.get(f"{url}/motion")).content == motion
            assert (await client.post(f"{url}/pose", json=goal)).json() == pose
            again = await client.patch(url, json={"description": "After."}, headers={"If-Match": '"2"'})
            assert again.json()["revision"] == 3
            assert (await client.post(f"{url}/publish", json={})).json()["verb"] == NAME
    finally:
        one.process.end()
        if other is not None:
            other.process.end()


async def test_captured_punches_become_a_verb(client, mocap, tmp_path):
    folder = tmp_path / "punch"
    folder.mkdir()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents(mocap / "punch").items():
            if name.endswith(".bvh"):
                archive.writestr(f"punch/{name}", content)
                (folder / name).write_bytes(content)
    made = await created(client, packed.getvalue(), name="punched")
    assert (made["effector"], made["problem"]) == ("RightHand", None)
    assert not any(row["excluded"] for row in made["clips"])
    published = await client.post(f"/v1/drafts/{made['id']}/publish", json={})
    assert published.status_code == 201, published.text
    proposal = propose(folder)
    write(proposal, folder)
    evaluator = Evaluator(build(folder).verb)
    for row in made["clips"][::5]:
        pose = await client.post("/v1/verbs/punched/pose", json={"adverbs": row["adverbs"], "phase": 0.5})
        wanted = evaluator.pose(row["adverbs"], phase=0.5)
        np.testing.assert_allclose(pose.json()["rotations"], wanted.rotations[0], atol=1e-3)
        np.testing.assert_allclose(pose.json()["root"], wanted.root[0], atol=1e-3)
    await client.delete(f"/v1/drafts/{made['id']}")
