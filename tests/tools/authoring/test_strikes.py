"""Punch, kick, jump and lift as committed: planted feet, order of the body's parts, speeds, flight, balance."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tools.authoring import jump, kick, lift, punch
from tools.authoring.humanoid import humanoid
from tools.authoring.source import write
from verbs import library
from verbs.authoring import source as sources
from verbs.domain import random_points
from verbs.figures.bodies import points
from verbs.io import bvh
from verbs.kernels import fk, quat
from verbs.runtime.evaluate import Evaluator

LIBRARY = Path(library.__file__).parent
MODULES = {"punch": punch, "kick": kick, "jump": jump, "lift": lift}
COUNTS = {"punch": 18, "kick": 18, "jump": 14, "lift": 12}


@cache
def examples(verb):
    """All committed examples of a verb, with positions and global rotations."""
    found = {}
    for example in sources.read(LIBRARY / verb).examples:
        motion = bvh.read(example.file)
        skeleton = motion.skeleton
        turned, placed = fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)
        found[example.name] = SimpleNamespace(
            motion=motion,
            fps=motion.fps,
            turned=turned,
            placed=placed,
            at=skeleton.index,
            low=points(skeleton, motion.root, motion.rotations)[..., 1].min(),
            keys=[round(key * motion.fps) for key in example.keytimes],
            values=example.values,
        )
    return found


def speed(it, joint):
    """Speed (F,) of a joint, m/s."""
    return np.linalg.norm(np.gradient(it.placed[:, it.at(joint)], 1.0 / it.fps, axis=0), axis=-1)


def yaw_rate(it, joint):
    """Rate (F,) at which a joint turns about the vertical, radians per second."""
    ahead = quat.rotate(it.turned[:, it.at(joint)], np.array([0.0, 0.0, 1.0]))
    return np.abs(np.gradient(np.unwrap(np.arctan2(ahead[:, 0], ahead[:, 2])), 1.0 / it.fps))


def bend(it, joint):
    """Angle (F,) of a joint's rotation, degrees."""
    return np.degrees(np.linalg.norm(quat.log(it.motion.rotations[:, it.at(joint)]), axis=-1))


def upward(it):
    """Directions (F, 3) of the chest's axis."""
    return quat.rotate(it.turned[:, it.at("Spine2")], np.array([0.0, 1.0, 0.0]))


def slide(ball):
    """Largest horizontal distance of positions (F, 3) from their mean, metres."""
    return np.linalg.norm((ball - ball.mean(axis=0))[:, [0, 2]], axis=-1).max()


@pytest.mark.parametrize("verb", MODULES)
def test_sources_regenerate_to_the_committed_numbers(verb, tmp_path):
    name = next(iter(examples(verb)))
    list(write(MODULES[verb].source([name]), tmp_path))
    fresh, kept = bvh.read(tmp_path / f"{name}.bvh"), examples(verb)[name].motion
    assert fresh.skeleton.names == kept.skeleton.names
    # The last of 4 decimals may round otherwise on another processor.
    np.testing.assert_allclose(fresh.root, kept.root, rtol=0, atol=2.1e-4)
    np.testing.assert_allclose(quat.align(fresh.rotations, kept.rotations), kept.rotations, rtol=0, atol=1e-5)


@pytest.mark.parametrize("verb", MODULES)
def test_examples_never_sink_nor_lock_a_knee(verb):
    assert len(examples(verb)) == COUNTS[verb]
    for name, it in examples(verb).items():
        assert it.low > 0.0, name
        assert min(bend(it, "LeftLeg").min(), bend(it, "RightLeg").min()) > 10.0, name


@pytest.mark.parametrize("verb", MODULES)
def test_built_verbs_meet_goals_between_their_examples(verb):
    loaded = library.load(verb)
    found = Evaluator(loaded).pose(random_points(loaded, np.random.default_rng(5), 200), phase=0.5)
    assert found.blend.error.max() < 1e-6
    assert (LIBRARY / f"{verb}.verb").stat().st_size < 1.3e6


@pytest.mark.parametrize("verb", ["punch", "kick"])
def test_strikes_end_as_they_began_on_planted_feet(verb):
    for name, it in examples(verb).items():
        ends = quat.log(quat.mul(quat.conjugate(it.motion.rotations[0]), it.motion.rotations[-1]))
        assert np.abs(ends).max() < 1e-4, name
        assert slide(it.placed[:, it.at("LeftToeBase")]) < 1e-3, name
        if verb == "punch":
            assert slide(it.placed[:, it.at("RightToeBase")]) < 1e-3, name


def test_punches_are_fast_with_the_hips_first_and_do_not_dwell():
    peaks = []
    for name, it in examples("punch").items():
        hand = speed(it, "RightHand")
        top, key = int(np.argmax(hand)), it.keys[1]
        peaks.append(hand[top])
        assert 0.05 <= (key - top) / it.fps <= 0.12, name
        order = [int(np.argmax(yaw_rate(it, joint)[: key + 6])) for joint in ("Hips", "Spine2")]
        order += [int(np.argmax(speed(it, joint)[: key + 6])) for joint in ("RightForeArm", "RightHand")]
        assert order[0] < order[1] <= order[2] + 1, name
        assert order[1] < order[3], name
        wrist = it.placed[:, it.at("RightHand")]
        near = np.linalg.norm(wrist - wrist[key], axis=-1) < 0.04
        assert 0.04 <= near.sum() / it.fps <= 0.11, name
        curl = bend(it, "RightHandMiddle2")
        assert curl.min() > 100.0, name
    assert min(peaks) > 5.5
    assert np.median(peaks) > 6.2


