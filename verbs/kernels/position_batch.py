"""Corrected blending of many characters that are measured by a joint's position; see :mod:`verbs.kernels.sums`.

The sums are the blended root position and the blended rotation rows of the chain. Results equal those of
:mod:`verbs.kernels.corrected_position` but for rounding.

Source: ``docs/math.md``, section "Corrected blending".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels import columns
from verbs.kernels.chart import chart_columns, clamp_columns, normalise_columns
from verbs.kernels.compile import kernel
from verbs.kernels.corrected_position import Blended, Chain, PositionProblem
from verbs.kernels.correction import Correction
from verbs.kernels.measure import GoalSpace
from verbs.kernels.pose import NLERP, SHORTEST
from verbs.kernels.radial_basis import feature_columns
from verbs.kernels.sums import FEW, PLAIN, Sums, move, normal, residuals, solve

__all__ = ["correct_positions_batch", "corrected_position_batch", "effector_positions_batch"]


@kernel
def _unit(sums: F64, row: int, reference: F64, unit: F64, scaled: F64, at: int) -> None:
    """Unit quaternions (4, T) of sums from ``row`` on; to ``scaled``, from ``at`` on, times 2 / length of the sum."""
    a, b, c, d = reference[0], reference[1], reference[2], reference[3]
    for k in range(unit.shape[1]):
        x, y, z, w = sums[row, k], sums[row + 1, k], sums[row + 2, k], sums[row + 3, k]
        length = np.sqrt(x * x + y * y + z * z + w * w)
        short = length < SHORTEST
        inverse = 1.0 / (SHORTEST if short else length)
        x, y = a if short else inverse * x, b if short else inverse * y
        z, w = c if short else inverse * z, d if short else inverse * w
        unit[0, k], unit[1, k], unit[2, k], unit[3, k] = x, y, z, w
        twice = inverse + inverse
        scaled[at, k], scaled[at + 1, k], scaled[at + 2, k], scaled[at + 3, k] = (
            twice * x,
            twice * y,
            twice * z,
            twice * w,
        )


@kernel
def _exponentials(sums: F64, row: int, reference: F64, unit: F64) -> None:
    """Unit quaternions (4, T) of sums of rotation vectors from ``row`` on, relative to the reference (4,)."""
    a, b, c, d = reference[0], reference[1], reference[2], reference[3]
    for k in range(unit.shape[1]):
        x, y, z = sums[row, k], sums[row + 1, k], sums[row + 2, k]
        angle = np.sqrt(x * x + y * y + z * z)
        scale = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        x, y, z, w = scale * x, scale * y, scale * z, np.cos(0.5 * angle)
        unit[0, k], unit[1, k] = d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x
        unit[2, k], unit[3, k] = d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z


@kernel
def _compose(turns: F64, parent: int, unit: F64) -> None:
    """Global rotations of a joint, from its parent's, which start at row ``parent``, to the four rows after them."""
    out = parent + 4
    for k in range(unit.shape[1]):
        x, y, z, w = turns[parent, k], turns[parent + 1, k], turns[parent + 2, k], turns[parent + 3, k]
        a, b, c, d = unit[0, k], unit[1, k], unit[2, k], unit[3, k]
        turns[out, k] = w * a + x * d + y * c - z * b
        turns[out + 1, k] = w * b - x * c + y * d + z * a
        turns[out + 2, k] = w * c + x * b - y * a + z * d
        turns[out + 3, k] = w * d - x * a - y * b - z * c


@kernel
def _advance(turns: F64, row: int, offset: F64, joints: F64, parent: int) -> None:
    """Positions of the next joint, to the three rows after its parent's: plus the offset (3,), rotated."""
    a, b, c, out = offset[0], offset[1], offset[2], parent + 3
    for k in range(joints.shape[1]):
        x, y, z, w = turns[row, k], turns[row + 1, k], turns[row + 2, k], turns[row + 3, k]
        s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        joints[out, k] = joints[parent, k] + a + w * s + y * u - z * t
        joints[out + 1, k] = joints[parent + 1, k] + b + w * t + z * s - x * u
        joints[out + 2, k] = joints[parent + 2, k] + c + w * u + x * t - y * s


@kernel
def _chain(
    mode: int, references: F64, offsets: F64, sums: F64, unit: F64, scaled: F64, turns: F64, joints: F64
) -> None:
    """Global rotations and positions of all joints of a tile; the last three rows of ``joints`` are the effector's."""
    for a in range(3):
        joints[a] = sums[a]
    for j in range(references.shape[0]):
        if mode == NLERP:
            _unit(sums, 3 + 4 * j, references[j], unit, scaled, 4 * j)
        else:
            _exponentials(sums, 3 + 4 * j, references[j], unit)
        _compose(turns, 4 * j, unit)
        _advance(turns, 4 * j + 4, offsets[j], joints, 3 * j)


