"""Programs by others read our files as we do: a validator, three.js, Babylon.js and three-vrm."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from tests.strangers import vrm_files
from tests.verbs.mapping.parted import split
from tests.verbs.mapping.rigs import remade
from verbs import library
from verbs.io import bvh, motion_files
from verbs.io.humanoid import bones_of, t_pose
from verbs.kernels import fk, quat
from verbs.mapping.embedding import embedded
from verbs.mapping.mapper import Mapper
from verbs.mapping.mapping import open_mapping
from verbs.mapping.presets import preset
from verbs.motion import Motion
from verbs.runtime import sequence
from verbs.runtime.evaluate import Evaluator

HERE = Path(__file__).parent
NODE = shutil.which("node")
BUILT_IN = ("arm3", "reach", "walk")
CAPTURED = ("reach/ReachForwardHigh.bvh", "locomotion/WalkCircleLf.bvh")

pytestmark = pytest.mark.skipif(
    NODE is None or not (HERE / "node_modules").is_dir(),
    reason="node, or the packages of tests/strangers, are not installed: npm --prefix tests/strangers ci",
)


def run(script: str, *arguments: object):
    command = [NODE, str(HERE / script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def built_in(name: str) -> Motion:
    evaluator = Evaluator(library.load(name))
    return sequence.to_motion(evaluator, sequence.sequence(evaluator, evaluator.verb.values[-1:], 30.0), 30.0)


@pytest.fixture(scope="module")
def motions() -> dict[str, Motion]:
    return {name: built_in(name) for name in BUILT_IN}


@pytest.fixture(params=BUILT_IN + CAPTURED)
def motion(request, motions) -> Motion:
    if request.param in motions:
        return motions[request.param]
    whole = bvh.read(request.getfixturevalue("mocap") / request.param)
    return Motion(whole.skeleton, whole.fps, whole.root[:200], whole.rotations[:200])


def times_of(motion: Motion) -> np.ndarray:
    """Twenty times on and between frames, in no order; the first and the last frame are among them."""
    inner = np.random.default_rng(7).uniform(0.0, motion.duration_s, 16)
    return np.array([*inner, 0.0, motion.duration_s, 1.0 / motion.fps, 10.0 / motion.fps])


def sampled(motion: Motion, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root positions and local rotations between frames, by SciPy."""
    at = np.minimum(times, motion.duration_s)
    keys = np.arange(len(motion)) / motion.fps
    root = np.stack([np.interp(at, keys, column) for column in motion.root.T], axis=-1)
    turns = [Slerp(keys, Rotation.from_quat(motion.rotations[:, k]))(at).as_quat() for k in range(len(motion.skeleton))]
    return root, np.stack(turns, axis=1)


def expected(motion: Motion, times: np.ndarray) -> dict[str, np.ndarray]:
    """Positions (20, 3) of all joints by name."""
    found = fk.forward(*sampled(motion, times), motion.skeleton.parents, motion.skeleton.offsets)[1]
    return {name: found[:, k] for k, name in enumerate(motion.skeleton.names)}


@pytest.mark.parametrize("mannequin", [True, False])
def test_the_validator_finds_no_fault(motion, mannequin, tmp_path):
    (tmp_path / "a.glb").write_bytes(motion_files.dump(motion, "glb", mannequin=mannequin, extras={"verb": "a"}))
    (report,) = run("validate.mjs", tmp_path / "a.glb")
    faults = [row for row in report["issues"]["messages"] if row["severity"] < 2]  # 0 is an error, 1 a warning
    assert faults == []
    assert report["info"]["animationCount"] == 1
    assert report["info"]["totalVertexCount"] > 0 or not mannequin


@pytest.mark.parametrize("script", ["positions_three.mjs", "positions_babylon.mjs"])
def test_engines_have_every_joint_where_we_have_it(motion, script, tmp_path):
    times = times_of(motion)
    (tmp_path / "a.glb").write_bytes(motion_files.dump(motion, "glb"))
    found = run(script, tmp_path / "a.glb", *times)["positions"]
    for name, places in expected(motion, times).items():
        np.testing.assert_allclose(found[name], places, atol=1e-4, err_msg=name)


def test_the_body_follows_the_skeleton(motion, tmp_path):
    """Each vertex, skinned by three.js, is as near to a bone as in the rest pose."""
    (tmp_path / "a.glb").write_bytes(motion_files.dump(motion, "glb"))
    vertices = np.array(run("positions_three.mjs", tmp_path / "a.glb", motion.duration_s / 2)["vertices"])
    own = motion.skeleton
    root, turns = sampled(motion, np.array([motion.duration_s / 2]))
    whole, places = (array[0] for array in fk.forward(root, turns, own.parents, own.offsets))
    tips = places[own.tip_parents] + quat.rotate(whole[own.tip_parents], own.tip_offsets)
    starts = np.concatenate([places[own.parents[1:]], places[own.tip_parents]])
    along = np.concatenate([places[1:], tips]) - starts
    share = np.einsum("vbk,bk->vb", vertices[:, None] - starts, along) / np.maximum((along**2).sum(axis=1), 1e-12)
    nearest = starts + np.clip(share, 0.0, 1.0)[..., None] * along
    assert np.linalg.norm(vertices[:, None] - nearest, axis=-1).min(axis=1).max() < 0.14


