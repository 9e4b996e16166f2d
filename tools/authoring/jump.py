"""The verb ``jump``: from standing, a jump with both feet in any direction before the body, and a landing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from tools.authoring import rig, strike, timing
from tools.authoring.figure import Figure
from tools.authoring.humanoid import humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["GRAVITY_M_S2", "Leap", "leaps", "motion", "plan", "source"]

GRAVITY_M_S2 = 9.81
_DECIMALS = 4
_CROUCH_S = 0.78
_LANDING_S, _AFTER_S = 0.22, 0.72
_TAKE_OFF_M, _TOUCH_DOWN_M = 0.05, -0.04
"""Height of the centre of mass at take-off and touch-down, above that of standing."""

# One side is a little later and weaker than the other, as people are; the same in every example, so blends keep it.
_LAG_S = {"Left": 0.010, "Right": -0.008}
_ARM_LAG_S, _ARM_SHARE = {"Left": 0.022, "Right": 0.0}, {"Left": 0.95, "Right": 1.0}
_YAW_RAD = np.radians(3.5)

_FORWARD = np.array([0.0, 0.0, 1.0])
_STRAIGHTEST_RAD = np.radians(17.0)
"""A foot whose leg is straighter leaves the ground."""

_TOE_OFF_RAD = np.radians(54.0)

# degrees at start, deepest crouch, take-off, in the air, touch-down, deepest landing, end
_TRUNK = (0.0, 40.0, 10.0, 16.0, 20.0, 36.0, 0.0)


@dataclass(frozen=True, slots=True)
class Leap:
    """Where a jump goes: horizontal distance, direction (radians, left positive) and rise of the centre of mass."""

    distance: float
    direction: float
    rise: float


@dataclass(frozen=True, slots=True)
class Plan:
    """Times of take-off, touch-down, deepest landing and end, seconds; speeds of flight, m/s."""

    take_off: float
    touch_down: float
    landed: float
    end: float
    up: float
    along: float


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``jump``, or only some of its examples."""
    known = leaps()
    return Source(
        comment="A standing jump, authored by tools.authoring (python -m tools.authoring jump).",
        keys={
            "name": "jump",
            "description": (
                "From standing, the body crouches, the arms swing, both feet leave the ground and land. The centre of "
                "mass is ballistic in flight. Authored by code, not captured. The figure faces +Z and stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "Hips",
            "effector_keytime_index": -1,
            "measure": "jump",
            "fps": strike.FPS,
            "keytime_names": ["start", "crouch before take-off", "landing crouch", "end"],
        },
        adverbs=(
            Adverb("distance", "m", "horizontal displacement of the root from the first to the last frame"),
            Adverb("direction", "rad", "angle of that displacement from +Z, positive toward +X (left)"),
            Adverb("height", "m", "highest root y minus root y at the first frame"),
        ),
        examples=(Example(name, *motion(known[name])) for name in names or known),
        decimals=_DECIMALS,
    )


def leaps() -> dict[str, Leap]:
    """Names and goals of the 14 examples."""
    places = {
        "up": (0.0, 0.0),
        "forward_near": (0.75, 0.0),
        "forward_far": (1.60, 0.0),
        "left": (1.25, np.radians(45.0)),
        "right": (1.25, np.radians(-45.0)),
        "left_side": (1.00, np.radians(90.0)),
        "right_side": (1.00, np.radians(-90.0)),
    }
    return {
        f"{height}_{name}": Leap(distance, direction, rise)
        for name, (distance, direction) in places.items()
        for height, rise in (("low", 0.17), ("high", 0.38))
    }


def plan(leap: Leap) -> Plan:
    """Speeds and times of a jump: the flight follows from the rise, the rest from the speed."""
    up = np.sqrt(2.0 * GRAVITY_M_S2 * (leap.rise - _TAKE_OFF_M))
    fall = np.sqrt(2.0 * GRAVITY_M_S2 * (leap.rise - _TOUCH_DOWN_M))
    flight = (up + fall) / GRAVITY_M_S2
    push = (_crouch_m(leap) + _TAKE_OFF_M) / (0.56 * up)
    take_off = _CROUCH_S + push
    landed = take_off + flight + _LANDING_S
    return Plan(take_off, take_off + flight, landed, landed + _AFTER_S, float(up), leap.distance / (flight + 0.26))


def motion(leap: Leap) -> tuple[Motion, F64]:
    """Author one jump.

    Returns
    -------
    motion : Motion
    keytimes : (4,) float64
        Start, crouch before take-off, landing crouch, end, seconds; all on frames.
    """
    figure, it = humanoid(), plan(leap)
    frames = np.round(np.array([0.0, _CROUCH_S, it.landed, it.end]) * strike.FPS)
    times = np.arange(frames[-1] + 1) / strike.FPS
    rest = figure.forward(figure.rest)[1]
    path = figure.centre_of_mass(rest) + _mass_path(times, leap, it)
    root = path + figure.rest.root - path[0]
    for _ in range(12):
        rotations = _body(figure, times, root, leap, it)
        positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
        root = root + 1.1 * (path - figure.centre_of_mass(positions))
    rotations = _body(figure, times, root, leap, it)
    return Motion(figure.skeleton, strike.FPS, root, quat.unroll(rotations)), frames / strike.FPS


def _crouch_m(leap: Leap) -> float:
    return 0.10 + 0.32 * leap.rise + 0.02 * leap.distance


def _mass_path(times: F64, leap: Leap, it: Plan) -> F64:
    """Displacement (F, 3) of the centre of mass: smooth on the ground, ballistic in the air."""
    g, fall = GRAVITY_M_S2, it.up - GRAVITY_M_S2 * (it.touch_down - it.take_off)
    depth = -0.44 * fall * _LANDING_S
    low = _TOUCH_DOWN_M - depth
    height = _pieces(
        times,
        [
            (0.22, (0.0, 0.0, 0.0)),
            (_CROUCH_S, (-_crouch_m(leap), 0.0, 7.0)),
            (it.take_off, (_TAKE_OFF_M, it.up, -g)),
            (it.touch_down, (_TOUCH_DOWN_M, fall, -g)),
            (it.landed, (low, 0.0, 9.0)),
            (it.landed + 0.62, (0.004, 0.0, 0.0)),
            (it.end, (0.0, 0.0, 0.0)),
        ],
    )
    away = it.along * (it.touch_down - it.take_off)
    ahead = 0.5 * (leap.distance - away)
    along = _pieces(
        times,
        [
            (0.30, (0.0, 0.0, 0.0)),
            (_CROUCH_S, (0.02 * leap.distance, 0.10 * it.along, 1.0 * it.along)),
            (it.take_off, (ahead, it.along, 0.0)),
            (it.touch_down, (ahead + away, it.along, 0.0)),
            (it.touch_down + 0.36, (leap.distance, 0.0, 0.0)),
            (it.end, (leap.distance, 0.0, 0.0)),
        ],
    )
    small = strike.idle(times, it.end).shift
    toward = np.array([np.sin(leap.direction), 0.0, np.cos(leap.direction)])
    grounded = 1.0 - timing.ease(times, 0.4, _CROUCH_S) + timing.ease(times, it.landed + 0.2, it.end)
    return np.asarray(along[:, None] * toward + height[:, None] * [0.0, 1.0, 0.0] + small * grounded[:, None])


def _pieces(times: F64, knots: list[tuple[float, tuple[float, ...]]]) -> F64:
    """Quintic pieces through values, speeds and accelerations at some times; constant before the first."""
    where = [time for time, _ in knots]
    curve = BPoly.from_derivatives(where, [list(values) for _, values in knots])
    return np.asarray(curve(np.clip(times, where[0], where[-1])))


def _eased(times: F64, it: Plan, degrees: tuple[float, ...]) -> F64:
    """Angles (F,), radians, that ease from one value to the next at the marks of a jump."""
    marks = (0.25, _CROUCH_S, it.take_off, 0.5 * (it.take_off + it.touch_down), it.touch_down, it.landed, it.end - 0.1)
    smooth = timing.ease
    angles = np.full(len(times), degrees[0])
    for start, end, before, after in zip(marks[:-1], marks[1:], degrees[:-1], degrees[1:], strict=True):
        angles = angles + (after - before) * smooth(times, start - 0.03, end + 0.03)
    return np.asarray(np.radians(angles))


def _body(figure: Figure, times: F64, root: F64, leap: Leap, it: Plan) -> F64:
    """Rotations (F, J, 4) over a root path (F, 3)."""
    small = strike.idle(times, it.end)
    aside = np.sin(leap.direction) * it.along
    scale = np.array([1.0, 0.75 + 0.8 * leap.rise, 1.0, 1.0, 1.0, 0.7 + 0.8 * leap.rise, 1.0])
    bow = _eased(times, it, tuple(scale * _TRUNK)) + 0.05 * it.along * _bumped(times, it) + small.lean
    land = strike.shock(times, it.touch_down + 0.03)
    bow = bow + np.radians(1.5) * land
    side = 0.10 * aside * (_bumped(times, it) - 0.8 * timing.bump(_share(times, it.touch_down - 0.1, it.landed + 0.45)))
    forward = strike.lean(0.0, bow)
    roll = strike.lean(0.5 * np.pi, side)
    yaw = _YAW_RAD * (timing.bump(_share(times, 0.2, it.take_off)) - timing.bump(_share(times, _CROUCH_S, it.landed)))
    pelvis = rig.turn(0.3 * yaw, 0.55 * forward + 0.8 * roll)
    trunk = rig.turn(yaw, forward + roll)
    rotations = rig.trunk(figure, strike.blank(figure, len(times)), pelvis, trunk)
    gaze_yaw = 0.35 * leap.direction * timing.bump(_share(times, 0.1, it.landed + 0.5))
    nod = np.radians(2.0) + 0.30 * bow - np.radians(2.5) * strike.shock(times, it.touch_down + 0.05)
    rotations = rig.head(figure, rotations, trunk, rig.turn(gaze_yaw, strike.lean(gaze_yaw, nod)))
    lift = np.stack([0 * times, 0 * times, small.lift], axis=-1)
    rotations[:, figure.skeleton.index("LeftShoulder")] = quat.exp(lift)
    rotations[:, figure.skeleton.index("RightShoulder")] = quat.exp(-lift)
    for name in ("Left", "Right"):
        rotations = _foot(figure, times, root, rotations, name, leap, it)
        rotations = _arm(figure, times, root, rotations, name, leap, it)
    return rotations


def _share(times: F64, start: float, end: float) -> F64:
    return np.asarray(np.clip((times - start) / (end - start), 0.0, 1.0))


def _bumped(times: F64, it: Plan) -> F64:
    """Rises during the push and falls in flight (F,)."""
    return timing.ease(times, _CROUCH_S, it.take_off + 0.05) - timing.ease(times, it.take_off, it.touch_down)


def _foot(figure: Figure, times: F64, root: F64, rotations: F64, side: str, leap: Leap, it: Plan) -> F64:
    """Plant a foot, roll it over its ball, carry it through the air and plant it again."""
    skeleton = figure.skeleton
    turned, positions = figure.forward(figure.rest)
    start = positions[skeleton.index(side + "ToeBase")]
    yaw = float(rig.yaw_of(quat.rotate(turned[skeleton.index(side + "Foot")], _FORWARD)))
    times = times - _LAG_S[side]
    way = _share(times, it.take_off, it.touch_down)
    toward = np.array([np.sin(leap.direction), 0.0, np.cos(leap.direction)])
    risen = it.up**2 / (2 * GRAVITY_M_S2) + 0.05 + 0.22 * (leap.rise - 0.15) + 0.05 * leap.distance
    lift = risen * timing.bump(way)
    balls = start + timing.ease(way)[:, None] * leap.distance * toward + lift[:, None] * [0.0, 1.0, 0.0]
    landing = np.radians(24.0) * (1.0 - 0.55 * min(1.0, leap.distance / 1.5))
    pitch = _TOE_OFF_RAD * timing.ease(times, _CROUCH_S + 0.02, it.take_off + 0.02)
    pitch = pitch + (landing - _TOE_OFF_RAD) * timing.ease(times, it.take_off + 0.06, it.touch_down)
    pitch = pitch - landing * timing.ease(times, it.touch_down, it.touch_down + 0.10)
    ankles, feet, rotations = rig.feet_on_balls(balls, np.full(len(times), yaw), pitch, figure, rotations, side)
    ankles = rig.within_reach(figure, root, rotations, side, ankles, _STRAIGHTEST_RAD)
    free = timing.ease(np.clip(lift / 0.16, 0.0, 1.0))
    toe = skeleton.index(side + "ToeBase")
    rotations[:, toe] = quat.exp((1 - 0.8 * free)[:, None] * quat.log(rotations[:, toe]))
    knees = quat.rotate(rig.turn(np.array([1.3 * yaw]))[0], _FORWARD)
    return rig.leg(figure, root, rotations, side, ankles, feet, np.tile(knees, (len(times), 1)))


def _arm(figure: Figure, times: F64, root: F64, rotations: F64, side: str, leap: Leap, it: Plan) -> F64:
    """Swing an arm back in the crouch, up at take-off, forward at landing, and let it hang again."""
    outward = 1.0 if side == "Left" else -1.0
    times = times - _ARM_LAG_S[side]
    top = 92.0 + 130.0 * (leap.rise - 0.17)
    back = -34.0 - 50.0 * (leap.rise - 0.17)
    marks = (
        (0.28, _CROUCH_S - 0.06, 8.0, back),
        (_CROUCH_S - 0.12, it.take_off + 0.06, back, top),
        (it.take_off + 0.04, it.touch_down + 0.12, top, 48.0),
        (it.touch_down + 0.04, it.end - 0.12, 48.0, 8.0),
    )
    swing = np.full(len(times), 8.0)
    for start, end, before, after in marks:
        swing = swing + _ARM_SHARE[side] * (after - before) * timing.ease(times, start, end)
    swing = np.radians(swing) + np.radians(3.0) * strike.shock(times, it.touch_down + 0.05)
    air = timing.ease(times, _CROUCH_S, it.take_off) - timing.ease(times, it.touch_down, it.end - 0.2)
    busy = timing.ease(times, 0.3, _CROUCH_S) - timing.ease(times, it.touch_down, it.end - 0.1)
    spread = np.radians(9.0) + np.radians(9.0) * busy + np.radians(8.0) * air
    bend = np.radians(22.0) + np.radians(10.0) * busy + np.radians(24.0) * air
    return _hang(figure, root, rotations, side, swing, outward * spread, bend)


def _hang(figure: Figure, root: F64, rotations: F64, side: str, swing: F64, spread: F64, bend: F64) -> F64:
    """Pose an arm by its angles (F,): swing forward, spread to the side, bend of the elbow."""
    skeleton = figure.skeleton
    upper, fore, hand = figure.joints(side + "Arm", side + "ForeArm", side + "Hand")
    along = np.stack([np.sin(spread), -np.cos(swing) * np.cos(spread), np.sin(swing) * np.cos(spread)], axis=-1)
    front = np.stack([0 * swing, np.sin(swing), np.cos(swing)], axis=-1)
    first, second = np.abs(skeleton.offsets[[fore, hand], 0])
    wrist = first * along + second * (np.cos(bend)[:, None] * along + np.sin(bend)[:, None] * front)
    turned, positions = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)
    chest = turned[:, skeleton.index("Spine2")]
    wrists, poles = positions[:, upper] + quat.rotate(chest, wrist), quat.rotate(chest, -front)
    inward = np.tile([-0.35, 0.0, 0.0], (len(root), 1))
    return rig.arm(figure, root, rotations, side, wrists, poles, inward)
