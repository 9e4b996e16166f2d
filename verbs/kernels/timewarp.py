"""Keytimes ↔ canonical time: monotone, once differentiable, always invertible.

Canonical time (phase) runs from 0 to 1 and has the verb's keytimes at fixed phases; a motion with its own keytimes
maps phase to seconds by a monotone cubic through (phase, keytime). Durations blend as logarithms of segment lengths,
so that every segment stays positive for any weights, negative ones too.

Source: F. N. Fritsch and J. Butland, "A method for constructing local monotone piecewise cubic interpolants", 1984
(slopes); Rose, Sloan, Cohen 2001, section 3 (keytimes as interpolated degrees of freedom).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel

__all__ = ["Clock", "blend_keytimes", "phase_at", "phase_near", "rate_at", "slopes", "time_at"]

NEWTON_END = 1e-7
"""Length of a Newton step, as a share of a segment, after which the next one is below rounding on a slope."""


class Clock(NamedTuple):
    """How a verb's phase and seconds belong together.

    Parameters
    ----------
    phases : (M,) float64
        Canonical phases of the keytimes.
    log_lengths : (N, M - 1) float64
        Logarithms of the examples' segment lengths in seconds.
    looping : bool
    """

    phases: F64
    log_lengths: F64
    looping: bool


@kernel
def _end_slope(near: float, far: float, near_secant: float, far_secant: float) -> float:
    """One-sided slope at an end: parabola through three points, limited so that it stays monotone."""
    slope = ((2.0 * near + far) * near_secant - near * far_secant) / (near + far)
    if slope * near_secant <= 0.0:
        return 0.0
    if near_secant * far_secant <= 0.0 and abs(slope) > 3.0 * abs(near_secant):
        return 3.0 * near_secant
    return slope


@kernel
def _inner_slope(left: float, right: float, left_secant: float, right_secant: float) -> float:
    """Weighted harmonic mean of the secants on both sides of a knot."""
    if left_secant * right_secant <= 0.0:
        return 0.0
    a, b = 2.0 * right + left, right + 2.0 * left
    return (a + b) / (a / left_secant + b / right_secant)


@kernel
def slopes(knots: F64, values: F64, periodic: bool, out: F64) -> None:
    """Slopes (M,) of the monotone cubic through ``values`` (M,) at ``knots`` (M,), rising, M ≥ 2.

    ``periodic`` makes the slopes at both ends equal, as if the last segment came before the first.
    """
    last = knots.shape[0] - 1
    if last == 1:
        out[0] = out[1] = (values[1] - values[0]) / (knots[1] - knots[0])
        return
    for m in range(1, last):
        left, right = knots[m] - knots[m - 1], knots[m + 1] - knots[m]
        out[m] = _inner_slope(left, right, (values[m] - values[m - 1]) / left, (values[m + 1] - values[m]) / right)
    first, second = knots[1] - knots[0], knots[2] - knots[1]
    final, before = knots[last] - knots[last - 1], knots[last - 1] - knots[last - 2]
    d_first, d_final = (values[1] - values[0]) / first, (values[last] - values[last - 1]) / final
    if periodic:
        out[0] = out[last] = _inner_slope(final, first, d_final, d_first)
        return
    out[0] = _end_slope(first, second, d_first, (values[2] - values[1]) / second)
    out[last] = _end_slope(final, before, d_final, (values[last - 1] - values[last - 2]) / before)


@kernel
def _segment(knots: F64, at: float) -> int:
    """Index of the segment that contains ``at``; the first or last one where it lies outside."""
    segment = 0
    while segment < knots.shape[0] - 2 and at >= knots[segment + 1]:
        segment += 1
    return segment


@kernel
def _hermite(u: float, width: float, y0: float, y1: float, m0: float, m1: float) -> float:
    """Cubic Hermite segment at u in [0, 1]; slopes are per unit of the knots."""
    v = 1.0 - u
    return v * v * ((1.0 + 2.0 * u) * y0 + u * width * m0) + u * u * ((3.0 - 2.0 * u) * y1 - v * width * m1)


@kernel
def time_at(phases: F64, keytimes: F64, tangents: F64, phase: float) -> float:
    """Seconds at a phase, of a motion with ``keytimes`` (M,) at ``phases`` (M,) and ``tangents`` of :func:`slopes`."""
    s = _segment(phases, phase)
    width = phases[s + 1] - phases[s]
    u = (phase - phases[s]) / width
    return _hermite(u, width, keytimes[s], keytimes[s + 1], tangents[s], tangents[s + 1])


@kernel
def rate_at(phases: F64, keytimes: F64, tangents: F64, phase: float) -> float:
    """Seconds per unit of phase at a phase: the derivative of :func:`time_at`."""
    s = _segment(phases, phase)
    width = phases[s + 1] - phases[s]
    u = (phase - phases[s]) / width
    secant = (keytimes[s + 1] - keytimes[s]) / width
    return (
        6.0 * u * (1.0 - u) * secant + (1.0 - u) * (1.0 - 3.0 * u) * tangents[s] + u * (3.0 * u - 2.0) * tangents[s + 1]
    )


@kernel
def phase_at(phases: F64, keytimes: F64, tangents: F64, time_s: float) -> float:
    """Phase at a time in seconds: the inverse of :func:`time_at`; NaN where ``time_s`` is."""
    s = _segment(keytimes, time_s)
    return _phase_in(phases, keytimes, tangents, time_s, s, (time_s - keytimes[s]) / (keytimes[s + 1] - keytimes[s]))


@kernel
def phase_near(phases: F64, keytimes: F64, tangents: F64, time_s: float, guess: float) -> float:
    """:func:`phase_at`, in fewer steps where ``guess`` is a phase near the result."""
    s = _segment(keytimes, time_s)
    return _phase_in(phases, keytimes, tangents, time_s, s, (guess - phases[s]) / (phases[s + 1] - phases[s]))


@kernel
def _phase_in(phases: F64, keytimes: F64, tangents: F64, time_s: float, s: int, u: float) -> float:
    """Phase at a time in segment ``s``, by Newton steps from its part ``u`` that bisection keeps in bounds."""
    if np.isnan(time_s):
        return np.nan
    y0, y1, width = keytimes[s], keytimes[s + 1], phases[s + 1] - phases[s]
    if time_s <= y0 or time_s >= y1:
        return phases[s] if time_s <= y0 else phases[s + 1]
    m0, m1 = width * tangents[s], width * tangents[s + 1]
    low, high = 0.0, 1.0
    u = min(max(u, 0.0), 1.0)
    for _ in range(60):
        v = 1.0 - u
        miss = v * v * ((1.0 + 2.0 * u) * y0 + u * m0) + u * u * ((3.0 - 2.0 * u) * y1 - v * m1) - time_s
        if miss > 0.0:
            high = u
        else:
            low = u
        rate = 6.0 * u * v * (y1 - y0) + v * (1.0 - 3.0 * u) * m0 + u * (3.0 * u - 2.0) * m1
        after = u - miss / rate if rate > 0.0 else 0.5 * (low + high)
        if not low <= after <= high:
            after = 0.5 * (low + high)
        moved = abs(after - u)
        u = after
        if moved < 1e-15 or (moved < NEWTON_END and rate > 0.1 * (y1 - y0)):
            break
    return phases[s] + u * width


@kernel
def blend_keytimes(weights: F64, log_lengths: F64, out: F64) -> None:
    """Keytimes (M,) in seconds from 0, of weights (N,) over examples with ``log_lengths`` (N, M-1).

    Segment m lasts exp(Σ w_i · ln L_im): exact at the examples, positive for any weights.
    """
    out[0] = 0.0
    for m in range(log_lengths.shape[1]):
        total = 0.0
        for i in range(weights.shape[0]):
            total += weights[i] * log_lengths[i, m]
        out[m + 1] = out[m] + np.exp(total)
