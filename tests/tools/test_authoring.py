"""The authored sources: regenerated alike, true to their tables, and fit to be looked at."""

import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tools.authoring import __main__ as author
from tools.authoring import arm3, hands, legs, reach, solver, timing
from tools.authoring.humanoid import foot_outline, humanoid, mirror_name, support_gap
from tools.authoring.source import write
from verbs import library
from verbs.authoring import source as sources
from verbs.errors import UnknownName, VerbError
from verbs.figures import draw
from verbs.io import bvh
from verbs.kernels import fk, quat

LIBRARY = Path(library.__file__).parent
REACHES = tuple(reach.targets())


@cache
def committed(verb, name):
    """A committed example with all that the checks look at."""
    example = next(each for each in sources.read(LIBRARY / verb).examples if each.name == name)
    motion = bvh.read(example.file)
    skeleton = motion.skeleton
    turns, positions = fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)
    frames = np.array(example.keytimes) * motion.fps
    return SimpleNamespace(
        example=example, motion=motion, skeleton=skeleton, turns=turns, positions=positions, frames=frames
    )


def numbers(path):
    """Every number and every other word of a BVH file."""
    words = path.read_text().split()
    values = [float(word) for word in words if word.lstrip("-")[:1].isdigit()]
    return np.array(values), [word for word in words if not word.lstrip("-")[:1].isdigit()]


def test_arm3_regenerates_to_the_committed_bytes(tmp_path, capsys):
    author.main(["arm3", "--out", str(tmp_path)])
    files = sorted(path.name for path in (tmp_path / "arm3").iterdir())
    assert files == sorted(path.name for path in (LIBRARY / "arm3").iterdir())
    for name in files:
        assert (tmp_path / "arm3" / name).read_bytes() == (LIBRARY / "arm3" / name).read_bytes(), name
    assert capsys.readouterr().err.count("arm3: ") == 9


def test_reach_regenerates_to_the_committed_numbers(tmp_path):
    names = ["low_side_far", "high_across_near"]
    list(write(reach.source(names), tmp_path / "first"))
    list(write(reach.source(names[1:]), tmp_path / "second"))
    same = f"{names[1]}.bvh"
    assert (tmp_path / "first" / same).read_bytes() == (tmp_path / "second" / same).read_bytes()
    for name in names:
        fresh, fresh_words = numbers(tmp_path / "first" / f"{name}.bvh")
        kept, kept_words = numbers(LIBRARY / "reach" / f"{name}.bvh")
        assert fresh_words == kept_words
        # Another processor may round the last of 5 decimals otherwise: sums in BLAS have no fixed order.
        np.testing.assert_allclose(fresh, kept, rtol=0, atol=1.01e-5)


def test_writing_removes_examples_that_are_gone(tmp_path):
    (tmp_path / "old.bvh").write_text("gone")
    (tmp_path / "notes.txt").write_text("kept")
    list(write(arm3.source(), tmp_path))
    assert not (tmp_path / "old.bvh").exists()
    assert (tmp_path / "notes.txt").exists()


def test_unknown_verb_names_those_that_exist(capsys):
    with pytest.raises(SystemExit):
        author.main(["arm4"])
    assert f"unknown verb arm4; known: {', '.join(author.VERBS)}" in capsys.readouterr().err


def test_arm3_holds_table_a9_exactly():
    # The grid of methods.md, table A9; its tips are where the rounded angles lead, so within 1e-4 m of it.
    grid = [(x, y) for y in (-0.45, 0.0, 0.45) for x in (0.15, 0.45, 0.75)]
    described = sources.read(LIBRARY / "arm3")
    assert described.rotations == "rotation_vector"
    for example, (name, angles), point in zip(described.examples, arm3.POSES_RAD.items(), grid, strict=True):
        it = committed("arm3", example.name)
        assert example.name == name
        np.testing.assert_allclose(it.frames, np.round(it.frames), atol=1e-9)
        start, apex, end = np.round(it.frames).astype(int)
        vectors = quat.log(it.motion.rotations)
        np.testing.assert_allclose(vectors[apex, :3, 2], angles, rtol=0, atol=1e-9)
        np.testing.assert_allclose(vectors[[start, end], :3, 2], [arm3.REST_RAD] * 2, rtol=0, atol=1e-9)
        assert not vectors[..., :2].any()
        assert end == len(it.motion) - 1
        np.testing.assert_allclose(example.values, arm3.tip(np.array(angles)), rtol=0, atol=1e-9)
        np.testing.assert_allclose(example.values, point, rtol=0, atol=1e-4)
        np.testing.assert_allclose(it.positions[apex, 3], [*example.values, 0.0], rtol=0, atol=1e-9)


def test_arm3_takes_longer_to_go_farther():
    rest = arm3.tip(np.array(arm3.REST_RAD))
    travel = [np.linalg.norm(arm3.tip(np.array(angles)) - rest) for angles in arm3.POSES_RAD.values()]
    out = [committed("arm3", name).frames[1] for name in arm3.POSES_RAD]
    assert (np.diff(np.array(out)[np.argsort(travel)]) >= 0).all()


