"""The verb ``lift``: both hands take a box from before the body and lift it to the waist.

From below the knee the legs bend more than the back, from above it the back more than the legs. A heavy box is drawn
in first and lifted slowly; the knees lead and the trunk follows, leaning back under the load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tools.authoring import hands, rig, strike, timing
from tools.authoring.figure import Figure
from tools.authoring.humanoid import BALANCE_POINT, humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["HALF_GRIP_M", "Load", "loads", "motion", "source"]

_DECIMALS = 4
HALF_GRIP_M = 0.205
"""Half the distance between the wrists while they hold the box."""

_BODY_KG, _LIGHT_KG, _HEAVY_KG = 75.0, 2.0, 20.0
_START_S, _REACH_S, _SETTLE_S = 0.14, 0.76, 0.42
_WAIST_M = np.array([0.0, 1.19, 0.37])
_BEFORE_KNEES_M = 0.40
"""How far a box is drawn in before it rises."""

_OPEN_M = 0.12
"""How much wider than the box each hand comes."""

_GRIP_ELBOW_RAD = np.radians(32.0)
_FORWARD = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Load:
    """A box: where its grips are (forward of the ankles and above the ground, metres), and its weight, 0 to 1."""

    distance: float
    height: float
    weight: float


@dataclass(frozen=True, slots=True)
class _Times:
    """Grip, start and end of the lift, end of the motion, seconds."""

    grip: float
    start: float
    lifted: float
    end: float


@dataclass(frozen=True, slots=True)
class _Stoop:
    """How far the body goes down to the box: lean of the trunk, radians, and drop of the hips, metres."""

    lean: float
    drop: float


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``lift``, or only some of its examples."""
    known = loads()
    return Source(
        comment="Lifting a box with both hands, authored by tools.authoring (python -m tools.authoring lift).",
        keys={
            "name": "lift",
            "description": (
                "Both hands take a box from before the body and lift it to the waist: near or far, low or high, light "
                "or heavy. A heavy box is drawn in and lifted slowly, knees first. Authored by code, not captured. "
                "The figure faces +Z and stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "RightHand",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "fps": strike.FPS,
            "keytime_names": ["start", "grip", "lifted", "end"],
            "goal": {"origin": [-HALF_GRIP_M, 0.0, 0.0], "axes": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]},
        },
        adverbs=(
            Adverb("distance", "m", "how far before the ankles the right wrist (RightHand) is at the grip (keytime 1)"),
            Adverb("height", "m", "how high above the ground the right wrist (RightHand) is at the grip (keytime 1)"),
            Adverb("weight", "none", "how heavy the box seems, from 0 (2 kg) to 1 (20 kg)", style=True),
        ),
        examples=(Example(name, *motion(known[name]), (known[name].weight,)) for name in names or known),
        decimals=_DECIMALS,
    )


def loads() -> dict[str, Load]:
    """Names and boxes of the 12 examples."""
    rows = (("low", 0.27, (0.40, 0.56)), ("knee", 0.60, (0.38, 0.60)), ("high", 0.98, (0.36, 0.60)))
    return {
        f"{row}_{column}_{name}": Load(distance, height, weight)
        for row, height, distances in rows
        for column, distance in zip(("near", "far"), distances, strict=True)
        for name, weight in (("light", 0.0), ("heavy", 1.0))
    }


def motion(load: Load) -> tuple[Motion, F64]:
    """Author one lift.

    Returns
    -------
    motion : Motion
    keytimes : (4,) float64
        Start, grip, lifted, end, seconds; all on frames.
    """
    figure, marks = humanoid(), _times(load)
    frames = np.round(np.array([0.0, marks.grip, marks.lifted, marks.end]) * strike.FPS)
    times = np.arange(frames[-1] + 1) / strike.FPS
    root, rotations = _balanced(figure, times, load, marks, _stoop(figure, load, marks))
    return Motion(figure.skeleton, strike.FPS, root, quat.unroll(rotations)), frames / strike.FPS


def _times(load: Load) -> _Times:
    frame = 1.0 / strike.FPS
    grip = round((_START_S + _REACH_S + 0.12 * load.weight) / frame) * frame
    start = grip + 0.02 + 0.13 * load.weight
    lifted = start + 0.86 + 0.30 * load.weight
    return _Times(grip, start, lifted, lifted + _SETTLE_S)


def _stoop(figure: Figure, load: Load, marks: _Times) -> _Stoop:
    """Find how far the body goes down so that the elbows are bent as they should be at the grip."""
    low, high = 0.0, 2.0
    times = np.array([0.0, marks.grip])
    shoulder = figure.skeleton.index("RightArm")
    reach = np.sqrt(0.295**2 + 0.26**2 + 2 * 0.295 * 0.26 * np.cos(_GRIP_ELBOW_RAD))
    for _ in range(22):
        middle = 0.5 * (low + high)
        root, rotations = _balanced(figure, times, load, marks, _mixed(load, middle), arms=False)
        positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
        away = np.linalg.norm(positions[-1, shoulder] - [-HALF_GRIP_M, load.height, load.distance])
        low, high = (middle, high) if away > reach else (low, middle)
    return _mixed(load, 0.5 * (low + high))


