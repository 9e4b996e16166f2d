"""Inverse blending: weights on a simplex that are a local minimum of weighted constraints.

Each constraint is a residual of the blend: a point (3 numbers), a distance (1), or a mean value (1). The
sum of their weighted squares falls by Levenberg–Marquardt steps. A step minimises the linearised, damped sum over the
simplex exactly, so that bounds and sum hold throughout; where no step gains the Karush–Kuhn–Tucker conditions hold.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 3 (InvBld); J. Nocedal, S. Wright, "Numerical Optimization", 2006,
section 10.3; the damping's rule is that of H. B. Nielsen, "Damping Parameter in Marquardt's Method", 1999.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import measure as measures
from verbs.kernels.compile import kernel
from verbs.kernels.corrected_position import Chain, ChainScratch, position_jacobian
from verbs.kernels.corrected_velocity import velocity_jacobian
from verbs.kernels.simplex import least
from verbs.kernels.timewarp import Clock

__all__ = ["Problem", "assess", "costs", "row_count", "solve", "subset"]

STEPS = 200
"""Most steps of one descent; it takes about ten, and more only along a curved, almost flat floor."""

FLOOR = 1e-9
"""Least damping, as a share of the largest squared derivative: keeps a step's quadratic definite."""

GAIN = 1e-10
"""A descent ends when the next step would gain less than this share of the remaining sum."""

EXACT = 1e-8
"""… or where the remaining sum is below this share of ``enough``."""


class Problem(NamedTuple):
    """Constraints of some examples, as arrays; P points and V mean values are required.

    Parameters
    ----------
    mode : int
        How rotations blend.
    kinds : (P,) int64
        What each point is: a joint's position, or speeds, as :mod:`verbs.kernels.measure` numbers them.
    factors : (P + V,) float64
        √(c n) of each constraint: the square root of its priority times its scale.
    radii : (P,) float64
        Negative: the point is to be met. Otherwise: this distance from it, metres.
    spans : (P, 2) int64
        First and last link of each joint position's chain.
    roots : (3·P, N) float64
        Root positions of joint positions.
    rows : (4·L, N) float64
        Rotation rows of all chains, one after another.
    references : (L, 4) float64
    offsets : (L, 3) float64
    strides : (K, N, 4) float64
    clock : Clock
    values : (V, N) float64
        Values of the examples whose means are required: adverbs that are not measured, and the displacement of a jump.
    """

    mode: int
    kinds: I64
    factors: F64
    radii: F64
    spans: I64
    roots: F64
    rows: F64
    references: F64
    offsets: F64
    strides: F64
    clock: Clock
    values: F64


@kernel
def _last(whole: F64, chosen: I64) -> F64:
    """Take the chosen examples of an array (A, N)."""
    out = np.empty((whole.shape[0], chosen.shape[0]))
    for a in range(whole.shape[0]):
        for c in range(chosen.shape[0]):
            out[a, c] = whole[a, chosen[c]]
    return out


@kernel
def _middle(whole: F64, chosen: I64) -> F64:
    """Take the chosen examples of an array (A, N, 3)."""
    out = np.empty((whole.shape[0], chosen.shape[0], 3))
    for a in range(whole.shape[0]):
        for c in range(chosen.shape[0]):
            for b in range(3):
                out[a, c, b] = whole[a, chosen[c], b]
    return out


@kernel
def subset(problem: Problem, chosen: I64) -> Problem:
    """The same constraints over some of the examples."""
    clock = problem.clock
    lengths = np.empty((chosen.shape[0], clock.log_lengths.shape[1]))
    for c in range(chosen.shape[0]):
        lengths[c] = clock.log_lengths[chosen[c]]
    return Problem(
        problem.mode,
        problem.kinds,
        problem.factors,
        problem.radii,
        problem.spans,
        _last(problem.roots, chosen),
        _last(problem.rows, chosen),
        problem.references,
        problem.offsets,
        _middle(problem.strides, chosen),
        Clock(clock.phases, lengths, clock.looping),
        _last(problem.values, chosen),
    )


@kernel
def _point(problem: Problem, p: int, weights: F64, scratch: F64, point: F64, jacobian: F64) -> None:
    """Measured point p (3,) of a blend, and its Jacobian (3, n)."""
    if problem.kinds[p] == measures.VELOCITY:
        velocity_jacobian(weights, problem.strides, problem.clock, point, jacobian)
    else:
        first, last = problem.spans[p, 0], problem.spans[p, 1]
        chain = Chain(
            problem.mode,
            problem.roots[3 * p : 3 * p + 3],
            problem.rows[4 * first : 4 * last],
            problem.references[first:last],
            problem.offsets[first:last],
        )
        rates = scratch[3, :6].reshape(2, 3, 4)
        position_jacobian(weights, chain, ChainScratch(scratch[0], scratch[1], scratch[2], rates), point, jacobian)


