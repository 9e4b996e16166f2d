"""Footsteps: a path at constant speeds, feet that stand beside it and swing between, and legs of two bones.

Leg phases are unwrapped: a foot strikes at every whole number, leaves the ground ``duty`` later, and swings to the
next. A standing foot turns about its heel or its ball only, so it does not slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from verbs.conventions import F64, I64, Floats
from verbs.kernels import quat

__all__ = ["Foot", "Path", "Steps", "Swing", "about", "loop_curve", "spans", "track", "two_bones", "walk_phase"]

_SAMPLES = 400
_SMOOTH = 0.012
"""Width of the Gaussian that rounds the corners of foot pitch, as a share of the cycle."""
_STEP = 1e-3
_CLEAR_M = 0.009
"""Height added shortly before a strike, so that no part of the foot touches the ground too early."""


class Path(NamedTuple):
    """Constant speeds of a body: forward, to the left (m/s) and turning left (rad/s)."""

    forward: float
    turn: float
    side: float

    def at(self, times: Floats) -> tuple[F64, F64]:
        """Positions (..., 3) on the ground and headings (...), rad."""
        times = np.asarray(times, np.float64)
        half = 0.5 * self.turn * times
        reach = times * np.sinc(half / np.pi)  # the chord of an arc
        ahead, across = self.forward * reach, self.side * reach
        x = across * np.cos(half) + ahead * np.sin(half)
        z = ahead * np.cos(half) - across * np.sin(half)
        return np.stack([x, np.zeros_like(x), z], axis=-1), np.asarray(2.0 * half)


class Foot(NamedTuple):
    """A foot: its ball and its heel in the frame of its ankle (3,), and the height of the ankle when it is flat."""

    ball: F64
    heel: F64
    sole_m: float

    def ankle(self, pitch: Floats) -> F64:
        """Ankle (..., 3) of a foot of some pitch (...), rad, toes up, over where it stands when flat.

        A negative pitch turns it about its ball, a positive one about its heel.
        """
        pitch = np.asarray(pitch, np.float64)
        pivot = np.where((pitch < 0.0)[..., None], self.ball, self.heel)
        flat = np.array([0.0, self.sole_m, 0.0])
        return flat + pivot - quat.rotate(about(0, -pitch), pivot)


class Swing(NamedTuple):
    """How a foot swings: heights and lengths, metres, that are added early and late in a swing, and to the left."""

    early_lift: float
    late_lift: float
    early_ahead: float
    late_ahead: float
    left: float


class Steps(NamedTuple):
    """Where and how one foot stands: ground positions (K, 3), headings (K,) and lifts (K,) of stances k = first … .

    ``lifts`` scale the swing that follows each stance.
    """

    first: int
    places: F64
    headings: F64
    lifts: F64


def about(axis: int, angles: Floats) -> F64:
    """Quaternions (..., 4) of rotations about one axis by angles (...), rad."""
    angles = np.asarray(angles, np.float64)
    vectors = np.zeros((*angles.shape, 3))
    vectors[..., axis] = angles
    return quat.exp(vectors)


def loop_curve(knots: Sequence[tuple[float, float]], smooth: float = _SMOOTH) -> CubicSpline:
    """Periodic curve of period 1 through knots (phase, value), without overshoot, its corners rounded."""
    at, values = np.array(knots).T
    at = np.concatenate([at - 1.0, at, at + 1.0])
    grid = np.arange(_SAMPLES) / _SAMPLES
    samples = PchipInterpolator(at, np.tile(values, 3))(grid)
    rounded = gaussian_filter1d(samples, smooth * _SAMPLES, mode="wrap") if smooth else samples
    return CubicSpline(np.append(grid, 1.0), np.append(rounded, rounded[0]), bc_type="periodic")


def walk_phase(times: Floats, strikes: Floats, length_s: float) -> F64:
    """Unwrapped leg phases (F,) at times (F,): whole at the strikes (K,) of a loop of so many seconds, smooth between.

    The first strike has phase 0.
    """
    strikes = np.asarray(strikes, np.float64)
    count = len(strikes)
    marks = np.append(strikes, strikes[0] + length_s)
    even = strikes[0] + length_s * np.arange(count + 1) / count
    # The deviation from even steps is periodic, which the spline keeps.
    late = CubicSpline(np.arange(count + 1), marks - even, bc_type="periodic")
    phases = (np.asarray(times) - strikes[0]) * count / length_s
    base = phases.copy()
    for _ in range(20):
        phases = base - late(phases % count) * count / length_s
    return np.asarray(phases)


def spans(times: F64, phases: F64, length_s: float, begin: float, end: float) -> list[tuple[float, float]]:
    """Intervals, s, of a loop in which a leg is between two phases of its cycle; one may end after the next begin.

    Parameters
    ----------
    times, phases : (F,) float64
        Unwrapped leg phases over the loop; they may fall.
    length_s : float
    begin, end : float
        Shares of the cycle.
    """
    order, lowest = np.argsort(phases), phases.min()
    cycles = round(abs(phases[-1] - phases[0]))
    found = []
    for k in range(cycles):
        wrapped = lowest + np.mod(np.array([begin, end]) + k - lowest, cycles)
        first, last = np.mod(np.interp(wrapped, phases[order], times[order]), length_s).tolist()
        found.append((first, last) if phases[-1] > phases[0] else (last, first))
    return sorted((round(first, 4), round(last, 4)) for first, last in found)


def track(phases: F64, steps: Steps, duty: float, pitch: CubicSpline, foot: Foot, swing: Swing) -> tuple[F64, F64, F64]:
    """Path of one foot.

    Parameters
    ----------
    phases : (F,) float64
        Unwrapped leg phases.
    steps : Steps
        Stances from the one before the first phase to the one after the last.
    duty : float
        Share of the cycle in which the foot stands.
    pitch : CubicSpline
        Pitch of the foot over a cycle, rad, toes up.
    foot : Foot
    swing : Swing

    Returns
    -------
    ankles : (F, 3) float64
    headings, pitches : (F,) float64
    """
    k = np.floor(phases + 1e-9).astype(np.int64)
    part = np.clip(phases - k, 0.0, 1.0)
    here, after = k - steps.first, k - steps.first + 1
    pitches = pitch(part)
    u = np.clip((part - duty) / (1.0 - duty), 0.0, 1.0)
    ease = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    headings = (1.0 - ease) * steps.headings[here] + ease * steps.headings[after]

    def standing(index: I64, at: Floats) -> F64:
        return np.asarray(
            steps.places[index] + quat.rotate(about(1, steps.headings[index]), foot.ankle(pitch(np.asarray(at))))
        )

    ends = []
    for index, at in ((here, duty), (after, 1.0)):
        before, now, later = (standing(index, np.full(len(phases), at + d)) for d in (-_STEP, 0.0, _STEP))
        ends.append((now, (later - before) / (2 * _STEP), (later - 2 * now + before) / _STEP**2))
    flying = _quintic(u, 1.0 - duty, ends[0], ends[1])
    lift = steps.lifts[here] * (
        swing.early_lift * _bump(u, 3, 6) + swing.late_lift * _bump(u, 3, 3) + _CLEAR_M * _bump(u, 10, 3)
    )
    along = swing.early_ahead * _bump(u, 3, 5) + swing.late_ahead * _bump(u, 5, 3)
    flying[:, 1] += lift
    flying += along[:, None] * quat.rotate(about(1, headings), np.array([0.0, 0.0, 1.0]))
    flying += swing.left * _bump(u, 3, 4)[:, None] * quat.rotate(about(1, headings), np.array([1.0, 0.0, 0.0]))
    # A foot on a curve swings along it, not along its chord, where the other leg stands. Its ends are on the curve
    # already, the more of the cycle it flies.
    chord = steps.places[after] - steps.places[here]
    outward = np.stack([-chord[:, 2], 0.0 * chord[:, 1], chord[:, 0]], axis=-1)
    bend = 0.5 * duty * np.tan(0.25 * (steps.headings[after] - steps.headings[here]))
    flying += (bend * _bump(u, 3, 3))[:, None] * outward
    ankles = np.where((part <= duty)[:, None], standing(here, part), flying)
    return ankles, headings, pitches


def _bump(u: F64, rise: int, fall: int) -> F64:
    """u^rise (1 - u)^fall, scaled to a peak of 1."""
    peak = rise / (rise + fall)
    return np.asarray(u**rise * (1.0 - u) ** fall / (peak**rise * (1.0 - peak) ** fall))


def _quintic(u: F64, length: float, start: tuple[F64, F64, F64], end: tuple[F64, F64, F64]) -> F64:
    """Positions (F, 3) at u in 0-1 between two states of position, velocity and acceleration per unit of phase."""
    (p0, v0, a0), (p1, v1, a1) = start, end
    v0, v1, a0, a1 = v0 * length, v1 * length, a0 * length**2, a1 * length**2
    u = u[:, None]
    gap = p1 - p0 - v0 - 0.5 * a0
    slope, bend = v1 - v0 - a0, a1 - a0
    c3, c4, c5 = 10 * gap - 4 * slope + 0.5 * bend, -15 * gap + 7 * slope - bend, 6 * gap - 3 * slope + 0.5 * bend
    return np.asarray(p0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5)))))


def two_bones(start: F64, end: F64, forward: F64, upper: float, lower: float) -> tuple[F64, F64, F64]:
    """Global rotations (F, 4) of two bones that hang along -Y and bend about X, and the bend (F,), rad.

    Parameters
    ----------
    start, end : (F, 3) float64
        Hip and ankle.
    forward : (F, 3) float64
        Direction in which the knee points.
    upper, lower : float
        Lengths, metres. A target out of reach gives a negative bend, that grows with what is missing.
    """
    reach = end - start
    distance = np.linalg.norm(reach, axis=-1)
    cosine = (distance**2 - upper**2 - lower**2) / (2.0 * upper * lower)
    bend = np.where(cosine < 1.0, np.arccos(np.clip(cosine, -1.0, 1.0)), -np.sqrt(np.maximum(2 * cosine - 2, 0.0)))
    down = reach / distance[:, None]
    across = np.cross(-down, forward)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    ahead = np.cross(across, -down)
    used = np.maximum(bend, 0.0)
    share = np.arctan2(lower * np.sin(used), upper + lower * np.cos(used))  # of the bend, before the straight line
    thigh = np.cos(share)[:, None] * down + np.sin(share)[:, None] * ahead
    shank = np.cos(used - share)[:, None] * down - np.sin(used - share)[:, None] * ahead
    return _frame(across, -thigh), _frame(across, -shank), bend


def _frame(x: F64, y: F64) -> F64:
    """Quaternions (F, 4) of the rotations that take X and Y to orthogonal unit vectors (F, 3)."""
    z = np.cross(x, y)
    w = 0.5 * np.sqrt(np.maximum(1e-12, 1.0 + x[:, 0] + y[:, 1] + z[:, 2]))
    small = w < 0.05
    quaternion = np.stack([y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0], 4 * w * w], axis=-1)
    if small.any():
        quaternion[small] = _frame_slow(x[small], y[small], z[small])
    return quat.normalize(quaternion)


def _frame_slow(x: F64, y: F64, z: F64) -> F64:
    """The same for rotations near half a revolution, by the largest eigenvector."""
    m = np.stack([x, y, z], axis=-1)
    k = np.zeros((len(m), 4, 4))
    for a in range(3):
        for b in range(3):
            k[:, a, b] = m[:, a, b] + m[:, b, a]
        k[:, a, a] -= np.trace(m, axis1=1, axis2=2)
    k[:, 3, 3] = np.trace(m, axis1=1, axis2=2)
    for a, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        k[:, a, 3] = k[:, 3, a] = m[:, i, j] - m[:, j, i]
    return np.asarray(np.linalg.eigh(k)[1][..., -1])