@kernel
def _rates(turns: F64, row: int, scaled: F64, at: int, i: int, j: int, m: int, out: F64) -> None:
    """Row i of the matrix from rotation rows to global angular velocity, to rows 4·i to 4·i + 3; i, j, m are cyclic."""
    first = 4 * i
    for k in range(out.shape[1]):
        x, y, z, w = turns[row + i, k], turns[row + j, k], turns[row + m, k], turns[row + 3, k]
        p, q, r, s = scaled[at + i, k], scaled[at + j, k], scaled[at + m, k], scaled[at + 3, k]
        xx, xy, xz = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
        out[first + i, k] = xx * s - xy * r + xz * q
        out[first + j, k] = xx * r + xy * s - xz * p
        out[first + m, k] = xy * p - xx * q + xz * s
        out[first + 3, k] = -(xx * p + xy * q + xz * r)


@kernel
def _vector_rates(turns: F64, row: int, sums: F64, at: int, out: F64) -> None:
    """Matrix from rotation vectors to global angular velocity (12, T): the exponential's right Jacobian, rotated."""
    for k in range(out.shape[1]):
        a, b, c, d = turns[row, k], turns[row + 1, k], turns[row + 2, k], turns[row + 3, k]
        x, y, z = sums[at, k], sums[at + 1, k], sums[at + 2, k]
        square = x * x + y * y + z * z
        angle = np.sqrt(square)
        first = (1.0 - np.cos(angle)) / square if angle > 1e-4 else 0.5
        second = (angle - np.sin(angle)) / (square * angle) if angle > 1e-3 else 1.0 / 6.0
        for i in range(3):
            if i == 0:
                p, q, r = 1.0 - 2.0 * (b * b + c * c), 2.0 * (a * b - c * d), 2.0 * (a * c + b * d)
            elif i == 1:
                p, q, r = 2.0 * (a * b + c * d), 1.0 - 2.0 * (a * a + c * c), 2.0 * (b * c - a * d)
            else:
                p, q, r = 2.0 * (a * c - b * d), 2.0 * (b * c + a * d), 1.0 - 2.0 * (a * a + b * b)
            along, rest = second * (p * x + q * y + r * z), 1.0 - second * square
            out[4 * i, k] = rest * p + along * x + first * (r * y - q * z)
            out[4 * i + 1, k] = rest * q + along * y + first * (p * z - r * x)
            out[4 * i + 2, k] = rest * r + along * z + first * (q * x - p * y)
            out[4 * i + 3, k] = 0.0


@kernel
def _arms(joints: F64, joint: int, effector: int, out: F64) -> None:
    """Vectors (3, T) from a joint to the effector, whose positions start at these rows."""
    for k in range(out.shape[1]):
        out[0, k] = joints[effector, k] - joints[joint, k]
        out[1, k] = joints[effector + 1, k] - joints[joint + 1, k]
        out[2, k] = joints[effector + 2, k] - joints[joint + 2, k]


@kernel
def _lever(rates: F64, column: int, arms: F64, out: F64, row: int) -> None:
    """Derivatives of the effector in one entry of a joint's row, to x, y, z from ``row`` on: angular velocity × arm."""
    for k in range(arms.shape[1]):
        p, q, r = rates[column, k], rates[4 + column, k], rates[8 + column, k]
        x, y, z = arms[0, k], arms[1, k], arms[2, k]
        out[row, k] = q * z - r * y
        out[row + 1, k] = r * x - p * z
        out[row + 2, k] = p * y - q * x


@kernel
def _derivatives(mode: int, sums: F64, scaled: F64, turns: F64, joints: F64, rates: F64, arms: F64, out: F64) -> None:
    """Derivatives (12·L, T) of effectors, x, y, z for each entry of a row, where :func:`_chain` was called last."""
    links = turns.shape[0] // 4 - 1
    for j in range(links):
        if mode == NLERP:
            _rates(turns, 4 * j + 4, scaled, 4 * j, 0, 1, 2, rates)
            _rates(turns, 4 * j + 4, scaled, 4 * j, 1, 2, 0, rates)
            _rates(turns, 4 * j + 4, scaled, 4 * j, 2, 0, 1, rates)
        else:
            _vector_rates(turns, 4 * j + 4, sums, 3 + 4 * j, rates)
        _arms(joints, 3 * j, 3 * links, arms)
        for c in range(4):
            _lever(rates, c, arms, out, 12 * j + 3 * c)


