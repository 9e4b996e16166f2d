"""Walks and runs of the humanoid: feet that stand, a pelvis that rides over them, a body that balances it.

Order: path, footsteps, pelvis, legs, trunk, head and arms. Feet never slide, since the legs are solved for them;
the pelvis is as high as the straightest knee allows. In a run, the height of the centre of mass follows from the
force of the ground, so it falls freely between two stances.

Sources: docs of the shapes and figures are in :mod:`tools.authoring.gait_fit`; the force of a run is half a sine,
R. Alexander, "Simple Models of Walking and Jumping", 1992.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from tools.authoring.figure import Figure
from tools.authoring.gait_model import GRAVITY, SIDES, STRIDES, Contacts, Gait, Timeline, lean_of
from tools.authoring.gait_upper import arms, trunk
from tools.authoring.humanoid import SOLE_M, humanoid
from tools.authoring.steps import Foot, Path, Steps, Swing, about, loop_curve, spans, track, two_bones, walk_phase
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["Legs", "cycle", "leg_angles", "solve_legs"]

_DIP_SHARE = 0.03
"""Half-width of a dip of the pelvis, as a share of a stride."""

_ROUNDS = 4
"""Corrections of the pelvis of a run, after which its centre of mass is where it should be."""

_ROUNDED = 0.015
"""Share of a stride by which the pitch of a foot starts early or ends late, since its corners are rounded."""

_KNEE_FOLLOWS_FOOT = 0.6
"""How far the knee points as its foot does; the rest as the pelvis does."""


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Frames of both legs: phases (2, F), ankles (2, F, 3), foot headings and pitches (2, F), toe pitches (2, F)."""

    phases: F64
    ankles: F64
    headings: F64
    pitches: F64
    toes: F64


@cache
def _foot() -> Foot:
    """The foot of the humanoid. Its heel is the point that contact detection looks at: a third of the ball's way."""
    skeleton = humanoid().skeleton
    ball = skeleton.offsets[skeleton.index("LeftToeBase")]
    return Foot(ball, np.array([0.0, ball[1], -0.3 * ball[2]]), SOLE_M)


def pitch_curve(gait: Gait) -> object:
    """Pitch of a foot over its cycle, rad."""
    duty = gait.duty
    knots = [
        (0.0, gait.strike), (gait.flat, 0.0), (gait.heel_off, 0.0), (duty, gait.push), (duty + 0.05, gait.trail),
        (duty + 0.4 * (0.94 - duty), gait.fold), (duty + 0.7 * (0.94 - duty), gait.swing), (0.94, gait.late),
    ]  # fmt: skip
    return loop_curve([(at, float(np.radians(value))) for at, value in knots])


def cycle(
    gait: Gait, path: Path, fps: float, *, seed: int = 0, vary: float = 1.0, backward: bool = False
) -> tuple[Motion, F64, Contacts]:
    """Author one cycle: two strides that differ a little; the last frame is the first one, moved.

    Parameters
    ----------
    gait : Gait
    path : Path
    fps : float
        Frames per second; the cycle is rounded to whole frames.
    seed : int
        Of the differences between sides and strides.
    vary : float
        Size of these differences.
    backward : bool
        Walk straight back, as a walk ahead looks in reverse: where a foot left the ground it strikes.

    Returns
    -------
    motion : Motion
    keytimes : (5,) float64
        :data:`KEYTIME_NAMES`, seconds.
    contacts : mapping
        Intervals, s, in which heel, ball and toe of each foot stand.
    """
    figure, rng = humanoid(), np.random.default_rng(seed)
    frames = round(STRIDES * gait.stride_s * fps)
    length = frames / fps
    gait = replace(gait, stride_s=length / STRIDES)
    times = np.arange(frames + 1) / fps
    late = vary * np.clip(rng.normal(size=2 * STRIDES), -1.5, 1.5) * 0.006 * gait.stride_s
    late -= late[0]
    strikes = (np.arange(2 * STRIDES) * 0.5 * gait.stride_s + late).reshape(STRIDES, 2)
    keytimes = np.append(strikes.ravel(), length)
    if backward:
        path = Path(-path.forward, -path.turn, -path.side)
        leaves = strikes + gait.duty * gait.stride_s
        times = leaves[0, 0] - times
        keytimes = np.append(np.sort(np.mod(leaves[0, 0] - leaves.ravel(), length)), length)
    slow = times / length + rng.uniform(0.0, 1.0, 6)[:, None]
    drift = np.asarray(1.0 + 0.05 * vary * np.cos(2 * np.pi * slow))
    legs = _legs(gait, path, times, strikes, length, rng, vary)
    phase = 0.5 * (legs.phases[0] + legs.phases[1] + 0.5)
    line = Timeline(times, phase, strikes, length, drift)
    root, rotations = _body(figure, gait, path, line, legs)
    start = path.at(times[:1])[0]
    contacts = {
        (name + "Foot", part): spans(np.arange(frames + 1) / fps, legs.phases[side], length, begin, end)
        for side, (name, _) in enumerate(SIDES)
        for part, begin, end in (
            ("heel", 0.0, gait.heel_off - _ROUNDED), ("ball", gait.flat + _ROUNDED, gait.duty),
            ("toe", gait.flat + _ROUNDED, gait.duty),
        )
    }  # fmt: skip
    return Motion(figure.skeleton, fps, root - start, quat.unroll(rotations)), keytimes, contacts