@kernel
def _add_residual(
    factor: float, radius: float, point: F64, target: F64, slopes: F64, row: int, residuals: F64, jacobian: F64
) -> int:
    """Write a point's residuals, from ``row`` on, and their derivatives; return the next row."""
    if radius < 0.0:
        for a in range(3):
            residuals[row + a] = factor * (point[a] - target[a])
            for i in range(jacobian.shape[1]):
                jacobian[row + a, i] = factor * slopes[a, i]
        return row + 3
    squared = 0.0
    for a in range(3):
        squared += (point[a] - target[a]) ** 2
    distance = np.sqrt(squared)
    residuals[row] = factor * (distance - radius)
    for i in range(jacobian.shape[1]):
        jacobian[row, i] = 0.0
        for a in range(3):
            if distance > 0.0:
                jacobian[row, i] += factor * (point[a] - target[a]) / distance * slopes[a, i]
    return row + 1


@kernel
def row_count(problem: Problem) -> int:
    """Number R of residuals."""
    rows = problem.values.shape[0]
    for p in range(problem.kinds.shape[0]):
        rows += 3 if problem.radii[p] < 0.0 else 1
    return rows


@kernel
def assess(problem: Problem, weights: F64, targets: F64, means: F64, residuals: F64, jacobian: F64) -> float:
    """Residuals (R,) of weights (n,) and their Jacobian (R, n); return the sum of squares.

    ``targets`` (P, 3) are the points and ``means`` (V,) the required mean values.
    """
    count, points = weights.shape[0], problem.kinds.shape[0]
    point, slopes = np.empty(3), np.empty((3, count))
    scratch = np.empty((4, max(problem.references.shape[0], 6), 4))
    row = 0
    for p in range(points):
        _point(problem, p, weights, scratch, point, slopes)
        row = _add_residual(problem.factors[p], problem.radii[p], point, targets[p], slopes, row, residuals, jacobian)
    for v in range(problem.values.shape[0]):
        factor = problem.factors[points + v]
        residuals[row] = -factor * means[v]
        for i in range(count):
            jacobian[row, i] = factor * problem.values[v, i]
            residuals[row] += weights[i] * jacobian[row, i]
        row += 1
    cost = 0.0
    for r in range(row):
        cost += residuals[r] * residuals[r]
    return cost


@kernel
def _model(jacobian: F64, residuals: F64, weights: F64, damping: float, quadratic: F64, linear: F64) -> None:
    """Quadratic of a step in the weights after it: half the linearised sum of squares plus the damping."""
    count = weights.shape[0]
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for r in range(residuals.shape[0]):
                total += jacobian[r, i] * jacobian[r, j]
            quadratic[i, j] = quadratic[j, i] = total
        quadratic[i, i] += damping
    for i in range(count):
        linear[i] = 0.0
        for j in range(count):
            linear[i] += quadratic[i, j] * weights[j]
        for r in range(residuals.shape[0]):
            linear[i] -= jacobian[r, i] * residuals[r]


@kernel
def _gain(jacobian: F64, residuals: F64, weights: F64, trial: F64) -> float:
    """How much smaller the linearised sum of squares is at ``trial``."""
    gain = 0.0
    for r in range(residuals.shape[0]):
        moved = residuals[r]
        for i in range(weights.shape[0]):
            moved += jacobian[r, i] * (trial[i] - weights[i])
        gain += residuals[r] * residuals[r] - moved * moved
    return gain


@kernel
def _descend(problem: Problem, targets: F64, means: F64, weights: F64, exact: float) -> float:
    """Improve weights (n,) on the simplex, in place, to a local minimum; return the sum of squares there."""
    n, rows = weights.shape[0], row_count(problem)
    residuals, jacobian = np.empty(rows), np.empty((rows, n))
    ahead, slopes, trial = np.empty(rows), np.empty((rows, n)), weights.copy()
    quadratic, linear = np.empty((n, n)), np.empty(n)
    free, factor, target = np.empty(n, np.int64), np.empty((n + 1, n)), np.empty(n)
    cost, gain, size, damping, growth = np.inf, 1.0, 0.0, 0.0, 2.0
    for step in range(STEPS):
        after = assess(problem, trial, targets, means, ahead, slopes)
        if after < cost:
            if step == 0:
                size = _largest(slopes)
                damping = 1e-3 * size
            else:
                share = 2.0 * (cost - after) / gain - 1.0
                damping = max(damping * max(1.0 / 3.0, 1.0 - share * share * share), FLOOR * size)
            weights[:], residuals[:], jacobian[:] = trial, ahead, slopes
            cost, growth = after, 2.0
        else:
            damping *= growth
            growth *= 2.0
        if cost <= exact or size == 0.0:
            break
        _model(jacobian, residuals, weights, damping, quadratic, linear)
        trial[:] = weights
        least(quadratic, linear, trial, free, factor, target)
        gain = _gain(jacobian, residuals, weights, trial)
        if gain <= GAIN * cost:
            break
    return cost


