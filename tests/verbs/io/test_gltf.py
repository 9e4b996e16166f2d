"""glTF files as an evaluator by matrices, and three.js, pose them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import PROJECT
from tests.verbs.clip_files import BODY, TIPS
from tests.verbs.gltf_files import Gltf, body_file, random_rotations, with_tangents
from verbs.io import gltf
from verbs.io.report import MotionFile
from verbs.kernels import fk, quat
from verbs.mapping.reading import read_rig

MODES = ["LINEAR", "STEP", "CUBICSPLINE"]
THREE = PROJECT / "clients/dashboard/node_modules/three"


def positions(file: MotionFile) -> dict[str, np.ndarray]:
    motion = file.motion
    found = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]
    return {name: found[:, k] for k, name in enumerate(motion.skeleton.names)}


def assert_poses(file: MotionFile, source: Gltf, *, start: float = 0.0, clip: int = 0, atol: float = 1e-6) -> None:
    """Every joint is where the evaluator has it, at every frame."""
    times = start + np.arange(len(file.motion)) / file.motion.fps
    expected = source.positions(times, clip)
    for name, found in positions(file).items():
        np.testing.assert_allclose(found, expected[name], atol=atol, err_msg=name)


def read(source: Gltf, folder: Path, name: str = "clip.glb", **options) -> MotionFile:
    return gltf.read_file(source.write(folder / name), **options)


# --- poses ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("skin", [True, False])
def test_a_body_poses_as_the_matrices_pose_it(mode, skin, tmp_path):
    source = body_file(mode, skin=skin)
    file = read(source, tmp_path)
    joints = file.motion.skeleton.names
    assert joints[0] == "Hips"
    assert {name for name, _, _ in BODY} <= set(joints)
    assert (file.motion.fps, len(file.motion)) == (32.0, 16)
    assert_poses(file, source)
    (note,) = file.report.of("applied")
    assert note.text == "the transform of 'Z_UP', 'Armature' is applied: rotation 90°, scale 0.01"


@pytest.mark.parametrize("mode", MODES)
def test_another_rate_samples_between_thewith_tangents(mode, tmp_path):
    source = body_file(mode)
    file = read(source, tmp_path, fps=128.0)
    assert len(file.motion) == 15 * 4 + 1
    assert_poses(file, source)


def test_three_js_poses_files_alike(tmp_path):
    node = shutil.which("node")
    if node is None or not THREE.is_dir():
        pytest.skip("node or three is not installed")
    for mode in MODES:
        source = body_file(mode)
        path = source.write(tmp_path / f"{mode}.glb")
        file = gltf.read_file(path, fps=64.0)
        times = [str(k / 64.0) for k in range(len(file.motion))]
        script = Path(__file__).parent / "read_gltf.mjs"
        command = [node, str(script), str(THREE), str(path), "0", *times]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        expected = json.loads(done.stdout)
        for name, found in positions(file).items():
            np.testing.assert_allclose(found, expected[name], atol=1e-5, err_msg=f"{mode} {name}")


def test_tips_come_from_plain_nodes_at_the_ends(tmp_path):
    skeleton = read(body_file(), tmp_path).motion.skeleton
    assert [skeleton.names[k] for k in skeleton.tip_parents] == [name for name, _, _ in BODY if name in dict(TIPS)]
    for carrier, offset in zip(skeleton.tip_parents, skeleton.tip_offsets, strict=True):
        np.testing.assert_allclose(offset, dict(TIPS)[skeleton.names[carrier]], atol=1e-7)


@pytest.mark.parametrize("name", ["clip.gltf", "clip.glb"])
def test_all_layouts_of_a_file_are_read_alike(name, tmp_path):
    source = body_file()
    file = read(source, tmp_path, name)
    (tmp_path / "embedded.gltf").write_text(source.embedded())
    again = gltf.read_file(tmp_path / "embedded.gltf")
    np.testing.assert_array_equal(file.motion.rotations, again.motion.rotations)
    np.testing.assert_array_equal(file.motion.root, again.motion.root)


@pytest.mark.parametrize("code", ["b", "h", "B", "H"])
def test_normalised_integers_are_quaternions(code, tmp_path):
    source, rng = Gltf(), np.random.default_rng(1)
    joint = source.node("a")
    source.node("b", joint, translation=[0, 1, 0])
    keys = random_rotations(rng, 9)
    keys = np.abs(keys) if code.isupper() else keys
    source.channel(source.animation(), joint, "rotation", np.arange(9) / 8, keys, code=code)
    file = read(source, tmp_path)
    assert_poses(file, source)
    gap = np.linalg.norm(quat.log(quat.mul(quat.conjugate(quat.normalize(keys)), file.motion.rotations[:, 0])), axis=-1)
    assert gap.max() < {"b": 0.03, "B": 0.02, "h": 1e-4, "H": 1e-4}[code]


@pytest.mark.parametrize("how", [{"sparse": True}, {"stride": 32}])
def test_sparse_and_strided_accessors_hold_the_samewith_tangents(how, tmp_path):
    source, rng = Gltf(), np.random.default_rng(1)
    joint = source.node("a")
    source.node("b", joint, translation=[0, 1, 0])
    keys = random_rotations(rng, 9)
    source.channel(source.animation(), joint, "rotation", np.arange(9) / 8, keys, **how)
    np.testing.assert_allclose(np.abs(np.sum(read(source, tmp_path).motion.rotations[:, 0] * keys, -1)), 1, atol=1e-7)


def test_a_matrix_node_is_decomposed(tmp_path):
    source, rng = body_file(), np.random.default_rng(3)
    for name in ("Z_UP", "Armature"):
        node = next(node for node in source.table["nodes"] if node.get("name") == name)
        matrix = np.eye(4)
        turn = random_rotations(rng, 1)[0]
        matrix[:3, :3] = quat.to_matrix(turn) * 0.25
        matrix[:3, 3] = rng.normal(size=3)
        for key in ("rotation", "translation", "scale"):
            node.pop(key, None)
        node["matrix"] = matrix.T.ravel().tolist()
    assert_poses(read(source, tmp_path), source)


@given(st.integers(0, 2**32 - 1), st.sampled_from(MODES), st.integers(1, 8), st.integers(1, 7), st.booleans())
@settings(max_examples=60, deadline=None)
def test_any_hierarchy_poses_as_the_matrices_pose_it(tmp_path_factory, seed, mode, count, keys, turned):
    rng, source = np.random.default_rng(seed), Gltf()
    top = source.node("top", rotation=random_rotations(rng, 1)[0].tolist(), scale=[0.5] * 3) if turned else None
    clip, joints = source.animation(), []
    for k in range(count):
        parent = joints[int(rng.integers(k))] if k else top
        place = rng.normal(size=3).tolist()
        joints.append(source.node(f"joint {k}", parent, translation=place, scale=[float(rng.uniform(0.5, 2.0))] * 3))
        times, values = np.arange(keys) / 32, random_rotations(rng, keys)
        if rng.random() < 0.7 or k == 0:
            source.channel(clip, joints[k], "rotation", times, with_tangents(rng, values, mode), mode)
    source.channel(clip, joints[0], "translation", times, with_tangents(rng, rng.normal(size=(keys, 3)), mode), mode)
    file = read(source, tmp_path_factory.getbasetemp(), fps=64.0)
    assert len(file.motion.skeleton) == count
    assert_poses(file, source, atol=5e-6)


# --- hierarchy --------------------------------------------------------------------------------------------


def travelling(source: Gltf, name: str, frames: int = 16, fps: float = 32.0) -> None:
    """Animate a node: it travels and turns about the vertical."""
    node = next(k for k, row in enumerate(source.table["nodes"]) if row.get("name") == name)
    half = np.linspace(0.0, 0.5, frames)
    turns = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=-1)
    clip, times = source.table["animations"][0], np.arange(frames) / fps
    source.channel(clip, node, "rotation", times, turns)
    source.channel(clip, node, "translation", times, np.linspace([0, 0, 0], [1, 0, 3], frames))


def test_an_animated_node_above_the_skin_is_folded(tmp_path):
    source = body_file()
    travelling(source, "Z_UP")
    file = read(source, tmp_path)
    assert file.motion.skeleton.names[0] == "Hips"
    assert [folded.name for folded in file.report.folded] == ["Z_UP", "Armature"]
    assert_poses(file, source)
    np.testing.assert_allclose(file.report.folded[0].positions[-1], [1, 0, 3], atol=1e-6)


def test_a_ground_joint_of_the_skin_is_folded_as_in_bvh(tmp_path):
    source = body_file(above=False)
    source.table["nodes"].append({"name": "root", "children": [0]})
    source.table["skins"][0]["joints"].append(len(source.table["nodes"]) - 1)
    travelling(source, "root")
    file = read(source, tmp_path)
    assert file.motion.skeleton.names[0] == "Hips"
    assert [folded.name for folded in file.report.folded] == ["root"]
    assert_poses(file, source)


def test_names_that_repeat_are_made_unique(tmp_path):
    source = body_file()
    for node in source.table["nodes"]:
        if node["name"].endswith("Hand"):
            node["name"] = "Hand"
        if node["name"] == "Head":
            node["name"] = "Hand.2"
    names = read(source, tmp_path).motion.skeleton.names
    assert [name for name in names if name.startswith("Hand")] == ["Hand.2", "Hand", "Hand.3"]


def test_nodes_without_names_are_named_by_their_place(tmp_path):
    source = body_file(above=False)
    del source.table["nodes"][3]["name"]
    assert read(source, tmp_path).motion.skeleton.names[3] == "nodes[3]"


def test_of_two_skinned_trees_the_larger_is_read(tmp_path):
    source = body_file()
    sword = source.node("Sword")
    blade = source.node("Blade", sword, translation=[0, 1, 0])
    source.skin([sword, blade])
    file = read(source, tmp_path)
    assert "Sword" not in file.motion.skeleton.names
    (note,) = file.report.of("ignored_root")
    assert note.text == "joints from 'Sword' down (2) are ignored; 'Hips' is read"
    assert read(source, tmp_path, root="Sword").motion.skeleton.names == ("Sword", "Blade")


SHEARED = [1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
PROPS = {"a mirror": {"scale": [-1, 1, 1]}, "a hidden node": {"scale": [0, 0, 0]}, "a shear": {"matrix": SHEARED}}


@pytest.mark.parametrize("prop", PROPS)
def test_nodes_that_are_no_joints_may_have_any_transform(prop, tmp_path):
    source = body_file()
    plain = gltf.read_file(source.write(tmp_path / "plain.glb")).motion
    top = source.node("prop", **PROPS[prop])
    source.node("mesh", top, mesh=0)
    found = gltf.read_file(source.write(tmp_path / "prop.glb")).motion
    np.testing.assert_array_equal(found.rotations, plain.rotations)
    assert read_rig(tmp_path / "prop.glb").skeleton.names == read_rig(tmp_path / "plain.glb").skeleton.names


def test_joints_between_those_of_the_skin_are_kept(tmp_path):
    source = body_file()
    source.table["skins"][0]["joints"].remove(4)  # the chest: a helper that the skin does not use
    file = read(source, tmp_path)
    assert len(file.motion.skeleton) == len(BODY)
    assert_poses(file, source)


def test_translation_keys_of_every_joint_are_offsets(tmp_path):
    """Exporters bake them: constant, and off by rounding."""
    source, rng = body_file(), np.random.default_rng(0)
    clip, times = source.table["animations"][0], np.arange(16) / 32
    for name, parent, offset in BODY:
        if parent is not None:
            noise = rng.uniform(-1e-3, 1e-3, (16, 3))  # centimetres
            source.channel(clip, node_of(source, name), "translation", times, 100.0 * np.array(offset) + noise)
    file = read(source, tmp_path)
    assert_poses(file, source, atol=1e-4)
    assert file.report.changes == ()
    assert file.report.folded == ()


# --- scale ------------------------------------------------------------------------------------------------


def node_of(source: Gltf, name: str) -> int:
    return next(k for k, row in enumerate(source.table["nodes"]) if row.get("name") == name)


def test_a_constant_uniform_scale_reaches_all_below(tmp_path):
    source = body_file()
    source.table["nodes"][node_of(source, "Chest")]["scale"] = [1.5, 1.5, 1.5]
    clip, times = source.table["animations"][0], np.arange(16) / 32
    source.channel(clip, node_of(source, "LeftUpLeg"), "scale", times, np.full((16, 3), 0.5))
    file = read(source, tmp_path)
    assert_poses(file, source)
    assert file.report.of("scale") == ()


def test_a_changing_scale_is_reported_and_ignored(tmp_path):
    source = body_file()
    clip, times = source.table["animations"][0], np.arange(16) / 32
    plain = read(source, tmp_path)
    source.channel(clip, node_of(source, "Chest"), "scale", times, np.linspace([1, 1, 1], [2, 1, 1], 16))
    file = read(source, tmp_path)
    np.testing.assert_array_equal(file.motion.skeleton.offsets, plain.motion.skeleton.offsets)
    (note,) = file.report.of("scale")
    assert note.text == "the scale of joint 'Chest' changes from 1 to 2; it is ignored"
    assert note.text in file.report.changes


# --- clips and rates --------------------------------------------------------------------------------------


def test_a_file_with_several_animations_needs_a_choice(tmp_path):
    source = body_file()
    run = source.animation("run")
    source.channel(run, node_of(source, "Hips"), "rotation", [0.0, 0.5], random_rotations(np.random.default_rng(5), 2))
    with pytest.raises(gltf.MotionFileError, match="found 'walk', 'run'; name it as clip"):
        read(source, tmp_path)
    for clip in ("run", 1):
        file = read(source, tmp_path, clip=clip)
        assert (file.report.clips, file.report.clip) == (("walk", "run"), 1)
        assert_poses(file, source, clip=1)
    with pytest.raises(gltf.MotionFileError, match="expected an animation 'jump', found 'walk', 'run'"):
        read(source, tmp_path, clip="jump")
    with pytest.raises(gltf.MotionFileError, match="one of 2 animations, found 2"):
        read(source, tmp_path, clip=2)


@pytest.mark.parametrize(
    ("times", "fps", "frames"),
    [
        (np.arange(10) / 30, 30.0, 10),
        (np.arange(1, 41) / 24, 24.0, 40),
        (np.arange(10) / (60 / 1.001), 60 / 1.001, 10),
        (np.array([0, 3, 4, 20]) / 30, 30.0, 21),
        (np.array([0, 2, 5]) / 120, 120.0, 6),
        (np.array([0.0, 0.1, 0.1 + 1 / np.pi]), 60.0, 26),
        (np.array([0.4]), 60.0, 1),
    ],
)
def test_the_rate_is_that_of_the_grid_ofwith_tangents(times, fps, frames, tmp_path):
    source = Gltf()
    joint = source.node("a")
    source.node("b", joint, translation=[0, 1, 0])
    keys = random_rotations(np.random.default_rng(2), len(times))
    source.channel(source.animation(), joint, "rotation", times, keys)
    file = read(source, tmp_path)
    assert (file.motion.fps, len(file.motion)) == (pytest.approx(fps), frames)
    assert_poses(file, source, start=float(np.float32(times[0])), atol=1e-5)


def test_a_clip_without_joints_is_one_frame_at_rest(tmp_path):
    source = body_file()
    source.table["animations"][0]["channels"] = []
    file = read(source, tmp_path)
    assert len(file.motion) == 1
    assert_poses(file, source)


def test_lengths_may_be_in_another_unit(tmp_path):
    source = body_file(above=False)
    metres, inches = read(source, tmp_path).motion, read(source, tmp_path, unit="in").motion
    np.testing.assert_allclose(inches.root, 0.0254 * metres.root)
    np.testing.assert_allclose(inches.skeleton.offsets, 0.0254 * metres.skeleton.offsets)
    np.testing.assert_allclose(inches.skeleton.tip_offsets, 0.0254 * metres.skeleton.tip_offsets)