def test_low_punches_stoop_and_far_ones_lunge():
    found = examples("punch")
    stoop, upright = (upward(found[name])[found[name].keys[1], 1] for name in ("low_forward_far", "high_forward_near"))
    assert stoop < np.cos(np.radians(35.0)) < upright
    hips = {name: it.placed[it.keys[1], 0] - it.placed[0, 0] for name, it in found.items()}
    assert hips["middle_forward_far"][2] > hips["middle_forward_near"][2] + 0.05
    assert hips["low_forward_far"][1] > -0.30  # not a squat


def test_kicks_leave_the_ground_whip_and_balance_on_one_foot():
    figure = humanoid()
    for name, it in examples("kick").items():
        key = it.keys[1]
        foot, knee = speed(it, "RightFoot"), bend(it, "RightLeg")
        height = it.placed[:, it.at("RightToeBase"), 1]
        up = np.flatnonzero(height > 0.05) / it.fps - key / it.fps
        assert -0.40 < up[0] < -0.25, name
        assert 0.35 < up[-1] < 0.55, name
        before, after = it.placed[: key - 26], it.placed[key + 34 :]
        toe = it.at("RightToeBase")
        assert max(slide(before[:, toe]), slide(after[:, toe])) < 3e-3, name
        assert foot.max() > 3.5, name
        assert knee[key - 15 : key - 4].max() > knee[key] + 35.0 < knee[key + 4 : key + 18].max() + 1.0, name
        mass = figure.centre_of_mass(it.placed[key])
        assert np.linalg.norm((mass - it.placed[key, it.at("LeftFoot")])[[0, 2]]) < 0.12, name
    assert np.median([speed(it, "RightFoot").max() for it in examples("kick").values()]) > 6.0


def test_jumps_fly_as_gravity_has_it_and_land_where_they_aim():
    figure = humanoid()
    for name, it in examples("jump").items():
        leap = jump.leaps()[name]
        plan = jump.plan(leap)
        mass = figure.centre_of_mass(it.placed)
        flight = slice(round(plan.take_off * it.fps) + 2, round(plan.touch_down * it.fps) - 2)
        fall = np.diff(mass[:, 1], 2)[flight] * it.fps**2
        assert np.abs(fall + jump.GRAVITY_M_S2).max() < 0.1 * jump.GRAVITY_M_S2, name
        moved = it.motion.root[-1] - it.motion.root[0]
        aim = leap.distance * np.array([np.sin(leap.direction), np.cos(leap.direction)])
        np.testing.assert_allclose(moved[[0, 2]], aim, atol=1e-3, err_msg=name)
        for side in ("Left", "Right"):
            ball = it.placed[:, it.at(side + "ToeBase")]
            assert slide(ball[: round((plan.take_off - 0.06) * it.fps)]) < 3e-3, name
            assert slide(ball[round((plan.touch_down + 0.06) * it.fps) :]) < 3e-3, name
        assert bend(it, "LeftLeg")[it.keys[1]] > 60.0, name
    highest = {name: it.motion.root[:, 1].max() for name, it in examples("jump").items()}
    assert highest["high_up"] > highest["low_up"] + 0.15


def test_lifts_keep_both_hands_on_the_box():
    for name, it in examples("lift").items():
        left, right = it.placed[:, it.at("LeftHand")], it.placed[:, it.at("RightHand")]
        held = np.linalg.norm(left - right, axis=-1)[it.keys[1] :]
        np.testing.assert_allclose(held, 2 * lift.HALF_GRIP_M, atol=5e-4, err_msg=name)
        assert right[it.keys[1], 0] == pytest.approx(-lift.HALF_GRIP_M, abs=5e-4)
        for side in ("Left", "Right"):
            assert slide(it.placed[:, it.at(side + "ToeBase")]) < 1e-3, name


def test_heavy_lifts_are_slower_closer_and_led_by_the_knees():
    found = examples("lift")
    for name in found:
        if not name.endswith("light"):
            continue
        light, heavy = found[name], found[name.replace("light", "heavy")]
        assert heavy.motion.duration_s > light.motion.duration_s + 0.3, name
        assert heavy.placed[-1, heavy.at("RightHand"), 2] < light.placed[-1, light.at("RightHand"), 2] - 0.05, name
        assert upward(heavy)[-1, 2] < upward(light)[-1, 2] - 0.05 < 0.0, name
    heavy = found["low_far_heavy"]
    start = heavy.keys[1]
    knee, lean = bend(heavy, "LeftLeg")[start:], upward(heavy)[start:, 2]
    assert np.argmax(knee < 0.5 * knee[0]) + 3 < np.argmax(lean < 0.5 * lean[0])
    knees = [bend(found[f"{row}_near_light"], "LeftLeg").max() for row in ("low", "knee", "high")]
    assert knees[0] > knees[1] > knees[2]
