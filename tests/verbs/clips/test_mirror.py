from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verbs import broken_clips as broken
from verbs.clips import mends
from verbs.clips.mirror import mirror
from verbs.clips.pairs import find_pairs, mirrored_name
from verbs.clips.reports import Mend
from verbs.errors import OutOfRange, UnknownName
from verbs.io import bvh
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

SIDES = np.array([-1.0, 1.0, 1.0])


def expected(motion, partner):
    """Joint positions of the mirror image."""
    return broken.positions(motion)[:, partner] * SIDES


def is_mirrored(motion, tolerance=1e-9, table=None):
    done = mirror(motion, table)
    away = broken.positions(done.motion) - expected(motion, find_pairs(motion.skeleton, table).partner)
    return np.abs(away).max() < tolerance


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("LeftHand", "RightHand"), ("hand_left", "hand_right"), ("leftArm", "rightArm"), ("l_wrist", "r_wrist"),
        ("wrist_r", "wrist_l"), ("hand.L", "hand.R"), ("L Hand", "R Hand"), ("Bip01 L Thigh", "Bip01 R Thigh"),
        ("mixamorig:LeftFoot", "mixamorig:RightFoot"), ("LThumb1", "RThumb1"), ("JtWristLf", "JtWristRt"),
        ("thigh.l.001", "thigh.r.001"), ("LEFT_KNEE", "RIGHT_KNEE"), ("handL", "handR"),
        ("Spine", None), ("Hips", None), ("Collar", None), ("Root", None), ("lowerback", None), ("Belly", None),
        ("Roll", None), ("upright", None),
    ],
)  # fmt: skip
def test_names_show_the_side(name, other):
    assert mirrored_name(name) == other
    if other is not None:
        assert mirrored_name(other) == name


@pytest.mark.parametrize("verb", ["reach", "walk", "jump"])
def test_positions_are_mirrored(verb):
    assert is_mirrored(broken.clean(verb))
    assert mirror(broken.clean(verb)).unmatched == ()


def test_a_captured_reach_is_the_left_one(mocap):
    folder = mocap / "reach_left"
    for file in sorted((mocap / "reach").glob("*.bvh")):
        swapped = file.name.replace("Left", "#").replace("Right", "Left").replace("#", "Right")
        other = bvh.read(folder / f"L{swapped}")
        assert broken.apart_m(mirror(bvh.read(file)).motion, other) < 1e-3, file


def test_captured_left_jumps_are_the_right_ones(mocap):
    files = sorted((mocap / "jump").glob("JumpLeft*.bvh"))
    pairs = [(file, file.with_name(file.name.replace("Left", "Right"))) for file in files]
    pairs = [pair for pair in pairs if pair[1].exists()]
    assert len(pairs) == 9
    for left, right in pairs:
        assert broken.apart_m(mirror(bvh.read(left)).motion, bvh.read(right)) < 1e-3


def test_every_captured_clip_is_mirrored_exactly(mocap):
    for folder in ("punch", "kick", "locomotion"):
        for file in sorted((mocap / folder).glob("*.bvh")):
            assert is_mirrored(bvh.read(file)), file


def with_frames(motion, frames):
    """The same joint positions with other local frames: a constant rotation (J, 4) of each joint's frame."""
    own = motion.skeleton
    parents = own.parents
    offsets, rotations = own.offsets.copy(), quat.mul(motion.rotations, frames)
    for joint in range(1, len(own)):
        back = quat.conjugate(frames[parents[joint]])
        offsets[joint] = quat.rotate(back, offsets[joint])
        rotations[:, joint] = quat.mul(back, rotations[:, joint])
    tips = quat.rotate(quat.conjugate(frames[own.tip_parents]), own.tip_offsets)
    return Motion(Skeleton(own.names, parents, offsets, own.tip_parents, tips), motion.fps, motion.root, rotations)


