"""One pose and many, in JSON and in binary."""

import numpy as np
import pytest

from service import compute, wire
from service.http import evaluation
from tests.service.conftest import ARM, SWAY, app_of, client_of
from tests.service.records import records_of
from verbs.kernels import fk
from verbs.runtime import describe

pytestmark = pytest.mark.anyio

OCTETS = {"Accept": "application/octet-stream"}


async def post(client, verb="arm3", route="pose", headers=None, **body):
    answer = await client.post(f"/v1/verbs/{verb}/{route}", json=body, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer


async def test_a_pose_is_what_the_library_evaluates(client, catalog):
    evaluator = catalog.entry("arm3").evaluator
    reply = (await post(client, adverbs=ARM, phase=0.4, weights=True)).json()
    poses = evaluator.pose(ARM, phase=0.4)
    assert reply == describe.pose_record(evaluator, poses, 0, weights=True)
    np.testing.assert_allclose(reply["rotations"], poses.rotations[0], atol=1e-7)
    np.testing.assert_allclose(reply["weights"], poses.blend.weights[0], atol=1e-15)


async def test_a_pose_has_exactly_the_promised_fields(client):
    reply = (await post(client, adverbs=ARM, phase=0.5)).json()
    promised = "verb version method phase time duration root rotations measured error clamped support"
    assert list(reply) == promised.split()
    assert set(reply["measured"]) == {"x", "y"}


async def test_support_is_whole_at_an_example_and_falls_outside(client, catalog):
    verb = catalog.entry("arm3").evaluator.verb
    example = dict(zip("xy", verb.values[0].tolist(), strict=True))
    found = [
        (await post(client, adverbs={name: factor * value for name, value in example.items()})).json()["support"]
        for factor in (1.0, 1.2, 1.5)
    ]
    assert found[0] == pytest.approx(1.0, abs=1e-6)
    assert found[0] > found[1] > found[2] > 0.0


async def test_records_have_the_support_in_their_flags_where_it_is_requested(client):
    for x in (0.5, 0.7, 50.0):  # inside, and clamped
        content = {"adverbs": {"x": x, "y": 0.1}, "phase": 0.5}
        whole = (await post(client, **content)).json()
        (plain,) = records_of((await post(client, headers=OCTETS, **content)).content, 4)
        (record,) = records_of((await post(client, headers=OCTETS, support=True, **content)).content, 4)
        assert plain["flags"] == wire.CLAMPED * whole["clamped"]
        assert record["flags"] & 15 == plain["flags"]
        assert ((record["flags"] >> 4) - 1) / 14 == pytest.approx(whole["support"], abs=0.5 / 14 + 1e-9)


async def test_phase_and_time_ask_for_the_same_pose(client):
    by_phase = (await post(client, adverbs=ARM, phase=0.3)).json()
    by_time = (await post(client, adverbs=ARM, time=by_phase["time"])).json()
    assert by_time["phase"] == pytest.approx(0.3, abs=1e-12)
    np.testing.assert_allclose(by_time["rotations"], by_phase["rotations"], atol=1e-6)


async def test_without_an_instant_the_motion_starts(client):
    assert (await post(client, adverbs=ARM)).json()["phase"] == 0.0


async def test_binary_says_what_json_says(client):
    body = {"adverbs": ARM, "phase": 0.4}
    reply = (await post(client, **body)).json()
    answer = await post(client, headers=OCTETS, **body)
    assert answer.headers["content-type"] == "application/octet-stream"
    assert len(answer.content) == 24 + 12 + 16 * 4
    (record,) = records_of(answer.content, 4)
    np.testing.assert_array_equal(record["rotations"], np.float32(reply["rotations"]))
    np.testing.assert_array_equal(record["root"], np.float32(reply["root"]))
    for name in ("phase", "time", "duration", "error"):
        assert record[name] == np.float32(reply[name])
    assert (record["version"], record["channel"], record["encoding"], record["flags"]) == (1, 0, 0, 0)


async def test_a_pose_that_cannot_be_measured_has_no_error(client):
    reply = (await post(client, verb="sway", adverbs=SWAY, max_error=0.1)).json()
    assert reply["error"] is None
    assert reply["met"] is None
    (record,) = records_of((await post(client, verb="sway", adverbs=SWAY, headers=OCTETS)).content, 3)
    assert np.isnan(record["error"])


async def test_a_loop_goes_on_and_tells_its_velocity(client):
    first = (await post(client, verb="sway", adverbs=SWAY, phase=0.25)).json()
    later = (await post(client, verb="sway", adverbs=SWAY, phase=2.25)).json()
    assert later["time"] == pytest.approx(first["time"] + 2 * first["duration"])
    np.testing.assert_allclose(later["root_velocity"], first["root_velocity"], atol=1e-6)
    assert later["root"][2] > first["root"][2]


async def test_global_space_gives_global_rotations_and_positions(client, catalog):
    skeleton = catalog.entry("arm3").verb.skeleton
    local = (await post(client, adverbs=ARM, phase=0.5)).json()
    reply = (await post(client, adverbs=ARM, phase=0.5, space="global")).json()
    turns, places = fk.forward(
        np.array(local["root"]), np.array(local["rotations"]), skeleton.parents, skeleton.offsets
    )
    np.testing.assert_allclose(reply["rotations"], turns, atol=1e-6)
    np.testing.assert_allclose(reply["positions"], places, atol=1e-6)


async def test_joints_are_given_in_the_order_asked_for(client, catalog):
    names = catalog.entry("arm3").verb.skeleton.names
    whole = (await post(client, adverbs=ARM, phase=0.5)).json()["rotations"]
    reply = (await post(client, adverbs=ARM, phase=0.5, joints=[names[2], names[0]])).json()["rotations"]
    assert reply == [whole[2], whole[0]]
    content = (await post(client, adverbs=ARM, phase=0.5, joints=[names[2], names[0]], headers=OCTETS)).content
    np.testing.assert_array_equal(records_of(content, 2)["rotations"][0], np.float32(reply))


async def test_remembered_joint_subsets_are_bounded(client, catalog):
    names = catalog.entry("reach").verb.skeleton.names
    for k in range(100):
        joints = [names[k % 22], names[(k // 22 + k) % 22]]
        await post(client, verb="reach", adverbs={"x": -0.3, "y": 1.2, "z": 0.4}, joints=joints)
    assert len(catalog.entry("reach")._subsets) <= 64


async def test_far_adverbs_are_clamped_and_the_error_is_told(client):
    reply = (await post(client, adverbs={"x": 50.0, "y": 0.0}, max_error=0.01)).json()
    assert reply["clamped"]
    assert reply["error"] > 1.0
    assert reply["met"] is False
    (record,) = records_of((await post(client, adverbs={"x": 50.0, "y": 0.0}, headers=OCTETS)).content, 4)
    assert record["flags"] == wire.CLAMPED


async def test_a_small_error_meets_the_largest_allowed(client):
    assert (await post(client, adverbs=ARM, method="corrected", max_error=0.001)).json()["met"] is True


def crowd(count: int) -> list[dict]:
    rng = np.random.default_rng(5)
    rows = rng.uniform(0.1, 0.6, (count, 2)).tolist()
    return [{"adverbs": {"x": x, "y": y}, "phase": k / count} for k, (x, y) in enumerate(rows)]


async def test_a_batch_equals_single_poses(client):
    items = crowd(70)  # more than one slice of JSON
    reply = (await post(client, route="poses", items=items, weights=True)).json()
    assert (reply["verb"], reply["version"], len(reply["poses"])) == ("arm3", 1, 70)
    for item, found in list(zip(items, reply["poses"], strict=True))[::9]:
        single = (await post(client, weights=True, **item)).json()
        assert found.keys() == single.keys()
        np.testing.assert_allclose(found["rotations"], single["rotations"], atol=1e-6)
        np.testing.assert_allclose(found["weights"], single["weights"], atol=1e-9)
        assert found["error"] == pytest.approx(single["error"], abs=1e-9)


async def test_a_binary_batch_equals_the_same_in_json(client):
    items = crowd(33)
    rows = np.array([[item["adverbs"]["x"], item["adverbs"]["y"], item["phase"]] for item in items], "<f4")
    answer = await client.post(
        "/v1/verbs/arm3/poses?method=rbf",
        content=rows.tobytes(),
        headers={"Content-Type": "application/octet-stream", **OCTETS},
    )
    assert answer.status_code == 200
    records = records_of(answer.content, 4)
    reply = (await post(client, route="poses", items=items, method="rbf")).json()["poses"]
    np.testing.assert_array_equal(records["channel"], np.arange(33))
    np.testing.assert_allclose(records["rotations"], [pose["rotations"] for pose in reply], atol=2e-6)
    assert {pose["method"] for pose in reply} == {"rbf"}


async def test_channels_of_a_large_crowd_wrap(client, catalog):
    rows = np.zeros((66_000, 3), "<f4")
    async with client_of(app_of(catalog, max_batch=100_000)) as wide:
        answer = await wide.post(
            "/v1/verbs/arm3/poses?joints=Tip",
            content=rows.tobytes(),
            headers={"Content-Type": "application/octet-stream", **OCTETS},
        )
    np.testing.assert_array_equal(records_of(answer.content, 1)["channel"], np.arange(66_000) % 65_536)


async def test_items_may_give_times(client):
    items = [{"adverbs": SWAY, "time": 0.5 * k} for k in range(6)]
    reply = (await post(client, verb="sway", route="poses", items=items)).json()["poses"]
    np.testing.assert_allclose([pose["time"] for pose in reply], 0.5 * np.arange(6), atol=1e-12)


async def test_a_long_call_leaves_the_event_loop_to_others(client, monkeypatch):
    ran = []

    async def run_sync(work, **_):
        ran.append(work)
        return work()

    monkeypatch.setattr(compute.anyio.to_thread, "run_sync", run_sync)
    await post(client, route="poses", items=crowd(3))
    assert not ran
    await post(client, route="poses", items=crowd(900))
    assert len(ran) == 1


async def test_too_many_waiting_calls_are_refused(client, app):
    app.state.server.pool._active = 1_000
    answer = await client.post("/v1/verbs/arm3/poses", json={"items": crowd(900)})
    assert answer.status_code == 503
    assert answer.json()["code"] == "overloaded"
    assert answer.headers["retry-after"] == "1"
    assert (await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM})).status_code == 200


async def test_walking_too_many_cycles_in_one_call_is_refused(client):
    items = [{"adverbs": SWAY, "phase": 900.0}] * 30
    answer = await client.post("/v1/verbs/sway/poses", json={"items": items})
    assert answer.status_code == 422
    assert f"{evaluation.MAX_CYCLES:.0f} are allowed" in answer.json()["detail"]
