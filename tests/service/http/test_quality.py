"""Maps of error and smoothness, and versions that are kept but not current."""

import numpy as np
import pytest

from verbs import library

pytestmark = pytest.mark.anyio


async def post(client, verb="arm3", **query):
    return await client.get(f"/v1/verbs/{verb}/quality", params=query)


async def test_a_map_holds_what_poses_say(client):
    reply = (await post(client, method="rbf", nodes=9)).json()
    assert (reply["across"], reply["up"], reply["unit"], reply["held"]) == ("x", "y", "m", {})
    assert len(reply["rows"]) == len(reply["columns"]) == 9
    row, column = 4, 3
    adverbs = {"x": reply["columns"][column], "y": reply["rows"][row]}
    pose = (await client.post("/v1/verbs/arm3/pose", json={"adverbs": adverbs, "method": "rbf"})).json()
    assert reply["error"][row][column] == pytest.approx(pose["error"], abs=1e-12)
    known = [value for line in reply["error"] for value in line if value is not None]
    assert reply["error_mean"] == pytest.approx(np.mean(known))
    assert reply["error_max"] == max(known)


async def test_corrected_is_exact_where_rbf_is_not(client):
    means = {method: (await post(client, method=method)).json()["error_mean"] for method in ("rbf", "corrected")}
    assert means["corrected"] < 1e-8
    assert means["rbf"] > 0.01


async def test_support_is_that_of_poses(client):
    reply = (await post(client, "arm3", nodes=9)).json()
    values = [value for row in reply["support"] for value in row if value is not None]
    assert reply["support_min"] == min(values)
    assert reply["support_mean"] == pytest.approx(np.mean(values))
    for row, column in ((4, 4), (3, 5)):
        adverbs = {"x": reply["columns"][column], "y": reply["rows"][row]}
        pose = (await client.post("/v1/verbs/arm3/pose", json={"adverbs": adverbs})).json()
        assert reply["support"][row][column] == pytest.approx(pose["support"], rel=1e-6)


async def test_other_adverbs_are_held(client):
    reply = (await post(client, "reach", across="z", up="x", at="y=1.5", nodes=5)).json()
    assert (reply["across"], reply["up"], reply["held"]) == ("z", "x", {"y": 1.5})
    middle = (await post(client, "reach", nodes=5)).json()
    reach = library.load("reach").adverbs[2]
    assert middle["held"] == {"z": pytest.approx(0.5 * (reach.minimum + reach.maximum))}


async def test_nodes_outside_the_domain_are_null(client):
    reply = (await post(client, "reach", nodes=21)).json()
    corners = [reply["error"][row][column] for row in (0, -1) for column in (0, -1)]
    assert corners == [None] * 4
    assert reply["smoothness"][10][10] is not None


@pytest.mark.parametrize(
    ("query", "code"),
    [
        ({"across": "q"}, "unknown_adverb"),
        ({"across": "x", "up": "x"}, "bad_request"),
        ({"method": "magic"}, "unknown_method"),
        ({"across": "x", "at": "x=1"}, "bad_request"),
        ({"at": "x=0,y=1"}, "bad_request"),
        ({"at": "x"}, "bad_request"),
        ({"at": "z=nan"}, "out_of_range"),
        ({"at": "z=1e99"}, "out_of_range"),
        ({"nodes": "2"}, "invalid_request"),
        ({"nodes": "1000"}, "invalid_request"),
        ({"version": "9"}, "unknown_version"),
    ],
)
async def test_wrong_questions_are_told_so(client, query, code):
    answer = await post(client, "reach", **query)
    assert 400 <= answer.status_code < 500
    assert answer.json()["code"] == code