@pytest.fixture(params=["reach", *CAPTURED])
def human(request, motions) -> Motion:
    if request.param in motions:
        return motions[request.param]
    whole = bvh.read(request.getfixturevalue("mocap") / request.param)
    return Motion(whole.skeleton, whole.fps, whole.root[:200], whole.rotations[:200])


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("scale", "limbs"), [(1.0, 1.0), (0.7, 1.2)])
def test_an_avatar_plays_a_vrm_animation(human, scale, limbs, turned, tmp_path):
    """Bones turn from the T-pose as ours do, and the hips move by the ratio of the hips' heights."""
    times = times_of(human)
    (tmp_path / "a.vrma").write_bytes(motion_files.dump(human, "vrma"))
    (tmp_path / "a.vrm").write_bytes(vrm_files.avatar(human.skeleton, scale=scale, limbs=limbs, turned=turned))
    found = run("positions_vrm.mjs", tmp_path / "a.vrm", tmp_path / "a.vrma", *times)["positions"]
    bones = bones_of(human.skeleton)
    assert set(found) == set(bones)
    for bone, places in retargeted(human, times, scale, limbs).items():
        np.testing.assert_allclose(found[bone], places, atol=1e-3, err_msg=bone)


def retargeted(motion: Motion, times: np.ndarray, scale: float, limbs: float) -> dict[str, np.ndarray]:
    """Positions (20, 3) of the avatar's bones, from global rotations relative to the T-pose."""
    skeleton = motion.skeleton
    bones = bones_of(skeleton)
    joints = sorted(bones.values())
    root, turns = sampled(motion, times)
    whole = fk.forward(root, turns, skeleton.parents, skeleton.offsets)[0]
    relative = quat.mul(whole, quat.conjugate(t_pose(skeleton, bones)))
    rest = vrm_files.t_places(skeleton, scale=scale, limbs=limbs)
    places = np.zeros((len(times), len(skeleton), 3))
    places[:, 0] = root * (rest[0, 1] / vrm_files.t_places(skeleton)[0, 1])
    for joint in joints[1:]:
        parent = joints[vrm_files.next_above(skeleton, joints, joint)]
        places[:, joint] = places[:, parent] + quat.rotate(relative[:, parent], rest[joint] - rest[parent])
    return {bone: places[:, joint] for bone, joint in bones.items()}


def test_an_avatar_of_our_proportions_stands_where_we_stand(motions, tmp_path):
    """On a body like ours, each bone of the avatar is at our joint."""
    motion = motions["reach"]
    times = times_of(motion)
    (tmp_path / "a.vrma").write_bytes(motion_files.dump(motion, "vrma"))
    (tmp_path / "a.vrm").write_bytes(vrm_files.avatar(motion.skeleton))
    found = run("positions_vrm.mjs", tmp_path / "a.vrm", tmp_path / "a.vrma", *times)["positions"]
    ours = expected(motion, times)
    for bone, joint in bones_of(motion.skeleton).items():
        np.testing.assert_allclose(found[bone], ours[motion.skeleton.names[joint]], atol=1e-3, err_msg=bone)


def test_the_validator_reads_a_vrm_animation(motions, tmp_path):
    (tmp_path / "a.glb").write_bytes(motion_files.dump(motions["reach"], "vrma"))
    (report,) = run("validate.mjs", tmp_path / "a.glb")
    assert [row for row in report["issues"]["messages"] if row["severity"] < 2] == []


@pytest.mark.parametrize("kind", ["glb", "parted.glb", "vrm"])
def test_a_motion_added_to_the_file_of_its_figure_is_performed_by_three(tmp_path, kind):
    """A skinned figure in a glb file, and an avatar whose bones rest turned; the file stays valid."""
    if kind != "vrm":
        rig = remade(preset("mixamo"), scale=0.8, arms=1.1)
        still = Motion(rig.skeleton, 30.0, np.tile(rig.origin, (2, 1)), np.stack([rig.rest, rig.rest]))
        content = motion_files.dump(still, "glb")
        (tmp_path / f"hero.{kind}").write_bytes(content if kind == "glb" else split(content, tmp_path))
    else:
        skeleton = library.load("reach").skeleton
        (tmp_path / "hero.vrm").write_bytes(vrm_files.avatar(skeleton, scale=1.2, limbs=0.9, turned=True))
    evaluator = Evaluator(library.load("reach"))
    mapper = Mapper.of_verb(evaluator, open_mapping(str(tmp_path / f"hero.{kind}")))
    poses = sequence.sequence(evaluator, evaluator.verb.values[:1], 30.0)
    motion, _ = mapper.sequence(evaluator, poses, 30.0)
    (tmp_path / "a.glb").write_bytes(embedded(mapper.mapping.rig, motion, name="reach"))
    (report,) = run("validate.mjs", tmp_path / "a.glb")
    assert [row for row in report["issues"]["messages"] if row["severity"] < 2] == []
    times = np.arange(len(motion)) / 30.0
    found = run("positions_three.mjs", tmp_path / "a.glb", *times[::7])["positions"]
    places = fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1][::7]
    for k, name in enumerate(motion.skeleton.names):
        np.testing.assert_allclose(found[name], places[:, k], atol=1e-4, err_msg=name)
