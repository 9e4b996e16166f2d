"""The verb ``punch``: from a fighting stance, the right fist strikes a point before the body and returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tools.authoring import rig, strike
from tools.authoring.figure import Figure
from tools.authoring.humanoid import humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64, Floats
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["motion", "source", "targets"]

_DECIMALS = 4
_KEY_S, _END_S = 0.85, 1.95

# Where the wrist goes: height above the ground, direction from the root (0 is forward, positive to the left), distance.
_HEIGHTS_M = {"low": 0.80, "middle": 1.22, "high": 1.62}
_DIRECTIONS_RAD = {"left": np.radians(34.0), "forward": 0.0, "right": np.radians(-38.0)}
_DISTANCES_M = {
    "low": {"left": (0.74, 0.98), "forward": (0.76, 1.06), "right": (0.72, 0.98)},
    "middle": {"left": (0.74, 1.02), "forward": (0.78, 1.12), "right": (0.74, 1.02)},
    "high": {"left": (0.62, 0.84), "forward": (0.64, 0.90), "right": (0.60, 0.84)},
}

# Windows out and back of each part, seconds from contact: hips lead, the hand arrives last and leaves first.
_HIPS = ((-0.35, 0.00), (0.08, 0.72))
_CHEST = ((-0.285, 0.00), (0.05, 0.62))
_ARM = ((-0.160, 0.012), (-0.014, 0.31))
_LUNGE = ((-0.34, 0.00), (0.09, 0.80))
_WIND_UP = ((-0.64, -0.34), (-0.36, -0.14))
_DRAW = ((-0.52, -0.17), (-0.10, 0.08))
_GAZE = ((-0.58, -0.22), (0.22, 0.85))


@dataclass(frozen=True, slots=True, eq=False)
class _Contact:
    """How the body goes to a target: angles in radians, displacement of the root (3,) in metres."""

    azimuth: float
    root: F64
    pelvis_yaw: float
    chest_yaw: float
    lean: float
    clavicle: F64
    gaze: F64


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``punch``, or only some of its examples."""
    positions = targets()
    return Source(
        comment="A right-hand punch, authored by tools.authoring (python -m tools.authoring punch).",
        keys={
            "name": "punch",
            "description": (
                "From a fighting stance, the right fist strikes a point before the body and returns to guard; hips, "
                "chest and arm follow each other, and the body lunges at far points. Authored by code, not captured. "
                "The figure faces +Z and stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "RightHand",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "chart": "cylinder",
            "fps": strike.FPS,
            "keytime_names": ["start", "contact", "end"],
        },
        adverbs=tuple(
            Adverb(axis, "m", f"{way} coordinate of the right wrist (RightHand) at contact (keytime 1)")
            for axis, way in (("x", "+X (left)"), ("y", "+Y (height above ground)"), ("z", "+Z (forward)"))
        ),
        examples=(Example(name, *motion(positions[name])) for name in names or positions),
        decimals=_DECIMALS,
    )


def targets() -> dict[str, F64]:
    """Names and wrist targets (3,) of the 18 examples, metres."""
    result = {}
    for row, height in _HEIGHTS_M.items():
        for column, angle in _DIRECTIONS_RAD.items():
            for name, distance in zip(("near", "far"), _DISTANCES_M[row][column], strict=True):
                at = np.array([distance * np.sin(angle), height, distance * np.cos(angle)])
                result[f"{row}_{column}_{name}"] = at
    return result


def motion(target: Floats) -> tuple[Motion, F64]:
    """Author one punch at a wrist target (3,).

    Returns
    -------
    motion : Motion
    keytimes : (3,) float64
        Start, contact, end, seconds; all on frames.
    """
    figure = humanoid()
    times = np.arange(round(_END_S * strike.FPS) + 1) / strike.FPS
    goal = np.asarray(target, np.float64)
    root, rotations = _body(figure, times, _contact(figure, goal), goal)
    keytimes = np.array([0.0, round(_KEY_S * strike.FPS) / strike.FPS, times[-1]])
    return Motion(figure.skeleton, strike.FPS, root, quat.unroll(rotations)), keytimes


def _body(figure: Figure, times: F64, to: _Contact, target: F64) -> tuple[F64, F64]:
    """Root (F, 3) and rotations (F, J, 4)."""
    root, rotations = _stance(figure, times, to)
    chest, arm, draw = (strike.stroke(times - _KEY_S, *windows) for windows in (_CHEST, _ARM, _DRAW))
    none = np.zeros(len(times))
    rotations = strike.guard(figure, root, rotations, "Left", chest[:, None] * [0.02, -0.03, -0.09], none)
    pole = quat.rotate(rig.turn(np.array([to.azimuth]))[0], np.array([-0.75, -0.65, 0.0]))
    blow = strike.Blow(target, pole, np.array([0.75, 0.0, 0.0]), arm)
    drawn = draw[:, None] * [-0.03, -0.05, -0.10]
    return root, strike.guard(figure, root, rotations, "Right", drawn, none, blow)


def _stance(figure: Figure, times: F64, to: _Contact) -> tuple[F64, F64]:
    """Root (F, 3) and rotations (F, J, 4) of all but the arms."""
    after, small = times - _KEY_S, strike.idle(times, _END_S)
    hips, chest, arm, lunge, wind_up, gaze = (
        strike.stroke(after, *windows) for windows in (_HIPS, _CHEST, _ARM, _LUNGE, _WIND_UP, _GAZE)
    )
    root = strike.ROOT_M + small.shift + lunge[:, None] * to.root + wind_up[:, None] * [-0.015, -0.02, -0.045]
    pelvis_yaw = strike.PELVIS_YAW + hips * (to.pelvis_yaw - strike.PELVIS_YAW) - np.radians(7.0) * wind_up
    chest_yaw = strike.CHEST_YAW + chest * (to.chest_yaw - strike.CHEST_YAW) - np.radians(14.0) * wind_up
    leaning = lunge * to.lean + np.radians(0.8) * strike.shock(after, 0.0)
    bow = strike.lean(chest_yaw, strike.CHEST_LEAN * (1 - 0.6 * lunge) + small.lean)
    rotations = strike.blank(figure, len(times))
    pelvis = rig.turn(pelvis_yaw, strike.lean(to.azimuth, 0.45 * leaning) + 0.3 * bow)
    trunk = rig.turn(chest_yaw, strike.lean(to.azimuth, leaning) + bow)
    rotations = rig.trunk(figure, rotations, pelvis, trunk)
    look = gaze[:, None] * to.gaze + [0.0, np.radians(5.0)]
    look[:, 1] -= np.radians(1.2) * strike.shock(after, 0.02)
    rotations = rig.head(figure, rotations, trunk, rig.turn(look[:, 0], strike.lean(look[:, 0], look[:, 1])))
    rotations = _clavicles(figure, rotations, arm[:, None] * to.clavicle, small.lift)
    return _legs(figure, root, rotations, pelvis_yaw, hips, to)


def _legs(figure: Figure, root: F64, rotations: F64, pelvis_yaw: F64, hips: F64, to: _Contact) -> tuple[F64, F64]:
    """Root (F, 3) and rotations with the left foot flat and the right one turning on its ball."""
    pivot = np.clip(to.pelvis_yaw + np.radians(-18.0), np.radians(-30.0), np.radians(10.0))
    far = float(np.linalg.norm(to.root[[0, 2]]))
    feet = {}
    for side in ("Left", "Right"):
        share = hips if side == "Right" else 0 * hips
        yaw = strike.STEP_YAW[side] + share * (pivot - strike.STEP_YAW[side])
        pitch = strike.HEEL[side] + share * (np.radians(26.0) + 1.2 * far)
        balls = np.tile(strike.STEP_M[side], (len(root), 1))
        ankles, turned, rotations = rig.feet_on_balls(balls, yaw, pitch, figure, rotations, side)
        feet[side] = (ankles, turned, 0.6 * yaw + 0.4 * pelvis_yaw)
    root = rig.leg_limit(figure, root, rotations[:, 0], {side: each[0] for side, each in feet.items()}, 0.28)
    for side, (ankles, turned, yaw) in feet.items():
        knees = quat.rotate(rig.turn(yaw), np.array([0.0, 0.0, 1.0]))
        rotations = rig.leg(figure, root, rotations, side, ankles, turned, knees)
    return root, rotations


def _clavicles(figure: Figure, rotations: F64, right: F64, lift: F64) -> F64:
    """Right shoulder forward by rotation vectors (F, 3); both shoulders rise with the breath."""
    solved: F64 = np.array(rotations)
    up = np.stack([0 * lift, 0 * lift, lift], axis=-1)
    left, own = figure.joints("LeftShoulder", "RightShoulder")
    solved[:, left], solved[:, own] = quat.exp(up), quat.exp(right - up)
    return solved


def _contact(figure: Figure, target: F64) -> _Contact:
    """Find how far the body lunges so that the elbow is bent as it should be at contact."""
    low, high = -0.6, 2.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _distance(figure, _lunged(target, middle), target) > _reach(target) else (low, middle)
        )
    return _lunged(target, 0.5 * (low + high))


