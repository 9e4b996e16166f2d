"""A verb whose adverbs name measures of their own, over a stream, single poses and batches: exact everywhere."""

import httpx
import numpy as np
import pytest

from service.catalog import catalog as catalogs
from tests.service.stream.conftest import Server, open_stream
from tests.verbs.redeclared import positions, redeclare
from tests.verbs.sources import arm_source
from verbs.authoring.fit import build
from verbs.domain import random_points
from verbs.io import artifact

pytestmark = pytest.mark.anyio

NAMES = ("x", "y", "when")


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    """A server with an arm that reaches a position (cm) at a time (s); and that verb."""
    folder = tmp_path_factory.mktemp("timed")
    when = {"name": "when", "unit": "s", "measure": {"kind": "time_to", "at": "reach"}}
    adverbs = [*positions("Hand", "reach", unit="cm")[:2], when]
    verb = build(redeclare(arm_source(folder / "arm"), folder / "timed", adverbs)).verb
    (folder / "data").mkdir()
    artifact.save(verb, folder / "data" / "arm.verb")
    server = Server(catalogs.load(folder / "data")).start()
    yield server, verb
    server.stop()


def goals_of(verb, count, seed=3):
    return random_points(verb, np.random.default_rng(seed), count)


def rest_of(server):
    return httpx.AsyncClient(base_url=f"http://127.0.0.1:{server.port}")


async def test_the_description_names_the_measures(timed):
    server, _ = timed
    async with rest_of(server) as rest:
        described = (await rest.get("/v1/verbs/arm")).json()
    assert described["measure"]["kind"] == "adverbs"
    assert described["measure"]["unit"] == "SI"
    assert described["measure"]["keytime"] is None
    found = [row["measure"] for row in described["adverbs"]]
    assert [(row["kind"], row["axis"], row["at"], row["unit"]) for row in found] == [
        ("position", "x", "reach", "m"),
        ("position", "y", "reach", "m"),
        ("time_to", "time", "reach", "s"),
    ]


async def test_poses_and_batches_meet_their_goals(timed):
    server, verb = timed
    goals = goals_of(verb, 40)
    items = [{"adverbs": dict(zip(NAMES, goal.tolist(), strict=True)), "phase": 0.5} for goal in goals]
    async with rest_of(server) as rest:
        batch = await rest.post("/v1/verbs/arm/poses", json={"items": items})
        single = await rest.post("/v1/verbs/arm/pose", json=items[0])
    assert batch.status_code == single.status_code == 200
    poses = batch.json()["poses"]
    assert max(pose["error"] for pose in poses) < 1e-9
    measured = np.array([[pose["measured"][name] for name in NAMES] for pose in poses])
    np.testing.assert_allclose(measured, goals, atol=1e-7)
    np.testing.assert_allclose(single.json()["rotations"], poses[0]["rotations"], atol=1e-9)


async def test_characters_of_a_stream_meet_their_goals(timed):
    server, verb = timed
    goals = goals_of(verb, 6)
    async with open_stream(server) as client, rest_of(server) as rest:
        for channel, goal in enumerate(goals, 1):
            await client.open(channel, "arm", phase=0.5, play=False, half_life=0, follow=False)
            await client.set_adverbs(channel, *goal)
        for channel, goal in enumerate(goals, 1):
            sent = goal.astype(np.float32).astype(float)
            body = {"adverbs": dict(zip(NAMES, sent.tolist(), strict=True)), "phase": 0.5}
            expected = np.array((await rest.post("/v1/verbs/arm/pose", json=body)).json()["rotations"])
            while True:
                (frame,) = await client.poses(1, channel=channel)
                if np.abs(frame.of(channel).rotations - expected).max() < 1e-6:
                    break
            assert frame.of(channel).error < 1e-6
