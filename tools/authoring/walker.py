"""A walker that is not human: two legs that stand on their toes, a hull with a head, two pods and a tail.

+Y up, +Z forward, +X left. In the zero pose thigh, shin and foot hang straight down and toes point ahead. Knees bend
forward, hocks backward, as in birds. Inner angles of a standing leg follow an emu's: J. Goetz et al., 2008.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tools.authoring.figure import skeleton_of
from tools.authoring.gait_model import SIDES, STRIDES, Contacts
from tools.authoring.steps import Foot, Path, Steps, Swing, about, loop_curve, spans, track, two_bones, walk_phase
from verbs.conventions import F64
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["TOE_M", "Stalk", "cycle", "walker"]

TOE_M = 0.07
"""Height of a toe joint that stands."""

_JOINTS: dict[str, tuple[str | None, tuple[float, float, float]]] = {
    "Hull": (None, (0.0, 0.0, 0.0)),
    "Neck": ("Hull", (0.0, 0.22, 0.42)),
    "Head": ("Neck", (0.0, 0.16, 0.22)),
    "LeftPod": ("Hull", (0.44, 0.20, 0.10)),
    "LeftBarrel": ("LeftPod", (0.10, -0.16, 0.12)),
    "RightPod": ("Hull", (-0.44, 0.20, 0.10)),
    "RightBarrel": ("RightPod", (-0.10, -0.16, 0.12)),
    "Tail1": ("Hull", (0.0, 0.04, -0.40)),
    "Tail2": ("Tail1", (0.0, -0.02, -0.36)),
}
_LEG = {"Thigh": (0.30, -0.10, -0.04), "Shin": (0.0, -0.56, 0.0), "Foot": (0.0, -0.72, 0.0), "Toe": (0.0, -0.52, 0.0)}
_TIPS = {
    "Head": (0.0, 0.0, 0.30), "LeftBarrel": (0.0, -0.04, 0.48), "RightBarrel": (0.0, -0.04, 0.48),
    "Tail2": (0.0, 0.0, -0.34), "LeftToe": (0.0, 0.0, 0.28), "RightToe": (0.0, 0.0, 0.28),
}  # fmt: skip
_FOOT_PITCH_RAD = np.radians(-28.0)
"""Direction of a standing foot: from the hock ahead and down to the toes, against the vertical."""

_WAVE_S, _WAVE_HZ = 0.11, 5.5


@dataclass(frozen=True, slots=True)
class Stalk:
    """One manner of walking: metres, seconds, degrees, phases as shares of a stride; pairs are left and right.

    Parameters
    ----------
    stride_s : float
    duty : (float, float)
        Share of the stride in which each foot stands.
    right_at : float
        Phase of the right foot's strike; the left one's is 0.
    slope : float
        Rise of the ground, degrees.
    width, ahead : float
        Distance of the feet, and how far before the hips they stand.
    lift, drag : (float, float)
        Height of each swing, and how far the toes hang.
    push : (float, float)
        How far each foot turns over its toes before it leaves the ground.
    crouch : (float, float)
        Least bend of each knee.
    rise, sway, roll, list, pitch, yaw : float
        Hull: half ranges of height and sway; how far it rolls toward the standing side, and its mean roll to the
        right; mean pitch, forward positive; how far it turns.
    limp : float
        How far the hull drops and rolls while the right foot stands.
    droop, hang : float
        How far the head and the right pod hang.
    wave, shudder : float
        Size of the wave after a landing, and of a tremor.
    """

    stride_s: float
    duty: tuple[float, float]
    right_at: float
    slope: float
    width: float
    ahead: float
    lift: tuple[float, float]
    drag: tuple[float, float]
    push: tuple[float, float]
    crouch: tuple[float, float]
    rise: float
    sway: float
    roll: float
    list: float
    pitch: float
    yaw: float
    limp: float
    droop: float
    hang: float
    wave: float
    shudder: float


@cache
def walker() -> Skeleton:
    """The skeleton of the walker."""
    rows = dict(_JOINTS)
    for side, sign in SIDES:
        parent = "Hull"
        for part, (x, y, z) in _LEG.items():
            rows[side + part] = (parent, (sign * x, y, z))
            parent = side + part
    return skeleton_of(rows, _TIPS)


def cycle(stalk: Stalk, speed: float, fps: float, *, seed: int = 0) -> tuple[Motion, F64, Contacts]:
    """Author two strides that differ a little, up or down a slope.

    Parameters
    ----------
    stalk : Stalk
    speed : float
        Metres per second, along the slope.
    fps : float
    seed : int

    Returns
    -------
    motion : Motion
    keytimes : (5,) float64
        :data:`tools.authoring.gait_model.KEYTIME_NAMES`, seconds.
    contacts : mapping
        Intervals, s, in which ball and toe of each foot stand.
    """
    rng = np.random.default_rng(seed)
    frames = round(STRIDES * stalk.stride_s * fps)
    length = frames / fps
    stalk = replace(stalk, stride_s=length / STRIDES)
    times = np.arange(frames + 1) / fps
    late = np.clip(rng.normal(size=(STRIDES, 2)), -1.5, 1.5) * (0.006 + 0.02 * stalk.limp / 10.0) * stalk.stride_s
    late -= late[0, 0]
    strikes = (np.arange(STRIDES)[:, None] + np.array([0.0, stalk.right_at])) * stalk.stride_s + late
    phases = np.stack([walk_phase(times, strikes[:, side], length) for side in range(2)])
    phase = 0.5 * (phases[0] + phases[1] + 0.5)
    hull, rotations = _hull(stalk, times, phase, phases, strikes, length, rng)
    root = _legs(stalk, speed, times, phases, strikes, length, hull, rotations, rng)
    contacts = {
        (name + "Foot", part): spans(times, phases[side], length, 0.01, stalk.duty[side])
        for side, (name, _) in enumerate(SIDES)
        for part in ("ball", "toe")
    }
    return Motion(walker(), fps, root, quat.unroll(rotations)), np.append(strikes.ravel(), length), contacts


def _wave(times: F64, strikes: F64, length: float, delay: float) -> F64:
    """Damped wave (F,) after each landing, of size 1."""
    since = np.mod(times[:, None] - strikes.ravel() - delay, length)
    shape = np.exp(-since / _WAVE_S) * (1.0 - np.exp(-since / 0.02)) * np.sin(2 * np.pi * _WAVE_HZ * since)
    return np.asarray(shape.sum(axis=1))


def _standing(part: F64, duty: float) -> F64:
    """How far a foot carries the hull (F,): 0 in its swing, 1 in the middle of its stance."""
    u = np.clip(part / duty, 0.0, 1.0)
    return np.asarray(np.sin(np.pi * u) ** 2)


def _hull(
    stalk: Stalk, times: F64, phase: F64, phases: F64, strikes: F64, length: float, rng: np.random.Generator
) -> tuple[F64, F64]:
    """Offsets (F, 3) of the hull in the frame of the path, and local rotations (F, J, 4) of all but the legs."""
    skeleton, turn = walker(), 2.0 * np.pi
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), len(skeleton), 1))
    slow = 1.0 + 0.06 * np.cos(turn * (times / length + rng.uniform()))
    weak = _standing(phases[1] % 1.0, stalk.duty[1])
    shake = stalk.shudder * sum(
        np.sin(turn * (k * times / length + rng.uniform())) for k in (round(6.3 * length), round(9.1 * length))
    )  # fmt: skip
    wave = stalk.wave * _wave(times, strikes, length, 0.01)
    side = np.cos(turn * (phase - 0.31)) * slow
    offsets = np.stack([
        stalk.sway * side,
        stalk.rise * np.cos(2 * turn * (phase - 0.31)) * slow - 0.006 * stalk.limp * weak - 0.004 * wave,
        0.02 * np.cos(2 * turn * (phase - 0.10)),
    ], axis=-1)  # fmt: skip
    roll = np.radians(-stalk.roll * side - stalk.list - 0.7 * stalk.limp * weak + 0.4 * shake)
    pitch = np.radians(
        stalk.pitch + 1.2 * np.cos(2 * turn * (phase - 0.06)) + 0.5 * stalk.limp * weak + 0.7 * wave + 0.3 * shake
    )
    yaw = -np.radians(stalk.yaw) * np.cos(turn * phase)
    rotations[:, 0] = quat.mul(quat.mul(about(1, yaw), about(2, roll)), about(0, pitch))
    late = np.radians(stalk.pitch * 0.5 + 0.8 * stalk.wave * _wave(times, strikes, length, 0.06))
    look = np.radians(stalk.droop) - 0.5 * pitch + 0.5 * late
    glance = -0.5 * yaw + np.radians(2.0) * np.cos(turn * (times / length + rng.uniform()))
    for name, share in (("Neck", 0.5), ("Head", 0.5)):
        joint = skeleton.index(name)
        rotations[:, joint] = quat.mul(
            about(1, share * glance), quat.mul(about(2, -0.4 * roll), about(0, share * look))
        )
    for name, sign in SIDES:
        pod, barrel = skeleton.index(name + "Pod"), skeleton.index(name + "Barrel")
        swing = np.cos(turn * (phase - 0.10 - 0.25 * (1 + sign)))
        loose = stalk.hang * (sign < 0)
        drop = np.radians(2.0 * swing + loose) + np.radians(1.5) * stalk.wave * _wave(times, strikes, length, 0.05)
        rotations[:, pod] = quat.mul(about(0, drop), about(2, np.full(len(times), -sign * np.radians(0.5 * loose))))
        sag = np.radians(3.0 * np.cos(turn * (phase - 0.18 - 0.25 * (1 + sign))) + 0.4 * loose) - 0.4 * pitch
        rotations[:, barrel] = about(0, sag)
    for name, lag, size in (("Tail1", 0.08, 5.0), ("Tail2", 0.20, 8.0)):
        sweep = np.radians(size) * np.cos(turn * (phase - lag))
        bob = np.radians(0.6 * stalk.droop) * -1.0 + np.radians(2.0) * stalk.wave * _wave(times, strikes, length, lag)
        joint = skeleton.index(name)
        rotations[:, joint] = quat.mul(about(1, sweep), about(0, bob - 0.3 * pitch))
    return offsets, rotations


def _legs(
    stalk: Stalk, speed: float, times: F64, phases: F64, strikes: F64, length: float, hull: F64, rotations: F64,
    rng: np.random.Generator,
) -> F64:  # fmt: skip
    """Write the local rotations of the legs; return the roots (F, 3)."""
    skeleton, path = walker(), Path(speed, 0.0, 0.0)
    tilt = about(0, np.full(len(times), -np.radians(stalk.slope)))
    hocks, soles, toes, room = [], [], [], []
    upper, lower = 0.56, 0.72
    level = quat.rotate(tilt, path.at(times)[0]) + hull * np.array([1.0, 0.0, 1.0])
    hips = [quat.rotate(rotations[:, 0], skeleton.offsets[skeleton.index(name + "Thigh")]) for name, _ in SIDES]
    for side, (_, sign) in enumerate(SIDES):
        ankles, yaws, pitches, flat = _track(stalk, path, side, sign, phases[side], strikes, length, rng)
        hocks.append(quat.rotate(tilt, ankles))
        soles.append(quat.mul(quat.mul(tilt, about(1, yaws)), about(0, _FOOT_PITCH_RAD - pitches)))
        toes.append(about(0, -_FOOT_PITCH_RAD + pitches - flat))
        away = np.linalg.norm((level + hips[side] - hocks[side])[:, [0, 2]], axis=-1)
        bent = np.cos(np.radians(stalk.crouch[side]))
        tall = np.sqrt(np.maximum(upper**2 + lower**2 + 2 * upper * lower * bent - away**2, 1e-4))
        room.append(hocks[side][:, 1] + tall - hips[side][:, 1] - hull[:, 1] - level[:, 1])
    height = float(np.min(room))
    root = level + (hull[:, 1] + height)[:, None] * np.array([0.0, 1.0, 0.0])
    ahead = np.broadcast_to(np.array([0.0, 0.0, 1.0]), root.shape)
    for side, (name, sign) in enumerate(SIDES):
        forward = quat.rotate(about(1, np.full(len(times), sign * np.radians(6.0))), ahead)
        thigh, shin, _ = two_bones(root + hips[side], hocks[side], forward, upper, lower)
        joints = [skeleton.index(name + part) for part in _LEG]
        rotations[:, joints[0]] = quat.mul(quat.conjugate(rotations[:, 0]), thigh)
        rotations[:, joints[1]] = quat.mul(quat.conjugate(thigh), shin)
        rotations[:, joints[2]] = quat.mul(quat.conjugate(shin), soles[side])
        rotations[:, joints[3]] = toes[side]
    return np.asarray(root)


def _track(
    stalk: Stalk, path: Path, side: int, sign: float, phases: F64, strikes: F64, length: float,
    rng: np.random.Generator,
) -> tuple[F64, F64, F64, F64]:  # fmt: skip
    """Hocks (F, 3) on level ground; headings and pitches of the foot, pitches of the toes (F,), rad, of one leg."""
    duty, push = stalk.duty[side], stalk.push[side]
    offset = quat.rotate(about(0, _FOOT_PITCH_RAD), np.array([0.0, -0.52, 0.0]))
    foot = Foot(offset, offset, TOE_M - offset[1])
    pitch = loop_curve([(at, float(np.radians(value))) for at, value in (
        (0.0, 7.0), (0.10, 4.0), (0.35 * duty, 0.0), (0.75 * duty, -0.35 * push), (duty, -push),
        (duty + 0.25 * (1 - duty), -1.25 * push), (duty + 0.65 * (1 - duty), -8.0), (0.95, 8.0),
    )])  # fmt: skip
    hang = loop_curve([(at, float(np.radians(value))) for at, value in (
        (0.0, 0.0), (0.5 * duty, 0.0), (duty + 0.02, 0.0), (duty + 0.40 * (1 - duty), -stalk.drag[side]),
        (duty + 0.75 * (1 - duty), -0.3 * stalk.drag[side]), (0.97, 0.0),
    )], smooth=0.008)  # fmt: skip
    stances = np.arange(-2, STRIDES + 3)
    own = np.mod(stances, STRIDES)
    shift = np.clip(rng.normal(size=(STRIDES, 3)), -1.5, 1.5) * (0.010, 0.012, 0.06)
    middle = strikes[own, side] + (stances - own) // STRIDES * length + 0.5 * duty * stalk.stride_s
    places, headings = path.at(middle)
    beside = sign * 0.5 * stalk.width + shift[own, 0]
    # The hock stands behind the toes; the place is where it is over when the foot is not pitched.
    places = places + np.stack([beside, 0.0 * beside, stalk.ahead - offset[2] + shift[own, 1]], axis=-1)
    steps = Steps(-2, places, headings + sign * np.radians(6.0), 1.0 + shift[own, 2])
    swing = Swing(0.55 * stalk.lift[side], 0.55 * stalk.lift[side], 0.0, 0.0, 0.0)
    ankles, yaws, pitches = track(phases, steps, duty, pitch, foot, swing)
    toes = ankles[:, 1] + quat.rotate(about(0, -pitches), offset)[:, 1]
    room = 0.9 * np.arcsin(np.clip((toes - TOE_M) / _TIPS["LeftToe"][2], 0.0, 1.0))  # so that the tips stay clear
    wanted = np.maximum(-hang(phases % 1.0), 0.0)
    hanging = room * wanted / np.maximum((room**4 + wanted**4) ** 0.25, 1e-9)
    return ankles, yaws, pitches, -hanging
