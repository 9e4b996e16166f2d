"""Corrected blending: one smooth step of weights toward a goal, and the correction of jumps.

Each step is a minimum-norm Gauss–Newton step on the weights. The residual is saturated, so that no step overshoots
onto another branch of solutions; what must not change (the sum of the weights, blended style adverbs) is projected
out. Being a composition of smooth maps, the result is as smooth as the weights it starts from, and exact.

Goals of other measures: :mod:`verbs.kernels.corrected_position`, :mod:`verbs.kernels.corrected_velocity`.

Source: ``docs/math.md``, section "Corrected blending"; the Jacobians are derived there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel

__all__ = [
    "SQUARE",
    "Correction",
    "LinearCorrection",
    "correct_jumps",
    "jump_rates",
    "linear_correction",
    "squared_distance",
    "step",
]

SQUARE = 100.0
"""A step of full length leaves at most this many times the square of the distance (1/m); 1 to 20 were measured."""


class Correction(NamedTuple):
    """What a correction keeps, and its limits.

    Parameters
    ----------
    fixed : (S, N) float64
        Orthonormal directions in which the weights must not move.
    scale : (3,) float64
        Units of the residual: 1 for metres, 1/range for mixed units.
    saturation : float
        Length at which the residual of one step saturates.
    damping : float
        λ of the normal equations.
    stop : float
        Scaled distance below which the goal counts as reached.
    steps : int
        Most steps.
    """

    fixed: F64
    scale: F64
    saturation: float
    damping: float
    stop: float
    steps: int


@kernel
def step(
    weights: F64, goal: F64, point: F64, jacobian: F64, fixed: F64, scale: F64, limits: tuple[float, float, float]
) -> float:
    """Move weights (N,) one step from ``point`` (3,) toward ``goal`` (3,), in place; return the scaled distance.

    ``jacobian`` (3, N), the derivative of the point in the weights, is overwritten. ``limits`` are saturation, damping
    and stop; see :class:`Correction`, whose arrays come one by one here: to pass them bundled costs two atomic
    operations for each, in every step.
    """
    count = weights.shape[0]
    saturation, damping, stop = limits
    x, y, z = scale[0] * (goal[0] - point[0]), scale[1] * (goal[1] - point[1]), scale[2] * (goal[2] - point[2])
    squared = x * x + y * y + z * z
    distance = np.sqrt(squared)
    if distance < stop:
        return distance
    shrink = 1.0 / np.sqrt(1.0 + squared / (saturation * saturation))
    for a in range(3):
        for i in range(count):
            jacobian[a, i] *= scale[a]
        for s in range(fixed.shape[0]):
            share = 0.0
            for i in range(count):
                share += jacobian[a, i] * fixed[s, i]
            for i in range(count):
                jacobian[a, i] -= share * fixed[s, i]
    xx, xy, xz, yy, yz, zz = damping, 0.0, 0.0, damping, 0.0, damping
    for i in range(count):
        jx, jy, jz = jacobian[0, i], jacobian[1, i], jacobian[2, i]
        xx += jx * jx
        xy += jx * jy
        xz += jx * jz
        yy += jy * jy
        yz += jy * jz
        zz += jz * jz
    # Cholesky's factors of the symmetric 3×3 system, written out
    a0 = np.sqrt(xx)
    b0, c0 = xy / a0, xz / a0
    d0 = np.sqrt(max(yy - b0 * b0, 1e-300))
    e0 = (yz - b0 * c0) / d0
    f0 = np.sqrt(max(zz - c0 * c0 - e0 * e0, 1e-300))
    x /= a0
    y = (y - b0 * x) / d0
    z = (z - c0 * x - e0 * y) / f0
    z /= f0
    y = (y - e0 * z) / d0
    x = (x - b0 * y - c0 * z) / a0
    for i in range(count):
        weights[i] += shrink * (jacobian[0, i] * x + jacobian[1, i] * y + jacobian[2, i] * z)
    return distance


@kernel
def squared_distance(goal: F64, point: F64, scale: F64) -> float:
    """Square of the scaled distance between a point (3,) and a goal (3,)."""
    squared = 0.0
    for a in range(3):
        squared += (scale[a] * (goal[a] - point[a])) ** 2
    return squared


class LinearCorrection(NamedTuple):
    """A correction in one step, of a point that is linear in the weights.

    Parameters
    ----------
    rates : (3, N) float64
        The point is ``rates @ weights``.
    gains : (3, N) float64
        Weights change by the residual times these.
    """

    rates: F64
    gains: F64


def linear_correction(rates: F64, correction: Correction) -> LinearCorrection:
    """The sum of all steps of a correction without saturation, for a point that is linear in the weights, in metres.

    A step leaves λ / (σ² + λ) of the residual along a singular direction of the projected rates, K steps its power.
    """
    free = rates - (rates @ correction.fixed.T) @ correction.fixed
    squares, directions = np.linalg.eigh(free @ free.T)
    squares = np.maximum(squares, 1e-12 * correction.damping)
    left = correction.steps * np.log(correction.damping / (squares + correction.damping))
    gains = (directions * (-np.expm1(left) / squares)) @ directions.T @ free
    return LinearCorrection(np.ascontiguousarray(rates), np.ascontiguousarray(gains))


def jump_rates(roots: F64) -> F64:
    """Displacement x, z and rise (3, N) of each example's jump; arrays as in :func:`verbs.kernels.measure.jump`."""
    rises = (roots[2, :, 0] - roots[0, :, 0], roots[2, :, 2] - roots[0, :, 2], roots[1, :, 1] - roots[0, :, 1])
    return np.stack(rises)


@kernel
def correct_jumps(weights: F64, goals: F64, correction: LinearCorrection) -> None:
    """Correct weights (B, N) in place until jumps have the displacement and rise of goals (B, 3)."""
    rates, gains = correction
    for b in range(weights.shape[0]):
        x, y, z = goals[b, 0], goals[b, 1], goals[b, 2]
        for i in range(weights.shape[1]):
            weight = weights[b, i]
            x -= weight * rates[0, i]
            y -= weight * rates[1, i]
            z -= weight * rates[2, i]
        for i in range(weights.shape[1]):
            weights[b, i] += x * gains[0, i] + y * gains[1, i] + z * gains[2, i]