def _legs(
    gait: Gait, path: Path, times: F64, strikes: F64, length: float, rng: np.random.Generator, vary: float
) -> Legs:
    """Feet over a cycle."""
    curve, duty = pitch_curve(gait), gait.duty
    out = -0.93 * np.tan(lean_of(path))
    rows = []
    for side, (_, sign) in enumerate(SIDES):
        phases = walk_phase(times, strikes[:, side], length)
        first = -2
        stances = np.arange(first, STRIDES + 3)
        own = np.mod(stances, STRIDES)
        shift = vary * np.clip(rng.normal(size=(STRIDES, 4)), -1.5, 1.5) * (0.005, 0.006, 0.012, 0.05)
        shift[:, 1] *= min(1.0, abs(path.forward) + abs(path.side))
        middle = (strikes[own, side] + (stances - own) // STRIDES * length) + 0.5 * duty * gait.stride_s
        places, headings = path.at(middle)
        beside = sign * 0.5 * gait.width + out + shift[own, 0]
        offset = np.stack([beside, np.zeros(len(own)), gait.ahead + shift[own, 1]], axis=-1)
        places = places + quat.rotate(about(1, headings), offset)
        steps = Steps(first, places, headings + sign * np.radians(gait.turn_out) + shift[own, 2], 1.0 + shift[own, 3])
        swing = Swing(gait.early_lift, gait.late_lift, gait.early_ahead, gait.late_ahead, sign * gait.out)
        ankles, yaws, pitches = track(phases, steps, duty, curve, _foot(), swing)
        rows.append((phases, ankles, yaws, pitches, _toes(phases % 1.0, pitches, duty)))
    return Legs(*(np.stack(part) for part in zip(*rows, strict=True)))


def _toes(part: F64, pitches: F64, duty: float) -> F64:
    """Bend of the toes (F,), rad: flat on the ground while the heel is up, straight again late in the swing."""
    u = np.clip(((part - duty) / (1.0 - duty) - 0.14) / 0.55, 0.0, 1.0)
    keep = 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return np.asarray(np.maximum(-pitches, 0.0) * np.where(part <= duty, 1.0, keep))


def _pelvis(gait: Gait, phase: F64, drift: F64, lean: float) -> tuple[F64, F64]:
    """Offsets (F, 3) of the pelvis, without its mean height, and rotations (F, 4), both in the frame of the heading."""
    turn = 2.0 * np.pi
    across = gait.sway * np.cos(turn * (phase - gait.sway_at)) * drift[0]
    ahead = gait.surge * np.cos(2 * turn * (phase - gait.surge_at))
    height = gait.rise * np.cos(2 * turn * (phase - gait.rise_at)) * drift[1]
    yaw = -np.radians(gait.yaw) * np.cos(turn * (phase - gait.yaw_at)) * drift[2]
    roll = np.radians(gait.list) * np.cos(turn * (phase - gait.list_at)) * drift[3]
    tilt = np.radians(gait.tilt) + np.radians(1.0) * np.cos(2 * turn * (phase - 0.05))
    rotations = quat.mul(about(2, np.full(len(phase), -0.75 * lean)), about(1, yaw))
    rotations = quat.mul(quat.mul(rotations, about(2, roll)), about(0, tilt))
    return np.stack([across, height, ahead], axis=-1), rotations


def _body(
    figure: Figure, gait: Gait, path: Path, line: Timeline, legs: Legs, mean: float | None = None
) -> tuple[F64, F64]:
    """Roots (F, 3) and local rotations (F, J, 4); ``mean``: height of the root unless the knees set it."""
    ground, headings = path.at(line.times)
    heading = about(1, headings)
    offsets, pelvis = _pelvis(gait, line.phase, line.drift, lean_of(path))
    rotations = np.tile(figure.rest.rotations, (len(line.times), 1, 1))
    rotations[:, 0] = quat.mul(heading, pelvis)
    trunk(figure, gait, path, line, pelvis, rotations)
    arms(figure, gait, line, rotations)
    level = ground + quat.rotate(heading, offsets * np.array([1.0, 0.0, 1.0]))
    height = offsets[:, 1]
    if gait.flight:
        wanted = _flight_height(gait, legs.phases)
        height = wanted.copy()
    for _ in range(_ROUNDS if gait.flight else 1):
        tall = _height(figure, gait, level, height, rotations, legs) if mean is None else height - height.mean() + mean
        root = level + tall[:, None] * np.array([0.0, 1.0, 0.0])
        rotations = solve_legs(figure, root, rotations, legs)
        if gait.flight:
            positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)[1]
            gap = wanted - figure.centre_of_mass(positions)[:, 1]
            height = root[:, 1] + gap - gap.mean()
    return root, rotations