class _Tile(NamedTuple):
    """Scratch arrays of one tile of T characters, for a chain of L joints.

    Parameters
    ----------
    unit : (4, T) float64
    scaled : (4·L, T) float64
    turns : (4·(L + 1), T) float64
        Global rotations; the first four rows are the identity.
    joints : (3·(L + 1), T) float64
    rates : (12, T) float64
    arms : (3, T) float64
    levers : (12·L, T) float64
        Derivatives of the point in the sums, the root's left out: x, y, z of each.
    moved : (3·S, T) float64
    products : (6, T) float64
    goals, residual : (3, T) float64
    sums, eta : (S, T) float64
    live : (T,) float64
    """

    unit: F64
    scaled: F64
    turns: F64
    joints: F64
    rates: F64
    arms: F64
    levers: F64
    moved: F64
    products: F64
    goals: F64
    residual: F64
    sums: F64
    eta: F64
    live: F64


@kernel
def _tile(width: int, links: int) -> _Tile:
    """Scratch arrays."""
    size, turns = 4 * links + 4, np.empty((4 * links + 4, width))
    turns[:3], turns[3] = 0.0, 1.0
    return _Tile(
        np.empty((4, width)), np.empty((4 * links, width)), turns, np.empty((3 * links + 3, width)),
        np.empty((12, width)), np.empty((3, width)),
        np.empty((12 * links, width)), np.empty((3 * size, width)), np.empty((6, width)),
        np.empty((3, width)), np.empty((3, width)), np.empty((size, width)), np.empty((size, width)), np.empty(width),
    )  # fmt: skip


@kernel
def _steps(correction: Correction, chain: Chain, couplings: F64, inner: F64, tile: _Tile, first: int) -> int:
    """Steps of a tile, from number ``first`` on, until no character moves or few enough for a narrower tile.

    ``inner`` (S, 4·L) are the columns of ``couplings`` (S, S) without the root's. Return the number of the next step.
    """
    mode, _, _, references, offsets = chain
    _, scale, saturation, damping, stop, steps = correction
    unit, scaled, turns, joints, rates, arms, levers, moved, products, goals, residual, now, eta, live = tile
    effector = joints[joints.shape[0] - 3 :]
    wide_levers = levers.reshape(inner.shape[1], 3 * live.shape[0])
    wide_moved = moved.reshape(inner.shape[0], 3 * live.shape[0])
    for s in range(first, steps):
        _chain(mode, references, offsets, now, unit, scaled, turns, joints)
        moving, left = residuals(goals, effector, scale, saturation, stop, live, residual)
        if moving > 0.0:
            _derivatives(mode, now, scaled, turns, joints, rates, arms, levers)
            np.dot(inner, wide_levers, wide_moved)
            normal(levers, moved, couplings, products)
            solve(products, scale, damping, residual)
            move(levers, moved, couplings, residual, now, eta)
        if left == 0.0 or left <= FEW * live.shape[0]:
            return s + 1
    return steps


@kernel
def _settle(correction: Correction, chain: Chain, sums: Sums, inner: F64, tile: _Tile) -> None:
    """Steps of a tile from ``tile.sums`` toward ``tile.goals``; writes ``tile.eta`` and the joints of the result.

    Characters that need more steps than most continue in a narrower tile.
    """
    tile.live[:] = 1.0
    tile.eta[:] = 0.0
    taken = _steps(correction, chain, sums.couplings, inner, tile, 0)
    while taken < correction.steps:
        origins = np.flatnonzero(tile.live)
        if origins.shape[0] == 0:
            break
        narrow = _tile(columns.tiles(origins.shape[0])[1], chain.references.shape[0])
        columns.take(tile.goals, origins, narrow.goals)
        columns.take(tile.sums, origins, narrow.sums)
        columns.take(tile.eta, origins, narrow.eta)
        narrow.live[:] = 1.0
        taken = _steps(correction, chain, sums.couplings, inner, narrow, taken)
        columns.put(narrow.sums, origins, tile.sums)
        columns.put(narrow.eta, origins, tile.eta)
        tile.live[origins] = narrow.live[: origins.shape[0]]
    _chain(chain.mode, chain.references, chain.offsets, tile.sums, tile.unit, tile.scaled, tile.turns, tile.joints)


@kernel
def _inner(couplings: F64, links: int) -> F64:
    """Columns (S, 4·L) of couplings (S, S) that belong to rotation rows."""
    return np.ascontiguousarray(couplings[:, PLAIN : PLAIN + 4 * links])


