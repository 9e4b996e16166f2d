"""Motions on other skeletons: directions of limbs, feet on the ground, the effector on its goal, smoothness."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.verbs.mapping.rigs import remade, with_spine
from verbs import library
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.mapping.mapper import Figures, Mapper
from verbs.mapping.mapping import Mapping, of_preset
from verbs.mapping.plan import explicit_joints
from verbs.mapping.presets import PRESETS, preset
from verbs.mapping.rig import Rig
from verbs.motion import Motion
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator, Poses

FPS = 60.0
LIMBS = [
    (f"{side}{a}", f"{side}{b}")
    for side in ("left", "right")
    for a, b in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))
]
TARGETS = {
    "child": lambda: remade(preset("vrm"), scale=0.6),
    "giant": lambda: remade(preset("vrm"), scale=1.4),
    "long arms, short legs": lambda: remade(preset("vrm"), arms=1.2, legs=0.8),
    "A-pose and other axes": lambda: remade(preset("vrm"), roll=3, lowered=0.8),
    "one spine joint": lambda: with_spine(preset("mixamo"), 1),
    "five spine joints": lambda: with_spine(preset("mixamo"), 5),
}


@cache
def evaluator(name: str) -> Evaluator:
    return Evaluator(library.load(name))


def blends(name: str, count: int = 3) -> list[Poses]:
    verb, rng = evaluator(name).verb, np.random.default_rng(5)
    weights = rng.dirichlet(np.full(len(verb.values), 0.7), size=count)
    cycles = 2 if verb.looping else 1
    return [sequence.sequence(evaluator(name), (row @ verb.values)[None], FPS, cycles=cycles) for row in weights]


def mapped(name: str, rig: Rig, **options: object) -> list[tuple[Poses, Motion, Figures]]:
    mapper = Mapper.of_verb(evaluator(name), Mapping(rig, **options))  # type: ignore[arg-type]
    return [(poses, *mapper.sequence(evaluator(name), poses, FPS)) for poses in blends(name)]


def positions(motion: Motion) -> F64:
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def directions(places: F64, bones: dict[str, int]) -> F64:
    spans = np.stack([places[:, bones[b]] - places[:, bones[a]] for a, b in LIMBS], axis=1)
    return spans / np.linalg.norm(spans, axis=-1, keepdims=True)


def itself(name: str) -> Rig:
    skeleton = evaluator(name).verb.skeleton
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton), 1))
    return Rig("itself", skeleton, still, still, np.zeros(3))


@pytest.mark.parametrize("name", ["reach", "kick", "locomotion"])
def test_the_same_skeleton_gets_the_same_motion(name: str) -> None:
    for poses, motion, figures in mapped(name, itself(name)):
        np.testing.assert_allclose(motion.root, poses.root, atol=5e-4)
        gap = quat.mul(quat.conjugate(poses.rotations), motion.rotations)
        assert np.linalg.norm(gap[..., :3], axis=-1).max() < 0.02
        assert figures.effector_m is None or figures.effector_m < 1e-6


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["reach", "punch", "locomotion"])
def test_limbs_point_where_those_of_the_source_do(name: str, target: str) -> None:
    rig = TARGETS[target]()
    # without the last step the directions are those of the source, whatever the lengths, rest pose and axes
    mapper = Mapper.of_verb(evaluator(name), Mapping(rig, feet=False))
    bones = mapper.source.roles.bones
    for poses in blends(name, 2):
        motion, _ = mapper.motion(Motion(evaluator(name).verb.skeleton, FPS, poses.root, poses.rotations))
        wanted = directions(evaluator(name).positions(poses)[1], dict(bones))
        found = directions(positions(motion), dict(rig.roles.bones))
        assert np.degrees(np.arccos(np.clip((wanted * found).sum(axis=-1), -1, 1))).max() < 0.5


@pytest.mark.parametrize("target", TARGETS)
def test_effector_is_at_the_scaled_goal(target: str) -> None:
    rig = TARGETS[target]()
    mapper = Mapper.of_verb(evaluator("reach"), Mapping(rig))
    effector = mapper.source.effector
    assert effector is not None
    hand = rig.roles.bones["rightHand"]
    for poses in blends("reach"):
        at = evaluator("reach").pose_of(poses.blend, phase=np.array([effector.phase]))
        wanted = evaluator("reach").positions(at)[1][0, effector.joint]
        center = mapper.source.center
        wanted = center + mapper.tables.scale * (wanted - center)
        found = mapper.poses(at)
        place = positions(Motion(rig.skeleton, 1.0, found.root, found.rotations))[0, hand]
        assert np.linalg.norm(place - wanted) < 1e-3
        assert abs(found.effector[0] - np.linalg.norm(place - wanted)) < 1e-9


@pytest.mark.parametrize("target", ["giant", "A-pose and other axes", "five spine joints"])
def test_effector_is_at_the_goal_of_the_world(target: str) -> None:
    for _, _, figures in mapped("reach", TARGETS[target](), goal="world"):
        assert figures.effector_m is not None
        assert figures.effector_m < 1e-3


def test_a_goal_out_of_reach_is_reported() -> None:
    figures = [row[2].effector_m or 0.0 for row in mapped("punch", TARGETS["child"](), goal="world")]
    assert max(figures) > 0.1


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["reach", "kick", "locomotion", "mood"])
def test_standing_feet_stay(name: str, target: str) -> None:
    rig = TARGETS[target]()
    for _, _, figures in mapped(name, rig):
        assert figures.foot_slide_m is not None
        assert figures.foot_height_m is not None
        assert figures.foot_slide_m < 2e-3
        assert figures.foot_height_m < 4e-3


@pytest.mark.parametrize("target", TARGETS)
def test_feet_stand_on_the_ground(target: str) -> None:
    rig = TARGETS[target]()
    toes = [rig.roles.bones[f"{side}Toes"] for side in ("left", "right")]
    ankles = [rig.roles.bones[f"{side}Foot"] for side in ("left", "right")]
    rest = rig.frames[1]
    for _, motion, _ in mapped("reach", rig):
        places = positions(motion)
        rise = places[0, toes, 1].mean() - places[0, ankles, 1].mean()
        assert abs(rise - (rest[toes, 1].mean() - rest[ankles, 1].mean())) < 0.01 * np.ptp(rest[:, 1])
        assert -0.001 < places[:, :, 1].min() < 0.05 * np.ptp(rest[:, 1])


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["reach", "locomotion", "jump"])
def test_no_joint_pops(name: str, target: str) -> None:
    def jerks(rotations: F64) -> tuple[float, float]:
        gap = quat.mul(quat.conjugate(rotations[:-1]), rotations[1:])
        speeds = 2.0 * FPS * np.where(gap[..., 3:] < 0, -gap, gap)[..., :3]
        turns = np.linalg.norm(np.diff(speeds, axis=0), axis=-1) * FPS
        return float(np.linalg.norm(speeds, axis=-1).max()), float(turns.max())

    for poses, motion, _ in mapped(name, TARGETS[target]()):
        before, after = jerks(poses.rotations), jerks(motion.rotations)
        assert after[0] < 1.2 * before[0] + 1.0
        assert after[1] < 1.2 * before[1] + 100.0


def test_spread_over_more_spine_joints_the_chest_turns_as_far() -> None:
    chests = []
    for count in (1, 2, 5):
        rig = with_spine(preset("mixamo"), count)
        assert len(rig.roles.spine) == count
        mapper = Mapper.of_verb(evaluator("reach"), Mapping(rig, feet=False))
        poses = blends("reach", 1)[0]
        motion, _ = mapper.motion(Motion(evaluator("reach").verb.skeleton, FPS, poses.root, poses.rotations))
        parents, offsets = motion.skeleton.parents, motion.skeleton.offsets
        chests.append(fk.forward(motion.root, motion.rotations, parents, offsets)[0][:, rig.roles.spine[-1]])
    for other in chests[1:]:
        gap = quat.mul(quat.conjugate(chests[0]), other)
        assert np.linalg.norm(gap[..., :3], axis=-1).max() < 1e-6


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name: str) -> None:
    mapper = Mapper.of_verb(evaluator("reach"), of_preset(name))
    for poses in blends("reach", 2):
        _, figures = mapper.sequence(evaluator("reach"), poses, FPS)
        assert figures.effector_m is not None
        assert figures.effector_m < 1e-3
        assert figures.foot_slide_m is not None
        assert figures.foot_slide_m < 2e-3


def test_a_single_pose_is_the_frame_of_the_motion() -> None:
    mapper = Mapper.of_verb(evaluator("locomotion"), of_preset("unreal"))
    poses = blends("locomotion", 1)[0]
    whole = mapper.poses(poses)
    one = evaluator("locomotion").pose_of(poses.blend, time_s=poses.time_s[40:41])
    np.testing.assert_allclose(mapper.poses(one).rotations[0], whole.rotations[40], atol=1e-6)
    np.testing.assert_allclose(mapper.poses(one).root[0], whole.root[40], atol=1e-6)


@pytest.mark.parametrize(
    "axis", [(0.0, np.pi, 0.0), (-0.5 * np.pi, 0.0, 0.0), (0.0, 0.5 * np.pi, 0.0), (0.0, 0.3, 0.0)]
)
def test_a_figure_may_face_and_lie_any_way_in_its_file(axis: tuple[float, float, float]) -> None:
    rig = preset("mixamo")
    pose = rig.reference.copy()
    pose[0] = quat.exp(np.array(axis))
    turned = Rig("turned", rig.skeleton, pose, pose, quat.rotate(pose[0], rig.origin), ground=None)
    level = Rig("level", rig.skeleton, rig.rest, rig.reference, rig.origin, ground=None)
    poses = blends("reach", 1)[0]
    places = []
    for target in (level, turned):
        mapper = Mapper.of_verb(evaluator("reach"), Mapping(target))
        places.append(positions(mapper.sequence(evaluator("reach"), poses, FPS)[0]))
    np.testing.assert_allclose(places[0], places[1], atol=1e-3)


@pytest.mark.parametrize(
    "axis", [(0.0, 0.0, 0.0), (0.0, np.pi, 0.0), (0.5 * np.pi, 0.0, 0.0)], ids=["Y-up", "facing -Z", "Z-up"]
)
def test_pairs_make_a_humanoid_of_unknown_names(axis: tuple[float, float, float]) -> None:
    rig = preset("mixamo")
    pose = rig.reference.copy()
    pose[0] = quat.exp(np.array(axis))
    named = Rig("named", rig.skeleton, pose, pose, quat.rotate(pose[0], rig.origin))
    skeleton = replace(rig.skeleton, names=tuple(f"j{k}" for k in range(len(rig.skeleton))))
    unknown = replace(named, skeleton=skeleton)
    first = Mapper.of_verb(evaluator("reach"), Mapping(named))
    pairs = explicit_joints(first.source.rig, unknown, first.tables.rows)
    second = Mapper.of_verb(evaluator("reach"), Mapping(unknown, pairs))
    assert not unknown.roles
    assert second.tables.scale == pytest.approx(first.tables.scale, abs=1e-9)
    poses = blends("reach", 1)[0]
    (one, figures), (two, _) = (mapper.sequence(evaluator("reach"), poses, FPS) for mapper in (first, second))
    assert figures.effector_m is not None
    joints = [row.target for row in second.tables.rows]
    np.testing.assert_allclose(positions(two)[:, joints], positions(one)[:, joints], atol=1e-6)


def test_pairs_of_the_spine_keep_it_a_spine() -> None:
    rig = preset("mixamo")
    named = Mapper.of_verb(evaluator("reach"), Mapping(rig))
    plain = {name.removeprefix("mixamorig:"): name for name in rig.skeleton.names}
    pairs = {name: plain[name] for name in named.source.rig.skeleton.names}
    paired = Mapper.of_verb(evaluator("reach"), Mapping(rig, pairs))
    poses = blends("reach", 1)[0]
    one, two = (mapper.sequence(evaluator("reach"), poses, FPS)[0] for mapper in (named, paired))
    np.testing.assert_allclose(positions(two), positions(one), atol=1e-6)
    assert explicit_joints(paired.source.rig, rig, paired.tables.rows) == pairs


@pytest.mark.parametrize("bone", ["rightHand", "rightLowerArm", "leftFoot", "leftLowerLeg"])
@pytest.mark.parametrize("name", ["reach", "kick"])
def test_a_bone_without_length_is_no_limb_that_bends(name: str, bone: str) -> None:
    rig = preset("vrm")
    offsets = rig.skeleton.offsets.copy()
    offsets[rig.roles.bones[bone]] = 0.0
    flat = replace(rig, skeleton=replace(rig.skeleton, offsets=offsets))
    for _, motion, _ in mapped(name, flat):
        assert np.isfinite(motion.root).all()
        np.testing.assert_allclose(np.linalg.norm(motion.rotations, axis=-1), 1.0, atol=1e-9)


def test_a_root_above_the_hips_carries_them() -> None:
    rig = preset("unreal")
    assert rig.skeleton.names[:2] == ("root", "pelvis")
    for poses, motion, _ in mapped("locomotion", rig):
        root = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[0][:, 0]
        np.testing.assert_allclose(np.abs(root[:, 3]), 1.0, atol=1e-9)
        assert np.ptp(motion.root[:, 2]) > 0.5 * np.ptp(poses.root[:, 2])
