"""Correction of many weights at once, in the space of the sums that a measured point depends on.

A measured point depends on the weights through a few weighted sums s = Q w only. With the projection P onto what may
change and M (3, S), the derivative of the point in s, a correction step moves w by P Qᵀ Mᵀ y and s by C Mᵀ y, with
C = Q P Qᵀ and (M C Mᵀ + λ I) y = ē. So steps touch s and η = Σ Mᵀ y only, and the N weights follow once at the end:
w + P Qᵀ η. Characters come last, in tiles (structure of arrays), and C Mᵀ is a matrix product. Characters that have
arrived move by zero: none depends on its neighbours.

Each loop is a function of its own with few arrays, as longer ones do not vectorise.

Source: ``docs/math.md``, section "Corrected blending".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.correction import SQUARE

__all__ = ["FEW", "Sums", "couple", "move", "normal", "residuals", "solve"]

FEW = 0.3
"""Where at most this share of a tile needs another step, those continue in a narrower tile."""


PLAIN = 3
"""The first sums are the root's position, whose derivative is the identity; they are left out of products."""

GROUP = 4
"""Sums are filled up to whole groups, and by at least one, as matrix products and loops are faster on these."""


class Sums(NamedTuple):
    """The sums that a measured point depends on, filled up with zeros to S rows.

    Parameters
    ----------
    rows : (S, N) float64
        Q: the sums of weights (N,) are ``rows @ weights``.
    couplings : (S, S) float64
        C = Q P Qᵀ.
    moves : (S, N) float64
        Q P: what η moves the weights by.
    """

    rows: F64
    couplings: F64
    moves: F64


