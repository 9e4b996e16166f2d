"""Targets and mappings of files: BVH, glTF, VRM, mapping.toml."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.strangers.vrm_files import avatar
from tests.verbs.gltf_files import body_file
from tests.verbs.mapping.rigs import remade
from verbs import library
from verbs.errors import MotionFileError, RequestError, SourceError, UnknownName
from verbs.io import bvh, gltf_writer, motion_files
from verbs.kernels import fk, quat
from verbs.mapping.alignment import ground
from verbs.mapping.embedding import embedded
from verbs.mapping.mapper import Mapper
from verbs.mapping.mapping import Mapping, open_mapping
from verbs.mapping.plan import explicit_joints, plan
from verbs.mapping.presets import preset
from verbs.mapping.reading import read_rig
from verbs.mapping.toml_writer import to_toml
from verbs.motion import Motion
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator


def standing(name: str = "mixamo", frames: int = 2) -> Motion:
    rig = preset(name)
    still = np.tile(rig.rest, (frames, 1, 1))
    return Motion(rig.skeleton, 30.0, np.tile([0.0, 0.96, 0.0], (frames, 1)), still)


def test_a_bvh_file_in_centimetres_has_a_figure_in_metres(tmp_path: Path) -> None:
    bvh.write(standing().scaled(100.0), tmp_path / "hero.bvh")
    rig = read_rig(tmp_path / "hero.bvh")
    assert rig.unit == "cm"
    np.testing.assert_allclose(rig.skeleton.offsets, preset("mixamo").skeleton.offsets, atol=1e-6)
    assert read_rig(tmp_path / "hero.bvh", unit="m").skeleton.offsets.max() > 10.0


def test_a_glb_file_has_the_skeleton_of_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "hero.glb").write_bytes(gltf_writer.dump(standing()))
    rig = read_rig(tmp_path / "hero.glb")
    assert rig.skeleton.names == preset("mixamo").skeleton.names
    np.testing.assert_allclose(rig.skeleton.offsets, preset("mixamo").skeleton.offsets, atol=1e-6)
    assert len(rig.nodes) == len(rig.skeleton)


def test_the_bones_of_a_vrm_file_are_those_it_names(tmp_path: Path) -> None:
    skeleton = library.load("reach").skeleton
    (tmp_path / "avatar.vrm").write_bytes(avatar(skeleton, scale=1.2, limbs=0.9, turned=True))
    rig = read_rig(tmp_path / "avatar.vrm")
    assert rig.ground == 0.0
    assert rig.skeleton.names[rig.roles.bones["leftUpperArm"]] == "bone leftUpperArm"
    assert rig.roles.bones.keys() >= {"hips", "head", "leftToes", "rightHand"}
    evaluator = Evaluator(library.load("reach"))
    mapper = Mapper.of_verb(evaluator, Mapping(rig))
    poses = sequence.sequence(evaluator, evaluator.verb.values[:1], 60.0)
    _, figures = mapper.sequence(evaluator, poses, 60.0)
    assert figures.effector_m is not None
    assert figures.effector_m < 1e-3
    assert figures.foot_slide_m is not None
    assert figures.foot_slide_m < 2e-3


def test_a_zero_pose_that_is_a_heap_of_bones_is_replaced_by_a_standing_frame(tmp_path: Path) -> None:
    """Every bone along +X in the zero pose, as in some capture formats; a frame of the clip stands."""
    rig = preset("mixamo")
    skeleton = rig.skeleton
    whole = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton), 1))
    for joint in range(len(skeleton)):
        below = np.flatnonzero(skeleton.parents == joint)
        if len(below) == 1:
            along = skeleton.offsets[below[0]] / np.linalg.norm(skeleton.offsets[below[0]])
            axis = np.cross([1.0, 0.0, 0.0], along)
            angle = np.arctan2(np.linalg.norm(axis), along[0])
            if np.linalg.norm(axis) < 1e-9:
                axis = np.array([0.0, 0.0, 1.0])
            whole[joint] = quat.exp(axis / np.linalg.norm(axis) * angle)
    offsets = skeleton.offsets.copy()
    offsets[1:] = quat.rotate(quat.conjugate(whole[skeleton.parents[1:]]), offsets[1:])
    local = whole.copy()
    local[1:] = quat.mul(quat.conjugate(whole[skeleton.parents[1:]]), whole[1:])
    heap = type(skeleton)(skeleton.names, skeleton.parents, offsets)
    frames = np.stack([local, local])
    bvh.write(Motion(heap, 30.0, np.zeros((2, 3)), frames), tmp_path / "heap.bvh", decimals=9)
    found = read_rig(tmp_path / "heap.bvh")
    np.testing.assert_allclose(found.frames[1] - found.frames[1][0], rig.frames[1] - rig.frames[1][0], atol=1e-5)
    evaluator = Evaluator(library.load("punch"))
    poses = sequence.sequence(evaluator, evaluator.verb.values[:1], 60.0)
    moved = [Mapper.of_verb(evaluator, Mapping(target)).sequence(evaluator, poses, 60.0)[0] for target in (found, rig)]
    places = [fk.forward(one.root, one.rotations, one.skeleton.parents, one.skeleton.offsets)[1] for one in moved]
    np.testing.assert_allclose(places[0], places[1], atol=0.02)


def test_a_scale_along_one_axis_is_that_of_the_reader(tmp_path: Path) -> None:
    source = body_file()
    names = [row["name"] for row in source.table["nodes"]]
    source.table["nodes"][names.index("Armature")]["scale"] = [0.01, 0.02, 0.01]
    source.table["nodes"][names.index("LeftArm")]["scale"] = [2.0, 1.0, 1.0]
    path = source.write(tmp_path / "a.glb")
    rig, file = read_rig(path, unit="m"), motion_files.read(path)
    skeleton = file.motion.skeleton
    assert rig.skeleton.names == skeleton.names
    np.testing.assert_allclose(rig.skeleton.offsets, skeleton.offsets, atol=1e-6)
    np.testing.assert_allclose(rig.skeleton.tip_offsets, skeleton.tip_offsets, atol=1e-6)
    assert [text for text in rig.notes if "LeftArm" in text]
    (tmp_path / "out.glb").write_bytes(embedded(rig, Motion(skeleton, 30.0, file.motion.root, file.motion.rotations)))
    again = motion_files.read(tmp_path / "out.glb", clip=0).motion
    np.testing.assert_allclose(again.root, file.motion.root, atol=1e-5)


def test_of_two_equal_figures_the_named_one_is_read(tmp_path: Path) -> None:
    source = body_file(above=False)
    count = len(source.table["nodes"])
    for row in json.loads(json.dumps(source.table["nodes"])):
        row["children"] = [count + child for child in row.pop("children", [])]
        source.node("Other" + row.pop("name"), **{key: value for key, value in row.items() if value})
    source.skin([count + joint for joint in source.table["skins"][0]["joints"]])
    source.write(tmp_path / "two.glb")
    text = bvh.dump(standing())
    tree, motion = text.split("MOTION\n")
    head, rows = motion.split("\n", 2)[:2], motion.split("\n", 2)[2]
    other = tree.removeprefix("HIERARCHY\n").replace("mixamorig:", "Other")
    twice = "\n".join(f"{row} {row}" for row in rows.strip().split("\n"))
    (tmp_path / "two.bvh").write_text(f"{tree}{other}MOTION\n" + "\n".join(head) + f"\n{twice}\n")
    for name in ("two.glb", "two.bvh"):
        with pytest.raises(MotionFileError, match=r"\[root\] joint"):
            read_rig(tmp_path / name)
        (tmp_path / "m.toml").write_text(f'target = "{name}"\n[root]\njoint = "OtherHips"\n')
        mapping = open_mapping(str(tmp_path / "m.toml"))
        assert mapping.rig.skeleton.names[0] == "OtherHips"
        assert len(mapping.rig.notes) == 1
        (tmp_path / "again.toml").write_text(to_toml(mapping, {}, name))
        assert open_mapping(str(tmp_path / "again.toml")).rig.skeleton.names[0] == "OtherHips"
        with pytest.raises(MotionFileError):
            read_rig(tmp_path / name, root="Tail")


@pytest.mark.parametrize(("ending", "height"), [("bvh", 1.5), ("npz", 1.5), ("glb", 1.5)])
def test_the_height_of_the_ground_is_in_the_unit_of_the_file(tmp_path: Path, ending: str, height: float) -> None:
    motion_files.write(standing().scaled(100.0), tmp_path / f"hero.{ending}")
    (tmp_path / "m.toml").write_text(f'target = "hero.{ending}"\nunit = "cm"\n[ground]\nheight = {height}\n')
    rig = open_mapping(str(tmp_path / "m.toml")).rig
    lowest = float(np.concatenate([rig.frames[1], rig.tips()])[:, 1].min())
    zero = 0.0 if ending == "glb" else lowest
    assert ground(rig) == pytest.approx(zero + 0.01 * height, abs=1e-9)
    assert lowest - 0.05 < ground(rig) < lowest + 0.05


def test_a_ground_at_zero_leaves_a_bvh_target_on_its_feet(tmp_path: Path) -> None:
    bvh.write(standing().scaled(100.0), tmp_path / "hero.bvh")
    (tmp_path / "m.toml").write_text('target = "hero.bvh"\n[ground]\nheight = 0.0\n')
    evaluator = Evaluator(library.load("reach"))
    poses = sequence.sequence(evaluator, evaluator.verb.values[:1], 60.0)
    stated, free = (open_mapping(str(tmp_path / name)) for name in ("m.toml", "hero.bvh"))
    motions = [Mapper.of_verb(evaluator, mapping).sequence(evaluator, poses, 60.0) for mapping in (stated, free)]
    assert motions[0][1].foot_slide_m is not None
    assert motions[0][1].foot_slide_m < 2e-3
    np.testing.assert_allclose(motions[0][0].root, motions[1][0].root, atol=0.05)


def test_mapping_toml_round_trip(tmp_path: Path) -> None:
    evaluator = Evaluator(library.load("reach"))
    mapping = open_mapping("unreal", goal="world")
    source = Mapper.of_verb(evaluator, mapping).source.rig
    rows = plan(source, mapping)
    joints = explicit_joints(source, mapping.rig, rows)
    assert joints["RightHand"] == "hand_r"
    (tmp_path / "mapping.toml").write_text(to_toml(mapping, joints, "unreal"))
    again = open_mapping(str(tmp_path / "mapping.toml"))
    assert (again.goal, again.feet, again.scale) == ("world", True, None)
    key = [(row.target, row.first, row.second, row.share, row.bone) for row in plan(source, again)]
    assert key == [(row.target, row.first, row.second, row.share, row.bone) for row in rows]


def test_a_given_joint_replaces_the_one_found(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text('preset = "vrm"\n[joints]\nRightHand = "leftHand"\nNeck = ""\n')
    mapping = open_mapping(str(tmp_path / "m.toml"))
    source = Mapper.of_verb(Evaluator(library.load("reach")), mapping).source.rig
    rows = {mapping.rig.skeleton.names[row.target]: row for row in plan(source, mapping)}
    assert source.skeleton.names[rows["leftHand"].first] == "RightHand"
    assert "rightHand" not in rows
    assert "neck" not in rows


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", SourceError),
        ('preset = "vrm"\ntarget = "a.glb"', SourceError),
        ('preset = "robot"', UnknownName),
        ('preset = "vrm"\nmystery = 1', SourceError),
        ('preset = "vrm"\n[effector]\ngoal = "moon"', SourceError),
        ('preset = "vrm"\n[root]\nscale = -1', SourceError),
        ('preset = "vrm"\n[root]\nscale = "world"', SourceError),
        ('preset = "vrm"\n[root]\ntravel = "legs"', SourceError),
        ('preset = "vrm"\n[root]\nscale = nan', SourceError),
        ('preset = "vrm"\n[root]\nscale = true', SourceError),
        (f'preset = "vrm"\n[root]\nscale = {"9" * 400}', SourceError),
        (f'preset = "vrm"\n[root]\ntravel = {"9" * 5000}', SourceError),
        (f'preset = "vrm"\n[ground]\nheight = -{"9" * 400}', SourceError),
        ('preset = "vrm"\n[joints]\nHips = 3', SourceError),
        ('preset = "vrm"\n[root]\njoint = "hips"', SourceError),
        ('target = "a.glb"\n[root]\njoint = 3', SourceError),
        ('target = "missing.glb"', MotionFileError),
        ("preset = ", SourceError),
    ],
)
def test_wrong_mappings_are_refused(tmp_path: Path, text: str, error: type[Exception]) -> None:
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(error):
        open_mapping(str(tmp_path / "m.toml"))


def test_names_that_do_not_exist_are_named(tmp_path: Path) -> None:
    evaluator = Evaluator(library.load("reach"))
    (tmp_path / "m.toml").write_text('preset = "vrm"\n[joints]\nThirdArm = "hips"\n')
    with pytest.raises(UnknownName, match="ThirdArm"):
        Mapper.of_verb(evaluator, open_mapping(str(tmp_path / "m.toml")))
    (tmp_path / "m.toml").write_text('preset = "vrm"\n[joints]\nHips = "tail"\n')
    with pytest.raises(UnknownName, match="tail"):
        Mapper.of_verb(evaluator, open_mapping(str(tmp_path / "m.toml")))


def test_a_verb_without_a_humanoid_is_refused() -> None:
    with pytest.raises(RequestError, match="can be mapped"):
        Mapper.of_verb(Evaluator(library.load("arm3")), open_mapping("vrm"))


def test_captures_are_targets_of_one_another(mocap: Path, tmp_path: Path) -> None:
    """Skeletons of captures: other lengths, a second neck joint, centimetres."""
    files = sorted(mocap.glob("*/*.bvh"))[::40]
    evaluator = Evaluator(library.load("reach"))
    poses = sequence.sequence(evaluator, evaluator.verb.values[:1], 60.0)
    for file in files:
        rig = read_rig(file)
        assert rig.roles
        _, figures = Mapper.of_verb(evaluator, Mapping(rig)).sequence(evaluator, poses, 60.0)
        assert figures.effector_m is not None
        assert figures.effector_m < 1e-3, file
        assert figures.foot_slide_m is not None
        assert figures.foot_slide_m < 2e-3, file


def test_other_axes_and_an_a_pose_survive_a_file(tmp_path: Path) -> None:
    rig = remade(preset("mixamo"), roll=9, lowered=0.7)
    motion = Motion(rig.skeleton, 30.0, np.tile([0.0, 0.96, 0.0], (2, 1)), np.stack([rig.rest, rig.rest]))
    bvh.write(motion, tmp_path / "odd.bvh", decimals=9)
    found = read_rig(tmp_path / "odd.bvh")
    np.testing.assert_allclose(found.frames[1] - found.frames[1][0], rig.frames[1] - rig.frames[1][0], atol=1e-5)
