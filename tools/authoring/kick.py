"""The verb ``kick``: from a fighting stance, the right foot strikes a point around the body and returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tools.authoring import rig, strike
from tools.authoring.figure import Figure
from tools.authoring.humanoid import humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["Aim", "aims", "motion", "source"]

_DECIMALS = 4
_KEY_S, _END_S = 0.95, 2.10

_HEIGHTS_M = {"low": 0.42, "middle": 0.80, "high": 1.16}
_DIRECTIONS_RAD = {"left": np.radians(30.0), "forward": np.radians(-14.0), "right": np.radians(-66.0)}
_KNEES_RAD = {"near": np.radians(54.0), "far": np.radians(20.0)}

# Windows out and back, seconds from the key. The knee is drawn up in the first part of the way and straightens in the
# second; both ways overlap, so that the foot passes the chamber without a stop.
_WEIGHT = ((-0.66, -0.24), (0.30, 0.80))
_PUSH = ((-0.52, -0.28), (0.40, 0.78))
_CHAMBER = ((-0.41, -0.04), (0.06, 0.50))
_SNAP = ((-0.150, 0.010), (-0.010, 0.160))
_HIPS = ((-0.38, -0.02), (0.10, 0.62))
_CHEST = ((-0.38, -0.01), (0.10, 0.66))
_LEAN = ((-0.40, -0.03), (0.08, 0.60))
_FOOT = ((-0.39, -0.14), (0.24, 0.50))
_GAZE = ((-0.70, -0.30), (0.30, 0.90))
_LANDING_S = 0.47
_CLEARANCE_M = 0.05


@dataclass(frozen=True, slots=True)
class Aim:
    """Where a kick goes: direction from the body (radians, left positive), height of the ankle, bend of the knee."""

    azimuth: float
    height: float
    knee: float


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``kick``, or only some of its examples."""
    known = aims()
    return Source(
        comment="A right-foot kick, authored by tools.authoring (python -m tools.authoring kick).",
        keys={
            "name": "kick",
            "description": (
                "From a fighting stance, the weight goes to the left foot, the right knee is drawn up, the foot snaps "
                "out to a point and returns to the stance. Authored by code, not captured. The figure faces +Z and "
                "stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "RightFoot",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "chart": "cylinder",
            "fps": strike.FPS,
            "keytime_names": ["start", "apex", "end"],
        },
        adverbs=tuple(
            Adverb(axis, "m", f"{way} coordinate of the right ankle (RightFoot) at the apex (keytime 1)")
            for axis, way in (("x", "+X (left)"), ("y", "+Y (height above ground)"), ("z", "+Z (forward)"))
        ),
        examples=(Example(name, *motion(known[name])) for name in names or known),
        decimals=_DECIMALS,
    )


def aims() -> dict[str, Aim]:
    """Names and aims of the 18 examples."""
    return {
        f"{row}_{column}_{name}": Aim(azimuth, height, knee)
        for row, height in _HEIGHTS_M.items()
        for column, azimuth in _DIRECTIONS_RAD.items()
        for name, knee in _KNEES_RAD.items()
    }


def motion(aim: Aim) -> tuple[Motion, F64]:
    """Author one kick.

    Returns
    -------
    motion : Motion
    keytimes : (3,) float64
        Start, apex, end, seconds; all on frames.
    """
    figure = humanoid()
    times = np.arange(round(_END_S * strike.FPS) + 1) / strike.FPS
    root, rotations = _balanced(figure, times, aim)
    keytimes = np.array([0.0, round(_KEY_S * strike.FPS) / strike.FPS, times[-1]])
    return Motion(figure.skeleton, strike.FPS, root, quat.unroll(rotations)), keytimes


def _balanced(figure: Figure, times: F64, aim: Aim) -> tuple[F64, F64]:
    """Move the root until the centre of mass goes from the middle of the stance over the left foot and back."""
    after, small = times - _KEY_S, strike.idle(times, _END_S)
    weight = strike.stroke(after, *_WEIGHT)[:, None]
    rest = strike.ROOT_M + small.shift
    root = rest + weight * [0.08, 0.0, 0.18]
    level = np.array([1.0, 0.0, 1.0])
    for _ in range(6):
        lowered, rotations = _body(figure, times, root, aim)
        positions = fk.forward(lowered, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
        mass = figure.centre_of_mass(positions)
        over = strike.STEP_M["Left"] + [0.0, 0.0, -0.07]
        path = mass[0] + small.shift + weight * (over - mass[0])
        root = root + level * (path - mass)
    return lowered, rotations


def _body(figure: Figure, times: F64, root: F64, aim: Aim) -> tuple[F64, F64]:
    """Root (F, 3) and rotations (F, J, 4) over a root whose planar path is given."""
    after, small = times - _KEY_S, strike.idle(times, _END_S)
    hips, chest, leaning, gaze = (strike.stroke(after, *each) for each in (_HIPS, _CHEST, _LEAN, _GAZE))
    high = (aim.height - 0.42) / 0.74
    side = np.clip(-aim.azimuth / np.radians(66.0), 0.0, 1.0)
    pelvis_yaw = strike.PELVIS_YAW + hips * (0.40 * aim.azimuth + np.radians(24.0) - strike.PELVIS_YAW)
    chest_yaw = strike.CHEST_YAW + chest * (0.30 * aim.azimuth + np.radians(12.0) - strike.CHEST_YAW)
    away = leaning * np.radians(12.0 + 16.0 * high + 20.0 * side * (0.3 + high))
    bow = strike.lean(chest_yaw, strike.CHEST_LEAN * (1 - 0.2 * leaning) + small.lean)
    bow += strike.lean(0.0, np.radians(1.2) * (strike.shock(after, 0.0) + strike.shock(after, _LANDING_S)))
    rotations = strike.blank(figure, len(times))
    pelvis = rig.turn(pelvis_yaw, strike.lean(aim.azimuth + np.pi, 0.65 * away) + 0.3 * bow)
    trunk = rig.turn(chest_yaw, strike.lean(aim.azimuth + np.pi, away) + bow)
    rotations = rig.trunk(figure, rotations, pelvis, trunk)
    look = np.stack([gaze * 0.75 * aim.azimuth, np.radians(5.0) + gaze * np.radians(12.0 - 14.0 * high)], axis=-1)
    look[:, 1] -= np.radians(1.5) * strike.shock(after, _LANDING_S + 0.02)
    rotations = rig.head(figure, rotations, trunk, rig.turn(look[:, 0], strike.lean(look[:, 0], look[:, 1])))
    root = root + [0.0, 1.0, 0.0] * (leaning * (0.03 + 0.02 * high) - 0.016 * strike.shock(after, _LANDING_S))[:, None]
    root, rotations = _legs(figure, after, root, rotations, pelvis_yaw, aim)
    swing = chest[:, None]
    rotations = strike.guard(figure, root, rotations, "Left", swing * [0.03, -0.02, 0.02], 0 * chest)
    return root, strike.guard(figure, root, rotations, "Right", swing * [-0.22, -0.40, -0.16], 0.5 * chest)


def _legs(figure: Figure, after: F64, root: F64, rotations: F64, pelvis_yaw: F64, aim: Aim) -> tuple[F64, F64]:
    """Root (F, 3) and rotations with the left foot planted, turning on its ball, and the right leg kicking."""
    hips, push = strike.stroke(after, *_HIPS), strike.stroke(after, *_PUSH)
    pivot = 0.45 * max(0.0, float(np.ptp(pelvis_yaw)))
    feet = {}
    for side, yaw, pitch in (
        ("Left", strike.STEP_YAW["Left"] + hips * pivot, hips * np.radians(4.0)),
        ("Right", strike.STEP_YAW["Right"] + push * np.radians(20.0), strike.HEEL["Right"] + push * np.radians(34.0)),
    ):
        balls = np.tile(strike.STEP_M[side], (len(root), 1))
        ankles, turned, rotations = rig.feet_on_balls(balls, yaw, pitch, figure, rotations, side)
        feet[side] = (ankles, turned, yaw)
    root = rig.leg_limit(figure, root, rotations[:, 0], {"Left": feet["Left"][0]}, np.radians(16.0))
    ankles, turned, yaw = feet["Left"]
    knees = quat.rotate(rig.turn(0.6 * yaw + 0.4 * pelvis_yaw), np.array([0.0, 0.0, 1.0]))
    rotations = rig.leg(figure, root, rotations, "Left", ankles, turned, knees)
    return root, _kick(figure, after, root, rotations, feet["Right"], pelvis_yaw, aim)


def _kick(
    figure: Figure, after: F64, root: F64, rotations: F64, planted: tuple[F64, F64, F64], pelvis_yaw: F64, aim: Aim
) -> F64:
    """Rotations (F, J, 4) with the right foot going from its place over the chamber to the target and back."""
    ankles, turned, yaw = planted
    chamber, snap, foot = (strike.stroke(after, *each) for each in (_CHAMBER, _SNAP, _FOOT))
    raised, target = _chamber_and_target(figure, after, root, rotations, aim)
    aside = 4.0 * chamber * (1.0 - chamber)  # past the standing leg
    path = ankles + chamber[:, None] * (raised - ankles) + snap[:, None] * (target - raised)
    path = path - aside[:, None] * [_CLEARANCE_M, 0.0, 0.0]
    ahead = quat.rotate(rig.turn(0.55 * aim.azimuth + 0.45 * pelvis_yaw), np.array([0.0, 0.0, 1.0]))
    standing = quat.rotate(rig.turn(0.6 * yaw + 0.4 * pelvis_yaw), np.array([0.0, 0.0, 1.0]))
    poles = (1 - chamber[:, None]) * standing + chamber[:, None] * (ahead + np.array([0.0, 0.9, 0.0]))
    rotations = rig.leg(figure, root, rotations, "Right", path, turned, poles)
    # In the air the foot follows the shank, drawn up in the chamber and stretched at the target.
    shank = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)[0]
    point = np.radians(8.0) * (1 - snap) + np.radians(38.0) * snap
    free = quat.mul(shank[:, figure.skeleton.index("RightLeg")], quat.exp(point[:, None] * [1.0, 0.0, 0.0]))
    way = quat.log(quat.mul(quat.conjugate(turned), quat.align(free, turned)))
    turned = quat.mul(turned, quat.exp(foot[:, None] * way))
    toe = figure.skeleton.index("RightToeBase")
    rotations[:, toe] = quat.exp((1 - foot)[:, None] * quat.log(rotations[:, toe]))
    return rig.leg(figure, root, rotations, "Right", path, turned, poles)


def _chamber_and_target(figure: Figure, after: F64, root: F64, rotations: F64, aim: Aim) -> tuple[F64, F64]:
    """Ankle (3,) with the knee drawn up, and at the key, from the hip joint at the key."""
    skeleton = figure.skeleton
    key = int(np.argmin(np.abs(after)))
    positions = fk.forward(root[[key]], rotations[[key]], skeleton.parents, skeleton.offsets)[1][0]
    hip = positions[skeleton.index("RightUpLeg")]
    thigh, shank = 0.430, 0.425
    length = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(aim.knee))
    rise = aim.height - hip[1]
    level = np.sqrt(length**2 - rise**2)
    toward = np.array([np.sin(aim.azimuth), 0.0, np.cos(aim.azimuth)])
    target = hip + level * toward + [0.0, rise, 0.0]
    raised = hip + (0.28 + 0.06 * (aim.height - 0.42)) * toward + [0.0, -0.46 + 0.45 * (aim.height - 0.42), 0.0]
    return raised, target