@pytest.mark.parametrize("name", REACHES)
def test_reach_meets_its_target_at_the_apex(name):
    it = committed("reach", name)
    np.testing.assert_allclose(it.frames, np.round(it.frames), atol=1e-9)
    wrist = it.positions[round(it.frames[1]), it.skeleton.index("RightHand")]
    assert np.linalg.norm(wrist - reach.targets()[name]) < 1e-4
    np.testing.assert_allclose(it.example.values, wrist, rtol=0, atol=1e-8)
    assert 1.6 <= it.motion.duration_s <= 2.6


@pytest.mark.parametrize("name", REACHES)
def test_reach_keeps_feet_planted_and_the_body_over_them(name):
    it = committed("reach", name)
    figure = humanoid()
    feet = figure.joints("LeftFoot", "RightFoot")
    soles = foot_outline(it.positions[:, feet], it.turns[:, feet])
    assert np.abs(soles - soles[0]).max() < 1e-4  # a tenth of a millimetre, toes and heels included
    assert np.abs(soles[..., 1]).max() < 1e-4
    gap = support_gap(soles[0].reshape(-1, 3), figure.centre_of_mass(it.positions))
    assert gap.max() < -0.05  # well inside the feet on every frame


@pytest.mark.parametrize("name", REACHES)
def test_reach_bends_joints_only_as_people_do(name):
    it = committed("reach", name)
    vectors = np.degrees(quat.log(it.motion.rotations))
    knees = vectors[:, humanoid().joints("LeftLeg", "RightLeg")]
    assert 3.0 < knees[..., 0].min() < knees[..., 0].max() < 120.0
    assert np.abs(knees[..., 1:]).max() < 1e-3  # a hinge
    elbows = quat.rotate(it.motion.rotations[:, it.skeleton.index("RightForeArm")], np.array([-1.0, 0.0, 0.0]))
    bend = np.degrees(np.arctan2(elbows[:, 2], -elbows[:, 0]))
    assert 5.0 < bend.min() < bend.max() < 140.0  # never straight, never backward
    neck = np.linalg.norm(vectors[:, humanoid().joints("Neck", "Head")], axis=-1)
    assert neck.max() < 50.0


@pytest.mark.parametrize("name", REACHES)
def test_reach_moves_without_pops_and_ends_as_it_began(name):
    motion = committed("reach", name).motion
    speeds = quat.log(quat.mul(quat.conjugate(motion.rotations[:-1]), motion.rotations[1:])) * motion.fps
    accelerations = np.diff(speeds, axis=0) * motion.fps
    assert np.linalg.norm(speeds, axis=-1).max() < 5.0  # rad/s
    assert np.linalg.norm(accelerations, axis=-1).max() < 40.0  # rad/s²
    assert np.linalg.norm(speeds[[0, -1]], axis=-1).max() < 0.05
    ends = quat.log(quat.mul(quat.conjugate(motion.rotations[0]), motion.rotations[-1]))
    assert np.abs(ends).max() < 1e-6
    assert np.abs(motion.root[0] - motion.root[-1]).max() < 1e-9


def test_reach_poses_change_smoothly_with_the_target():
    # A line of targets through the bending of the knees, where a solver without a preference flips.
    places = reach.targets()
    shares = np.linspace(0.10, 0.25, 4)
    line = [(1 - s) * places["low_outward_near"] + s * places["high_forward_far"] for s in shares]
    poses = np.array([reach.apex(humanoid(), target) for target in line])
    steps = np.abs(np.diff(poses, axis=0))
    assert np.degrees(steps.max()) < 12.0  # per 6 cm of target
    assert np.abs(np.diff(poses, 2, axis=0)).max() < 0.5 * steps.max()


def test_rest_pose_is_symmetric_planted_and_balanced():
    figure = humanoid()
    turns, positions = figure.forward(figure.rest)
    names = figure.skeleton.names
    mirrored = positions[[names.index(mirror_name(name)) for name in names]] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(positions, mirrored, atol=1e-8)
    crown = positions[names.index("Head"), 1] + 0.17
    assert 1.70 < crown < 1.80
    assert figure.mass_shares.sum() == pytest.approx(1.0)
    feet = figure.joints("LeftFoot", "RightFoot")
    outline = foot_outline(positions[feet], turns[feet]).reshape(-1, 3)
    assert support_gap(outline, figure.centre_of_mass(positions)) < -0.08


