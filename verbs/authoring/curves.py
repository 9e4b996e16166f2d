"""Convert motions to canonical curves: heading, time-warp, hemispheres, spline coefficients.

Source: Rose, Sloan, Cohen 2001, section 3 (keytimes, common time frame); the forms are those of ``docs/math.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from verbs.clips.advice import turn_advice
from verbs.conventions import F32, F64, MAX_KEYS
from verbs.errors import IllPosedVerb
from verbs.kernels import pose as poses
from verbs.kernels import quat, timewarp
from verbs.kernels.contacts import IN_PLACE_M
from verbs.motion import Motion

__all__ = ["CURVE_RATE_HZ", "Curves", "canonical_phases", "fit"]

CURVE_RATE_HZ = 60.0
"""Least density of canonical samples, in samples per second of the example that is slowest there."""

TURN_LIMIT_RAD = np.pi
"""Examples that lie farther than this from a joint's reference cannot be blended without ambiguity."""


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Fitted curves; arrays as in :class:`verbs.Verb`, and warnings for the report."""

    curves: F32
    references: F64
    strides: F64
    warnings: tuple[str, ...]


def canonical_phases(keytimes: F64, rate_hz: float, *, count: int = 0) -> tuple[F64, int]:
    """Phases (M,) of the keytimes and the number of intervals K, so that each phase is a multiple of 1/K.

    The phase of a keytime is the mean over examples of its share of the motion. K is ``count`` where that is given;
    else the least number that gives every example ``rate_hz`` samples per second in every segment.
    """
    shares = (keytimes - keytimes[:, :1]) / (keytimes[:, -1:] - keytimes[:, :1])
    mean = shares.mean(axis=0)
    if not count:
        count = int(np.ceil((np.diff(keytimes, axis=1).max(axis=0) * rate_hz / np.diff(mean)).max()))
    count = max(count, 2 * len(mean))
    if count >= MAX_KEYS:
        seconds = (keytimes[:, -1] - keytimes[:, 0]).max()
        raise IllPosedVerb(
            f"the motions last up to {seconds:.0f} s and would need {count} samples, over the limit of {MAX_KEYS}; "
            "cut them shorter, or make their segments more alike in length"
        )
    marks = np.round(mean * count)
    for m in range(1, len(marks)):  # two keytimes never share a sample
        marks[m] = max(marks[m], marks[m - 1] + 1)
    marks[-1] = count
    for m in range(len(marks) - 2, 0, -1):
        marks[m] = min(marks[m], marks[m + 1] - 1)
    return np.asarray(marks / count), count


def fit(
    motions: list[Motion],
    names: list[str],
    keytimes: F64,
    phases: F64,
    intervals: int,
    *,
    looping: bool,
    climbing: bool,
    root_motion: int,
    rotation_mode: int,
) -> Curves:
    """Fit canonical curves to the motions.

    Parameters
    ----------
    motions : list of Motion, length N
        One skeleton in all.
    names : list of str
        Names of the examples, for messages.
    keytimes : (N, M) float64
        Seconds from the start of each file.
    phases : (M,) float64, intervals : int
        Of :func:`canonical_phases`.
    looping, climbing : bool
        Whether the end of a cycle is the start of the next, and whether that may be higher or lower.
    root_motion, rotation_mode : int
        Numbers of :mod:`verbs.kernels.pose`.

    Raises
    ------
    IllPosedVerb
        If rotations of two examples lie so far apart that no mean is defined.
    """
    grid = np.arange(intervals + 1) / intervals
    striding = root_motion == poses.STRIDE
    resampled, warnings = [], []
    for name, motion, marks in zip(names, motions, keytimes, strict=True):
        times = np.clip(warp(marks, phases, grid, looping=looping), 0.0, motion.duration_s)
        resampled.append(_stride(motion, times, climbing=climbing) if striding else _absolute(motion, times))
        if looping:
            warnings += _seam(name, motion, climbing=climbing)
    roots, rotations, strides = (np.array(part) for part in zip(*resampled, strict=True))
    rows, references, more = _rows(rotations, names, motions, rotation_mode)
    samples = np.zeros((intervals + 1, len(motions), 4 + rows.shape[2] * 4))
    samples[:, :, :3] = roots.transpose(1, 0, 2)
    samples[:, :, 4:] = rows.transpose(1, 0, 2, 3).reshape(intervals + 1, len(motions), -1)
    steps = np.ascontiguousarray(strides.transpose(1, 0, 2))
    return Curves(_coefficients(samples, looping=looping), references, steps, tuple(warnings + more))


def warp(marks: F64, phases: F64, grid: F64, *, looping: bool) -> F64:
    """Seconds (K + 1,) in a motion with keytimes ``marks`` (M,) at every phase of the grid."""
    tangents = np.empty(len(marks))
    timewarp.slopes(phases, marks, looping, tangents)
    return np.array([timewarp.time_at(phases, marks, tangents, phase) for phase in grid])


def _spline(frames: F64, values: F64, times: F64, *, bend: str = "not-a-knot") -> F64:
    """Values (F, …) at frames (F,), interpolated at ``times`` by a cubic spline, or linearly below 3 frames."""
    if len(frames) < 3:
        flat = values.reshape(len(frames), -1)
        return np.stack([np.interp(times, frames, column) for column in flat.T], axis=-1).reshape(-1, *values.shape[1:])
    return np.asarray(CubicSpline(frames, values, bc_type=bend)(times))


def _absolute(motion: Motion, times: F64) -> tuple[F64, F64, F64]:
    """Root (K + 1, 3), rotations (K + 1, J, 4) and no steps (0, 4) of a motion at ``times`` (K + 1,)."""
    frames = np.arange(len(motion)) / motion.fps
    rotations = _spline(frames, quat.unroll(motion.rotations), times)
    return _spline(frames, motion.root, times), quat.normalize(rotations), np.zeros((0, 4))


def _stride(motion: Motion, times: F64, *, climbing: bool) -> tuple[F64, F64, F64]:
    """Root heights, rotations without heading and steps (K, 4) of one cycle at ``times`` (K + 1,).

    The heading rotates at the cycle's mean rate; steps are taken in the frame of the heading halfway through them.
    Where the cycle climbs, heights are those above the ground, which rises along the path.
    """
    frames = np.arange(len(motion)) / motion.fps
    rotations = quat.unroll(motion.rotations)
    rate = _heading_change(rotations[:, 0]) / frames[-1]
    rotations[:, 0] = quat.mul(_about_vertical(-rate * frames), rotations[:, 0])
    rotations, root = _closed(rotations), np.zeros((len(times), 3))
    heading = rate * times
    mid = 0.5 * (heading[1:] + heading[:-1])
    x, z = np.diff(_spline(frames, motion.root[:, [0, 2]], times), axis=0).T
    steps = [x * np.cos(mid) - z * np.sin(mid), x * np.sin(mid) + z * np.cos(mid), np.diff(heading)]
    if climbing:
        root[:, 1] = _spline(frames, motion.root[:, 1], times)
        steps.append(_rises(np.stack(steps[:2], axis=-1), np.diff(times), float(root[-1, 1] - root[0, 1])))
        root[1:, 1] -= np.cumsum(steps[3])
    else:
        root[:, 1] = _spline(frames, _closed(motion.root[:, 1]), times, bend="periodic")
        steps.append(np.zeros(len(x)))
    rotations = quat.normalize(_spline(frames, rotations, times, bend="periodic"))
    return root, rotations, np.stack(steps, axis=-1)


def _rises(planar: F64, seconds: F64, rise_m: float) -> F64:
    """Rise (K,) of each step of a cycle: that of an inclined plane under planar steps (K, 2), sideways and forward.

    A cycle that goes nowhere rises evenly in time.
    """
    whole = planar.sum(axis=0)
    square = float(whole @ whole)
    if square < IN_PLACE_M**2:
        return np.asarray(rise_m * seconds / seconds.sum())
    return np.asarray(rise_m * (planar @ whole) / square)


def _heading_change(rotations: F64) -> float:
    """Change of heading, radians, from the first to the last root rotation (F, 4); full revolutions count.

    It is the part about +Y of the rotation since the first frame, which does not depend on the root's local axes.
    """
    since = quat.mul(rotations, quat.conjugate(rotations[0]))
    yaw = 2.0 * np.unwrap(np.arctan2(since[:, 1], since[:, 3]))
    return float(yaw[-1] - yaw[0])


def _about_vertical(angles: F64) -> F64:
    """Quaternions (F, 4) of rotations about +Y by angles (F,)."""
    zero = np.zeros_like(angles)
    return np.stack([zero, np.sin(0.5 * angles), zero, np.cos(0.5 * angles)], axis=-1)


def _closed(cycle: F64) -> F64:
    """Values (F, …) of a cycle with the last made equal to the first.

    Rounding errors of files (up to 0.001) are dropped from the last frame; a larger gap is spread over the cycle.
    """
    last = quat.align(cycle[-1], cycle[0]) if cycle.ndim == 3 else cycle[-1]
    gap = cycle[0] - last
    size = np.linalg.norm(gap, axis=-1, keepdims=True) if cycle.ndim == 3 else np.abs(gap)
    spread = np.where(size > 1e-3, gap, 0.0)  # whole rotations: components depend on the local axes
    share = np.linspace(0.0, 1.0, len(cycle)).reshape(-1, *[1] * (cycle.ndim - 1))
    closed = cycle + share * spread
    closed[-1] = cycle[0]
    return np.asarray(closed)


def _seam(name: str, motion: Motion, *, climbing: bool) -> list[str]:
    """Warning where a cycle does not close: its last frame should be the first, moved and rotated."""
    back = _about_vertical(np.array([-_heading_change(quat.unroll(motion.rotations[:, 0]))]))[0]
    last = motion.rotations[-1].copy()
    last[0] = quat.mul(back, last[0])
    gaps = np.linalg.norm(quat.log(quat.mul(quat.conjugate(motion.rotations[0]), last)), axis=-1)
    joint, drop = int(np.argmax(gaps)), 0.0 if climbing else motion.root[-1, 1] - motion.root[0, 1]
    if gaps[joint] < np.radians(2.0) and abs(drop) < 0.01:
        return []
    return [
        f"example '{name}' does not close its cycle: joint '{motion.skeleton.names[joint]}' ends "
        f"{np.degrees(gaps[joint]):.1f}° and the root {drop * 1000:.0f} mm from the start; "
        "the gap is spread over the cycle"
    ]


def _rows(rotations: F64, names: list[str], motions: list[Motion], mode: int) -> tuple[F64, F64, list[str]]:
    """Rows to blend (N, K + 1, J, 4), references (J, 4), warnings; from rotations (N, K + 1, J, 4)."""
    joints = motions[0].skeleton.names
    rotations = np.stack([quat.unroll(one) for one in rotations])
    references = quat.principal(rotations.reshape(-1, len(joints), 4))
    # Signs must be continuous in time within an example and agree between examples at each instant: the mean of an
    # instant is unrolled over time, and each example takes the sign that agrees with it most of the time.
    means = quat.unroll(quat.principal(rotations))
    agreement = np.einsum("nkja,kja->nj", rotations, means)
    rotations = rotations * np.where(agreement < 0, -1.0, 1.0)[:, None, :, None]
    if mode == poses.ROTATION_VECTOR:
        vectors = quat.log(quat.mul(quat.conjugate(references), rotations))
        jumps = np.abs(np.diff(vectors, axis=1)).max(axis=(1, 3))
        if jumps.max() > 0.5 * np.pi:
            example, joint = np.unravel_index(np.argmax(jumps), jumps.shape)
            raise IllPosedVerb(
                f"example '{names[example]}' rotates joint '{joints[joint]}' by more than 180° from the mean; "
                'rotation vectors cannot blend that: use rotations = "quaternion"'
            )
        return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 1))], axis=-1), references, []
    dots = np.einsum("nkja,kja->nkj", rotations, means).min(axis=1)
    apart = 2.0 * np.arccos(np.clip(dots, -1.0, 1.0))
    example, joint = np.unravel_index(np.argmax(apart), apart.shape)
    where = f"example '{names[example]}' rotates joint '{joints[joint]}' {np.degrees(apart.max()):.0f}° from the mean"
    if apart.max() >= TURN_LIMIT_RAD:
        advice = turn_advice(motions[example], int(joint), names[example])
        raise IllPosedVerb(f"{where}; blends need less than 180°: {advice}")
    far = [f"{where}; blends with it may look odd"] if apart.max() > 0.5 * np.pi else []
    return rotations, references, far


def _coefficients(samples: F64, *, looping: bool) -> F32:
    """Uniform cubic B-spline coefficients (K + 3, …) that pass through samples (K + 1, …)."""
    count = len(samples) - 1
    if looping:
        samples[-1] = samples[0]  # equal up to rounding; a periodic spline needs them equal
    spline = CubicSpline(np.arange(count + 1), samples, bc_type="periodic" if looping else "not-a-knot")
    inner = samples - spline(np.arange(count + 1), 2) / 6.0
    first = 6.0 * samples[0] - 4.0 * inner[0] - inner[1]
    last = 6.0 * samples[-1] - 4.0 * inner[-1] - inner[-2]
    return np.concatenate([first[None], inner, last[None]]).astype(np.float32)
