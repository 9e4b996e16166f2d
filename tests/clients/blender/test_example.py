"""Examples that the Blender add-on exports: BVH files and lines of verb.toml that `adverb build` reads."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from adverb_blender import example

from verbs import library
from verbs.authoring.fit import build
from verbs.io import bvh
from verbs.kernels.pose import forward
from verbs.runtime.evaluate import Evaluator

FPS = 60.0


def clip_of(evaluator, adverbs):
    """The motion of adverbs, as the add-on reads it from an armature, and its keytimes."""
    verb = evaluator.verb
    blend = evaluator.blend(np.array([adverbs]), method="rbf")
    duration_s = float(evaluator.pose_of(blend, phase=0.0, plant=False).duration_s[0])
    frames = range(int(duration_s * FPS) + 1)
    poses = [evaluator.pose_of(blend, time_s=frame / FPS, plant=False) for frame in frames]
    offsets = [tuple(row) for row in verb.skeleton.offsets.tolist()]
    roots = [tuple(pose.root[0].tolist()) for pose in poses]
    rotations = [[tuple(row) for row in pose.rotations[0].tolist()] for pose in poses]
    parents = verb.skeleton.parents.tolist()
    positions = [evaluator.positions(pose)[1][0] for pose in poses]
    return example.Clip(list(verb.skeleton.names), parents, offsets, FPS, roots, rotations), positions


@pytest.fixture(scope="module")
def reach():
    return Evaluator(library.load("reach"))


def test_an_exported_file_has_the_positions_of_the_motion(reach):
    clip, expected = clip_of(reach, [-0.3, 1.2, 0.4])
    motion = bvh.parse(example.bvh(clip))
    assert motion.skeleton.names == reach.verb.skeleton.names
    assert motion.fps == pytest.approx(FPS)
    positions, skeleton = np.empty((len(motion), len(motion.skeleton), 3)), motion.skeleton
    forward(
        motion.root, motion.rotations, skeleton.parents, skeleton.offsets, np.empty_like(motion.rotations), positions
    )
    for frame in (0, 20, len(expected) - 1):
        np.testing.assert_allclose(example.positions(clip, frame), expected[frame], atol=1e-9)
        np.testing.assert_allclose(positions[frame], expected[frame], atol=1e-6)


def test_a_folder_of_exported_examples_is_a_verb(tmp_path):
    arm = Evaluator(library.load("arm3"))
    head = 'name = "arm"\neffector = "Tip"\neffector_keytime_index = 1\nmeasure = "joint_position"\n'
    head += 'keytime_names = ["start", "reach", "end"]\n[units]\nlength = "m"\n'
    (tmp_path / "verb.toml").write_text(
        head + '[[adverb]]\nname = "x"\nunit = "m"\n[[adverb]]\nname = "y"\nunit = "m"\n'
    )
    for k, values in enumerate(arm.verb.values):
        clip, positions = clip_of(arm, values)
        last = len(positions) - 1
        middle = last // 2
        keytimes = example.keytimes_of([("end", last), ("start", 0), ("reach", middle)], 0, FPS)
        assert keytimes == sorted(keytimes)
        x, y, _ = positions[middle][-1]
        example.save_example(tmp_path, f"example_{k}", clip, keytimes, [x, y])
    assert len(tomllib.loads((tmp_path / "verb.toml").read_text())["example"]) == 9
    built = build(tmp_path)
    assert built.verb.skeleton.names == arm.verb.skeleton.names
    assert not [warning for warning in built.warnings if "differs" in warning]


def test_an_example_is_not_overwritten(tmp_path, reach):
    clip, _ = clip_of(reach, [-0.3, 1.2, 0.4])
    (tmp_path / "verb.toml").touch()
    example.save_example(tmp_path, "one", clip, [0.0, 1.0], [0.0])
    with pytest.raises(ValueError, match="exists"):
        example.save_example(tmp_path, "one", clip, [0.0, 1.0], [0.0])


def test_a_folder_without_a_source_gets_no_file(tmp_path, reach):
    clip, _ = clip_of(reach, [-0.3, 1.2, 0.4])
    with pytest.raises(ValueError, match=r"verb\.toml"):
        example.save_example(tmp_path, "one", clip, [0.0, 1.0], [0.0])
    assert not list(tmp_path.iterdir())


def test_markers_of_an_earlier_motion_are_replaced():
    names = ["start", "apex", "end"]
    markers = [("start", 1), ("apex", 20), ("end", 45), ("music", 20), ("start", 50), ("apex", 70), ("end", 90)]
    assert example.stale_markers(markers, names, 1) == [0, 1, 2]
    assert example.stale_markers(markers, names, 50) == [4, 5, 6]
    assert example.stale_markers(markers, names, 100) == []


@pytest.mark.parametrize(
    ("markers", "part"),
    [([("a", 1)], "at least"), ([("a", 0), ("b", 4)], "before"), ([("a", 2), ("b", 2)], "same frame")],
)
def test_wrong_markers_are_errors(markers, part):
    with pytest.raises(ValueError, match=part):
        example.keytimes_of(markers, 1, FPS)
