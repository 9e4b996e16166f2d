"""What punch and kick share: the fighting stance, its breath and sway, and the timing of strokes.

A stroke goes out and back in two minimum-jerk windows. Each part of the body has its own, so that hips lead and the
hand or foot arrives last. Source of the windows and their order: measurements of captured strikes (peak speeds, their
order, dwell at the target).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tools.authoring import hands, rig, timing
from tools.authoring.figure import Figure
from verbs.conventions import F64, Floats
from verbs.kernels import fk, quat

__all__ = [
    "CHEST_LEAN",
    "CHEST_YAW",
    "FPS",
    "HEEL",
    "PELVIS_YAW",
    "ROOT_M",
    "STEP_M",
    "Blow",
    "Idle",
    "Window",
    "blank",
    "carried",
    "guard",
    "idle",
    "lean",
    "shock",
    "stroke",
]

FPS = 60.0

ROOT_M = np.array([0.0, 0.905, 0.0])
PELVIS_YAW, CHEST_YAW = np.radians(-34.0), np.radians(-30.0)
STEP_M = {"Left": np.array([0.10, 0.02, 0.30]), "Right": np.array([-0.16, 0.02, -0.20])}
"""Toe joints of the stance: the left foot leads."""
STEP_YAW = {"Left": np.radians(-14.0), "Right": np.radians(-52.0)}
HEEL = {"Left": np.radians(0.0), "Right": np.radians(14.0)}
"""Directions of the feet, and how far the heels are raised."""
CHEST_LEAN = np.radians(13.0)

_WRISTS_M = {"Left": np.array([0.085, 0.150, 0.325]), "Right": np.array([-0.065, 0.145, 0.215])}
_ELBOWS = {"Left": np.array([0.40, -1.0, 0.05]), "Right": np.array([-0.40, -1.0, -0.05])}
_WRISTS_RAD = {"Left": np.array([-0.35, -0.12, 0.12]), "Right": np.array([-0.7, 0.12, -0.12])}
"""Guard: wrists and directions of the elbows in the frame of the chest, and rotation vectors of the hands."""

Window = tuple[float, float]
"""Start and end, seconds from the key."""


@dataclass(frozen=True, slots=True, eq=False)
class Idle:
    """Small motion that never stops: shift of the root (F, 3), lean of the chest and lift of the shoulders (F,)."""

    shift: F64
    lean: F64
    lift: F64


def idle(times: Floats, duration_s: float) -> Idle:
    """Breath and sway of whole periods in ``duration_s``, so that the last frame is the first."""
    turn = 2.0 * np.pi * np.append(0.0, times) / duration_s
    sideways = 3.0 * np.sin(turn + 0.6) + 1.4 * np.sin(2 * turn + 2.0)
    up = 2.2 * np.sin(2 * turn + 1.1) + 0.8 * np.sin(3 * turn)
    forward = 3.6 * np.sin(turn + 2.4) + 1.5 * np.sin(3 * turn + 0.4)
    shift = 1e-3 * np.stack([sideways, up, forward], axis=-1)
    breath = np.sin(turn - 0.9)
    rise = (breath - breath[0])[1:]
    return Idle((shift - shift[0])[1:], np.radians(-0.7) * rise, np.radians(0.9) * rise)


def stroke(times: Floats, out: Window, back: Window) -> F64:
    """Progress (F,) from 0 to 1 in one window and back in another; they may overlap a little, and the top is 1."""
    fine = np.linspace(out[0], back[1], 4001)
    top = (timing.ease(fine, *out) - timing.ease(fine, *back)).max()
    return np.asarray((timing.ease(times, *out) - timing.ease(times, *back)) / top)


def shock(times: Floats, start: float, rate_hz: float = 7.5, fade_s: float = 0.07) -> F64:
    """Damped wave (F,) from a stop or a landing at ``start``; its first swing is about 0.7."""
    u = np.maximum(np.asarray(times) - start, 0.0)
    return np.asarray(np.exp(-u / fade_s) * np.sin(2.0 * np.pi * rate_hz * u) * timing.ease(u, 0.0, 0.04))


def lean(yaw: Floats | float, angle: Floats | float) -> F64:
    """Rotation vectors (F, 3) that lean by ``angle`` toward the direction ``yaw``; one of them may be a number."""
    yaw, angle = np.broadcast_arrays(np.asarray(yaw, np.float64), np.asarray(angle, np.float64))
    return np.stack([angle * np.cos(yaw), 0 * yaw, -angle * np.sin(yaw)], axis=-1)


def carried(figure: Figure, root: Floats, rotations: Floats, offsets: Floats, directions: Floats) -> tuple[F64, F64]:
    """Points and directions (F, 3) in the world of ``offsets`` and ``directions`` in the frame of the chest."""
    chest = figure.skeleton.index("Spine2")
    turned, positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)
    return positions[:, chest] + quat.rotate(turned[:, chest], offsets), quat.rotate(turned[:, chest], directions)


@dataclass(frozen=True, slots=True, eq=False)
class Blow:
    """Where an arm goes from guard: wrist, direction of the elbow, rotation vector of the hand (3,); how far (F,)."""

    wrist: F64
    elbow: F64
    hand: F64
    share: F64


def guard(
    figure: Figure, root: Floats, rotations: Floats, side: str, shift: Floats, back: Floats, blow: Blow | None = None
) -> F64:
    """Hold one arm in guard as a fist, or send it from there.

    ``shift`` (F, 3) moves the wrist in the frame of the chest; ``back`` (F,) turns the elbow backward.
    """
    count = len(root)
    elbows = _ELBOWS[side] - np.asarray(back)[:, None] * [0.0, 0.0, 1.0]
    wrists, poles = carried(figure, root, rotations, _WRISTS_M[side] + shift, elbows)
    held = np.tile(_WRISTS_RAD[side], (count, 1))
    if blow is not None:
        way = blow.share[:, None]
        wrists = wrists + way * (blow.wrist - wrists)
        poles = poles / np.linalg.norm(poles, axis=-1, keepdims=True) * (1 - way) + way * blow.elbow
        held = held + way * (blow.hand - held)
    rotations = rig.arm(figure, root, rotations, side, wrists, poles, held)
    return hands.shape(figure, rotations, side, "fist", np.ones(count))


def blank(figure: Figure, count: int) -> F64:
    """Rotations (F, J, 4) of the zero pose with the fingers of the rest pose."""
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (count, len(figure.skeleton), 1))
    fingers = [joint for joint, name in enumerate(figure.skeleton.names) if "Middle" in name]
    rotations[:, fingers] = figure.rest.rotations[fingers]
    return rotations
