"""Weights on the standard simplex {w : w ≥ 0, Σ w = 1}: the least quadratic there, and barycentric blending.

Source: J. Nocedal, S. Wright, "Numerical Optimization", 2006, algorithm 16.3 (primal active set) for the quadratic;
Feng, Huang, Kallmann, Shapiro 2012, section 3, for barycentric interpolation.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["barycentric", "least"]

CONTAINED = 1e-12
"""A barycentric coordinate may be this much below 0 and its point still count as inside."""


@kernel
def _solve_free(quadratic: F64, linear: F64, free: I64, count: int, factor: F64, target: F64) -> float:
    """Minimum over the free weights with sum 1, written to ``target``; return the multiplier of the sum.

    Two solves with one Cholesky factor: Q w = g + μ 1 with μ such that Σ w = 1.
    """
    unit = factor[-1]
    for a in range(count):
        for b in range(a + 1):
            total = quadratic[free[a], free[b]]
            for c in range(b):
                total -= factor[a, c] * factor[b, c]
            factor[a, b] = np.sqrt(max(total, 1e-300)) if a == b else total / factor[b, b]
    for a in range(count):
        target[a], unit[a] = linear[free[a]], 1.0
        for c in range(a):
            target[a] -= factor[a, c] * target[c]
            unit[a] -= factor[a, c] * unit[c]
        target[a] /= factor[a, a]
        unit[a] /= factor[a, a]
    for a in range(count - 1, -1, -1):
        for c in range(a + 1, count):
            target[a] -= factor[c, a] * target[c]
            unit[a] -= factor[c, a] * unit[c]
        target[a] /= factor[a, a]
        unit[a] /= factor[a, a]
    have, slope = 0.0, 0.0
    for a in range(count):
        have += target[a]
        slope += unit[a]
    multiplier = (1.0 - have) / slope
    for a in range(count):
        target[a] += multiplier * unit[a]
    return multiplier


@kernel
def _step_free(weights: F64, free: I64, count: int, target: F64) -> int:
    """Move the free weights toward ``target`` until one of them reaches 0; return how many stay free."""
    stride, blocking = 1.0, -1
    for a in range(count):
        if target[a] < 0.0:
            now = weights[free[a]]
            reach = now / (now - target[a])
            if reach < stride:
                stride, blocking = reach, a
    for a in range(count):
        weights[free[a]] += stride * (target[a] - weights[free[a]])
    if blocking < 0:
        return count
    weights[free[blocking]] = 0.0
    for a in range(blocking, count - 1):
        free[a] = free[a + 1]
    return count - 1


@kernel
def _entering(quadratic: F64, linear: F64, weights: F64, free: I64, count: int, multiplier: float, slack: float) -> int:
    """The weight at 0 that the sum falls fastest with; -1 where it falls with none."""
    best, worst = -1, -slack
    for i in range(weights.shape[0]):
        if weights[i] > 0.0 or count == weights.shape[0]:
            continue
        slope = -linear[i] - multiplier
        for a in range(count):
            slope += quadratic[i, free[a]] * weights[free[a]]
        if slope < worst:
            best, worst = i, slope
    return best


@kernel
def least(quadratic: F64, linear: F64, weights: F64, free: I64, factor: F64, target: F64) -> None:
    """Minimise ½ wᵀQw − gᵀw over the simplex, in place, starting from the ``weights`` given.

    A primal active set: exact after finitely many steps, and fast from a start whose zeros are about right.

    Parameters
    ----------
    quadratic : (n, n) float64
        Q, positive definite.
    linear : (n,) float64
        g.
    weights : (n,) float64
        On the simplex; overwritten by the minimum.
    free : (n,) int64
    factor : (n + 1, n) float64
    target : (n,) float64
        Scratch.
    """
    count, size = 0, 0.0
    for i in range(weights.shape[0]):
        size = max(size, abs(linear[i]), quadratic[i, i])
        if weights[i] > 0.0:
            free[count] = i
            count += 1
        else:
            weights[i] = 0.0
    for _ in range(6 * weights.shape[0] + 10):  # far more than it ever takes; rounding could make it run in circles
        multiplier = _solve_free(quadratic, linear, free, count, factor, target)
        stay = _step_free(weights, free, count, target)
        if stay < count:
            count = stay
            continue
        entering = _entering(quadratic, linear, weights, free, count, multiplier, 1e-13 * size)
        if entering < 0:
            return
        free[count] = entering
        count += 1


@kernel
def _coordinates(point: F64, inverse: F64, out: F64) -> float:
    """Barycentric coordinates (D + 1,) of a point in one simplex; return the least of them."""
    dims, least_share = point.shape[0], np.inf
    for c in range(dims + 1):
        out[c] = inverse[c, dims]
        for a in range(dims):
            out[c] += inverse[c, a] * point[a]
        least_share = min(least_share, out[c])
    return least_share


@kernel
def _spread(members: I64, shares: F64, scale: float, out: F64) -> None:
    """Add a simplex's coordinates, cut off at 0 and summing to 1, to the weights of its examples."""
    total = 0.0
    for c in range(members.shape[0]):
        total += max(shares[c], 0.0)
    for c in range(members.shape[0]):
        out[members[c]] += scale * max(shares[c], 0.0) / total