def _flight_height(gait: Gait, phases: F64) -> F64:
    """Height (F,) of the centre of mass of a run about its mean: -g in flight, half a sine of force in each stance."""
    count = 4096
    at = np.arange(count) / count
    force = np.zeros(count)
    for shift in (0.0, 0.5):
        part = np.mod(at - shift, 1.0) / gait.duty
        force += np.where(part < 1.0, np.sin(np.pi * np.minimum(part, 1.0)), 0.0)
    acceleration = GRAVITY * (force / force.mean() - 1.0)
    frequencies = 2 * np.pi * np.fft.rfftfreq(count, gait.stride_s / count)
    spectrum = np.fft.rfft(acceleration)
    spectrum[1:] /= -(frequencies[1:] ** 2)
    spectrum[0] = 0.0
    height = np.fft.irfft(spectrum, count)
    found = [np.interp(np.mod(row + shift, 1.0), np.append(at, 1.0), np.append(height, height[0]))
             for row, shift in zip(phases, (0.0, 0.5), strict=True)]  # fmt: skip
    return np.asarray(0.5 * (found[0] + found[1]))


def _hips(figure: Figure, rotations: F64) -> F64:
    """Hip joints (2, F, 3) relative to the root."""
    joints = figure.joints("LeftUpLeg", "RightUpLeg")
    return np.stack([quat.rotate(rotations[:, 0], figure.skeleton.offsets[joint]) for joint in joints])


def _height(figure: Figure, gait: Gait, level: F64, height: F64, rotations: F64, legs: Legs) -> F64:
    """Heights (F,) of the root: as high as the knees allow, none of which is straighter than in the gait.

    A run keeps the shape of its height. A walk dips a little where a leg reaches far, so the others stand straighter.
    """
    skeleton = figure.skeleton
    upper, lower = (-skeleton.offsets[skeleton.index(name), 1] for name in ("LeftLeg", "LeftFoot"))
    hips = _hips(figure, rotations) + level
    flat = np.linalg.norm((hips - legs.ankles)[..., [0, 2]], axis=-1)
    straight = np.sqrt(upper**2 + lower**2 + 2 * upper * lower * np.cos(np.radians(gait.knee)))
    allowed = legs.ankles[..., 1] + np.sqrt(np.maximum(straight**2 - flat**2, 1e-6))
    room = (allowed - (hips[..., 1] - level[:, 1]) - height).min(axis=0)
    if gait.flight:
        return np.asarray(height + room.min())
    mean, width = room.min() + gait.dip, _DIP_SHARE * (len(height) - 1) / STRIDES
    missing = np.maximum(mean - room[:-1], 0.0)
    wide = gaussian_filter1d(maximum_filter1d(missing, 2 * round(2 * width) + 1, mode="wrap"), width, mode="wrap")
    lower_by = wide * max(1.0, float(np.max(missing / np.maximum(wide, 1e-9))))
    return np.asarray(height + mean - np.append(lower_by, lower_by[0]))