def _mixed(load: Load, amount: float) -> _Stoop:
    """Squat from low places, stoop from higher ones, never one alone; a heavy box is lifted more by the legs."""
    squat = float(timing.ease(np.array(load.height), 1.0, 0.15))
    lean = np.radians(50.0 + 4.0 * squat - 5.0 * load.weight)
    return _Stoop(float(amount * lean), amount * (0.05 + 0.30 * squat + 0.03 * load.weight))


def _balanced(
    figure: Figure, times: F64, load: Load, marks: _Times, stoop: _Stoop, *, arms: bool = True
) -> tuple[F64, F64]:
    """Move the root until body and box together stay over the feet."""
    small = strike.idle(times, marks.end)
    level = np.array([1.0, 0.0, 1.0])
    rest = figure.centre_of_mass(figure.forward(figure.rest)[1])
    shares = _shares(times, load, marks)
    mass = _LIGHT_KG + (_HEAVY_KG - _LIGHT_KG) * load.weight
    held = (mass / (mass + _BODY_KG) * timing.ease(times, marks.grip, marks.start + 0.10))[:, None]
    box = _box(times, load, marks)
    root = figure.rest.root + small.shift - stoop.drop * shares["legs"][:, None] * [0.0, 1.0, 0.0]
    for _ in range(8):
        lowered, rotations = _body(figure, times, root, load, marks, stoop)
        if arms:
            rotations = _arms(figure, times, lowered, rotations, load, marks)
        positions = fk.forward(lowered, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
        own = figure.centre_of_mass(positions)
        path = rest + small.shift + 0.3 * shares["legs"][:, None] * (BALANCE_POINT * level - rest * level)
        root = root + level * (path - (own + held * (box - own)))
    return lowered, rotations


def _shares(times: F64, load: Load, marks: _Times) -> dict[str, F64]:
    """Progress (F,) of legs, trunk and gaze down to the box and up again; heavy boxes are lifted legs first."""
    late = 0.16 * load.weight
    up = marks.lifted - marks.start
    down = timing.ease(times, _START_S, marks.grip)
    return {
        "legs": down - timing.ease(times, marks.start - 0.02, marks.start + (0.92 - 0.06 * load.weight) * up),
        "trunk": timing.ease(times, _START_S - 0.06, marks.grip - 0.02)
        - timing.ease(times, marks.start + 0.02 + late, marks.lifted + 0.02 + 0.1 * load.weight),
        "gaze": timing.ease(times, 0.02, 0.55) - timing.ease(times, marks.start + 0.1, marks.lifted + 0.2),
        "held": timing.ease(times, marks.start, marks.lifted + 0.12),
    }


def _body(figure: Figure, times: F64, root: F64, load: Load, marks: _Times, stoop: _Stoop) -> tuple[F64, F64]:
    """Root (F, 3) and rotations (F, J, 4) of trunk, head and legs."""
    small, shares = strike.idle(times, marks.end), _shares(times, load, marks)
    effort = load.weight * shares["held"]
    bow = stoop.lean * shares["trunk"] + small.lean - np.radians(2.0 + 5.0 * load.weight) * shares["held"]
    bow = bow + np.radians(0.6 + 0.8 * load.weight) * strike.shock(times, marks.start + 0.05, 4.0, 0.12)
    yaw = np.radians(3.0) * timing.bump(np.clip(times / marks.grip, 0.0, 1.0))
    pelvis = rig.turn(0.4 * yaw, strike.lean(0.0, 0.52 * bow + np.radians(3.0) * effort))
    trunk = rig.turn(yaw, strike.lean(0.0, bow))
    rotations = rig.trunk(figure, strike.blank(figure, len(times)), pelvis, trunk)
    down = np.arctan2(1.45 - load.height, load.distance + 0.25) * shares["gaze"]
    nod = np.minimum(0.42 * down + 0.35 * bow + np.radians(4.0), 1.2) - np.radians(1.0) * shares["held"]
    rotations = rig.head(figure, rotations, trunk, rig.turn(0.6 * yaw, strike.lean(0.6 * yaw, nod)))
    lift = small.lift + np.radians(2.5) * effort
    ahead = 0.22 * shares["trunk"] + np.radians(3.0)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        shrug = np.stack([0 * lift, -sign * ahead, sign * lift], axis=-1)
        rotations[:, figure.skeleton.index(side + "Shoulder")] = quat.exp(shrug)
    return _stand(figure, root, rotations)


def _stand(figure: Figure, root: F64, rotations: F64) -> tuple[F64, F64]:
    """Root (F, 3) and rotations with both feet flat where they are at rest."""
    turned, positions = figure.forward(figure.rest)
    feet = {}
    for side in ("Left", "Right"):
        foot, ball = figure.joints(side + "Foot", side + "ToeBase")
        yaw = np.full(len(root), rig.yaw_of(quat.rotate(turned[foot], _FORWARD)))
        balls = np.tile(positions[ball], (len(root), 1))
        ankles, flat, rotations = rig.feet_on_balls(balls, yaw, 0 * yaw, figure, rotations, side)
        feet[side] = (ankles, flat, quat.rotate(rig.turn(1.8 * yaw), _FORWARD))
    root = rig.leg_limit(figure, root, rotations[:, 0], {side: each[0] for side, each in feet.items()}, np.radians(9.0))
    for side, (ankles, flat, knees) in feet.items():
        rotations = rig.leg(figure, root, rotations, side, ankles, flat, knees)
    return root, rotations


def _box(times: F64, load: Load, marks: _Times) -> F64:
    """Middle of the grips (F, 3): at rest until the lift, drawn in, up before the knees to the waist, then carried."""
    up = marks.lifted - marks.start
    rise = timing.ease(times, marks.start, marks.lifted + 0.04)
    drawn = timing.ease(times, marks.start - 0.10 * load.weight, marks.start + (0.80 - 0.30 * load.weight) * up)
    start = np.array([0.0, load.height, load.distance])
    end = _WAIST_M - load.weight * np.array([0.0, 0.09, 0.085])
    close = np.array([0.0, load.height, min(load.distance, _BEFORE_KNEES_M)])
    path = start + drawn[:, None] * (close - start) + rise[:, None] * (end - close)
    settle = 0.012 * strike.shock(times, marks.lifted - 0.06, 2.6, 0.16)
    path[:, 1] -= settle * (1.0 + load.weight)
    return np.asarray(path)


def _arms(figure: Figure, times: F64, root: F64, rotations: F64, load: Load, marks: _Times) -> F64:
    """Bring both hands from hanging, past the knees, onto the box and keep them there."""
    skeleton = figure.skeleton
    positions = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)[1]
    chest = _global_rotations(figure, root, rotations, "Spine2")
    near = timing.ease(times, _START_S - 0.08, marks.grip - 0.20)[:, None]
    closing = timing.ease(times, marks.grip - 0.34, marks.grip - 0.02)
    half = HALF_GRIP_M + _OPEN_M * (1.0 - closing)
    box = _within_reach(positions[:, figure.joints("LeftArm", "RightArm")], _box(times, load, marks), half)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        shoulder = positions[:, skeleton.index(side + "Arm")]
        hanging = shoulder + quat.rotate(chest, np.array([sign * 0.055, -0.525, 0.070]))
        wrists = hanging + near * (box + half[:, None] * [sign, 0.0, 0.0] - hanging)
        poles = quat.rotate(chest, np.array([sign * 0.45, -0.1, -1.0]))
        hand = np.zeros((len(times), 3))
        hand[:, 2] = sign * (-0.10 - 0.12 * near[:, 0])
        held = rig.arm(figure, root, rotations, side, wrists, poles, hand)
        inward = _palm_inward(figure, root, held, side, sign)
        hand[:, 0] = -0.35 + closing * (inward + 0.35)
        rotations = rig.arm(figure, root, rotations, side, wrists, poles, hand)
        rotations = hands.shape(figure, rotations, side, "flat", 0.85 * closing)
    return rotations


