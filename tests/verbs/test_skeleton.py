from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from verbs.conventions import MAX_JOINTS
from verbs.errors import SkeletonMismatch, UnknownName
from verbs.skeleton import Skeleton

NAMES = ("Hips", "Spine", "Head", "LeftLeg", "LeftFoot")
PARENTS = np.array([-1, 0, 1, 0, 3])
OFFSETS = np.array([[0, 0, 0], [0, 0.2, 0], [0, 0.5, 0], [0.1, -0.1, 0], [0, -0.8, 0]], float)


def skeleton(names=NAMES, parents=PARENTS, offsets=OFFSETS, **tips) -> Skeleton:
    return Skeleton(names, parents, offsets, **tips)


def test_a_skeleton_counts_its_joints_and_finds_them_by_name():
    assert len(skeleton()) == 5
    assert [skeleton().index(name) for name in NAMES] == [0, 1, 2, 3, 4]


def test_an_unknown_joint_lists_the_known_ones():
    with pytest.raises(
        UnknownName, match="unknown joint 'Tail'; known: Hips, Spine, Head, LeftLeg, LeftFoot"
    ) as caught:
        skeleton().index("Tail")
    assert caught.value.kind == "joint"
    assert caught.value.known == NAMES


def test_a_chain_runs_from_the_root_to_the_joint():
    np.testing.assert_array_equal(skeleton().chain(4), [0, 3, 4])
    np.testing.assert_array_equal(skeleton().chain(0), [0])
    assert skeleton().chain(2).dtype == np.int64


def test_tips_are_optional():
    assert skeleton().tip_parents.shape == (0,)
    assert skeleton().tip_offsets.shape == (0, 3)
    tipped = skeleton(tip_parents=np.array([2, 4]), tip_offsets=np.ones((2, 3)))
    assert tipped.tip_offsets.shape == (2, 3)


def test_a_skeleton_is_frozen_and_survives_pickling():
    with pytest.raises(dataclasses.FrozenInstanceError):
        skeleton().names = ()
    assert skeleton().difference(pickle.loads(pickle.dumps(skeleton()))) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": (), "parents": PARENTS[:0], "offsets": OFFSETS[:0]}, "1 to 1000 joints, not 0"),
        ({"names": NAMES[:4]}, r"4 joint names, but parents \(5,\) and offsets \(5, 3\)"),
        ({"offsets": OFFSETS[:, :2]}, r"offsets \(5, 2\)"),
        ({"names": ("Hips", "Spine", "Head", "Spine", "LeftFoot")}, "'Spine' stands twice"),
        ({"parents": np.array([-1, 2, 1, 0, 3])}, "parent must stand before it"),
        ({"parents": np.array([-1, 0, 1, -1, 3])}, "only the first is a root"),
        ({"parents": np.array([0, 0, 1, 0, 3])}, "only the first is a root"),
        ({"parents": np.array([-1, 0, 1, 3, 3])}, "parent must stand before it"),
        ({"offsets": OFFSETS * np.nan}, "an offset is not finite"),
        ({"tip_parents": np.array([1]), "tip_offsets": np.zeros((2, 3))}, "differ in length"),
        ({"tip_parents": np.array([5]), "tip_offsets": np.zeros((1, 3))}, "does not exist"),
        ({"tip_parents": np.array([-1]), "tip_offsets": np.zeros((1, 3))}, "does not exist"),
        ({"tip_parents": np.array([1]), "tip_offsets": np.full((1, 3), np.inf)}, "an offset is not finite"),
    ],
)
def test_a_wrong_skeleton_says_what_is_wrong(arguments, message):
    with pytest.raises(SkeletonMismatch, match=message):
        skeleton(**arguments)


def test_too_many_joints_are_refused():
    count = MAX_JOINTS + 1
    with pytest.raises(SkeletonMismatch, match=f"not {count}"):
        Skeleton(tuple(map(str, range(count))), np.arange(count) - 1, np.zeros((count, 3)))


def test_a_skeleton_does_not_differ_from_itself_or_from_its_rounding():
    assert skeleton().difference(skeleton()) is None
    assert skeleton().difference(skeleton(offsets=OFFSETS + 9e-5)) is None


@pytest.mark.parametrize(
    ("arguments", "difference"),
    [
        ({"names": ("Hips", "Spine", "Head", "LeftLeg", "Toe")}, "lacks LeftFoot; adds Toe"),
        ({"names": NAMES[:4], "parents": PARENTS[:4], "offsets": OFFSETS[:4]}, "lacks LeftFoot"),
        ({"names": ("Hips", "Head", "Spine", "LeftLeg", "LeftFoot")}, "has the same joints in another order"),
        ({"parents": np.array([-1, 0, 1, 1, 3])}, "gives joint 'LeftLeg' another parent"),
        ({"offsets": OFFSETS * [1, 1.01, 1]}, "has joint 'LeftFoot' at an offset that differs by 8.0 mm"),
    ],
)
def test_a_difference_is_named(arguments, difference):
    assert skeleton().difference(skeleton(**arguments)) == difference


def test_the_tolerance_of_a_difference_is_an_argument():
    moved = skeleton(offsets=OFFSETS * [1, 1.01, 1])
    assert skeleton().difference(moved, tolerance_m=0.01) is None