def couple(rows: F64, fixed: F64) -> Sums:
    """Sums of weights by ``rows`` (.., N), if weights must not move along ``fixed`` (K, N), orthonormal."""
    filled = np.zeros((len(rows) // GROUP * GROUP + GROUP, rows.shape[1]))
    filled[: len(rows)] = rows
    moves = filled - (filled @ fixed.T) @ fixed
    return Sums(filled, moves @ moves.T, moves)


@kernel
def residuals(
    goals: F64, points: F64, scale: F64, saturation: float, stop: float, live: F64, out: F64
) -> tuple[float, float]:
    """Saturated residuals (3, T) of points (3, T); zero where the goal is reached.

    ``live`` (T,) is 1 where a character moves; it becomes 0 where the coming step is the last one. Return how many
    take this step, and how many may need another.
    """
    sx, sy, sz, count, left = scale[0], scale[1], scale[2], 0.0, 0.0
    per_square = 1.0 / (saturation * saturation)
    for k in range(goals.shape[1]):
        x, y, z = (
            sx * (goals[0, k] - points[0, k]),
            sy * (goals[1, k] - points[1, k]),
            sz * (goals[2, k] - points[2, k]),
        )
        squared = x * x + y * y + z * z
        moving = live[k] if squared >= stop * stop else 0.0
        share = moving / np.sqrt(1.0 + squared * per_square)
        out[0, k], out[1, k], out[2, k] = share * x, share * y, share * z
        again = moving if SQUARE * squared >= stop else 0.0
        live[k] = again
        count += moving
        left += again
    return count, left


@kernel
def normal(derivatives: F64, moved: F64, couplings: F64, out: F64) -> None:
    """Products xx, xy, xz, yy, yz, zz (6, T) of M and C Mᵀ; see :func:`move` for the arguments."""
    xx, xy, xz = couplings[0, 0], couplings[0, 1], couplings[0, 2]
    yy, yz, zz = couplings[1, 1], couplings[1, 2], couplings[2, 2]
    for k in range(out.shape[1]):
        out[0, k], out[1, k], out[2, k] = moved[0, k] + xx, moved[1, k] + xy, moved[2, k] + xz
        out[3, k], out[4, k], out[5, k] = moved[4, k] + yy, moved[5, k] + yz, moved[8, k] + zz
    for i in range(0, derivatives.shape[0] // 3, 2):
        a, b = couplings[PLAIN + i], couplings[PLAIN + i + 1]
        _add_products(derivatives, 3 * i, moved, 3 * (PLAIN + i), (a[0], a[1], a[2]), (b[0], b[1], b[2]), out)


@kernel
def _add_products(
    derivatives: F64, i: int, moved: F64, j: int,
    first: tuple[float, float, float], second: tuple[float, float, float], out: F64,
) -> None:  # fmt: skip
    """Add the products of two sums, whose constant parts are ``first`` and ``second``, to all six."""
    a, b, c = first
    d, e, f = second
    for k in range(out.shape[1]):
        dx, dy, dz = derivatives[i, k], derivatives[i + 1, k], derivatives[i + 2, k]
        ex, ey, ez = derivatives[i + 3, k], derivatives[i + 4, k], derivatives[i + 5, k]
        x, y, z = moved[j, k] + a, moved[j + 1, k] + b, moved[j + 2, k] + c
        p, q, r = moved[j + 3, k] + d, moved[j + 4, k] + e, moved[j + 5, k] + f
        out[0, k] += dx * x + ex * p
        out[1, k] += dx * y + ex * q
        out[2, k] += dx * z + ex * r
        out[3, k] += dy * y + ey * q
        out[4, k] += dy * z + ey * r
        out[5, k] += dz * z + ez * r


@kernel
def solve(products: F64, scale: F64, damping: float, residual: F64) -> None:
    """Solve the damped 3×3 systems of :func:`normal` for residuals (3, T), in place, by Cholesky's factors."""
    sx, sy, sz = scale[0], scale[1], scale[2]
    for k in range(residual.shape[1]):
        xx, xy, xz = sx * sx * products[0, k] + damping, sx * sy * products[1, k], sx * sz * products[2, k]
        yy, yz, zz = sy * sy * products[3, k] + damping, sy * sz * products[4, k], sz * sz * products[5, k] + damping
        a = np.sqrt(xx)
        b, c = xy / a, xz / a
        d = np.sqrt(max(yy - b * b, 1e-300))
        e = (yz - b * c) / d
        f = np.sqrt(max(zz - c * c - e * e, 1e-300))
        x = residual[0, k] / a
        y = (residual[1, k] - b * x) / d
        z = (residual[2, k] - c * x - e * y) / (f * f)
        y = (y - e * z) / d
        x = (x - b * y - c * z) / a
        residual[0, k], residual[1, k], residual[2, k] = sx * x, sy * y, sz * z


@kernel
def move(derivatives: F64, moved: F64, couplings: F64, factors: F64, sums: F64, eta: F64) -> None:
    """Add to sums (S, T) and η (S, T) what factors y (3, T) move them by.

    Parameters
    ----------
    derivatives : (3·n, T) float64
        x, y, z of Mᵀ, for each of the n sums after the first three; n is even.
    moved : (3·S, T) float64
        x, y, z of C Mᵀ for each sum, without what the first three contribute, which is constant.
    """
    for i in range(PLAIN):
        for k in range(factors.shape[1]):
            eta[i, k] += factors[i, k]
    for i in range(0, sums.shape[0], 2):
        a, b = couplings[i], couplings[i + 1]
        _add_factors(moved, 3 * i, (a[0], a[1], a[2]), (b[0], b[1], b[2]), factors, sums, i)
    for i in range(0, derivatives.shape[0] // 3, 2):
        _add_factors(derivatives, 3 * i, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), factors, eta, PLAIN + i)


@kernel
def _add_factors(
    rates: F64, i: int, first: tuple[float, float, float], second: tuple[float, float, float],
    factors: F64, out: F64, row: int,
) -> None:  # fmt: skip
    """Add rates from row i on, plus ``first`` and ``second``, times factors (3, T) to two rows."""
    a, b, c = first
    d, e, f = second
    after = row + 1
    for k in range(factors.shape[1]):
        x, y, z = factors[0, k], factors[1, k], factors[2, k]
        out[row, k] += x * (rates[i, k] + a) + y * (rates[i + 1, k] + b) + z * (rates[i + 2, k] + c)
        out[after, k] += x * (rates[i + 3, k] + d) + y * (rates[i + 4, k] + e) + z * (rates[i + 5, k] + f)
