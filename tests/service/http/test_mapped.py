"""Poses on other skeletons: the option ``map`` of pose, poses and sequence."""

import numpy as np
import pytest

from tests.service.conftest import ARM
from tests.service.records import records_of
from verbs.io import motion_files
from verbs.kernels import fk
from verbs.mapping.mapper import Mapper
from verbs.mapping.mapping import of_preset
from verbs.mapping.presets import PRESETS, preset

pytestmark = pytest.mark.anyio

GOAL = {"x": -0.3, "y": 1.2, "z": 0.4}
OCTETS = {"Accept": "application/octet-stream"}


async def post(client, verb="reach", route="pose", headers=None, **body):
    answer = await client.post(f"/v1/verbs/{verb}/{route}", json=body, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer


@pytest.mark.parametrize("name", PRESETS)
async def test_a_pose_has_the_joints_of_the_skeleton_and_both_figures(client, catalog, name):
    reply = (await post(client, adverbs=GOAL, phase=0.5, map=name, space="global")).json()
    skeleton = preset(name).skeleton
    assert reply["map"]["joints"] == list(skeleton.names)
    assert (reply["map"]["name"], reply["map"]["goal"]) == (name, "scaled")
    assert len(reply["rotations"]) == len(reply["positions"]) == len(skeleton)
    assert reply["figures"]["effector_m"] < 1e-3
    assert reply["figures"]["foot_slide_m"] < 1e-3
    evaluator = catalog.entry("reach").evaluator
    mapper = Mapper.of_verb(evaluator, of_preset(name))
    wanted = mapper.poses(evaluator.pose(GOAL, phase=0.5))
    places = fk.forward(wanted.root, wanted.rotations, skeleton.parents, skeleton.offsets)[1]
    np.testing.assert_allclose(reply["positions"], places[0], atol=1e-6)


async def test_without_a_map_nothing_of_it_is_returned(client):
    reply = (await post(client, adverbs=GOAL, phase=0.5)).json()
    assert not {"map", "figures"} & set(reply)


async def test_a_world_goal_is_where_the_verb_has_its_effector(client):
    verb = (await client.get("/v1/verbs/reach")).json()
    keytime = dict(zip(verb["keytime_names"], verb["keytime_phases"], strict=True))[verb["measure"]["keytime"]]
    request = {"adverbs": GOAL, "phase": keytime, "space": "global"}
    plain = (await post(client, **request)).json()
    wanted = plain["positions"][verb["skeleton"]["names"].index(verb["measure"]["effector"])]
    found = (await post(client, **request, map="unreal", map_goal="world", joints=["hand_r", "hand_l"])).json()
    assert found["map"]["joints"] == ["hand_r", "hand_l"]
    np.testing.assert_allclose(found["positions"][0], wanted, atol=1e-3)


async def test_many_poses_name_the_joints_once(client):
    items = [{"adverbs": GOAL, "phase": phase} for phase in (0.1, 0.5, 0.9)]
    reply = (await post(client, route="poses", items=items, map="smpl")).json()
    assert reply["map"]["joints"] == list(preset("smpl").skeleton.names)
    one = (await post(client, adverbs=GOAL, phase=0.5, map="smpl")).json()
    assert "map" not in reply["poses"][1]
    assert reply["poses"][1]["rotations"] == one["rotations"]
    assert reply["poses"][1]["figures"] == pytest.approx(one["figures"])


async def test_binary_rows_and_records(client):
    rows = np.array([[-0.3, 1.2, 0.4, 0.5]], "<f4").tobytes()
    headers = OCTETS | {"Content-Type": "application/octet-stream"}
    answer = await client.post("/v1/verbs/reach/poses?map=mixamo", content=rows, headers=headers)
    assert answer.status_code == 200, answer.text
    (record,) = records_of(answer.content, len(preset("mixamo").skeleton))
    one = (await post(client, adverbs=GOAL, phase=0.5, map="mixamo")).json()
    np.testing.assert_allclose(record["rotations"], one["rotations"], atol=1e-5)


async def test_a_motion_and_its_file_are_on_the_skeleton(client, tmp_path):
    reply = (await post(client, route="sequence", adverbs=GOAL, fps=30, map="vrm")).json()
    assert reply["map"]["joints"] == list(preset("vrm").skeleton.names)
    assert reply["figures"]["foot_slide_m"] < 2e-3
    assert np.shape(reply["rotations"]) == (reply["frames"], len(preset("vrm").skeleton), 4)
    file = await post(
        client, route="sequence", adverbs=GOAL, fps=30, map="vrm", headers={"Accept": "model/gltf-binary"}
    )
    (tmp_path / "reach.glb").write_bytes(file.content)
    motion = motion_files.read(tmp_path / "reach.glb").motion
    assert motion.skeleton.names == preset("vrm").skeleton.names
    np.testing.assert_allclose(motion.root, reply["root"], atol=1e-5)


@pytest.mark.parametrize("name", PRESETS)
async def test_a_vrm_animation_of_a_skeleton_has_its_bones(client, name):
    headers = {"Accept": "application/x-vrma"}
    file = await post(client, route="sequence", adverbs=GOAL, fps=30, map=name, headers=headers)
    assert b'"leftUpperArm":{"node":' in file.content
    assert preset(name).skeleton.names[preset(name).roles.bones["leftUpperArm"]].encode() in file.content


async def test_a_track_is_mapped_frame_by_frame(client):
    track = [{"time": 0, "adverbs": GOAL}, {"time": 1, "adverbs": GOAL | {"y": 1.0}}]
    reply = (await post(client, route="sequence", track=track, fps=30, map="unreal")).json()
    assert reply["figures"]["effector_m"] < 1e-3


async def test_unknown_maps_name_the_known_ones(client):
    answer = await client.post("/v1/verbs/reach/pose", json={"adverbs": GOAL, "map": "robot"})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, "unknown_map")
    assert problem["known"] == list(PRESETS)
    answer = await client.post("/v1/verbs/reach/pose", json={"adverbs": GOAL, "map": "vrm", "joints": ["Hips"]})
    assert (answer.status_code, answer.json()["code"]) == (422, "unknown_joint")
    answer = await client.post("/v1/verbs/reach/pose", json={"adverbs": GOAL, "map": "vrm", "map_goal": "moon"})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


async def test_a_verb_without_a_humanoid_cannot_be_mapped(client):
    answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": ARM, "map": "vrm"})
    assert (answer.status_code, answer.json()["code"]) == (422, "bad_request")
    assert "mapping.toml" in answer.json()["detail"]


async def test_a_travelling_root_is_scaled(client):
    verb = (await client.get("/v1/verbs/locomotion")).json()
    middle = {adverb["name"]: 0.5 * (adverb["min"] + adverb["max"]) for adverb in verb["adverbs"]}
    plain = (await post(client, verb="locomotion", adverbs=middle, phase=0.3)).json()
    found = (await post(client, verb="locomotion", adverbs=middle, phase=0.3, map="smpl")).json()
    scale = found["map"]["scale"]
    np.testing.assert_allclose(
        found["root_velocity"], np.array(plain["root_velocity"]) * [scale, scale, 1.0], rtol=1e-5
    )
    assert found["figures"]["effector_m"] is None