@kernel
def _largest(jacobian: F64) -> float:
    """Largest squared length of a Jacobian's columns."""
    size = 0.0
    for i in range(jacobian.shape[1]):
        squared = 0.0
        for r in range(jacobian.shape[0]):
            squared += jacobian[r, i] * jacobian[r, i]
        size = max(size, squared)
    return size


@kernel
def _errors(problem: Problem, examples: F64, targets: F64, means: F64, out: F64) -> None:
    """Sum of weighted squares (N,) of each example alone; ``examples`` (P, N, 3) are their measured points."""
    points = problem.kinds.shape[0]
    for i in range(out.shape[0]):
        out[i] = 0.0
        for p in range(points):
            squared = 0.0
            for a in range(3):
                squared += (examples[p, i, a] - targets[p, a]) ** 2
            radius = problem.radii[p]
            out[i] += problem.factors[p] ** 2 * (squared if radius < 0.0 else (np.sqrt(squared) - radius) ** 2)
        for v in range(problem.values.shape[0]):
            out[i] += (problem.factors[points + v] * (problem.values[v, i] - means[v])) ** 2


@kernel
def _choose(errors: F64, k: int, start: F64, chosen: I64) -> int:
    """Write the k examples of least error, then every other one of which ``start`` (N,) makes use; return how many."""
    count = 0
    for _ in range(min(k, errors.shape[0])):
        best = -1
        for i in range(errors.shape[0]):
            if (best < 0 or errors[i] < errors[best]) and not np.any(chosen[:count] == i):
                best = i
        chosen[count] = best
        count += 1
    nearest = chosen[:count]
    for i in range(errors.shape[0]):
        if start[i] > 0.0 and not np.any(nearest == i):
            chosen[count] = i
            count += 1
    return count


@kernel
def _begin(errors: F64, k: int, chosen: I64, out: F64) -> None:
    """Weights (N,) to start from: a smooth function of the k least errors, whose mean is its width."""
    out[:] = 0.0
    count = _choose(errors, k, out, chosen)
    width, total = 0.0, 0.0
    for c in range(count):
        width += errors[chosen[c]] / count
    for c in range(count):
        out[chosen[c]] = np.exp(-errors[chosen[c]] / width) if width > 0.0 else 1.0
        total += out[chosen[c]]
    for c in range(count):
        out[chosen[c]] /= total


@kernel
def _improve(problem: Problem, chosen: I64, targets: F64, means: F64, exact: float, weights: F64) -> float:
    """Improve weights (N,), in place, over the chosen examples; return their sum of squares."""
    few = np.empty(chosen.shape[0])
    for c in range(chosen.shape[0]):
        few[c] = weights[chosen[c]]
    cost = _descend(subset(problem, chosen), targets, means, few, exact)
    for c in range(chosen.shape[0]):
        weights[chosen[c]] = few[c]
    return cost


@kernel
def solve(
    problem: Problem, examples: F64, k: int, targets: F64, means: F64, start: F64, enough: float, out: F64
) -> None:
    """Weights (B, N) that meet constraints, written to ``out``.

    Parameters
    ----------
    problem : Problem
        Over all N examples.
    examples : (P, N, 3) float64
        Points that each example is measured at by itself.
    k : int
        Examples that take part: those of least error.
    targets : (B, P, 3) float64
    means : (B, V) float64
    start : (B, N) or (0, N) float64
        Initial weights on the simplex; the examples that they use take part as well.
    enough : float
        If the sum of squares from ``start`` stays above this, the usual start is tried too, and the better counts.
    """
    count, warm = out.shape[1], start.shape[0] > 0
    errors, trial, chosen = np.empty(count), np.empty(count), np.empty(count, np.int64)
    for b in range(out.shape[0]):
        _errors(problem, examples, targets[b], means[b], errors)
        best = np.inf
        for attempt in range(2):
            if attempt == 0 and warm:
                trial[:] = start[b]
            elif attempt == 0 or (warm and best > enough):
                _begin(errors, k, chosen, trial)
            else:
                break
            taking_part = chosen[: _choose(errors, k, trial, chosen)]
            cost = _improve(problem, taking_part, targets[b], means[b], EXACT * enough, trial)
            if cost < best:
                best = cost
                out[b] = trial


@kernel
def costs(problem: Problem, targets: F64, means: F64, weights: F64, out: F64) -> None:
    """Sum of weighted squares (B,) of weights (B, N); the other arrays as in :func:`solve`."""
    rows = row_count(problem)
    residuals, jacobian = np.empty(rows), np.empty((rows, weights.shape[1]))
    for b in range(out.shape[0]):
        out[b] = assess(problem, weights[b], targets[b], means[b], residuals, jacobian)