@kernel
def _gap(shares: F64, heights: F64) -> float:
    """Distance that a point has at least from a simplex: that from the half-space of its most violated facet."""
    gap = 0.0
    for c in range(shares.shape[0]):
        gap = max(gap, -shares[c] * heights[c])
    return gap


@kernel
def _project(point: F64, corners: F64, shares: F64, gram: F64, edges: F64, free: I64, factor: F64) -> float:
    """Improve ``shares`` (D + 1,) of one simplex to those of its point nearest to ``point``; return the distance."""
    dims, size, total = point.shape[0], 0.0, 0.0
    linear, target = np.zeros(dims + 1), np.empty(dims + 1)
    for c in range(dims + 1):
        shares[c] = max(shares[c], 0.0)
        total += shares[c]
        for a in range(dims):
            edges[c, a] = corners[c, a] - point[a]
    for c in range(dims + 1):
        shares[c] /= total
        for d in range(dims + 1):
            gram[c, d] = 0.0
            for a in range(dims):
                gram[c, d] += edges[c, a] * edges[d, a]
        size = max(size, gram[c, c])
    gram += size  # Σ w is fixed, so this changes nothing but makes the quadratic definite
    least(gram, linear, shares, free, factor, target)
    squared = 0.0
    for a in range(dims):
        miss = 0.0
        for c in range(dims + 1):
            miss += shares[c] * edges[c, a]
        squared += miss * miss
    return np.sqrt(squared)


@kernel
def _toward(point: F64, corners: F64, shares: F64, out: F64) -> float:
    """Direction (D,) to ``point`` from that with ``shares`` in a simplex; return the level of the latter along it."""
    level = 0.0
    out[:] = point
    for c in range(shares.shape[0]):
        for a in range(point.shape[0]):
            out[a] -= shares[c] * corners[c, a]
    for c in range(shares.shape[0]):
        for a in range(point.shape[0]):
            level += shares[c] * corners[c, a] * out[a]
    return level


@kernel
def _beyond(corners: F64, toward: F64, level: float) -> bool:
    """Whether a simplex has a corner farther along a direction; if none has, it has no nearer point either."""
    for c in range(corners.shape[0]):
        along = 0.0
        for a in range(toward.shape[0]):
            along += corners[c, a] * toward[a]
        if along > level:
            return True
    return False


@kernel
def _nearest(point: F64, members: I64, corners: F64, inverses: F64, gaps: F64, out: F64) -> None:
    """Weights (N,) of the nearest point of the simplices to a ``point`` outside them all, added to ``out``.

    ``gaps`` (S,) are distances that they have at least. The search starts where that is least; every other simplex that
    could be nearer is tried, which in a convex set of simplices soon is none.
    """
    dims, toward = point.shape[0], np.empty(point.shape[0])
    gram, edges = np.empty((dims + 1, dims + 1)), np.empty((dims + 1, dims))
    free, factor = np.empty(dims + 1, np.int64), np.empty((dims + 2, dims + 1))
    trial, shares = np.empty(dims + 1), np.empty(dims + 1)
    found = int(np.argmin(gaps))
    _coordinates(point, inverses[found], shares)
    best = _project(point, corners[found], shares, gram, edges, free, factor)
    level = _toward(point, corners[found], shares, toward) + 1e-12
    for s in range(members.shape[0]):
        if s == found or gaps[s] >= best or not _beyond(corners[s], toward, level):
            continue
        _coordinates(point, inverses[s], trial)
        distance = _project(point, corners[s], trial, gram, edges, free, factor)
        if distance < best - 1e-12:  # simplices that share the nearest face agree but for rounding
            best, found = distance, s
            shares[:] = trial
            level = _toward(point, corners[found], shares, toward) + 1e-12
    _spread(members[found], shares, 1.0, out)


@kernel
def barycentric(
    points: F64, members: I64, corners: F64, inverses: F64, heights: F64, overlapping: bool, out: F64
) -> None:
    """Barycentric weights (B, N) at points (B, D), written to ``out``.

    In one simplex: the coordinates in it. In several (``overlapping``): the mean of theirs, each counted by its least
    coordinate, which is 0 on its facets. In none: those of the nearest point of all simplices.

    Parameters
    ----------
    points : (B, D) float64
    members : (S, D + 1) int64
        Examples at the corners of each simplex.
    corners : (S, D + 1, D) float64
    inverses : (S, D + 1, D + 1) float64
        Matrices from (point, 1) to barycentric coordinates.
    heights : (S, D + 1) float64
        Height of each simplex over each of its facets, that which lacks the corner.
    overlapping : bool
        False where simplices share nothing but facets; then the first one that contains the point counts.
    """
    shares, gaps = np.empty(members.shape[1]), np.empty(members.shape[0])
    for b in range(points.shape[0]):
        row, point, total = out[b], points[b], 0.0
        row[:] = 0.0
        for s in range(members.shape[0]):
            depth = _coordinates(point, inverses[s], shares)
            if depth < -CONTAINED:
                gaps[s] = _gap(shares, heights[s])
                continue
            share = depth + 2.0 * CONTAINED  # above 0, so that a facet on the border of all simplices still counts
            _spread(members[s], shares, share, row)
            total += share
            if not overlapping:
                break
        if total > 0.0:
            for i in range(row.shape[0]):
                row[i] /= total
        else:
            _nearest(point, members, corners, inverses, gaps, row)
