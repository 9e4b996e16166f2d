"""Adverbs of a stream, of a pose route and of a description are in the unit that the source declares."""

import httpx
import numpy as np
import pytest

from service.catalog.catalog import Catalog
from tests.service.stream.conftest import Server, open_stream
from tests.verbs.sources import arm_source
from tests.verbs.test_units import converted
from verbs.authoring.fit import build
from verbs.io import artifact

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def centimetres(tmp_path_factory):
    """A server with one verb, an arm whose adverbs are in centimetres; and that verb."""
    from service.catalog import catalog as catalogs

    folder = tmp_path_factory.mktemp("units")
    source, _ = converted(arm_source(folder / "m"), folder / "cm")
    verb = build(source).verb
    (folder / "data").mkdir()
    artifact.save(verb, folder / "data" / "arm.verb")
    catalog: Catalog = catalogs.load(folder / "data")
    server = Server(catalog).start()
    yield server, verb
    server.stop()


async def test_a_binary_goal_carries_the_declared_unit(centimetres):
    server, verb = centimetres
    goal = verb.values.mean(axis=0)
    async with open_stream(server) as client:
        opened = await client.open(1, "arm", phase=0.5, play=False, half_life=0, follow=False)
        assert [adverb["unit"] for adverb in opened["adverbs"]] == ["cm", "cm"]
        assert opened["adverbs"][0]["max"] == pytest.approx(verb.adverbs[0].maximum)
        await client.set_adverbs(1, *goal)
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{server.port}") as rest:
            body = {"adverbs": dict(zip("xy", goal.tolist(), strict=True)), "phase": 0.5}
            expected = (await rest.post("/v1/verbs/arm/pose", json=body)).json()
        while True:
            (frame,) = await client.poses(1, channel=1)
            if np.abs(frame.of(1).rotations - np.array(expected["rotations"])).max() < 1e-6:
                break
    assert frame.of(1).error == pytest.approx(expected["error"], abs=1e-7)
    assert expected["measured"]["x"] == pytest.approx(goal[0], abs=1e-6)
    assert expected["error"] < 1e-8
