"""Motions written as .glb read back as the same motion."""

import json
import struct

import numpy as np
import pytest

from tests.verbs.gltf_files import random_rotations
from verbs import library
from verbs.errors import MotionFileError
from verbs.io import gltf, gltf_writer
from verbs.motion import Motion
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator
from verbs.skeleton import Skeleton

BUILT_IN = ("arm3", "reach", "walk")


def motion_of(name, fps=30.0):
    evaluator = Evaluator(library.load(name))
    row = evaluator.verb.values[:1]
    return sequence.to_motion(evaluator, sequence.sequence(evaluator, row, fps), fps)


def table_of(content):
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length])


def assert_same(found, motion):
    assert found.skeleton.names == motion.skeleton.names
    assert found.fps == motion.fps
    np.testing.assert_array_equal(found.skeleton.parents, motion.skeleton.parents)
    np.testing.assert_allclose(found.skeleton.offsets[1:], motion.skeleton.offsets[1:], atol=1e-6)
    np.testing.assert_allclose(found.root, motion.root, atol=1e-6)
    signs = np.sign((found.rotations * motion.rotations).sum(axis=-1, keepdims=True))
    np.testing.assert_allclose(found.rotations * signs, motion.rotations, atol=1e-6)


@pytest.mark.parametrize("mannequin", [True, False])
@pytest.mark.parametrize("name", BUILT_IN)
def test_a_motion_reads_back_as_it_was(name, mannequin, tmp_path):
    motion = motion_of(name)
    (tmp_path / "a.glb").write_bytes(gltf_writer.dump(motion, mannequin=mannequin))
    found = gltf.read_file(tmp_path / "a.glb").motion
    assert_same(found, motion)
    np.testing.assert_array_equal(found.skeleton.tip_parents, motion.skeleton.tip_parents)
    np.testing.assert_allclose(found.skeleton.tip_offsets, motion.skeleton.tip_offsets, atol=1e-6)


@pytest.mark.parametrize("fps", [24.0, 60.0, 120.0])
def test_a_rate_reads_back(fps, tmp_path):
    motion = motion_of("arm3", fps)
    (tmp_path / "a.glb").write_bytes(gltf_writer.dump(motion))
    assert_same(gltf.read_file(tmp_path / "a.glb").motion, motion)


def test_signs_of_quaternions_do_not_jump(tmp_path):
    motion = motion_of("reach")
    flips = np.where(np.random.default_rng(1).random((len(motion), len(motion.skeleton), 1)) < 0.5, -1.0, 1.0)
    flipped = Motion(motion.skeleton, motion.fps, motion.root, motion.rotations * flips)
    content = gltf_writer.dump(flipped, mannequin=False)
    table = table_of(content)
    binary = content[12 + 8 + struct.unpack_from("<I", content, 12)[0] + 8 :]
    rotations = [s for s, c in enumerate(table["animations"][0]["channels"]) if c["target"]["path"] == "rotation"]
    assert len(rotations) == len(motion.skeleton)
    for sampler in rotations:
        row = table["accessors"][table["animations"][0]["samplers"][sampler]["output"]]
        view = table["bufferViews"][row["bufferView"]]
        keys = np.frombuffer(binary, "<f4", 4 * row["count"], view["byteOffset"]).reshape(-1, 4)
        assert ((keys[1:] * keys[:-1]).sum(axis=1) > 0.0).all()


def test_equal_motions_give_equal_bytes_and_extras_are_kept():
    motion = motion_of("arm3")
    content = gltf_writer.dump(motion, extras={"verb": "arm3", "version": 3, "adverbs": {"x": 0.25}})
    assert content == gltf_writer.dump(motion, extras={"verb": "arm3", "version": 3, "adverbs": {"x": 0.25}})
    extras = table_of(content)["asset"]["extras"]
    assert extras == {"verb": "arm3", "version": 3, "adverbs": {"x": 0.25}, "fps": 30.0}


def test_a_frame_of_one_joint_is_a_file(tmp_path):
    motion = Motion(Skeleton(("a",), np.array([-1]), np.zeros((1, 3))), 60.0, np.ones((1, 3)), np.eye(4)[None, 3:])
    (tmp_path / "a.glb").write_bytes(gltf_writer.dump(motion))
    assert_same(gltf.read_file(tmp_path / "a.glb").motion, motion)


def test_a_chain_of_many_joints_has_wide_indices(tmp_path):
    count = 300
    skeleton = Skeleton(
        tuple(f"joint {k}" for k in range(count)), np.arange(count) - 1, np.eye(3)[np.arange(count) % 3] * 0.1
    )
    rotations = random_rotations(np.random.default_rng(2), 2 * count).reshape(2, count, 4)
    motion = Motion(skeleton, 30.0, np.zeros((2, 3)), rotations)
    content = gltf_writer.dump(motion)
    table = table_of(content)
    joints = table["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"]
    assert table["accessors"][joints]["componentType"] == 5123
    (tmp_path / "a.glb").write_bytes(content)
    assert_same(gltf.read_file(tmp_path / "a.glb").motion, motion)


def test_the_rest_pose_stands_on_the_ground():
    table = table_of(gltf_writer.dump(motion_of("reach")))
    (mesh,) = table["meshes"]
    row = table["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]
    assert abs(row["min"][1]) < 0.06  # the soles are as thick as the mesh
    assert 1.5 < row["max"][1] < 2.0
    assert row["max"][0] == pytest.approx(-row["min"][0], abs=1e-6)


def test_half_a_surrogate_is_refused():
    skeleton = Skeleton(("\ud800",), np.array([-1]), np.zeros((1, 3)))
    motion = Motion(skeleton, 60.0, np.zeros((1, 3)), np.eye(4)[None, 3:])
    with pytest.raises(MotionFileError, match="joint name"):
        gltf_writer.dump(motion)