def _palm_inward(figure: Figure, root: F64, rotations: F64, side: str, sign: float) -> F64:
    """Twist (F,) of the forearm that turns the palm toward the other hand; down (-Y) is its direction at none."""
    forearm = _global_rotations(figure, root, rotations, side + "ForeArm")
    toward = quat.rotate(quat.conjugate(forearm), np.array([-sign, 0.0, 0.0]))
    return np.asarray(np.unwrap(np.arctan2(-toward[:, 2], -toward[:, 1])))


def _within_reach(shoulders: F64, box: F64, half: F64) -> F64:
    """Box (F, 3) kept within reach of both shoulders (F, 2, 3), with a soft corner: straight arms carry it along.

    ``half`` (F,) is half the distance between the wrists.
    """
    across = half - np.abs(shoulders[:, :, 0]).mean(axis=1)
    middle = shoulders.mean(axis=1)
    most = np.sqrt(0.546**2 - across**2)
    way = (box - middle) * [0.0, 1.0, 1.0]
    distance = np.linalg.norm(way, axis=-1)
    beyond = 0.006 * np.logaddexp(0.0, (distance - most) / 0.006)
    return np.asarray(box - way * (beyond / distance)[:, None])


def _global_rotations(figure: Figure, root: F64, rotations: F64, joint: str) -> F64:
    """Global rotations (F, 4) of a joint."""
    skeleton = figure.skeleton
    return fk.forward(root, rotations, skeleton.parents, skeleton.offsets)[0][:, skeleton.index(joint)]
