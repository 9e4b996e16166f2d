"""Verbs of rigs whose joints have other local axes, or whose hips move under a root: the same joints move alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.verbs import clip_files
from tests.verbs.living import joints, play
from tests.verbs.sources import example_row, write_source
from verbs import Characters, Evaluator
from verbs.authoring.fit import build
from verbs.clips import orientation
from verbs.io import bvh
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.runtime.sequence import sequence
from verbs.verb import Verb

GAITS = {
    "walk": {"speed": 1.1},
    "run": {"speed": 2.4},
    "left": {"speed": 1.2, "turn": 0.7},
    "right": {"speed": 1.2, "turn": -0.7},
    "strafe": {"speed": 0.9, "side": 0.5},
}
WAVES = {"low": 0.4, "middle": 1.0, "high": 1.8}
COUNT = len(clip_files.BODY)


def rigs(kind: str) -> np.ndarray:
    """New local axes (J, 4) of all joints: X along the spine, other right angles for each joint, or any."""
    rng = np.random.default_rng(7)
    if kind == "spine":
        return np.tile(quat.exp(np.array([0.0, 0.0, 0.5 * np.pi])), (COUNT, 1))
    if kind == "right angles":
        return orientation._CUBE[rng.integers(24, size=COUNT)]
    return quat.normalize(rng.normal(size=(COUNT, 4)))


def wave(angle: float) -> Motion:
    """Stand, lift the left arm, and back."""
    still = clip_files.walk(31, speed=0.0)
    bell = np.sin(np.linspace(0, np.pi, 31)) ** 2
    rotations = np.tile(still.rotations[:1], (31, 1, 1))
    lift = quat.exp(bell[:, None] * np.array([0.0, 0.0, angle]))
    arm = still.skeleton.index("LeftArm")
    rotations[:, arm] = quat.mul(rotations[:, arm], lift)
    rotations[:, 0] = quat.mul(quat.exp(bell[:, None] * np.array([0.0, 0.3, 0.0])), rotations[:, 0])
    return Motion(still.skeleton, 30.0, still.root * [0, 1, 0] + bell[:, None] * [0.0, 0.0, 0.1], rotations)


def loop_source(folder: Path, motions: dict[str, Motion]) -> Path:
    rows = []
    for name, motion in motions.items():
        gait = GAITS[name]
        values = [gait["speed"], gait.get("turn", 0.0), gait.get("side", 0.0)]
        rows.append(example_row(name, [0.0, motion.duration_s / 2, motion.duration_s], values))
    units = {"forward_speed": "m/s", "turn_rate": "rad/s", "side_speed": "m/s"}
    adverbs = "".join(f'[[adverb]]\nname = "{name}"\nunit = "{unit}"\n' for name, unit in units.items())
    head = 'name = "gait"\nlooping = true\nmeasure = "root_velocity"\nkeytime_names = ["left", "right", "end"]\n'
    return write_source(folder, motions, rows, head + adverbs)


def wave_source(folder: Path, motions: dict[str, Motion]) -> Path:
    rows = [example_row(name, [0.0, 0.5, 1.0], [WAVES[name]]) for name in motions]
    head = 'name = "wave"\nkeytime_names = ["start", "top", "end"]\n[[adverb]]\nname = "lift"\nstyle = true\n'
    return write_source(folder, motions, rows, head)


@pytest.fixture(scope="module")
def verbs_of(tmp_path_factory):
    """Builds the loop and the wave of a kind of rig, each once."""
    found: dict[str, tuple[Verb, Verb]] = {}

    def get(kind: str) -> tuple[Verb, Verb]:
        if kind not in found:
            folder = tmp_path_factory.mktemp("rig")
            axes = np.tile([0.0, 0, 0, 1], (COUNT, 1)) if kind == "plain" else rigs(kind)
            gaits = {name: clip_files.rerigged(clip_files.walk(**gait), axes) for name, gait in GAITS.items()}
            waves = {name: clip_files.rerigged(wave(angle), axes) for name, angle in WAVES.items()}
            found[kind] = tuple(
                build(source).verb for source in (loop_source(folder / "l", gaits), wave_source(folder / "w", waves))
            )
        return found[kind]

    return get


KINDS = ["spine", "right angles", "any"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_measures_and_poses_alike(verbs_of, kind):
    plain, rig = verbs_of("plain")[0], verbs_of(kind)[0]
    np.testing.assert_allclose(rig.values, plain.values, atol=2e-6)
    np.testing.assert_allclose(rig.strides, plain.strides, atol=2e-6)
    row = plain.values.mean(axis=0, keepdims=True)
    shown = [sequence(Evaluator(verb), row, 30, cycles=2, plant=False) for verb in (plain, rig)]
    before, after = (joints(verb, one.root, one.rotations) for verb, one in zip((plain, rig), shown, strict=True))
    np.testing.assert_allclose(after, before, atol=2e-5)


def test_the_plain_loop_measures_what_was_walked(verbs_of):
    """Speeds over a whole cycle of about a second; the turn is exact, as the cycles close."""
    values = verbs_of("plain")[0].values
    np.testing.assert_allclose(values[:, 1], [gait.get("turn", 0.0) for gait in GAITS.values()], atol=1e-6)
    np.testing.assert_allclose(values[:, 0], [gait["speed"] for gait in GAITS.values()], rtol=0.02)


def played(first: Verb, second: Verb, *, plant: bool) -> np.ndarray:
    """Joint positions (F, J, 3) of a stream: loop, wave, loop."""
    one, two = Characters(Evaluator(first)), Characters(Evaluator(second))
    shown = []

    def run(people, slot, verb, frames):
        root, rotations, _ = play(people, slot, frames)
        shown.append(joints(verb, root[:, 0], rotations[:, 0]))

    slot = one.add(first.values[2], plant=plant)
    run(one, slot, first, 80)
    other = two.go_on(one, slot, second.values[1], transition_s=0.4)
    run(two, other, second, 40)
    run(one, one.go_on(two, other, first.values[0], transition_s=0.4), first, 60)
    return np.concatenate(shown)


@pytest.mark.parametrize("plant", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_switches_of_a_stream_show_the_same_joints(verbs_of, kind, plant):
    plain, rig = played(*verbs_of("plain"), plant=plant), played(*verbs_of(kind), plant=plant)
    assert np.linalg.norm(plain[-1, 0] - plain[0, 0]) > 1.0
    # Axes at right angles to those of the body are found exactly; for others the heading comes from the posture. A
    # planted foot with a straight knee magnifies rounding to single precision.
    np.testing.assert_allclose(rig, plain, atol=5e-3 if plant or kind == "any" else 2e-6)


def test_hips_under_a_ground_root_build_the_same_loop(verbs_of, tmp_path):
    """One clip whose hips happen to stay under the root among clips whose hips move."""
    motions, folder = {}, tmp_path / "ground"
    for name, gait in GAITS.items():
        motions[name] = clip_files.walk(**gait)
    source = loop_source(folder, motions)
    for name, motion in motions.items():
        bvh.write(motion, folder / f"{name}.bvh", decimals=9)
        head, _, rest = (folder / f"{name}.bvh").read_text().partition("ROOT Hips")
        body, _, table = rest.partition("MOTION\n")
        lines = table.splitlines()
        ground = [[0.0, 0.0, 0.01 * k, 0.0] for k in range(len(motion))]
        hips = motion.root - [[x, y, z] for x, y, z, _ in ground]
        if name == "walk":
            ground, hips = [[*place, 0.0] for place in motion.root], np.zeros((len(motion), 3))
        rows = [
            " ".join(f"{value:.9f}" for value in (*above, *place)) + " " + " ".join(line.split()[3:])
            for above, place, line in zip(ground, hips, lines[2:], strict=True)
        ]
        root = "ROOT Reference\n{\nOFFSET 0 0 0\nCHANNELS 4 Xposition Yposition Zposition Yrotation\nJOINT Hips"
        (folder / f"{name}.bvh").write_text("\n".join([f"{head}{root}{body}}}\nMOTION", *lines[:2], *rows]) + "\n")
    built = build(source)
    np.testing.assert_allclose(built.verb.values, verbs_of("plain")[0].values, atol=1e-6)
    np.testing.assert_allclose(built.verb.curves, verbs_of("plain")[0].curves, atol=1e-5)
    assert built.warnings[0] == "example 'walk' and 4 others: joint 'Reference' is folded into 'Hips', the new root"


def blender(motion: Motion) -> Motion:
    """The motion with +Z up and -Y forward."""
    turn = quat.exp(np.array([0.5 * np.pi, 0.0, 0.0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(turn, motion.root), rotations)


def state_axes(source: Path) -> Path:
    text = (source / "verb.toml").read_text()
    (source / "verb.toml").write_text(f'up_axis = "+Z"\nforward_axis = "-Y"\n{text}')
    return source


def test_motions_with_another_axis_up_are_converted_as_stated(verbs_of, tmp_path):
    motions = {name: blender(clip_files.walk(**gait)) for name, gait in GAITS.items()}
    built = build(state_axes(loop_source(tmp_path / "loop", motions))).verb
    np.testing.assert_allclose(built.values, verbs_of("plain")[0].values, atol=2e-6)
    np.testing.assert_allclose(np.abs(built.curves), np.abs(verbs_of("plain")[0].curves), atol=1e-5)


def test_another_axis_up_is_a_warning_until_it_is_stated(tmp_path):
    source = wave_source(tmp_path / "waves", {name: blender(wave(angle)) for name, angle in WAVES.items()})
    assert "seem to have another axis up: +Z up, -Y forward" in build(source).warnings[0]
    assert not any("another axis up" in warning for warning in build(state_axes(source)).warnings)
