"""Places of a striding root at knots of canonical time, their rates, and the derivatives of both in the weights.

A place is the sum of blended steps, each rotated by the blended heading half way through it; see
:func:`verbs.kernels.pose.stride_to`, whose cubic between knots has the mean of both neighbours as its slope there.

Source: ``docs/math.md``, sections "Walking" and "Measures of adverbs".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["Places", "places_of", "travel_places"]

X, Z, HEADING, HEIGHT = range(4)


class Places(NamedTuple):
    """Places at P knots, as :func:`travel_places` writes them.

    Parameters
    ----------
    places, rates : (P, 4) float64
        x, z (m), heading (rad), rise (m), and their change per unit of phase.
    d_places, d_rates : (P, 4, N) float64
        Their derivatives in the weights.
    """

    places: F64
    rates: F64
    d_places: F64
    d_rates: F64


@kernel
def places_of(knots: int, count: int) -> Places:
    """Arrays for so many knots and examples, all at the origin and at rest."""
    return Places(np.zeros((knots, 4)), np.zeros((knots, 4)), np.zeros((knots, 4, count)), np.zeros((knots, 4, count)))


@kernel
def _blended(weights: F64, strides: F64, k: int, out: F64) -> None:
    """Blended step (4,) of interval ``k``."""
    for a in range(4):
        out[a] = 0.0
        for i in range(weights.shape[0]):
            out[a] += weights[i] * strides[k, i, a]


@kernel
def _rotated(
    strides: F64, k: int, i: int, heading: float, side: float, ahead: float, turned: float
) -> tuple[float, float]:
    """Derivative in weight i of step k, side and ahead, rotated by a heading whose own derivative is ``turned``."""
    cosine, sine = np.cos(heading), np.sin(heading)
    x = strides[k, i, 0] * cosine + strides[k, i, 1] * sine + turned * (ahead * cosine - side * sine)
    z = strides[k, i, 1] * cosine - strides[k, i, 0] * sine - turned * (side * cosine + ahead * sine)
    return x, z


@kernel
def _rate(weights: F64, strides: F64, k: int, looping: bool, place: F64, d_place: F64, rate: F64, d_rate: F64) -> None:
    """Rates (4,) and their derivatives (4, N) at knot ``k``, where the root is at a place (4,)."""
    intervals, step = strides.shape[0], np.empty(4)
    before, after = k - 1, k
    if looping:
        before, after = before % intervals, after % intervals
    elif k in (0, intervals):
        before = after = 0 if k == 0 else intervals - 1
    cosine, sine = np.cos(place[HEADING]), np.sin(place[HEADING])
    rate[:], d_rate[:] = 0.0, 0.0
    for row in (before, after):
        _blended(weights, strides, row, step)
        scale = 0.5 * intervals
        rate[X] += scale * (step[0] * cosine + step[1] * sine)
        rate[Z] += scale * (step[1] * cosine - step[0] * sine)
        rate[HEADING] += scale * step[2]
        rate[HEIGHT] += scale * step[3]
        for i in range(weights.shape[0]):
            x, z = _rotated(strides, row, i, place[HEADING], step[0], step[1], d_place[HEADING, i])
            d_rate[X, i] += scale * x
            d_rate[Z, i] += scale * z
            d_rate[HEADING, i] += scale * strides[row, i, 2]
            d_rate[HEIGHT, i] += scale * strides[row, i, 3]


@kernel
def travel_places(weights: F64, strides: F64, looping: bool, knots: I64, out: Places) -> None:
    """Places and rates of weights (N,) at knots (P,) of a walk from the origin, with strides (K, N, 4), to ``out``."""
    places, rates, d_places, d_rates = out
    count, step = weights.shape[0], np.empty(4)
    place, d_place = np.zeros(4), np.zeros((4, count))
    for k in range(strides.shape[0] + 1):
        for p in range(knots.shape[0]):
            if knots[p] == k:
                places[p], d_places[p] = place, d_place
                _rate(weights, strides, k, looping, place, d_place, rates[p], d_rates[p])
        if k == strides.shape[0]:
            break
        _blended(weights, strides, k, step)
        middle = place[HEADING] + 0.5 * step[2]
        for i in range(count):
            turned = d_place[HEADING, i] + 0.5 * strides[k, i, 2]
            x, z = _rotated(strides, k, i, middle, step[0], step[1], turned)
            d_place[X, i] += x
            d_place[Z, i] += z
            d_place[HEADING, i] += strides[k, i, 2]
            d_place[HEIGHT, i] += strides[k, i, 3]
        place[X] += step[0] * np.cos(middle) + step[1] * np.sin(middle)
        place[Z] += step[1] * np.cos(middle) - step[0] * np.sin(middle)
        place[HEADING] += step[2]
        place[HEIGHT] += step[3]