def solve_legs(figure: Figure, root: F64, rotations: F64, legs: Legs) -> F64:
    """Local rotations (F, J, 4) with the legs bent to their feet."""
    skeleton, solved = figure.skeleton, rotations.copy()
    hips = _hips(figure, rotations) + root
    facing = quat.rotate(rotations[:, 0], np.array([0.0, 0.0, 1.0]))
    yaw = np.arctan2(facing[:, 0], facing[:, 2])
    for side, (name, _) in enumerate(SIDES):
        hip, knee, foot, toe = figure.joints(*(name + part for part in ("UpLeg", "Leg", "Foot", "ToeBase")))
        away = np.mod(legs.headings[side] - yaw + np.pi, 2 * np.pi) - np.pi
        pointing = about(1, yaw + _KNEE_FOLLOWS_FOOT * away)
        forward = quat.rotate(pointing, np.array([0.0, 0.0, 1.0]))
        upper, lower = -skeleton.offsets[knee, 1], -skeleton.offsets[foot, 1]
        thigh, shank, _ = two_bones(hips[side], legs.ankles[side], forward, upper, lower)
        sole = quat.mul(about(1, legs.headings[side]), about(0, -legs.pitches[side]))
        solved[:, hip] = quat.mul(quat.conjugate(rotations[:, 0]), thigh)
        solved[:, knee] = quat.mul(quat.conjugate(thigh), shank)
        solved[:, foot] = quat.mul(quat.conjugate(shank), sole)
        solved[:, toe] = about(0, -legs.toes[side])
    return solved


def leg_angles(gait: Gait, forward: float, count: int, mean: float | None = None) -> dict[str, F64]:
    """Curves of the left leg in straight, regular walking at ``count`` even phases of a stride, degrees.

    Parameters
    ----------
    gait : Gait
    forward : float
        Speed, m/s.
    count : int
    mean : float, optional
        Mean height of the root; unless given, that at which the straightest knee is bent as in the gait.

    Returns
    -------
    curves : dict of str to (count,) float64
        ``hip`` against the pelvis, ``thigh`` against the vertical, ``knee``, ``ankle``; and ``toe`` and ``heel``,
        their heights in metres, ``height`` and ``root`` those of centre of mass and pelvis, ``sharp`` the acceleration
        of the toe joint, m/s².
    """
    figure, path = humanoid(), Path(forward, 0.0, 0.0)
    length = STRIDES * gait.stride_s
    times = np.arange(count) / count * gait.stride_s
    strikes: F64 = (np.arange(2 * STRIDES) * 0.5 * gait.stride_s).reshape(STRIDES, 2).astype(np.float64)
    line = Timeline(times, times / gait.stride_s, strikes, length, np.ones((6, count)))
    legs = _legs(gait, path, times, strikes, length, np.random.default_rng(0), 0.0)
    root, rotations = _body(figure, gait, path, line, legs, mean)
    turns, positions = fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets)
    hip, knee, foot, toe = figure.joints("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase")
    thigh, shank = positions[:, knee] - positions[:, hip], positions[:, foot] - positions[:, knee]
    upright, lower = np.arctan2(thigh[:, 2], -thigh[:, 1]), np.arctan2(shank[:, 2], -shank[:, 1])
    tip = positions[:, toe] + quat.rotate(turns[:, toe], figure.skeleton.tip_offsets[-1] * np.array([-1.0, 1.0, 1.0]))
    heel = positions[:, foot] + quat.rotate(turns[:, foot], _foot().heel)
    return {
        "hip": np.degrees(upright) + gait.tilt,
        "thigh": np.degrees(upright),
        "knee": np.degrees(upright - lower) - np.degrees(_missing(figure, root, rotations, legs)),
        "ankle": np.degrees(legs.pitches[0] - lower),
        "toe": np.minimum(tip[:, 1], positions[:, toe, 1]),
        "heel": heel[:, 1],
        "height": figure.centre_of_mass(positions)[:, 1],
        "root": root[:, 1],
        "sharp": np.maximum(
            *(_sharpness(positions[:, one], forward * gait.stride_s, gait.stride_s / count) for one in (toe, knee))
        ),
    }


def _sharpness(path: F64, stride_m: float, step_s: float) -> F64:
    """Accelerations (F,) along a path (F, 3) that repeats a stride further on, m/s²."""
    ahead = np.array([0.0, 0.0, stride_m])
    whole = np.concatenate([path[-1:] - ahead, path, path[:1] + ahead])
    return np.asarray(np.linalg.norm(np.diff(whole, 2, axis=0), axis=1) / step_s**2)


def _missing(figure: Figure, root: F64, rotations: F64, legs: Legs) -> F64:
    """How far (F,), rad, the left leg is from reaching its foot; 0 where it does."""
    skeleton = figure.skeleton
    upper, lower = (-skeleton.offsets[skeleton.index(name), 1] for name in ("LeftLeg", "LeftFoot"))
    forward = np.broadcast_to(np.array([0.0, 0.0, 1.0]), root.shape)
    bend = two_bones(_hips(figure, rotations)[0] + root, legs.ankles[0], forward, upper, lower)[2]
    return np.asarray(np.maximum(-bend, 0.0))
