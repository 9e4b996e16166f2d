"""Whole motions: frames, tracks, events; over the wire and in the library."""

import json
import struct

import numpy as np
import pytest

from service import wire
from service.http.negotiation import FILES
from tests.service.conftest import ARM, SWAY, app_of, client_of
from tests.service.records import records_of
from verbs.errors import OutOfRange, RequestError
from verbs.io import bvh, motion_files
from verbs.runtime import sequence

pytestmark = pytest.mark.anyio

ENDS = [{"x": 0.3, "y": 0.5}, {"x": 0.6, "y": 0.1}]


async def post(client, verb="arm3", headers=None, **body):
    answer = await client.post(f"/v1/verbs/{verb}/sequence", json=body, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer


@pytest.mark.parametrize("fps", [1.0, 24.0, 30.0, 59.94, 240.0])
async def test_frames_stand_at_multiples_up_to_the_end(client, fps):
    reply = (await post(client, adverbs=ARM, fps=fps)).json()
    last = np.floor(reply["duration"] * fps + 1e-6)
    assert reply["frames"] == len(reply["rotations"]) == last + 1
    np.testing.assert_allclose(reply["times"], np.arange(last + 1) / fps, atol=1e-12)


async def test_each_frame_is_the_pose_at_its_time(client):
    reply = (await post(client, adverbs=ARM, fps=12, space="global", joints=["Tip"], weights=True)).json()
    for k in (0, 5, reply["frames"] - 1):
        body = {"adverbs": ARM, "time": reply["times"][k], "space": "global", "joints": ["Tip"], "weights": True}
        pose = (await client.post("/v1/verbs/arm3/pose", json=body)).json()
        np.testing.assert_allclose(reply["rotations"][k], pose["rotations"], atol=1e-6)
        np.testing.assert_allclose(reply["positions"][k], pose["positions"], atol=1e-6)
        assert reply["phases"][k] == pytest.approx(pose["phase"], abs=1e-12)
        assert reply["weights"] == [pose["weights"]]
        assert reply["error"] == pose["error"]
        assert reply["support"] == pose["support"]
        assert "supports" not in reply


async def test_a_loop_runs_for_its_cycles_and_walks_on(client):
    reply = (await post(client, verb="sway", adverbs=SWAY, cycles=3)).json()
    assert reply["duration"] == pytest.approx(3 * reply["times"][-1] / reply["phases"][-1], rel=0.05)
    assert 2.9 < reply["phases"][-1] <= 3.0
    steps = np.linalg.norm(np.diff(np.array(reply["root"])[:, ::2], axis=0), axis=1)
    assert steps.max() < 2 * steps.min()  # it walks on, over the seams too
    assert [event["name"] for event in reply["events"]] == ["left", "right"] * 3
    assert len(reply["root_velocity"]) == reply["frames"]


async def test_a_track_that_stays_is_the_sequence(client):
    for verb, adverbs, cycles in (("arm3", ARM, 1), ("sway", SWAY, 3)):
        plain = (await post(client, verb=verb, adverbs=adverbs, cycles=cycles)).json()
        track = [{"time": 0.1, "adverbs": adverbs}, {"time": 0.7, "adverbs": adverbs}]
        tracked = (await post(client, verb=verb, track=track, cycles=cycles)).json()
        assert tracked["frames"] == plain["frames"]
        for column in ("times", "phases", "root", "rotations"):
            np.testing.assert_allclose(tracked[column], plain[column], atol=1e-6)


async def test_a_track_has_an_error_and_a_support_per_frame(client):
    track = [{"time": k / 2, "adverbs": adverbs} for k, adverbs in enumerate(ENDS)]
    reply = (await post(client, track=track, method="rbf")).json()
    assert len(reply["errors"]) == reply["frames"]
    assert reply["error"] == max(reply["errors"])
    assert len(reply["supports"]) == reply["frames"]
    assert reply["support"] == min(reply["supports"])
    assert reply["measured"] is None


def test_a_changing_track_stays_smooth_and_ends_at_its_end(catalog):
    for name in ("arm3", "sway"):
        evaluator = catalog.entry(name).evaluator
        rows = np.stack([evaluator.verb.values[0], evaluator.verb.values[-1]])
        coarse = sequence.tracked(evaluator, np.array([0.0, 0.8]), rows, 60.0)
        fine = sequence.tracked(evaluator, np.array([0.0, 0.8]), rows, 240.0)
        assert np.all(np.diff(coarse.phase) > 0)
        assert 1 - coarse.phase[-1] < 0.05
        shared = min(len(coarse.phase), (len(fine.phase) + 3) // 4)
        # Midpoint steps: second order, so that a quarter of the step leaves a sixteenth of the error.
        np.testing.assert_allclose(coarse.phase[:shared], fine.phase[::4][:shared], atol=2e-4)
        assert np.abs(np.diff(fine.rotations, axis=0)).max() < 0.05
        assert np.abs(np.diff(fine.root, axis=0)).max() < 0.05


def test_events_of_a_sequence_are_the_blended_keytimes(catalog):
    evaluator = catalog.entry("arm3").evaluator
    row = evaluator.verb.values[2:3]
    events = sequence.events(evaluator, sequence.sequence(evaluator, row, 30.0, method="rbf"))
    assert [event.name for event in events] == list(evaluator.verb.keytime_names)
    np.testing.assert_allclose([event.time_s for event in events], evaluator.verb.keytimes[2], atol=1e-9)


async def test_binary_frames_equal_json_and_the_last_is_flagged(client):
    reply = (await post(client, adverbs=ARM)).json()
    answer = await post(client, adverbs=ARM, headers={"Accept": "application/octet-stream"})
    records = records_of(answer.content, 4)
    np.testing.assert_array_equal(records["rotations"], np.float32(reply["rotations"]))
    np.testing.assert_array_equal(records["time"], np.float32(reply["times"]))
    assert records["flags"].tolist() == [0] * (reply["frames"] - 1) + [wire.LAST]
    assert not records["channel"].any()


async def test_bvh_reads_back_as_the_same_motion(client, catalog):
    answer = await post(client, verb="sway", adverbs=SWAY, cycles=2, headers={"Accept": "text/x-bvh"})
    assert answer.headers["content-type"] == "text/x-bvh; charset=utf-8"
    motion = bvh.parse(answer.text)
    reply = (await post(client, verb="sway", adverbs=SWAY, cycles=2)).json()
    assert motion.skeleton.names == catalog.entry("sway").verb.skeleton.names
    np.testing.assert_allclose(motion.root, reply["root"], atol=2e-6)
    signs = np.sign((motion.rotations * reply["rotations"]).sum(axis=-1, keepdims=True))
    np.testing.assert_allclose(motion.rotations * signs, reply["rotations"], atol=1e-6)


async def test_too_many_frames_are_refused_with_the_limit(catalog):
    async with client_of(app_of(catalog, max_sequence_frames=20)) as client:
        track = [{"time": 0, "adverbs": ARM}]
        for body in ({"adverbs": ARM}, {"track": track}):
            answer = await client.post("/v1/verbs/arm3/sequence", json=body)
            assert answer.status_code == 422
            assert "20" in answer.json()["detail"]


@pytest.mark.parametrize(("media_type", "form"), FILES.items())
async def test_a_file_of_some_joints_is_refused(media_type, form, client):
    for option in ({"joints": ["Tip"]}, {"space": "global"}):
        answer = await client.post(
            "/v1/verbs/arm3/sequence", json={"adverbs": ARM, **option}, headers={"Accept": media_type}
        )
        assert answer.status_code == 422
        assert f"a {form} file holds all joints" in answer.json()["detail"]


@pytest.mark.parametrize("media_type", ["text/x-bvh", "model/gltf-binary", "application/x-npz"])
@pytest.mark.parametrize("track", [False, True])
async def test_each_file_reads_back_as_the_json_motion(media_type, track, client, tmp_path):
    form = FILES[media_type]
    body = {"track": [{"time": k / 2, "adverbs": row} for k, row in enumerate(ENDS)]} if track else {"adverbs": ARM}
    answer = await post(client, **body, headers={"Accept": media_type})
    assert answer.headers["content-type"].split(";")[0] == media_type
    assert answer.headers["content-disposition"] == f'attachment; filename="arm3.{form}"'
    (tmp_path / f"a.{form}").write_bytes(answer.content)
    motion = motion_files.read(tmp_path / f"a.{form}").motion
    reply = (await post(client, **body)).json()
    assert (motion.fps, len(motion)) == (30.0, reply["frames"])
    np.testing.assert_allclose(motion.root, reply["root"], atol=1e-6)
    np.testing.assert_allclose(np.abs((motion.rotations * reply["rotations"]).sum(axis=-1)), 1.0, atol=1e-6)


async def test_a_glb_has_a_body_on_request_and_names_its_verb(client, catalog):
    plain = await post(client, adverbs=ARM, headers={"Accept": "model/gltf-binary"})
    shown = await post(client, adverbs=ARM, mannequin=True, headers={"Accept": "model/gltf-binary"})
    assert b'"meshes"' not in plain.content
    assert b'"meshes"' in shown.content
    (length,) = struct.unpack_from("<I", plain.content, 12)
    extras = json.loads(plain.content[20 : 20 + length])["asset"]["extras"]
    assert extras == {"verb": "arm3", "version": catalog.entry("arm3").version, "adverbs": ARM, "fps": 30.0}


async def test_a_vrm_animation_of_no_humanoid_is_refused_with_the_bones_it_lacks(client):
    answer = await client.post(
        "/v1/verbs/arm3/sequence", json={"adverbs": ARM}, headers={"Accept": "application/x-vrma"}
    )
    assert answer.status_code == 422
    assert "no joint for hips (Hips), spine (Spine)" in answer.json()["detail"]


async def test_a_vrm_animation_of_a_humanoid(client):
    goal = {"x": -0.3, "y": 1.2, "z": 0.4}
    answer = await post(client, verb="reach", adverbs=goal, headers={"Accept": "application/x-vrma"})
    assert answer.headers["content-disposition"] == 'attachment; filename="reach.vrma"'
    assert b'"VRMC_vrm_animation":{"specVersion":"1.0"' in answer.content


def test_a_sequence_checks_its_numbers(catalog):
    arm = catalog.entry("arm3").evaluator
    row = arm.verb.values[:1]
    with pytest.raises(OutOfRange, match="between 1 and 240"):
        sequence.sequence(arm, row, 500.0)
    with pytest.raises(OutOfRange, match="between 1 and 100"):
        sequence.sequence(catalog.entry("sway").evaluator, np.full((1, 2), 0.5), 30.0, cycles=1_000)
    with pytest.raises(RequestError, match="does not loop"):
        sequence.sequence(arm, row, 30.0, cycles=2)
    with pytest.raises(OutOfRange, match="one set of adverbs"):
        sequence.sequence(arm, arm.verb.values[:2], 30.0)
    with pytest.raises(OutOfRange, match="rise"):
        sequence.tracked(arm, np.array([1.0, 0.5]), arm.verb.values[:2], 30.0)
    with pytest.raises(OutOfRange, match="a time for each"):
        sequence.tracked(arm, np.array([1.0]), arm.verb.values[:2], 30.0)