@given(st.integers(0, 10_000))
def test_local_frames_need_not_be_mirror_images(seed):
    motion = broken.clean()
    rng = np.random.default_rng(seed)
    frames = quat.normalize(rng.standard_normal((len(motion.skeleton), 4)))
    odd = with_frames(motion, frames)
    assert np.abs(broken.positions(odd) - broken.positions(motion)).max() < 1e-9
    assert is_mirrored(odd)
    again = mirror(mirror(odd).motion).motion
    assert broken.apart_deg(again, odd) < 1e-5
    assert np.array_equal(again.root, odd.root)


def test_bones_along_the_same_local_axis_on_both_sides():
    """Rigs whose right arm has the frame of the left one: offsets are equal, not mirrored."""
    motion = broken.clean()
    names = motion.skeleton.names
    frames = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1))
    for name in ("RightArm", "RightForeArm", "RightHand"):
        frames[names.index(name)] = [0.0, 0.0, 1.0, 0.0]
    assert is_mirrored(with_frames(motion, frames))


@given(st.integers(0, 10_000), st.floats(-3.0, 3.0))
def test_mirroring_twice_is_the_identity(seed, x):
    rng = np.random.default_rng(seed)
    body = broken.clean().skeleton
    rotations = quat.normalize(rng.standard_normal((2, len(body), 4)))
    motion = Motion(body, 30.0, np.array([[x, 1.0, 0.2], [0.0, 1.0, x]]), rotations)
    assert is_mirrored(motion)
    again = mirror(mirror(motion).motion).motion
    assert broken.apart_deg(again, motion) < 1e-5
    assert np.array_equal(again.root, motion.root)


def test_other_bones_on_the_other_side_are_reported():
    motion = broken.scaled(broken.clean(), 1.0, joints={"RightForeArm": 1.1})
    done = mirror(motion)
    length = np.linalg.norm(broken.clean().skeleton.offsets[motion.skeleton.index("RightForeArm")])
    assert {name for name, _ in done.bones} == {"LeftForeArm", "RightForeArm"}
    assert done.bones[0][1] == pytest.approx(0.1 * length)
    assert broken.apart_deg(mirror(done.motion).motion, motion) < 1e-5


def renamed(motion, names):
    own = motion.skeleton
    new = tuple(names.get(name, name) for name in own.names)
    return Motion(replace(own, names=new), motion.fps, motion.root, motion.rotations)


def test_odd_names_are_paired_by_a_table():
    odd = renamed(broken.clean(), {"LeftHand": "Paw_A", "RightHand": "Paw_B", "LeftToeBase": "LeftTip"})
    with pytest.raises(OutOfRange, match="are no pair; name the pairs in a table"):
        mirror(odd)
    table = {"Paw_A": "Paw_B", "RightToeBase": "LeftTip"}
    assert is_mirrored(odd, table=table)
    with pytest.raises(UnknownName, match="unknown joint 'Paw_C'"):
        mirror(odd, {"Paw_A": "Paw_C"})
    with pytest.raises(OutOfRange, match="has two partners"):
        mirror(odd, {"Paw_A": "Paw_B", "LeftTip": "Paw_B"})


def test_joints_without_a_partner_are_reported():
    """A hook on the left hand, a stump on the right: both follow their hands, and the rest is mirrored exactly."""
    clean = broken.clean()
    names = clean.skeleton.names
    leaves = [name for k, name in enumerate(names) if name.startswith("Left") and k not in clean.skeleton.parents]
    odd = renamed(clean, {leaves[0]: "LeftHook", leaves[0].replace("Left", "Right"): "Stump"})
    done = mirror(odd)
    assert done.unmatched == ("LeftHook", "Stump")
    rest = [k for k, name in enumerate(odd.skeleton.names) if name not in done.unmatched]
    away = broken.positions(done.motion) - expected(odd, find_pairs(odd.skeleton).partner)
    assert np.abs(away[:, rest]).max() < 1e-9
    assert broken.apart_deg(mirror(done.motion).motion, odd) < 1e-5


def test_a_clip_is_mirrored_as_a_mend():
    clean = broken.clean()
    done = mends.apply(clean, [Mend("mirror")])
    assert broken.apart_m(done.motion, mirror(clean).motion) == 0.0
    assert done.reports[0].done == "mirrored"
    assert mends.find(clean, ["mirror"]) == []
