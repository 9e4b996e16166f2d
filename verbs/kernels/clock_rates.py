"""Seconds at canonical phases, seconds per phase there, and the derivatives of both in the weights.

Segment lengths are exponentials of blended logarithms. Keytimes are their sums and tangents are the slopes of
:func:`verbs.kernels.timewarp.slopes`; both are differentiated in the lengths first, then chained to the weights.

Source: ``docs/math.md``, sections "Time" and "Measures of adverbs".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.timewarp import Clock, blend_keytimes, rate_at, slopes, time_at

__all__ = ["Times", "blended_times", "slope_derivatives", "times_of"]


class Times(NamedTuple):
    """Times at P phases, as :func:`blended_times` writes them.

    Parameters
    ----------
    seconds, rates : (P,) float64
        Seconds from the start, and seconds per unit of phase.
    d_seconds, d_rates : (P, N) float64
        Their derivatives in the weights.
    """

    seconds: F64
    rates: F64
    d_seconds: F64
    d_rates: F64


@kernel
def times_of(phases: int, count: int) -> Times:
    """Arrays for so many phases and examples."""
    return Times(np.empty(phases), np.empty(phases), np.empty((phases, count)), np.empty((phases, count)))


@kernel
def _inner(near: float, far: float, slope: float, secant: float) -> float:
    """Derivative of an inner slope in one of its two secants; ``near`` is the width of that secant's segment."""
    a = 2.0 * far + near
    return a / (3.0 * (near + far)) * (slope / secant) ** 2


@kernel
def slope_derivatives(phases: F64, keytimes: F64, tangents: F64, periodic: bool, out: F64) -> None:
    """Derivatives (M, M - 1) of the slopes through rising keytimes (M,) in the segment lengths."""
    last = phases.shape[0] - 1
    out[:] = 0.0
    if last == 1:
        out[0, 0] = out[1, 0] = 1.0 / (phases[1] - phases[0])
        return
    for m in range(1, last):
        left, right = phases[m] - phases[m - 1], phases[m + 1] - phases[m]
        before, after = (keytimes[m] - keytimes[m - 1]) / left, (keytimes[m + 1] - keytimes[m]) / right
        out[m, m - 1] = _inner(left, right, tangents[m], before) / left
        out[m, m] = _inner(right, left, tangents[m], after) / right
    first, final = phases[1] - phases[0], phases[last] - phases[last - 1]
    if periodic:
        before, after = (keytimes[last] - keytimes[last - 1]) / final, (keytimes[1] - keytimes[0]) / first
        for end in (0, last):
            out[end, last - 1] = _inner(final, first, tangents[0], before) / final
            out[end, 0] = _inner(first, final, tangents[0], after) / first
        return
    if tangents[0] > 0.0:
        second = phases[2] - phases[1]
        out[0, 0] = (2.0 * first + second) / (first + second) / first
        out[0, 1] = -first / (first + second) / second
    if tangents[last] > 0.0:
        before = phases[last - 1] - phases[last - 2]
        out[last, last - 1] = (2.0 * final + before) / (final + before) / final
        out[last, last - 2] = -final / (final + before) / before


@kernel
def blended_times(weights: F64, clock: Clock, phases: F64, out: Times) -> None:
    """Seconds and rates of weights (N,) at phases (P,), with their derivatives, to ``out``."""
    marks, log_lengths, looping = clock
    seconds, rates, d_seconds, d_rates = out
    last, count = marks.shape[0] - 1, weights.shape[0]
    keytimes, tangents, bent = np.empty(last + 1), np.empty(last + 1), np.empty((last + 1, last))
    blend_keytimes(weights, log_lengths, keytimes)
    slopes(marks, keytimes, looping, tangents)
    slope_derivatives(marks, keytimes, tangents, looping, bent)
    for p in range(phases.shape[0]):
        phase = phases[p]
        seconds[p] = time_at(marks, keytimes, tangents, phase)
        rates[p] = rate_at(marks, keytimes, tangents, phase)
        s = 0
        while s < last - 1 and phase >= marks[s + 1]:
            s += 1
        width = marks[s + 1] - marks[s]
        u = (phase - marks[s]) / width
        v = 1.0 - u
        d_seconds[p, :], d_rates[p, :] = 0.0, 0.0
        for m in range(last):
            whole, own = 1.0 if m < s else 0.0, 1.0 if m == s else 0.0
            time = whole + own * u * u * (3.0 - 2.0 * u)
            time += width * (v * v * u * bent[s, m] - u * u * v * bent[s + 1, m])
            rate = own * 6.0 * u * v / width + v * (1.0 - 3.0 * u) * bent[s, m] + u * (3.0 * u - 2.0) * bent[s + 1, m]
            length = keytimes[m + 1] - keytimes[m]
            for i in range(count):
                d_seconds[p, i] += time * length * log_lengths[i, m]
                d_rates[p, i] += rate * length * log_lengths[i, m]
