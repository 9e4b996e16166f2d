import numpy as np
import pytest

from tests.verbs import broken_clips as broken
from verbs.clips.feet import feet, point_positions
from verbs.clips.retarget import bone_reports, retarget
from verbs.errors import SkeletonMismatch
from verbs.kernels import fk
from verbs.skeleton import Skeleton


def rotations_of(motion):
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[0]


def soles(motion):
    """Lowest points (F, feet, 3) of the feet."""
    turns, places = rotations_of(motion), broken.positions(motion)
    ends = [foot[-1] for foot in feet(motion.skeleton, turns, places)]
    return np.stack([point_positions(turns, places, end.joint, end.offset) for end in ends], axis=1)


@pytest.mark.parametrize("factor", [0.85, 1.1])
@pytest.mark.parametrize("verb", ["reach", "punch", "jump"])
def test_effector_and_soles_are_kept(verb, factor):
    clean = broken.clean(verb)
    other = broken.scaled(clean, factor).skeleton
    effector = clean.skeleton.index("RightHand")
    done = retarget(clean, other, effector=effector)
    assert done.motion.skeleton is other
    assert done.scale == pytest.approx(factor, abs=1e-9)
    old, new = broken.positions(clean), broken.positions(done.motion)
    away = np.linalg.norm(old[:, effector] - new[:, effector], axis=1)
    assert away.max() == pytest.approx(done.effector_m, abs=1e-9)
    chain = other.chain(effector)
    length = np.linalg.norm(other.offsets[chain[2:]], axis=1).sum()
    in_reach = np.linalg.norm(old[:, effector] - new[:, chain[1]], axis=1) < 0.97 * length
    assert in_reach.mean() > 0.4
    assert away[in_reach].max() < 1e-3
    assert done.feet_m < 1e-3
    assert np.abs(soles(done.motion) - soles(clean) * [1.0, factor, 1.0]).max() < 1e-3
    foot = clean.skeleton.index("LeftFoot")
    same = np.abs(np.sum(rotations_of(clean)[:, foot] * rotations_of(done.motion)[:, foot], axis=1))
    assert same.min() > 1 - 1e-9
    assert np.abs(new[:, 0] - old[:, 0] * [1.0, factor, 1.0])[:, [0, 2]].max() == 0.0


def test_without_planting_local_rotations_are_kept():
    clean = broken.clean("jump")
    plain = retarget(clean, broken.scaled(clean, 0.9).skeleton, plant=False)
    assert plain.feet_m == 0.0
    assert np.array_equal(plain.motion.rotations, clean.rotations)
    assert np.allclose(plain.motion.root, clean.root * [1.0, 0.9, 1.0], atol=1e-12)


def test_only_the_changed_bones_are_reported():
    clean = broken.clean()
    other = broken.scaled(clean, 1.0, joints={"RightForeArm": 1.2, "LeftLeg": 0.9})
    reports = bone_reports(other.skeleton, clean.skeleton)
    assert [report.mend.joint for report in reports] == ["RightForeArm", "LeftLeg"]
    length = np.linalg.norm(clean.skeleton.offsets[clean.skeleton.index("LeftLeg")])
    assert reports[1].figure == pytest.approx(100 * length)
    back = retarget(other, clean.skeleton, effector=clean.skeleton.index("RightHand"))
    assert back.effector_m < 1e-3


def test_a_goal_out_of_reach_is_stated():
    clean = broken.clean()
    tiny = broken.scaled(clean, 1.0, joints={"RightArm": 0.3, "RightForeArm": 0.2, "RightHand": 0.2})
    done = retarget(clean, tiny.skeleton, effector=clean.skeleton.index("RightHand"))
    assert done.effector_m > 0.02
    assert f"effector within {1000 * done.effector_m:.1f} mm" in done.report("a", []).done


def test_a_kicking_foot_is_kept_where_it_was():
    clean = broken.clean("kick")
    foot = clean.skeleton.index("RightFoot")
    done = retarget(clean, broken.scaled(clean, 1.05).skeleton, effector=foot)
    away = np.linalg.norm(broken.positions(clean)[:, foot] - broken.positions(done.motion)[:, foot], axis=1)
    assert away.max() < 1e-3


def test_the_motion_stays_smooth():
    clean = broken.clean("reach")
    done = retarget(clean, broken.scaled(clean, 0.9).skeleton, effector=clean.skeleton.index("RightHand"))

    def roughness(motion):
        path = broken.positions(motion)
        return np.abs(np.diff(path, 3, axis=0)).max()

    assert roughness(done.motion) < 3 * roughness(clean)


def test_other_joints_are_refused():
    clean = broken.clean()
    with pytest.raises(SkeletonMismatch, match="cannot retarget"):
        retarget(clean, Skeleton(("A",), np.array([-1]), np.zeros((1, 3))))


def test_captured_reaches_on_another_body(mocap):
    from verbs.io import bvh

    clean = bvh.read(mocap / "reach" / "ReachForwardHigh.bvh")
    other = bvh.read(mocap / "locomotion" / "Walk.bvh").skeleton
    effector = clean.skeleton.index("RightHand")
    done = retarget(clean, other, effector=effector)
    assert done.effector_m < 1e-3
    assert done.feet_m < 1e-3
