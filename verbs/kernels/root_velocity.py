"""Mean speeds of one walked cycle, and their derivatives in the weights: few passes over contiguous rows.

A step contributes its blended stride, rotated by the angle from a frame that turns at the cycle's mean rate to the
step's own heading. Strides and headings are linear in the weights, seconds in keytimes and tangents; so all are sums
of rows that never change, and only the turning in between is not linear. Derivatives are taken backwards: each
step's sensitivity first, then one more pass over the rows.

Rows are filled up with zeros to whole ``LANES``, and come in whole groups, so that loops vectorise.

Source: ``docs/math.md``, sections "Measures" and "Corrected blending".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.timewarp import Clock, blend_keytimes, slopes

__all__ = ["Cycle", "Scratch", "cycle_of", "mean_speeds", "scratch", "speed_derivatives"]

LANES = 16
"""Steps that a vectorised loop takes in one go."""

GROUP = 4
"""Rows that are summed in one go."""

SIDE, AHEAD, ANGLE, SINE, COSINE = range(5)
"""Rows of ``steps``. Once rotated, ``SIDE`` and ``AHEAD`` are the step in the frame of the mean rate."""


class Cycle(NamedTuple):
    """The strides of a loop, laid out as rows.

    Parameters
    ----------
    rows : (2·G + H, C) float64
        Sideways strides of the N examples, filled up to G rows; forward strides, likewise; headings at mid step, and
        the 2·(M - 1) rows of :func:`_lay_clock`, together filled up to H rows. C is K in whole lanes.
    turns : (N,) float64
        Angle by which each example turns over the cycle, rad.
    clock : Clock
    """

    rows: F64
    turns: F64
    clock: Clock


class Scratch(NamedTuple):
    """Scratch arrays of one cycle; :func:`mean_speeds` writes the first three, from which derivatives start.

    Parameters
    ----------
    times : (2, M) float64
        Keytimes and tangents.
    full : (H,) float64
        Factors of the rows.
    steps : (5, C) float64
    shares : (M + 1, M) float64
    jacobian : (3, G) float64
        Written by :func:`speed_derivatives`; the first N columns count.
    """

    times: F64
    full: F64
    steps: F64
    shares: F64
    jacobian: F64


@kernel
def _whole(count: int, unit: int) -> int:
    """Round up to whole units."""
    return (count + unit - 1) // unit * unit


@kernel
def cycle_of(strides: F64, clock: Clock) -> Cycle:
    """Lay out the strides (K, N, 4) of a loop: see :func:`verbs.kernels.pose.stride_to`; rises do not count."""
    steps, count = strides.shape[0], strides.shape[1]
    group, turns = _whole(count, GROUP), np.empty(count)
    rows = np.zeros((2 * group + _whole(count + 2 * clock.phases.shape[0] - 2, GROUP), _whole(steps, LANES)))
    for i in range(count):
        heading = 0.0
        for k in range(steps):
            rows[i, k], rows[group + i, k] = strides[k, i, 0], strides[k, i, 1]
            rows[2 * group + i, k] = heading + 0.5 * strides[k, i, 2]
            heading += strides[k, i, 2]
        turns[i] = heading
    _lay_clock(clock.phases, steps, rows[2 * group + count :])
    return Cycle(rows, turns, clock)


@kernel
def _lay_clock(phases: F64, steps: int, clock: F64) -> None:
    """Add what keytimes 1 to M - 1 and tangents 0 to M - 2 weigh in the seconds at mid step, one row each.

    Keytime 0 is 0 s, and a loop's last tangent is its first. Mid step is the mean of the step's ends; at each end
    :func:`verbs.kernels.timewarp.time_at` is written out.
    """
    last, s = phases.shape[0] - 1, 0
    for end in range(steps + 1):
        phase = end / steps
        while s < last - 1 and phase >= phases[s + 1]:
            s += 1
        width = phases[s + 1] - phases[s]
        u = (phase - phases[s]) / width
        v = 1.0 - u
        for k in range(max(end - 1, 0), min(end + 1, steps)):
            if s > 0:
                clock[s - 1, k] += 0.5 * v * v * (1.0 + 2.0 * u)
            clock[s, k] += 0.5 * u * u * (3.0 - 2.0 * u)
            clock[last + s, k] += 0.5 * v * v * u * width
            clock[last + (s + 1) % last, k] -= 0.5 * u * u * v * width


@kernel
def scratch(cycle: Cycle) -> Scratch:
    """Scratch arrays for a cycle."""
    marks, group = cycle.clock.phases.shape[0], _whole(cycle.turns.shape[0], GROUP)
    times, full = np.empty((2, marks)), np.zeros(cycle.rows.shape[0] - 2 * group)
    shares, jacobian = np.empty((marks + 1, marks)), np.empty((3, group))
    return Scratch(times, full, np.empty((5, cycle.rows.shape[1])), shares, jacobian)


@kernel
def _sum_rows(full: F64, walk: F64, first: int, count: int, steps: F64, a: int) -> None:
    """Weighted sum of ``count`` rows of ``walk`` from ``first`` on, to row ``a`` of ``steps``."""
    for k in range(walk.shape[1]):
        steps[a, k] = 0.0
    for i in range(0, count, GROUP):
        p, q, r, s, row = full[i], full[i + 1], full[i + 2], full[i + 3], first + i
        for k in range(walk.shape[1]):
            steps[a, k] += p * walk[row, k] + q * walk[row + 1, k] + r * walk[row + 2, k] + s * walk[row + 3, k]


@kernel
def _half_turn(q: float) -> tuple[float, float]:
    """sin(h)/h and cos(h) of q = h², by their Taylor series: to 1e-16 for |h| ≤ π/4."""
    sine = 1.0 / 6227020800.0 - q * (1.0 / 1307674368000.0)
    sine = q * sine - 1.0 / 39916800.0
    sine = q * sine + 1.0 / 362880.0
    sine = q * sine - 1.0 / 5040.0
    sine = q * sine + 1.0 / 120.0
    sine = q * sine - 1.0 / 6.0
    cosine = q * (1.0 / 20922789888000.0) - 1.0 / 87178291200.0
    cosine = q * cosine + 1.0 / 479001600.0
    cosine = q * cosine - 1.0 / 3628800.0
    cosine = q * cosine + 1.0 / 40320.0
    cosine = q * cosine - 1.0 / 720.0
    cosine = q * cosine + 1.0 / 24.0
    return 1.0 + q * sine, 1.0 - q * (0.5 - q * cosine)


@kernel
def _sines(steps: F64) -> None:
    """Sines and cosines of the angles. A fixed number of terms vectorises, the library's functions do not.

    Taking away half turns is as exact as the angles are: it errs by 1e-16 for each.
    """
    for k in range(steps.shape[1]):
        angle = steps[ANGLE, k]
        halves = np.floor(angle * (1.0 / np.pi) + 0.5)
        half = 0.5 * (angle - np.pi * halves)
        sign = 1.0 - 2.0 * (halves - 2.0 * np.floor(0.5 * halves))
        share, cosine = _half_turn(half * half)
        sine = half * share
        steps[SINE, k] = sign * 2.0 * sine * cosine
        steps[COSINE, k] = sign * (1.0 - 2.0 * sine * sine)


@kernel
def _rotate(steps: F64) -> tuple[float, float]:
    """Rotate every step by its angle, in place; return the sums: sideways, forward."""
    x_sum, z_sum = 0.0, 0.0
    for k in range(steps.shape[1]):
        side, ahead, sine, cosine = steps[SIDE, k], steps[AHEAD, k], steps[SINE, k], steps[COSINE, k]
        x, z = side * cosine + ahead * sine, ahead * cosine - side * sine
        steps[SIDE, k], steps[AHEAD, k] = x, z
        x_sum += x
        z_sum += z
    return x_sum, z_sum


@kernel
def mean_speeds(
    weights: F64, rows: F64, turns: F64, phases: F64, log_lengths: F64, times: F64, full: F64, steps: F64, point: F64
) -> None:
    """Forward speed (m/s), turn rate (rad/s), sideways speed (m/s) of weights (N,) over a cycle, to ``point`` (3,).

    Arrays as in :class:`Cycle` and :class:`Scratch`. They come one by one: to pass a bundle costs two atomic
    operations for each array in it, in every step of every row.
    """
    count, last = weights.shape[0], phases.shape[0] - 1
    blend_keytimes(weights, log_lengths, times[0])
    slopes(phases, times[0], True, times[1])
    duration, total = times[0, last], 0.0
    for i in range(count):
        total += weights[i] * turns[i]
        full[i] = weights[i]
    rate = total / duration
    for m in range(last):
        full[count + m], full[count + last + m] = -rate * times[0, m + 1], -rate * times[1, m]
    group = (rows.shape[0] - full.shape[0]) // 2
    _sum_rows(full, rows, 0, group, steps, SIDE)
    _sum_rows(full, rows, group, group, steps, AHEAD)
    _sum_rows(full, rows, 2 * group, full.shape[0], steps, ANGLE)
    _sines(steps)
    x_sum, z_sum = _rotate(steps)
    point[0], point[1], point[2] = z_sum / duration, rate, x_sum / duration


@kernel
def _slope_shares(phases: F64, times: F64, bent: F64) -> None:
    """Derivatives (M - 1, M - 1) of a loop's tangents in the segment lengths, all positive; the last column is over.

    A slope s = (a + b) / (a/d + b/e) of secants d, e (:func:`verbs.kernels.timewarp.slopes`) has ∂s/∂d = a (s/d)² /
    (a + b).
    """
    last = phases.shape[0] - 1
    for m in range(last):
        for n in range(last):
            bent[m, n] = 0.0
    if last == 1:
        bent[0, 0] = 1.0 / (phases[1] - phases[0])
        return
    for n in range(last):
        m = n - 1 if n > 0 else last - 1
        left, right = phases[m + 1] - phases[m], phases[n + 1] - phases[n]
        a, b = 2.0 * right + left, right + 2.0 * left
        bent[m, n] += a / (a + b) * left * (times[1, n] / (times[0, m + 1] - times[0, m])) ** 2
        bent[n, n] += b / (a + b) * right * (times[1, n] / (times[0, n + 1] - times[0, n])) ** 2


@kernel
def _gather(walk: F64, steps: F64, jacobian: F64) -> None:
    """Derivatives of the sums in the weights, of steps only: forward and sideways, rows 0, 2 of ``jacobian`` (3, G)."""
    rows = jacobian.shape[1]
    for i in range(0, rows, 2):
        j, n = rows + i, 2 * rows + i
        dx0, dx1, dz0, dz1 = 0.0, 0.0, 0.0, 0.0
        for k in range(walk.shape[1]):
            x, z, sine, cosine = steps[SIDE, k], steps[AHEAD, k], steps[SINE, k], steps[COSINE, k]
            dx0 += walk[i, k] * cosine + walk[j, k] * sine + walk[n, k] * z
            dz0 += walk[j, k] * cosine - walk[i, k] * sine - walk[n, k] * x
            dx1 += walk[i + 1, k] * cosine + walk[j + 1, k] * sine + walk[n + 1, k] * z
            dz1 += walk[j + 1, k] * cosine - walk[i + 1, k] * sine - walk[n + 1, k] * x
        jacobian[0, i], jacobian[0, i + 1], jacobian[2, i], jacobian[2, i + 1] = dz0, dz1, dx0, dx1


@kernel
def _pace(walk: F64, first: int, times: F64, steps: F64, shares: F64) -> None:
    """Sums Σ_k x, z times the seconds at mid step, and times their derivatives in each segment length.

    ``shares`` (M + 1, M) contains the tangents' derivatives in its first M - 1 rows. Its last two are written: x and z;
    the derivatives come first, the sum last.
    """
    last = times.shape[1] - 1
    shares[last:] = 0.0
    for c in range(last):
        row, other = first + c, first + last + c
        x, z, x_bent, z_bent = 0.0, 0.0, 0.0, 0.0
        for k in range(walk.shape[1]):
            x += walk[row, k] * steps[SIDE, k]
            z += walk[row, k] * steps[AHEAD, k]
            x_bent += walk[other, k] * steps[SIDE, k]
            z_bent += walk[other, k] * steps[AHEAD, k]
        shares[last, last] += x * times[0, c + 1] + x_bent * times[1, c]
        shares[last + 1, last] += z * times[0, c + 1] + z_bent * times[1, c]
        for m in range(last):
            ahead = 1.0 if m <= c else 0.0  # a longer segment delays every keytime after it
            shares[last, m] += x * ahead + x_bent * shares[m, c]
            shares[last + 1, m] += z * ahead + z_bent * shares[m, c]


@kernel
def speed_derivatives(
    rows: F64, turns: F64, phases: F64, log_lengths: F64, times: F64, steps: F64, point: F64, shares: F64, jacobian: F64
) -> None:
    """Jacobian (3, G) of :func:`mean_speeds` at its last weights, whose result is ``point`` (3,).

    ∂angle/∂w_i is the heading's row, less what the frame turns further by ∂rate/∂w_i and by the growth of time; the
    latter two are sums over the steps, chained to the examples last.
    """
    count, last = turns.shape[0], phases.shape[0] - 1
    _slope_shares(phases, times, shares)
    _gather(rows, steps, jacobian)
    _pace(rows, 2 * jacobian.shape[1] + count, times, steps, shares)
    per_s = 1.0 / times[0, last]
    forward, rate, sideways = point[0], point[1], point[2]
    for i in range(count):
        jacobian[0, i] *= per_s
        jacobian[1, i] = turns[i] * per_s
        jacobian[2, i] *= per_s
    for m in range(last):
        share = (times[0, m + 1] - times[0, m]) * per_s  # one segment's, of the cycle
        dz = share * (rate * shares[last, m] - forward)
        dx = share * (rate * shares[last + 1, m] + sideways)
        for i in range(count):
            jacobian[0, i] += dz * log_lengths[i, m]
            jacobian[1, i] -= share * rate * log_lengths[i, m]
            jacobian[2, i] -= dx * log_lengths[i, m]
    dz, dx = shares[last, last] * per_s, shares[last + 1, last] * per_s
    for i in range(count):
        jacobian[0, i] += dz * jacobian[1, i]
        jacobian[2, i] -= dx * jacobian[1, i]
