"""Directions of motions from their geometry: any file axes, any local axes, names or none."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.verbs import clip_files
from verbs.clips import orientation
from verbs.errors import OutOfRange
from verbs.io import bvh
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton


def turned(motion: Motion, turn: np.ndarray) -> Motion:
    """The motion rotated in the world by a quaternion."""
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(turn, motion.root), rotations)


def places(motion: Motion) -> np.ndarray:
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def renamed(motion: Motion, names: list[str]) -> Motion:
    return replace(motion, skeleton=replace(motion.skeleton, names=tuple(names)))


def random_axes(seed: int, count: int = len(clip_files.BODY)) -> np.ndarray:
    return quat.normalize(np.random.default_rng(seed).normal(size=(count, 4)))


@pytest.mark.parametrize("way", [{"speed": 1.2}, {"speed": 0.0}, {"speed": -1.0}, {"speed": 0.3, "side": 1.0}])
def test_a_body_that_faces_z_is_found_whichever_way_it_walks(way):
    found = orientation.find(clip_files.walk(**way))
    assert found.text == "+Y up, +Z forward"
    assert found.confidence > 0.8
    np.testing.assert_array_equal(found.left, [1, 0, 0])
    assert found.evidence[1].startswith("+Z forward: 'LeftArm' and 'RightArm', 'LeftUpLeg' and 'RightUpLeg': ")


@pytest.mark.parametrize("index", range(24))
def test_any_axes_of_the_file_are_found_and_converted(index):
    motion, turn = clip_files.walk(), orientation._CUBE[index]
    found = orientation.find(turned(motion, turn))
    np.testing.assert_allclose(found.up, quat.rotate(turn, np.array([0.0, 1, 0])), atol=1e-12)
    np.testing.assert_allclose(found.forward, quat.rotate(turn, np.array([0.0, 0, 1])), atol=1e-12)
    back = orientation.convert(turned(motion, turn))
    np.testing.assert_allclose(places(back), places(motion), atol=1e-9)
    stated = orientation.convert(
        turned(motion, turn), up=orientation.axis_name(found.up), forward=orientation.axis_name(found.forward)
    )
    np.testing.assert_array_equal(stated.rotations, back.rotations)


@pytest.mark.parametrize("seed", range(5))
def test_local_axes_have_no_effect(seed):
    motion = clip_files.walk(turn=0.4)
    found = orientation.find(clip_files.rerigged(motion, random_axes(seed)))
    plain = orientation.find(motion)
    assert (found.text, found.evidence) == (plain.text, plain.evidence)
    np.testing.assert_allclose(found.facing, plain.facing, atol=1e-9)
    assert found.confidence == pytest.approx(plain.confidence)


def test_the_exact_direction_at_the_first_frame_is_kept_beside_the_axis():
    found = orientation.find(turned(clip_files.walk(), quat.exp(np.array([0.0, 0.35, 0.0]))))
    assert found.text == "+Y up, +Z forward"
    assert np.arctan2(found.facing[0], found.facing[2]) == pytest.approx(0.35, abs=0.1)


def test_a_clip_that_faces_backwards_is_seen():
    found = orientation.find(turned(clip_files.walk(), quat.exp(np.array([0.0, np.pi, 0.0]))))
    assert found.text == "+Y up, -Z forward"
    assert found.evidence[-1] == "the way from start to end: 0° from -Z"


def test_without_names_equal_limbs_and_travel_show_the_direction():
    motion = renamed(clip_files.walk(), [f"joint{k}" for k in range(len(clip_files.BODY))])
    found = orientation.find(motion, up="+Y")
    assert found.text == "+Y up, +Z forward"
    assert "equal limbs" in found.evidence[1]


def test_sides_that_contradict_the_feet_lower_the_confidence():
    swap = {"Left": "Right", "Right": "Left"}
    names = [
        name.replace(word, swap[word])
        for name, *_ in clip_files.BODY
        for word in ["Left" if "Left" in name else "Right"]
    ]
    found = orientation.find(renamed(clip_files.walk(), names))
    assert found.confidence < 0.2


def test_a_chain_without_sides_has_no_confidence():
    skeleton = Skeleton(("a", "b"), np.array([-1, 0]), np.array([[0.0, 0, 0], [0, 1, 0]]))
    found = orientation.find(Motion(skeleton, 30.0, np.zeros((2, 3)), np.tile([0.0, 0, 0, 1], (2, 2, 1))))
    assert (found.text, found.confidence) == ("+Y up, +Z forward", 0.0)
    assert found.evidence[1] == "+Z forward: nothing shows it"


def test_stated_directions_are_taken_as_they_are():
    motion = clip_files.walk()
    found = orientation.find(motion, up="+Y", forward="-X")
    assert found.text == "+Y up, -X forward"
    assert found.evidence[:2] == ("+Y up as stated", "-X forward as stated")
    for up, forward in (("+Y", "-Y"), ("+Z", "+Z")):
        with pytest.raises(OutOfRange, match="they must lie on two axes"):
            orientation.find(motion, up=up, forward=forward)
        with pytest.raises(OutOfRange, match="they must lie on two axes"):
            orientation.convert(motion, up=up, forward=forward)
    with pytest.raises(OutOfRange, match=r"up is 'Y'; known: \+X, \+Y"):
        orientation.find(motion, up="Y")


def test_captures_face_forward(mocap):
    for path in itertools.chain.from_iterable(sorted(mocap.glob(f"*/*{k}.bvh")) for k in ("Near", "Low", "Walk", "Lf")):
        found = orientation.find(bvh.read(path))
        assert found.text == "+Y up, +Z forward", path.name
        assert found.confidence > 0.7, path.name


@pytest.mark.parametrize("index", range(24))
def test_the_frame_of_a_root_follows_its_local_axes(index):
    """Axes that are turned by right angles are found exactly, although the hips lean."""
    motion, axes = clip_files.walk(), np.tile(orientation._CUBE[index], (len(clip_files.BODY), 1))
    rig = clip_files.rerigged(motion, axes)
    frame = orientation.root_frame(rig.skeleton, rig.rotations[3])
    np.testing.assert_allclose(np.abs(frame @ orientation._CUBE[index]), 1.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("heading", [-2.0, 0.0, 0.7])
def test_the_frame_of_a_root_gives_its_heading_whatever_its_axes(seed, heading):
    motion = turned(clip_files.walk(), quat.exp(np.array([0.0, heading, 0.0])))
    rig = clip_files.rerigged(motion, random_axes(seed))
    relative = quat.mul(rig.rotations[:, 0], quat.conjugate(orientation.root_frame(rig.skeleton, rig.rotations[0])))
    found = 2.0 * np.arctan2(relative[:, 1], relative[:, 3])
    plain = 2.0 * np.arctan2(motion.rotations[:, 0, 1], motion.rotations[:, 0, 3])
    assert np.abs(np.sin(0.5 * (found - plain))).max() < 0.02