@kernel
def correct_positions_batch(weights: F64, goals: F64, correction: Correction, chain: Chain, sums: Sums) -> None:
    """Correct weights (B, N) in place until effectors are at goals (B, 3)."""
    count, width = columns.tiles(weights.shape[0])
    tile, inner = _tile(width, chain.references.shape[0]), _inner(sums.couplings, chain.references.shape[0])
    taken, change = np.empty((weights.shape[1], width)), np.empty((width, weights.shape[1]))
    for t in range(count):
        columns.gather(weights, t * width, taken)
        columns.gather(goals, t * width, tile.goals)
        np.dot(sums.rows, taken, tile.sums)
        _settle(correction, chain, sums, inner, tile)
        np.dot(tile.eta.T, sums.moves, change)
        for k in range(min(width, weights.shape[0] - t * width)):
            for i in range(weights.shape[1]):
                weights[t * width + k, i] += change[k, i]


@kernel
def effector_positions_batch(weights: F64, chain: Chain, out: F64) -> None:
    """Effector positions (B, 3) of weights (B, N)."""
    mode, roots, rows, references, offsets = chain
    count, width = columns.tiles(weights.shape[0])
    tile = _tile(width, references.shape[0])
    taken = np.empty((weights.shape[1], width))
    for t in range(count):
        columns.gather(weights, t * width, taken)
        np.dot(roots, taken, tile.sums[:PLAIN])
        np.dot(rows, taken, tile.sums[PLAIN : PLAIN + rows.shape[0]])
        _chain(mode, references, offsets, tile.sums, tile.unit, tile.scaled, tile.turns, tile.joints)
        columns.scatter(tile.joints[tile.joints.shape[0] - 3 :], t * width, out)


@kernel
def _goal_columns(space: GoalSpace, adverbs: F64, out: F64) -> None:
    """Goals (3, T) of adverbs (D, T): origin + frame · measured adverbs."""
    axes, origin, frame = space.axes, space.origin, space.frame
    for a in range(3):
        for k in range(out.shape[1]):
            out[a, k] = origin[a]
        for m in range(axes.shape[0]):
            share, row = frame[a, m], axes[m]
            for k in range(out.shape[1]):
                out[a, k] += share * adverbs[row, k]


@kernel
def _compare_columns(space: GoalSpace, goals: F64, points: F64, first: int, measured: F64, error: F64) -> None:
    """Measured adverbs (B, m) of points (3, T) and their distance (B,) to goals (3, T), from row ``first`` on."""
    origin, inverse = space.origin, space.inverse
    for k in range(min(goals.shape[1], error.shape[0] - first)):
        x, y, z = points[0, k], points[1, k], points[2, k]
        error[first + k] = np.sqrt((x - goals[0, k]) ** 2 + (y - goals[1, k]) ** 2 + (z - goals[2, k]) ** 2)
        x, y, z = x - origin[0], y - origin[1], z - origin[2]
        for m in range(inverse.shape[0]):
            measured[first + k, m] = inverse[m, 0] * x + inverse[m, 1] * y + inverse[m, 2] * z


@kernel
def corrected_position_batch(rows: F64, charted: bool, problem: PositionProblem, out: Blended) -> None:
    """Method ``corrected`` for rows (B, D): weights, measured adverbs and error, to ``out``.

    Rows are adverbs, or (``charted``) normalised coordinates of the domain's chart.
    """
    domain, basis, own_chart, correction, chain, space, sums, to_sums, to_weights = problem
    weights, measured, error, moved = out
    batch, dims, examples = rows.shape[0], rows.shape[1], weights.shape[1]
    count, width = columns.tiles(batch)
    tile, inner = _tile(width, chain.references.shape[0]), _inner(sums.couplings, chain.references.shape[0])
    terms = to_sums.shape[1]
    known = np.empty((to_weights.shape[0], width))  # features, then η
    adverbs, inside, points = np.empty((dims, width)), np.empty((dims, width)), np.empty((dims, width))
    requested, clamped = np.empty((3, width)), np.empty((2, width))
    blended = np.empty((width, examples))
    for t in range(count):
        first = t * width
        chart_columns(rows, first, charted, domain.chart, adverbs, points)
        clamp_columns(adverbs, domain, points, inside, clamped)
        _goal_columns(space, adverbs, requested)
        _goal_columns(space, inside, tile.goals)
        if own_chart:
            normalise_columns(basis.chart, inside, points)
        feature_columns(points, basis, known)
        np.dot(to_sums, known[:terms], tile.sums)
        _settle(correction, chain, sums, inner, tile)
        known[terms:] = tile.eta
        columns.product(known, to_weights, blended, first, weights)
        for k in range(min(width, batch - first)):
            moved[first + k] = clamped[0, k]
        _compare_columns(space, requested, tile.joints[tile.joints.shape[0] - 3 :], first, measured, error)