@pytest.mark.parametrize("name", hands.SHAPES)
def test_hands_take_a_shape_alike_on_both_sides_and_relax_again(name):
    figure = humanoid()
    rotations = figure.rest.rotations[None]
    for side in ("Left", "Right"):
        rotations = hands.shape(figure, rotations, side, name, np.ones(1))
    poses = draw.points(figure.skeleton, figure.rest.root[None], rotations)[0]
    names = [*figure.skeleton.names, *(figure.skeleton.names[k] + "Tip" for k in figure.skeleton.tip_parents)]
    mirrored = poses[[names.index(mirror_name(each)) for each in names]] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(poses, mirrored, atol=1e-8)
    wrist, knuckle, tip = (poses[names.index(f"RightHand{part}")] for part in ("", "Middle1", "Middle2Tip"))
    reach_of_hand = np.linalg.norm(tip - wrist) / np.linalg.norm(knuckle - wrist)
    assert reach_of_hand < 0.7 if name == "fist" else reach_of_hand > 1.3
    for side in ("Left", "Right"):
        rotations = hands.shape(figure, rotations, side, "relaxed", np.ones(1))
    np.testing.assert_allclose(quat.align(rotations[0], figure.rest.rotations), figure.rest.rotations, atol=1e-9)


def test_unknown_hand_shape_names_those_that_exist():
    figure = humanoid()
    with pytest.raises(UnknownName, match="relaxed, open, flat, pinch, fist"):
        hands.shape(figure, figure.rest.rotations[None], "Left", "claw", np.ones(1))


def test_solver_meets_hard_terms_and_spends_least_effort():
    figure = humanoid()
    wrist = figure.joints("RightHand")
    target = figure.forward(figure.rest)[1][wrist] + [0.0, 0.2, 0.2]
    terms = [solver.posture(figure), solver.limits(figure)]
    values = solver.solve(figure, terms, [solver.place(wrist, target)])
    assert np.abs(figure.forward(solver.pose(figure, values))[1][wrist] - target).max() < 1e-9
    locked = figure.stiffness.ravel() == 0
    assert not solver.vectors(figure, values).reshape(-1)[locked].any()
    again = solver.solve(figure, terms, [solver.place(wrist, target)], start=values + 0.02)
    np.testing.assert_allclose(again, values, atol=1e-7)


def test_solver_says_when_constraints_cannot_be_met():
    figure = humanoid()
    far = np.array([[0.0, 9.0, 0.0]])
    hands_and_feet = [solver.place(figure.joints(name), far) for name in ("LeftFoot", "RightFoot")]
    pinned = solver.place(figure.joints("RightHand"), -far)
    with pytest.raises(RuntimeError, match="no pose found"):
        solver.solve(figure, [solver.posture(figure)], [*hands_and_feet, pinned])


def test_planted_legs_leave_solved_poses_alone():
    figure = humanoid()
    turns, positions = figure.forward(figure.rest)
    foot = figure.skeleton.index("LeftFoot")
    rotations = legs.plant(
        figure, figure.rest.root[None], figure.rest.rotations[None], "Left", positions[foot], turns[foot]
    )
    np.testing.assert_allclose(quat.align(rotations[0], figure.rest.rotations), figure.rest.rotations, atol=1e-7)


def test_ease_starts_and_ends_at_rest():
    times = np.linspace(-0.1, 1.1, 121)
    progress = timing.ease(times)
    assert progress[0] == 0.0
    assert progress[-1] == 1.0
    assert (np.diff(progress) >= 0).all()
    assert timing.ease(0.5) == pytest.approx(0.5)
    assert timing.there_and_back(np.array([0.0, 1.0, 2.0]), (0.1, 0.9), (0.2, 1.0)) == pytest.approx([0, 1, 0])
    assert timing.bump(np.array([0.0, 0.5, 1.0])) == pytest.approx([0, 1, 0])


@pytest.mark.parametrize(("verb", "name"), [("arm3", "high_far"), ("reach", "low_side_far")])
@pytest.mark.parametrize("layout", ["row", "onion"])
def test_pictures_are_drawn(tmp_path, verb, name, layout):
    pytest.importorskip("matplotlib")
    motion = committed(verb, name).motion
    poses = draw.points(motion.skeleton, motion.root, motion.rotations)
    assert poses.shape == (len(motion), len(motion.skeleton) + len(motion.skeleton.tip_parents), 3)
    path = tmp_path / "picture.png"
    draw.draw_poses(
        motion.skeleton,
        list(poses[::30]),
        path,
        layout=layout,
        labels=["first"],
        marks=[poses[0, 0]],
        trace=poses[:, 3],
    )
    assert path.read_bytes().startswith(b"\x89PNG")
    draw.draw_poses(motion.skeleton, list(poses[:1, : len(motion.skeleton)]), path, view="side")


def test_drawing_names_what_exists_and_what_to_install(tmp_path, monkeypatch):
    figure = humanoid()
    poses = [figure.forward(figure.rest)[1]]
    with pytest.raises(UnknownName, match="known: front, side"):
        draw.draw_poses(figure.skeleton, poses, tmp_path / "a.png", view="above")
    with pytest.raises(UnknownName, match="known: row, onion"):
        draw.draw_poses(figure.skeleton, poses, tmp_path / "a.png", layout="heap")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(VerbError, match=r"adverb\[figures\]"):
        draw.draw_poses(figure.skeleton, poses, tmp_path / "a.png")
