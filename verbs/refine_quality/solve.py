"""Weights that meet a goal exactly and move better than given ones."""

from __future__ import annotations

import numpy as np

from verbs.blend.corrected import Corrected
from verbs.conventions import F64
from verbs.refine_quality.cost import IMPOSSIBLE, MotionCost

__all__ = ["better_weights"]

ITERATIONS, TOLERANCE, STEP = 30, 1e-6, 1e-6
"""Most iterations of SLSQP, the change of the objective at which it ends, and the step of differences."""

RANK = 1e-6
"""Directions of the goal that weights move less than this share of the largest are not constraints: an arm in a plane
never leaves it."""


def better_weights(cost: MotionCost, corrected: Corrected, start: F64, goal: F64) -> F64:
    """Minimise cost(w) + |w − w₀|² with f(w) = goal, Σw and the style adverbs held.

    Sequential quadratic programming in the space of steps that leave sum and style as they are.

    Parameters
    ----------
    cost : MotionCost
    corrected : Corrected
        Its goal measures weights, and its correction holds what must not change.
    start : (N,) float64
        w₀, which meets the goal.
    goal : (3,) float64

    Returns
    -------
    weights : (N,) float64
        ``start`` where no direction is free.

    Source: D. Kraft, "A software package for sequential quadratic programming", DFVLR-FB 88-28, 1988.
    """
    from scipy.optimize import minimize  # large, and servers check rules without it

    held = corrected.correction.fixed
    free = np.linalg.svd(held)[2][len(held) :].T  # columns span the steps that keep sum and style
    if not free.shape[1]:
        return start
    measure, scale = corrected.goal.measured, corrected.correction.scale

    def misses(steps: F64) -> F64:
        return np.asarray(scale * (measure(start + steps @ free.T) - goal), np.float64)

    def nudged(step: F64) -> F64:
        return np.asarray(step + np.concatenate([np.zeros((1, len(step))), STEP * np.eye(len(step))]), np.float64)

    def objective(step: F64) -> tuple[float, F64]:
        steps = nudged(step)
        values = cost.costs(start + steps @ free.T)
        slope = (values[1:] - values[0]) / STEP
        slope[values[1:] >= IMPOSSIBLE] = 0.0  # the duration's bound is no slope
        return float(values[0] + step @ step), slope + 2.0 * step

    def slopes(step: F64) -> F64:
        values = misses(nudged(step))
        return np.asarray((values[1:] - values[0]).T / STEP, np.float64)

    origin = np.zeros(free.shape[1])
    left, sizes, _ = np.linalg.svd(slopes(origin))
    ways = left[:, : int(np.sum(sizes > RANK * sizes[0]))].T
    if len(ways) >= free.shape[1]:
        return start
    constraint = {
        "type": "eq",
        "fun": lambda step: np.nan_to_num(ways @ misses(step[None])[0], nan=IMPOSSIBLE),
        "jac": lambda step: np.nan_to_num(ways @ slopes(step)),
    }
    found = minimize(objective, origin, jac=True, method="SLSQP", constraints=[constraint],
                     options={"maxiter": ITERATIONS, "ftol": TOLERANCE})  # fmt: skip
    return start + free @ found.x if np.isfinite(found.x).all() else start
