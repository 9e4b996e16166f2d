"""Limbs in closed form: they meet their targets, and refuse what is out of reach."""

import numpy as np
import pytest

from tools.authoring import rig, strike
from tools.authoring.humanoid import humanoid
from verbs.kernels import fk, quat

LEVEL = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
DOWN = np.tile([0.0, -1.0, 0.0], (2, 1))
AHEAD = np.tile([0.0, 0.0, 1.0], (2, 1))


def standing():
    """Figure, root (2, 3) a little low, and rotations (2, J, 4) of an upright trunk."""
    figure = humanoid()
    root = np.tile(figure.rest.root - [0.0, 0.1, 0.0], (2, 1))
    rotations = rig.trunk(figure, strike.blank(figure, 2), LEVEL, LEVEL)
    return figure, root, rig.head(figure, rotations, LEVEL, LEVEL)


def positions(figure, root, rotations):
    return fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)


@pytest.mark.parametrize(("side", "sign"), [("Left", 1.0), ("Right", -1.0)])
def test_arm_reaches_the_target_with_the_elbow_toward_the_pole(side, sign):
    figure, root, rotations = standing()
    targets = np.array([[sign * 0.25, 1.2, 0.3], [sign * 0.1, 1.4, 0.35]])
    turns = np.tile([0.4, 0.1, -0.1], (2, 1))
    solved = rig.arm(figure, root, rotations, side, targets, DOWN, turns)
    placed = positions(figure, root, solved)[1]
    upper, elbow, wrist = figure.joints(side + "Arm", side + "ForeArm", side + "Hand")
    np.testing.assert_allclose(placed[:, wrist], targets, atol=1e-9)
    straight = 0.5 * (placed[:, upper] + placed[:, wrist])
    assert (placed[:, elbow, 1] < straight[:, 1] - 0.05).all()
    hinge = quat.log(rig.arm(figure, root, rotations, side, targets, DOWN, 0 * turns)[:, elbow])
    assert np.abs(hinge[:, [0, 2]]).max() < 1e-9
    both = quat.mul(solved[:, elbow], solved[:, wrist])
    plain = quat.mul(quat.exp(hinge), quat.exp(turns))
    np.testing.assert_allclose(quat.align(both, plain), plain, atol=1e-9)


@pytest.mark.parametrize(("side", "sign"), [("Left", 1.0), ("Right", -1.0)])
def test_leg_stands_on_its_ball_with_level_toes(side, sign):
    figure, root, rotations = standing()
    balls = np.array([[sign * 0.12, 0.02, 0.1], [sign * 0.12, 0.02, 0.2]])
    ankles, feet, rotations = rig.feet_on_balls(balls, np.zeros(2), np.array([0.0, 0.6]), figure, rotations, side)
    turned, placed = positions(figure, root, rig.leg(figure, root, rotations, side, ankles, feet, AHEAD))
    toe, knee, hip = figure.joints(side + "ToeBase", side + "Leg", side + "UpLeg")
    np.testing.assert_allclose(placed[:, toe], balls, atol=1e-9)
    np.testing.assert_allclose(quat.rotate(turned[:, toe], AHEAD)[:, 1], 0.0, atol=1e-9)
    assert ankles[0, 1] == pytest.approx(0.075)
    assert ankles[1, 1] > 0.12
    assert (placed[:, knee, 2] > 0.5 * (placed[:, hip, 2] + ankles[:, 2]) + 0.05).all()


def test_a_target_out_of_reach_is_an_error():
    figure, root, rotations = standing()
    far = np.tile([0.0, 1.2, 2.0], (2, 1))
    with pytest.raises(RuntimeError, match="a limb of 0.555 m reaches for"):
        rig.arm(figure, root, rotations, "Left", far, DOWN, np.zeros((2, 3)))


def test_legs_limit_the_height_of_the_root_and_of_free_feet():
    figure, root, rotations = standing()
    ankles = np.array([[0.1, 0.075, 0.3], [0.1, 0.075, 0.0]])
    high = root + np.array([0.0, 0.3, 0.0])
    lowered = rig.leg_limit(figure, high, LEVEL, {"Left": ankles}, np.radians(10.0))
    solved = rig.leg(figure, lowered, rotations, "Left", ankles, LEVEL, AHEAD)
    knees = np.degrees(np.linalg.norm(quat.log(solved[:, figure.skeleton.index("LeftLeg")]), axis=-1))
    assert (knees > 9.9).all()
    assert (knees < 20.0).all()
    pulled = rig.within_reach(figure, high, rotations, "Left", ankles, np.radians(10.0))
    assert (pulled[:, 1] > ankles[:, 1] + 0.1).all()
    near = rig.within_reach(figure, root - [0.0, 0.2, 0.0], rotations, "Left", ankles, np.radians(10.0))
    np.testing.assert_allclose(near, ankles, atol=1e-4)


def test_a_stroke_is_at_its_top_once_and_a_shock_fades():
    times = np.linspace(-1.0, 1.0, 2001)
    progress = strike.stroke(times, (-0.16, 0.012), (-0.014, 0.31))
    assert progress.max() == pytest.approx(1.0, abs=1e-4)
    assert abs(times[np.argmax(progress)]) < 0.01
    assert progress[[0, -1]] == pytest.approx([0.0, 0.0])
    wave = strike.shock(times, 0.0)
    assert not wave[times <= 0.0].any()
    assert np.abs(wave).max() < 1.0
    assert np.abs(wave[times > 0.5]).max() < 1e-3
