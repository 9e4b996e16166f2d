"""Weights and phases to poses: characters sorted by knot interval, whose coefficients are read once for several.

Within an interval a pose is a sum over the same 4·N rows of coefficients, so characters of one interval are summed
four at a time. The sum of a character does not depend on its neighbours. A crowd goes through in tiles of
:data:`TILE` characters, which stay in the cache until they are normalised and written.

Sums are in the precision of ``shares`` and ``out``: single for streams, double elsewhere.

Source: Rose, Sloan, Cohen 2001, equation 3; the rotation part as ``docs/math.md`` states it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.kernels.compile import kernel
from verbs.kernels.pose import NLERP, SHORTEST, finish_rotation, spline_taps

__all__ = [
    "TILE",
    "Curves",
    "blend_sorted",
    "curves_of",
    "finish_double",
    "finish_single",
    "interval",
    "share",
    "sort_by_interval",
    "sums",
]

TILE = 64
"""Characters that are summed, normalised and written together."""

_ONE, _SHORTEST_SQUARED = np.float32(1.0), np.float32(SHORTEST * SHORTEST)


class Curves(NamedTuple):
    """Curves of a verb as :func:`sums` reads them.

    Parameters
    ----------
    rows : ((K + 3)·N, 4 + 4·J) float32
        Coefficients, see :mod:`verbs.kernels.pose`; a row for each coefficient and example.
    intervals : int
        K.
    mode : int
        How rotations blend.
    references : (J, 4) float64
    """

    rows: F32
    intervals: int
    mode: int
    references: F64


def curves_of(curves: F32, mode: int, references: F64) -> Curves:
    """Curves (K + 3, N, 4 + 4·J) as they are read here, without a copy."""
    return Curves(curves.reshape(-1, curves.shape[2]), curves.shape[0] - 3, mode, references)


@kernel
def interval(phase: float, intervals: int) -> int:
    """Knot interval that contains a phase; the first or last one where it lies outside."""
    return min(max(int(np.floor(phase * intervals)), 0), intervals - 1)


@kernel
def sort_by_interval(chosen: I64, phases: F64, intervals: int, order: I64) -> None:
    """Write the numbers ``chosen`` (C,) to ``order`` (C,), sorted by the knot interval of their ``phases``; stable."""
    size = chosen.shape[0]
    if size < 3:
        for c in range(size):
            order[c] = chosen[c]
        return
    starts = np.zeros(intervals + 1, np.int64)
    for c in range(size):
        starts[interval(phases[chosen[c]], intervals) + 1] += 1
    for k in range(intervals):
        starts[k + 1] += starts[k]
    for c in range(size):
        k = interval(phases[chosen[c]], intervals)
        order[starts[k]] = chosen[c]
        starts[k] += 1


@kernel
def _one(shares: Any, rows: F32, first: int, out: Any) -> None:
    """Sum of rows from ``first`` on, weighted by ``shares`` (1, 4·N), to ``out`` (1, width)."""
    out0 = out[0]
    out0[:] = 0
    for k in range(0, shares.shape[1], 4):
        r0, r1, r2, r3 = rows[first + k], rows[first + k + 1], rows[first + k + 2], rows[first + k + 3]
        a0, a1, a2, a3 = shares[0, k], shares[0, k + 1], shares[0, k + 2], shares[0, k + 3]
        for c in range(out0.shape[0]):
            out0[c] += a0 * r0[c] + a1 * r1[c] + a2 * r2[c] + a3 * r3[c]


@kernel
def _two(shares: Any, rows: F32, first: int, out: Any) -> None:
    """Two sums as :func:`_one`, of ``shares`` (2, 4·N), which read each row once."""
    out0, out1 = out[0], out[1]
    out[:] = 0
    for k in range(0, shares.shape[1], 4):
        r0, r1, r2, r3 = rows[first + k], rows[first + k + 1], rows[first + k + 2], rows[first + k + 3]
        a0, a1, a2, a3 = shares[0, k], shares[0, k + 1], shares[0, k + 2], shares[0, k + 3]
        b0, b1, b2, b3 = shares[1, k], shares[1, k + 1], shares[1, k + 2], shares[1, k + 3]
        for c in range(out0.shape[0]):
            x0, x1, x2, x3 = r0[c], r1[c], r2[c], r3[c]
            out0[c] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
            out1[c] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3


@kernel
def _four(shares: Any, rows: F32, first: int, out: Any) -> None:
    """Four sums as :func:`_one`, of ``shares`` (4, 4·N), which read each row once."""
    out0, out1, out2, out3 = out[0], out[1], out[2], out[3]
    out[:] = 0
    for k in range(0, shares.shape[1], 4):
        r0, r1, r2, r3 = rows[first + k], rows[first + k + 1], rows[first + k + 2], rows[first + k + 3]
        a0, a1, a2, a3 = shares[0, k], shares[0, k + 1], shares[0, k + 2], shares[0, k + 3]
        b0, b1, b2, b3 = shares[1, k], shares[1, k + 1], shares[1, k + 2], shares[1, k + 3]
        c0, c1, c2, c3 = shares[2, k], shares[2, k + 1], shares[2, k + 2], shares[2, k + 3]
        d0, d1, d2, d3 = shares[3, k], shares[3, k + 1], shares[3, k + 2], shares[3, k + 3]
        for c in range(out0.shape[0]):
            x0, x1, x2, x3 = r0[c], r1[c], r2[c], r3[c]
            out0[c] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
            out1[c] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
            out2[c] += c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3
            out3[c] += d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3


@kernel
def share(weights: F64, phase: float, intervals: int, taps: F64, out: Any) -> int:
    """Shares (4·N,) of rows in a pose at weights (N,) and a phase; return its interval. ``taps`` (4,) is scratch."""
    count = weights.shape[0]
    k = spline_taps(phase, intervals, taps)
    for tap in range(4):
        for i in range(count):
            out[tap * count + i] = taps[tap] * weights[i]
    return k


@kernel
def sums(shares: Any, at: I64, rows: F32, out: Any) -> None:
    """Sums of coefficients of T characters that are sorted by interval.

    Parameters
    ----------
    shares : (T, 4·N)
        Of :func:`share`.
    at : (T,) int64
        Their intervals.
    rows : ((K + 3)·N, width) float32
    out : (T, width)
        Written, in the precision of ``shares``.
    """
    count, size = shares.shape[1] // 4, at.shape[0]
    b = 0
    while b < size:
        k = at[b]
        if b + 3 < size and at[b + 3] == k:
            _four(shares[b : b + 4], rows, k * count, out[b : b + 4])
            b += 4
        elif b + 1 < size and at[b + 1] == k:
            _two(shares[b : b + 2], rows, k * count, out[b : b + 2])
            b += 2
        else:
            _one(shares[b : b + 1], rows, k * count, out[b : b + 1])
            b += 1


@kernel
def finish_single(tile: F32, scales: F32, mode: int, references: F64) -> None:
    """Unit quaternions, in place, of summed rows (T, 4 + 4·J) in single precision, whose first four numbers stay.

    ``scales`` (T·(J + 1),) is scratch. A sum shorter than 0.3 becomes its reference, as in
    :func:`verbs.kernels.pose.finish_rotation`.
    """
    size, blocks = tile.shape[0], tile.shape[1] // 4
    if mode != NLERP:
        _exponentials(tile, mode, references)
        return
    flat = tile.reshape(size * 4 * blocks)
    for k in range(size * blocks):
        x, y, z, w = flat[4 * k], flat[4 * k + 1], flat[4 * k + 2], flat[4 * k + 3]
        scales[k] = x * x + y * y + z * z + w * w
    for b in range(size):
        scales[b * blocks] = _ONE
    least = _ONE
    for k in range(size * blocks):
        least = min(least, scales[k])
        scales[k] = _ONE / np.sqrt(scales[k])
    for k in range(size * blocks):
        scale = scales[k]
        for a in range(4):
            flat[4 * k + a] *= scale
    if least < _SHORTEST_SQUARED:
        _replace_short(tile, scales, references)


@kernel
def _exponentials(tile: F32, mode: int, references: F64) -> None:
    """Unit quaternions, in place, of summed rotation vectors."""
    q = np.empty(4)
    for b in range(tile.shape[0]):
        for j in range(references.shape[0]):
            q[:] = tile[b, 4 + 4 * j : 8 + 4 * j]
            finish_rotation(mode, references[j], q)
            tile[b, 4 + 4 * j : 8 + 4 * j] = q


@kernel
def _replace_short(tile: F32, scales: F32, references: F64) -> None:
    """Replace quaternions by their references where the sum was too short."""
    blocks = tile.shape[1] // 4
    for b in range(tile.shape[0]):
        for j in range(references.shape[0]):
            if not scales[b * blocks + j + 1] <= _ONE / np.sqrt(_SHORTEST_SQUARED):  # estimated, so NaN for length 0
                tile[b, 4 + 4 * j : 8 + 4 * j] = references[j]


@kernel
def finish_double(row: Any, mode: int, references: F64, root: F64, rotations: F64) -> None:
    """Root (3,) and unit quaternions (J, 4) in double precision of a summed row (4 + 4·J,) of any precision."""
    for a in range(3):
        root[a] = row[a]
    for j in range(references.shape[0]):
        at = 4 + 4 * j
        x, y, z, w = np.float64(row[at]), np.float64(row[at + 1]), np.float64(row[at + 2]), np.float64(row[at + 3])
        squared = x * x + y * y + z * z + w * w
        if mode == NLERP and squared >= SHORTEST * SHORTEST:
            scale = 1.0 / np.sqrt(squared)
            x, y, z, w = scale * x, scale * y, scale * z, scale * w
        rotations[j, 0], rotations[j, 1], rotations[j, 2], rotations[j, 3] = x, y, z, w
        if mode != NLERP or not squared >= SHORTEST * SHORTEST:
            finish_rotation(mode, references[j], rotations[j])


@kernel
def blend_sorted(weights: F64, phases: F64, curves: Curves, root: F64, rotations: F64) -> None:
    """Blend one pose per batch entry, in double precision.

    Parameters
    ----------
    weights : (B, N) float64
        Weights of the examples; each row sums to 1.
    phases : (B,) float64
        Canonical time, 0 to 1.
    curves : Curves
    root : (B, 3) float64
        Written: root position, metres.
    rotations : (B, J, 4) float64
        Written: local rotations, unit quaternions.
    """
    rows, intervals, mode, references = curves
    size = weights.shape[0]
    order, at, taps = np.empty(size, np.int64), np.empty(TILE, np.int64), np.empty(4)
    sort_by_interval(np.arange(size), phases, intervals, order)
    most = min(TILE, size)
    shares, tile = np.empty((most, 4 * weights.shape[1])), np.empty((most, rows.shape[1]))
    for start in range(0, size, TILE):
        count = min(TILE, size - start)
        for k in range(count):
            b = order[start + k]
            at[k] = share(weights[b], phases[b], intervals, taps, shares[k])
        sums(shares[:count], at[:count], rows, tile[:count])
        for k in range(count):
            b = order[start + k]
            finish_double(tile[k], mode, references, root[b], rotations[b])
