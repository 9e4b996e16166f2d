"""Authored gaits: feet stand, loops close, curves are the published ones, bodies fall and lean by physics."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tools.authoring import gait_fit, gait_table, jog, locomotion, mood, walk
from tools.authoring.gait import leg_angles
from tools.authoring.gait_model import GRAVITY, KEYTIME_NAMES
from tools.authoring.humanoid import humanoid
from tools.authoring.source import write
from verbs import library
from verbs.authoring import source as sources
from verbs.authoring.fit import build
from verbs.clips.feet import point_positions
from verbs.contacts import PARTS
from verbs.io import bvh
from verbs.kernels import fk, quat

LIBRARY = Path(library.__file__).parent
EXAMPLES = {"locomotion": locomotion.PATHS, "jog": jog.PATHS, "mood": mood.GRID, "walk": walk.GRID}
ALL = [(verb, name) for verb, examples in EXAMPLES.items() for name in examples]
HUMAN = [(verb, name) for verb, name in ALL if verb != "walk"]
RUNS = [
    ("locomotion", "jog"),
    ("locomotion", "run"),
    ("locomotion", "run_fast"),
    *(("jog", name) for name in jog.PATHS),
]


@cache
def source_of(verb):
    return sources.read(LIBRARY / verb)


@cache
def committed(verb, name):
    """A committed example, with its positions over two cycles."""
    example = next(each for each in source_of(verb).examples if each.name == name)
    motion = bvh.read(example.file)
    body, frames = motion.skeleton, len(motion) - 1
    change = quat.mul(motion.rotations[-1, 0], quat.conjugate(motion.rotations[0, 0]))
    turn = quat.exp(np.array([0.0, 2.0 * np.arctan2(change[1], change[3]), 0.0]))
    root = np.concatenate([motion.root[:-1], quat.rotate(turn, motion.root - motion.root[0]) + motion.root[-1]])
    after = motion.rotations.copy()
    after[:, 0] = quat.mul(turn, after[:, 0])
    rotations, positions = fk.forward(root, np.concatenate([motion.rotations[:-1], after]), body.parents, body.offsets)
    return SimpleNamespace(
        example=example, motion=motion, body=body, frames=frames, turn=turn, rotations=rotations, positions=positions,
        keytimes=np.array(example.keytimes),
    )  # fmt: skip


def point_of(it, foot, part):
    """Path of a part of a foot over two cycles."""
    toe = it.body.index(
        foot.replace("Foot", "ToeBase") if "LeftToeBase" in it.body.names else foot.replace("Foot", "Toe")
    )
    ball = it.body.offsets[toe]
    tip = it.body.tip_offsets[list(it.body.tip_parents).index(toe)]
    joint, offset = {
        "heel": (it.body.index(foot), np.array([0.0, ball[1], -0.3 * ball[2]])),
        "ball": (toe, np.zeros(3)),
        "toe": (toe, tip),
    }[part]
    return point_positions(it.rotations, it.positions, joint, offset)


def stances(verb, name):
    """Foot, part and frames of every stance that the source states."""
    it = committed(verb, name)
    for contact in source_of(verb).contacts:
        for begin, end in contact.intervals[name]:
            last = end if end > begin else end + it.motion.duration_s
            first, stop = np.ceil(begin * it.motion.fps + 0.01), np.floor(last * it.motion.fps - 0.01)
            yield contact.joint, contact.part, np.arange(int(first), int(stop) + 1)


@pytest.mark.parametrize(("verb", "name"), ALL)
def test_standing_feet_stay_where_they_are(verb, name):
    it, count = committed(verb, name), 0
    for foot, part, frames in stances(verb, name):
        path = point_of(it, foot, part)[frames]
        assert np.linalg.norm(path - path.mean(axis=0), axis=1).max() < 0.001, (foot, part)
        count += len(frames)
    assert count > 0.2 * it.frames


@pytest.mark.parametrize(("verb", "name"), HUMAN)
def test_feet_stay_above_the_ground(verb, name):
    it = committed(verb, name)
    for foot in ("LeftFoot", "RightFoot"):
        for part in ("heel", "ball", "toe"):
            assert point_of(it, foot, part)[:, 1].min() > 0.0185, "a point that stands is 20 mm up"


@pytest.mark.parametrize(("verb", "name"), ALL)
def test_the_last_frame_is_the_first_one_moved(verb, name):
    it = committed(verb, name)
    last, first = it.motion.rotations[-1].copy(), it.motion.rotations[0]
    last[0] = quat.mul(quat.conjugate(it.turn), last[0])
    assert np.degrees(np.abs(quat.log(quat.mul(quat.conjugate(first), last))).max()) < 0.01
    joint = np.linalg.norm(np.diff(it.positions, 2, axis=0), axis=-1).max(axis=1) * it.motion.fps**2
    assert joint[it.frames - 2 : it.frames + 1].max() <= joint.max(), "the seam is not the jerkiest place"
    assert joint[it.frames - 2 : it.frames + 1].max() < 140.0


@pytest.mark.parametrize(("verb", "name"), HUMAN)
def test_knees_bend_forward_and_never_lock(verb, name):
    it = committed(verb, name)
    knees = quat.log(it.motion.rotations[:, humanoid().joints("LeftLeg", "RightLeg")])
    assert np.abs(knees[..., 1:]).max() < 1e-4, "a hinge"
    assert 2.0 < np.degrees(knees[..., 0].min()) < np.degrees(knees[..., 0].max()) < 125.0


def closest(it, one, other):
    """Least distance between two bones, each from a joint to another, over all frames."""
    shares = np.linspace(0.0, 1.0, 10)[:, None]
    ends = [[it.positions[: it.frames, None, it.body.index(name)] for name in bone] for bone in (one, other)]
    first, second = (start + (end - start) * shares for start, end in ends)
    return np.linalg.norm(first[:, :, None] - second[:, None], axis=-1).min()


@pytest.mark.parametrize(("verb", "name"), HUMAN)
def test_limbs_do_not_pass_through_each_other(verb, name):
    it = committed(verb, name)
    bones = [("Leg", "Foot"), ("Foot", "ToeBase")]
    for one in bones:
        for other in bones:
            left, right = tuple(f"Left{end}" for end in one), tuple(f"Right{end}" for end in other)
            assert closest(it, left, right) > 0.06, (one, other)
    for side in ("Left", "Right"):
        arm, thigh = (f"{side}ForeArm", f"{side}HandMiddle1"), (f"{side}UpLeg", f"{side}Leg")
        assert closest(it, arm, thigh) > 0.06


@pytest.mark.parametrize("speed", [*gait_fit.WALKS, *gait_fit.RUNS])
def test_fitted_gaits_move_as_published(speed):
    gait = gait_table.run(speed) if speed in gait_fit.RUNS else gait_table.walk(speed)
    rms = gait_fit.errors(gait, speed)
    assert len(rms) == 3
    assert max(rms.values()) < 10.0, rms


def test_stance_knees_of_a_walk_are_nearly_straight():
    knee = leg_angles(gait_table.walk(1.3), 1.3, 100)["knee"]
    assert 2.0 < knee[25:45].mean() < 14.0
    assert 55.0 < knee[60:90].max() < 72.0


@pytest.mark.parametrize(("verb", "name"), RUNS)
def test_runners_fall_freely_between_steps(verb, name):
    it = committed(verb, name)
    height = humanoid().centre_of_mass(it.positions)[:, 1]
    acceleration = np.diff(height, 2) * it.motion.fps**2
    held = np.zeros(len(height), bool)
    for _, _, frames in stances(verb, name):
        for shift in (-it.frames, 0, it.frames):
            near = np.concatenate([frames - 1, frames, frames + 1]) + shift
            held[near[(near >= 0) & (near < len(held))]] = True
    flying = ~held[1:-1]
    assert flying.sum() > 0.1 * len(flying)
    np.testing.assert_allclose(acceleration[flying], -GRAVITY, rtol=0.1)


@pytest.mark.parametrize(
    ("verb", "name"),
    [("locomotion", "run_arc_left"), ("locomotion", "run_arc_right"), ("jog", "brisk_left"), ("jog", "easy_right")],
)
def test_runners_lean_into_a_curve(verb, name):
    it, (speed, turn, _) = committed(verb, name), EXAMPLES[verb][name]
    centre = humanoid().centre_of_mass(it.positions)
    leans = []
    for foot, part, frames in stances(verb, name):
        if part == "ball":
            middle = frames[len(frames) // 2]
            heading = turn * middle / it.motion.fps
            left = np.array([np.cos(heading), 0.0, -np.sin(heading)])
            gap = centre[middle] - point_of(it, foot, part)[middle]
            leans.append(np.arctan2(gap @ left, gap[1]))
    assert np.mean(leans) == pytest.approx(np.arctan(speed * turn / GRAVITY), abs=np.radians(4.0))


def momentum(it, parts):
    """Angular momentum (F,) of some joints about the vertical through the centre of mass, per unit of body mass."""
    share = humanoid().mass_shares
    joints = [k for k, name in enumerate(it.body.names) if any(part in name for part in parts)]
    about = it.positions - humanoid().centre_of_mass(it.positions)[:, None]
    moving = np.gradient(about, 1.0 / it.motion.fps, axis=0)
    turning = about[..., 2] * moving[..., 0] - about[..., 0] * moving[..., 2]
    return (turning[:, joints] * share[joints]).sum(axis=1)


@pytest.mark.parametrize("name", ["walk_slow", "walk", "walk_fast", "jog", "run", "run_fast"])
def test_arms_swing_against_the_legs(name):
    it = committed("locomotion", name)
    arms, legs = momentum(it, ("Arm", "Hand")), momentum(it, ("Leg", "Foot", "Toe"))
    assert np.corrcoef(arms[: it.frames], legs[: it.frames])[0, 1] < -0.8


@pytest.mark.parametrize(
    ("name", "low", "high"), [("walk_slow", 28, 58), ("walk", 40, 80), ("jog", 52, 100), ("run_fast", 80, 150)]
)
def test_peak_accelerations_are_those_of_people(name, low, high):
    it = committed("locomotion", name)
    body = [k for k, joint in enumerate(it.body.names) if "HandMiddle" not in joint and "Thumb" not in joint]
    slow = it.positions[::2, body]  # 30 frames a second, as the captures that the limits come from
    assert low < np.linalg.norm(np.diff(slow, 2, axis=0), axis=-1).max() * 900.0 < high


@pytest.mark.parametrize("name", ["walk", "run"])
def test_sides_and_strides_differ_a_little(name):
    it = committed("locomotion", name)
    left, right = (
        np.degrees(quat.log(it.motion.rotations[:-1, it.body.index(f"{side}Leg")])[:, 0]) for side in ("Left", "Right")
    )
    half = it.frames // 2
    assert 0.2 < np.sqrt(np.mean((left[:half] - left[half : 2 * half]) ** 2)) < 8.0, "strides"
    assert 0.5 < np.sqrt(np.mean((left - np.roll(right, it.frames // 4)) ** 2)) < 12.0, "sides"


def test_a_body_at_rest_breathes_and_sways_on_standing_feet():
    it = committed("locomotion", "idle")
    moved = np.ptp(it.positions, axis=0).max(axis=1)
    feet = [it.body.index(f"{side}{part}") for side in ("Left", "Right") for part in ("Foot", "ToeBase")]
    assert moved[feet].max() < 1e-4
    assert (np.delete(moved, feet) > 0.002).all(), "nothing is frozen"
    assert moved.max() < 0.08
    speed = np.linalg.norm(np.diff(it.positions[:, it.body.index("Head")], axis=0), axis=1) * it.motion.fps
    assert speed.max() < 0.1


@pytest.mark.parametrize(("verb", "name"), [(verb, name) for verb in ("locomotion", "jog") for name in EXAMPLES[verb]])
def test_a_path_is_followed_at_its_speeds(verb, name):
    it, (ahead, turn, side) = committed(verb, name), EXAMPLES[verb][name]
    assert it.example.values == (ahead, turn, side)
    fps, root = it.motion.fps, it.motion.root
    heading = turn * (np.arange(it.frames) + 0.5) / fps
    x, _, z = np.diff(root, axis=0).T * fps
    measured = np.mean(z * np.cos(heading) + x * np.sin(heading)), np.mean(x * np.cos(heading) - z * np.sin(heading))
    np.testing.assert_allclose(measured, (ahead, side), atol=2e-3)


@pytest.mark.parametrize("name", list(walk.GRID))
def test_a_walker_rises_with_the_slope_and_limps_when_it_is_damaged(name):
    it, (slope, damage) = committed("walk", name), walk.GRID[name]
    over, rise = np.hypot(*(it.motion.root[-1] - it.motion.root[0])[[0, 2]]), np.ptp(it.motion.root[[0, -1], 1])
    assert np.sign(it.motion.root[-1, 1] - it.motion.root[0, 1]) == np.sign(slope)
    assert rise / over == pytest.approx(np.tan(np.radians(abs(slope))), abs=1e-4)
    held = {
        side: sum(len(frames) for foot, _, frames in stances("walk", name) if foot == f"{side}Foot")
        for side in ("Left", "Right")
    }
    assert held["Right"] / held["Left"] == pytest.approx(1.0 - 0.18 * damage, abs=0.05)


@pytest.mark.parametrize(("verb", "name"), [("locomotion", "walk"), ("mood", "tired_sad"), ("walk", "up_broken")])
def test_gaits_regenerate_to_the_committed_numbers(tmp_path, verb, name):
    author = {"locomotion": locomotion, "mood": mood, "walk": walk}[verb]
    list(write(author.source([name]), tmp_path))
    fresh, kept = bvh.read(tmp_path / f"{name}.bvh"), committed(verb, name).motion
    np.testing.assert_allclose(fresh.root, kept.root, atol=1e-4)
    np.testing.assert_allclose(quat.align(fresh.rotations, kept.rotations), kept.rotations, atol=1e-5)


def test_moods_differ_in_pace_posture_and_arms():
    def figures(name):
        it = committed("mood", name)
        head, hips = (it.positions[:, it.body.index(joint)] for joint in ("Head", "Hips"))
        speed = (it.motion.root[-1, 2] - it.motion.root[0, 2]) / it.motion.duration_s
        bowed = np.degrees(np.arctan2((head - hips)[:, 2].mean(), (head - hips)[:, 1].mean()))
        return speed, bowed, np.ptp((it.positions[:, it.body.index("LeftHand")] - hips)[:, 2])

    slow, bowed, calm = figures("tired_sad")
    fast, upright, swung = figures("lively_happy")
    assert fast > 1.8 * slow
    assert bowed > upright + 8.0
    assert swung > 2.0 * calm


def test_four_walkers_build_without_warnings(tmp_path):
    names = ["down_whole", "level_whole", "up_broken", "level_broken"]
    list(write(walk.source(names), tmp_path / "walk"))
    built = build(tmp_path / "walk")
    assert built.warnings == ()
    assert built.verb.strides[..., 3].any()
    assert [PARTS[part] for part in built.verb.contacts.parts] == ["ball", "toe", "ball", "toe"]


@pytest.mark.parametrize("verb", list(EXAMPLES))
def test_artifacts_hold_what_the_sources_state(verb):
    built = library.load(verb)
    assert built.examples == tuple(EXAMPLES[verb])
    assert built.looping
    assert list(built.keytime_names) == KEYTIME_NAMES
    np.testing.assert_allclose(built.values, list(EXAMPLES[verb].values()), atol=2e-3)
    if verb != "walk":
        assert built.skeleton.names == humanoid().skeleton.names
    assert built.quality["curve_error_max_m"] < 0.002
