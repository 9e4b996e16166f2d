"""Figures of whole motions that one compiled call takes from weights: accelerations, joint ranges, slip of the feet.

A motion is sampled at about 60 Hz; a loop in as many equal steps as come closest to it. The curves are summed over the
examples first, which makes a motion a hundredth of the work of its poses one by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.kernels import pose, timewarp
from verbs.kernels.compile import kernel
from verbs.kernels.crowd_pose import finish_double
from verbs.kernels.timewarp import Clock

__all__ = ["FIGURES", "MotionProblem", "motion_figures"]

RATE_HZ, LONGEST_S, FEWEST = 60.0, 60.0, 5
"""Frames per second; a motion that is longer, or has fewer frames, has no figures."""

FIGURES = ("strain", "beyond", "slip", "rms", "peak", "excess", "duration")
"""Columns of :func:`motion_figures`."""


class MotionProblem(NamedTuple):
    """What the motions of a verb depend on.

    Parameters
    ----------
    curves : (K + 3, N, 4 + 4·J) float32
    mode : int
        How rotations blend.
    references : (J, 4) float64
    strides : (K, N, 4) float64
        Without rows where the root does not stride.
    clock : Clock
    parents : (J,) int64
    offsets : (J, 3) float64
    low, high : (J, 3) float64
        Ranges of rotation vectors from the references, radians.
    slack : float
        Width that is added to ranges for ``beyond``, radians.
    points : (P,) int64
        Joints that carry the contact points.
    point_offsets : (P, 3) float64
    contact : (K + 1, N, P) float32
    """

    curves: F32
    mode: int
    references: F64
    strides: F64
    clock: Clock
    parents: I64
    offsets: F64
    low: F64
    high: F64
    slack: float
    points: I64
    point_offsets: F64
    contact: F32


@kernel
def _collapse(weights: F64, curves: F32, out: F64) -> None:
    """Sum over the examples: ``out`` (K + 3, C) of curves (K + 3, N, C)."""
    count = weights.shape[0]
    for k in range(curves.shape[0]):
        row = out[k]
        row[:] = 0.0
        i = 0
        while i + 3 < count:
            a, b, c, d = weights[i], weights[i + 1], weights[i + 2], weights[i + 3]
            r0, r1, r2, r3 = curves[k, i], curves[k, i + 1], curves[k, i + 2], curves[k, i + 3]
            for x in range(row.shape[0]):
                row[x] += a * r0[x] + b * r1[x] + c * r2[x] + d * r3[x]
            i += 4
        while i < count:
            a, r0 = weights[i], curves[k, i]
            for x in range(row.shape[0]):
                row[x] += a * r0[x]
            i += 1


@kernel
def _phases(weights: F64, clock: Clock) -> tuple[F64, float, float]:
    """Unwrapped phases of the frames, seconds per frame, and the duration; no frames where it is out of bounds."""
    marks, log_lengths, looping = clock
    keytimes, tangents = np.empty(marks.shape[0]), np.empty(marks.shape[0])
    timewarp.blend_keytimes(weights, log_lengths, keytimes)
    timewarp.slopes(marks, keytimes, looping, tangents)
    duration = keytimes[marks.shape[0] - 1]
    if not FEWEST / RATE_HZ <= duration <= LONGEST_S:  # NaN compares false
        return np.empty(0), 0.0, duration
    steps = int(np.rint(duration * RATE_HZ)) if looping else int(duration * RATE_HZ + 1e-9)
    step_s = duration / steps if looping else 1.0 / RATE_HZ
    phases = np.empty(steps + 1 + 2 * looping)
    for f in range(phases.shape[0]):
        whole = f // steps if looping else 0
        time_s = min(max((f - whole * steps) * step_s, 0.0), duration)
        phases[f] = whole + timewarp.phase_at(marks, keytimes, tangents, time_s)
    return phases, step_s, duration


@kernel
def _pose(phase: float, rows: F64, problem: MotionProblem, taps: F64, row: F64, root: F64, rotations: F64) -> None:
    """Root (3,) and local rotations (J, 4) at a phase in [0, 1], from summed curves."""
    k = pose.spline_taps(phase, rows.shape[0] - 3, taps)
    a, b, c, d = taps[0], taps[1], taps[2], taps[3]
    r0, r1, r2, r3 = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
    for x in range(row.shape[0]):
        row[x] = a * r0[x] + b * r1[x] + c * r2[x] + d * r3[x]
    finish_double(row, problem.mode, problem.references, root, rotations)


@kernel
def _excess(rotations: F64, problem: MotionProblem) -> tuple[float, float]:
    """Sum of the 6th powers of what is beyond the ranges and the slack, and the largest excess of any joint."""
    references, low, high, slack = problem.references, problem.low, problem.high, problem.slack
    total, largest = 0.0, 0.0
    back, turned = np.empty(4), np.empty(4)
    for j in range(1, rotations.shape[0]):  # the root's rotation is a heading
        for a in range(3):
            back[a] = -references[j, a]
        back[3] = references[j, 3]
        pose.multiply(back, rotations[j], turned)
        if turned[3] < 0.0:
            turned *= -1.0
        sine = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2])
        scale = 2.0 * np.arctan2(sine, turned[3]) / sine if sine > 1e-9 else 2.0
        squared = 0.0
        for a in range(3):
            angle = scale * turned[a]
            out = max(angle - high[j, a], low[j, a] - angle)
            if out > 0.0:
                squared += out * out
                if out > slack:
                    total += (out - slack) ** 6
        largest = max(largest, squared)
    return total, np.sqrt(largest)


@kernel
def _slip(weights: F64, phases: F64, step_s: float, turned: F64, positions: F64, problem: MotionProblem) -> float:
    """Root of the mean square of the speed over the ground of contact points while they stand, m/s."""
    points, offsets, contact, looping = problem.points, problem.point_offsets, problem.contact, problem.clock.looping
    intervals, place = contact.shape[0] - 1, np.empty(3)
    total, count = 0.0, 0
    for p in range(points.shape[0]):
        stood, x, z = False, 0.0, 0.0
        for f in range(phases.shape[0]):
            at = (phases[f] - np.floor(phases[f]) if looping else min(phases[f], 1.0)) * intervals
            k = min(int(at), intervals - 1)
            u, share = at - k, 0.0
            for i in range(weights.shape[0]):
                share += weights[i] * ((1.0 - u) * contact[k, i, p] + u * contact[k + 1, i, p])
            stands = share > 0.5
            if stands:
                place[:] = positions[f, points[p]]
                pose.add_rotated(turned[f, points[p]], offsets[p], place)
                if stood:
                    total += ((place[0] - x) ** 2 + (place[2] - z) ** 2) / (step_s * step_s)
                    count += 1
                x, z = place[0], place[2]
            stood = stands
    return np.sqrt(total / count) if count else 0.0


@kernel
def _motion(weights: F64, problem: MotionProblem, rows: F64, steps: F64, out: F64) -> None:
    """Figures (7,) of one motion; ``rows`` (K + 3, C) and ``steps`` (K, 1, 4) are scratch."""
    phases, step_s, duration = _phases(weights, problem.clock)
    out[:] = np.nan
    out[6] = duration
    frames, joints = phases.shape[0], problem.parents.shape[0]
    if frames < 3:
        return
    _collapse(weights, problem.curves, rows)
    root, rotations = np.empty((frames, 3)), np.empty((frames, joints, 4))
    taps, row = np.empty(4), np.empty(rows.shape[1])
    beyond, excess = 0.0, 0.0
    for f in range(frames):
        _pose(phases[f] - np.floor(phases[f]) if problem.clock.looping else phases[f], rows, problem, taps, row,
              root[f], rotations[f])  # fmt: skip
        total, largest = _excess(rotations[f], problem)
        beyond += total
        excess = max(excess, largest)
    if steps.shape[0]:
        for k in range(steps.shape[0]):
            for a in range(steps.shape[2]):
                steps[k, 0, a] = 0.0
                for i in range(weights.shape[0]):
                    steps[k, 0, a] += weights[i] * problem.strides[k, i, a]
        pose.travel(np.ones((frames, 1)), steps, phases, problem.clock.looping, True, root, rotations)
    turned, positions = np.empty_like(rotations), np.empty((frames, joints, 3))
    pose.forward(root, rotations, problem.parents, problem.offsets, turned, positions)
    strain, square, peak, scale = 0.0, 0.0, 0.0, 1.0 / step_s**4
    for f in range(1, frames - 1):
        for j in range(joints):
            length = 0.0
            for a in range(3):
                second = positions[f + 1, j, a] - 2.0 * positions[f, j, a] + positions[f - 1, j, a]
                length += second * second
            length *= scale
            square += length
            strain += length**4
            peak = max(peak, length)
    out[0], out[1] = strain**0.125, beyond ** (1.0 / 6.0)
    out[2] = _slip(weights, phases, step_s, turned, positions, problem)
    out[3] = np.sqrt(square * step_s / (duration * joints))
    out[4], out[5] = np.sqrt(peak), excess


@kernel
def motion_figures(weights: F64, problem: MotionProblem, out: F64) -> None:
    """Figures (B, 7) of the whole motions of weights (B, N), in the order of :data:`FIGURES`.

    These are: the 8-norm of the accelerations of all joints in all frames, m/s²; the 6-norm of the excess over ranges
    and slack, radians; the slip of standing points, m/s; the root mean square of the accelerations, and the largest,
    m/s²; the largest excess of a joint over its range, radians; and the duration, seconds. All but the duration are
    NaN where it is out of bounds.
    """
    curves, strides = problem.curves, problem.strides
    rows, steps = np.empty((curves.shape[0], curves.shape[2])), np.empty((strides.shape[0], 1, strides.shape[2]))
    for b in range(weights.shape[0]):
        _motion(weights[b], problem, rows, steps, out[b])