def _distance(figure: Figure, to: _Contact, target: F64) -> float:
    """Distance from shoulder to target at contact."""
    root, rotations = _stance(figure, np.array([_KEY_S]), to)
    positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
    return float(np.linalg.norm(positions[0, figure.skeleton.index("RightArm")] - target))


def _reach(target: F64) -> float:
    """Distance from shoulder to wrist at contact: the elbow is bent by 54° at near targets, 24° at far ones."""
    far = np.clip((np.linalg.norm(target[[0, 2]]) - 0.5) / 0.45, 0.0, 1.0)
    bend = np.radians(54.0 + far * (24.0 - 54.0))
    return float(np.sqrt(0.295**2 + 0.26**2 + 2 * 0.295 * 0.26 * np.cos(bend)))


def _lunged(target: F64, amount: float) -> _Contact:
    azimuth = float(rig.yaw_of(target))
    low, high = (float(np.logaddexp(0.0, rise / 0.1) * 0.1) for rise in (1.22 - target[1], target[1] - 1.22))
    ahead = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    root = (0.07 + 0.20 * amount - 0.12 * low) * ahead
    root[1] = -0.03 - 0.09 * amount * (1 - 2.2 * high) - 0.22 * low + 0.06 * high
    return _Contact(
        azimuth=azimuth,
        root=root,
        pelvis_yaw=np.radians(20.0) + 0.45 * azimuth,
        chest_yaw=np.radians(46.0) + 0.80 * azimuth,
        lean=float(np.radians(6.0 + 20.0 * amount * (1 - 1.6 * high) + 85.0 * low - 12.0 * high)),
        clavicle=np.array([0.0, 0.30, -0.10 + 0.3 * low]),
        gaze=np.array([0.85 * azimuth, 0.9 * low - 0.35 * high + 0.05]),
    )
