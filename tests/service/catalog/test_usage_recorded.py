"""A refinement weighted by usage is better at requested adverbs, from requests to poses."""

import asyncio

import numpy as np
import pytest

from tests.service.catalog.conftest import OCTETS, PATIENCE_S, until
from tests.service.stream.conftest import open_stream
from verbs import library
from verbs.domain import inside
from verbs.io import artifact
from verbs.runtime.evaluate import Evaluator

pytestmark = [pytest.mark.anyio]

PSEUDO = 16


def corner(verb, seed, count):
    """Adverbs (count, D) around one point of the domain."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    rows = low + (high - low) * (0.7 + 0.06 * np.random.default_rng(seed).normal(size=(count, len(low))))
    return rows[inside(verb.domain, verb.domain.chart.points(rows))]


async def refined(client, **requested):
    """Version that a refinement of the built-in arm publishes."""
    await client.post("/v1/verbs/arm3/versions/1/activate")
    requested = {"max_pseudo": PSEUDO, "target_error": 1e-6, "method": "refined", **requested}
    started = await client.post("/v1/verbs/arm3/refinements", json=requested)
    ended = await until(client, started.headers["location"], lambda row: row["state"] not in ("queued", "running"))
    assert (ended["state"], ended["progress"]["pseudo"]) == ("published", PSEUDO), ended
    return ended


async def downloaded(client, number, path):
    path.write_bytes((await client.get(f"/v1/verbs/arm3/versions/{number}")).content)
    return artifact.load(path)


async def test_requests_in_one_corner_improve_that_corner(client, kept, tmp_path):
    verb = library.load("arm3")
    rows = corner(verb, 1, 2_000)
    batch = np.column_stack([rows, np.zeros(len(rows))]).astype("<f4").tobytes()
    for _ in range(2):
        answer = await client.post("/v1/verbs/arm3/poses", content=batch, headers={"Content-Type": OCTETS})
        assert answer.status_code == 200
    named = dict(zip("xy", rows[0].tolist(), strict=True))
    await client.post("/v1/verbs/arm3/pose", json={"adverbs": named})
    await client.post("/v1/verbs/arm3/sequence", json={"adverbs": named, "fps": 30})
    track = [{"time": 0.1 * k, "adverbs": named} for k in range(5)]
    await client.post("/v1/verbs/arm3/sequence", json={"track": track, "fps": 30})
    requested = 2 * len(rows) + 1 + 1 + 5
    assert await stored_usage(kept, "arm3", requested) == pytest.approx(requested, rel=1e-3)
    weighted = await refined(client, weighted_by_traffic=True)
    uniform = await refined(client)
    assert weighted["progress"]["note"] == ""
    fresh, errors = corner(verb, 2, 2_000), []
    for row in (weighted, uniform):
        published = await downloaded(client, row["version_after"], tmp_path / f"{row['version_after']}.verb")
        errors.append(Evaluator(published).blend(fresh, method="refined").error.mean())
    assert errors[0] < 0.8 * errors[1]


async def test_characters_of_streams_count_too(client, kept):
    async with open_stream(kept) as stream:
        await stream.open(1, "board")
        await stream.open(2, "board")
        assert await stored_usage(kept, "board", 6) >= 6
    assert (await client.get("/readyz")).json()["degraded"] is False


async def stored_usage(server, verb, least):
    """Wait until the stored usage of a verb reaches a number; returns it."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            rows = await asyncio.to_thread(server.state.store_sync.store.usage, verb, not_before_s=0.0)
            weight = sum(cell["weight"] for row in rows for cell in row["cells"])
            if weight >= 0.99 * least:
                return weight
            await asyncio.sleep(0.2)
