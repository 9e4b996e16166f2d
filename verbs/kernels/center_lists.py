"""Basis evaluation that looks at few centers: a grid of center lists, and a tree of bounding spheres.

Radial functions of compact support are zero at most centers. Cells of a grid hold the centers that can reach them;
a query looks its cell up and sums over that list alone, in the order of the centers, so that it differs from
:func:`verbs.kernels.radial_basis.evaluate` by rounding at most. The tree is the recursive clustering that the paper
names for its O(log N); it is here to be compared, and the grid is what runs.

Source: Rose, Sloan, Cohen 2001, section 4.3 (multiresolution with recursive clustering); ``docs/math.md``,
section "Refinement", has the comparison.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import chart as charts
from verbs.kernels import radial_basis
from verbs.kernels.compile import kernel

__all__ = ["COMPACT", "Grid", "Tree", "active", "cardinal", "cardinal_tree", "cluster", "grid", "radial_matrix"]

COMPACT = frozenset({radial_basis.BSPLINE, radial_basis.WENDLAND})
"""Radial functions that end; the others never do."""

SUPPORT = 2.0
"""Radii at which all of them end."""

CELLS = {1: 512, 2: 64, 3: 24}
"""Cells to a side of the grid, by the number of axes that it divides."""

MARGIN = 0.15
"""The grid reaches this share of its size beyond the centers, as queries do; farther out all centers are tried."""

LEAF = 8
"""Most centers of a leaf of the tree."""

DEPTH = 64


class Grid(NamedTuple):
    """Lists of the centers that reach each cell.

    Parameters
    ----------
    axes : (A,) int64
        Axes that the grid divides: the three of widest spread, or fewer.
    low, inverse : (A,) float64
        Lower corner, and cells per unit of length.
    shape : (A,) int64
        Cells to a side.
    starts : (cells + 1,) int64
        Where each cell's list starts in ``members``.
    members : (entries,) int64
        Centers, rising within a list.
    """

    axes: I64
    low: F64
    inverse: F64
    shape: I64
    starts: I64
    members: I64


class Tree(NamedTuple):
    """Binary tree of spheres, each of which holds the supports of all centers below it.

    Parameters
    ----------
    middles : (nodes, D) float64
    reaches : (nodes,) float64
    children : (nodes, 2) int64
        Indices of two nodes; -1 at leaves.
    spans : (nodes, 2) int64
        Range in ``order`` of the centers below.
    order : (C,) int64
    """

    middles: F64
    reaches: F64
    children: I64
    spans: I64
    order: I64


def grid(centers: F64, radii: F64) -> Grid:
    """Lists of centers (C, D) of radii (C,), for a compact radial function."""
    low, high = centers.min(axis=0), centers.max(axis=0)
    # A stable sort, so that axes of one spread always come in one order.
    axes = np.sort(np.argsort(low - high, kind="stable")[:3]).astype(np.int64)
    size = np.maximum(high - low, 1e-9)[axes]
    shape = np.full(len(axes), CELLS[len(axes)], np.int64)
    corner, inverse = low[axes] - MARGIN * size, shape / ((1.0 + 2.0 * MARGIN) * size)
    reaches = SUPPORT * radii
    starts = np.zeros(int(shape.prod()) + 1, np.int64)
    nothing = np.empty(0, np.int64)
    _list(centers, reaches, axes, corner, inverse, shape, starts, nothing)
    members = np.empty(int(starts[1:].sum()), np.int64)
    starts = np.cumsum(starts)
    _list(centers, reaches, axes, corner, inverse, shape, starts[:-1].copy(), members)
    return Grid(axes, corner, inverse, shape, starts, members)


@kernel
def _list(
    centers: F64, reaches: F64, axes: I64, low: F64, inverse: F64, shape: I64, cursors: I64, members: I64
) -> None:
    """Visit each cell that a center's support meets: count it in ``cursors``, or with ``members`` write it there.

    Counts go one place up (``cursors`` is (cells + 1,) then), so that their running sum is where lists start.
    """
    counting = members.shape[0] == 0
    count = axes.shape[0]
    first, last, at = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    for c in range(centers.shape[0]):
        for a in range(count):
            where, reach = (centers[c, axes[a]] - low[a]) * inverse[a], reaches[c] * inverse[a]
            # One cell more to each side: rounding may put a query one cell from where its support was cut off.
            first[a] = max(0, int(np.floor(where - reach)) - 1)
            last[a] = min(shape[a] - 1, int(np.floor(where + reach)) + 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    at[0], at[1], at[2] = i, j, k
                    cell, squared = 0, 0.0
                    for a in range(count):
                        cell = cell * shape[a] + at[a]
                        middle = low[a] + (at[a] + 0.5) / inverse[a]
                        # A cell that is a thousandth too wide keeps queries on its faces safe from rounding.
                        gap = abs(centers[c, axes[a]] - middle) - 0.501 / inverse[a]
                        squared += max(gap, 0.0) ** 2
                    if squared < reaches[c] * reaches[c]:
                        if counting:
                            cursors[cell + 1] += 1
                        else:
                            members[cursors[cell]] = c
                            cursors[cell] += 1


@kernel
def _gather(point: F64, among: I64, centers: F64, radii: F64, held: I64, squares: F64, count: int) -> int:
    """Append the centers of a list that reach a point (D,), and their squared distances; return the new count.

    A millionth more than the support is let through: the radial function decides there, and gives zero.
    """
    reach = 1.000001 * SUPPORT * SUPPORT
    for m in range(among.shape[0]):
        c, squared = among[m], 0.0
        for a in range(point.shape[0]):
            squared += (point[a] - centers[c, a]) ** 2
        if squared < reach * radii[c] * radii[c]:
            held[count], squares[count] = c, squared
            count += 1
    return count


@kernel
def _sum(kernel: int, radii: F64, radial: F64, held: I64, squares: F64, count: int, out: F64) -> None:
    """Add the shares of ``count`` centers to ``out`` (N,).

    Distances, functions and sums have a loop each: roots and divisions of several centers then run side by side.
    """
    for k in range(count):
        squares[k] = radial_basis.phi(kernel, np.sqrt(squares[k]) / radii[held[k]])
    for k in range(count):
        value, c = squares[k], held[k]
        for i in range(out.shape[0]):
            out[i] += value * radial[c, i]


@kernel
def _plane(point: F64, degree: int, poly: F64, row: F64, out: F64) -> None:
    """Polynomial part of the weights (N,), in the order of :func:`verbs.kernels.radial_basis.evaluate`."""
    count = radial_basis.features(point, degree, row)
    for i in range(out.shape[0]):
        out[i] = 0.0
    for f in range(count):
        for i in range(out.shape[0]):
            out[i] += row[f] * poly[f, i]


@kernel
def _cell(point: F64, axes: I64, low: F64, inverse: F64, shape: I64) -> int:
    """Cell of a point (D,), or -1 outside the grid."""
    cell = 0
    for a in range(axes.shape[0]):
        where = (point[axes[a]] - low[a]) * inverse[a]
        if not (where >= 0.0 and where < shape[a]):
            return -1
        cell = cell * shape[a] + int(where)
    return cell


@kernel
def cardinal(
    adverbs: F64,
    kind: int,
    chart_axes: I64,
    bend: F64,
    shift: F64,
    scale: F64,
    kernel: int,
    degree: int,
    centers: F64,
    radii: F64,
    radial: F64,
    poly: F64,
    axes: I64,
    low: F64,
    inverse: F64,
    shape: I64,
    starts: I64,
    members: I64,
    out: F64,
) -> None:
    """Weights (B, N) at adverbs (B, D), as :func:`verbs.kernels.weights.cardinal` by :class:`Grid`."""
    point, row = np.empty(adverbs.shape[1]), np.empty(poly.shape[0])
    held, squares = np.empty(centers.shape[0], np.int64), np.empty(centers.shape[0])
    for b in range(adverbs.shape[0]):
        charts.to_chart(kind, chart_axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        _plane(point, degree, poly, row, out[b])
        cell = _cell(point, axes, low, inverse, shape)
        among = members[starts[cell] : starts[cell + 1]] if cell >= 0 else np.arange(centers.shape[0])
        count = _gather(point, among, centers, radii, held, squares, 0)
        _sum(kernel, radii, radial, held, squares, count, out[b])


def cluster(centers: F64, radii: F64) -> Tree:
    """Tree over centers (C, D) of radii (C,): halved across the widest spread until a leaf holds :data:`LEAF`."""
    reaches, order = SUPPORT * radii, np.arange(len(centers))
    middles: list[F64] = []
    bounds: list[float] = []
    children: list[list[int]] = []
    spans: list[list[int]] = []
    waiting = [(0, len(centers), -1, 0)]
    while waiting:
        begin, end, parent, side = waiting.pop()
        held = order[begin:end]
        points = centers[held]
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        node = len(middles)
        middles.append(middle)
        bounds.append(float((np.linalg.norm(points - middle, axis=1) + reaches[held]).max()))
        children.append([-1, -1])
        spans.append([begin, end])
        if parent >= 0:
            children[parent][side] = node
        if end - begin > LEAF:
            across = int(np.argmax(np.ptp(points, axis=0)))
            order[begin:end] = held[np.argsort(points[:, across], kind="stable")]
            half = (begin + end) // 2
            waiting += [(begin, half, node, 0), (half, end, node, 1)]
    return Tree(
        np.array(middles),
        np.array(bounds),
        np.array(children, np.int64),
        np.array(spans, np.int64),
        order.astype(np.int64),
    )


@kernel
def cardinal_tree(
    points: F64,
    kernel: int,
    degree: int,
    centers: F64,
    radii: F64,
    radial: F64,
    poly: F64,
    middles: F64,
    reaches: F64,
    children: I64,
    spans: I64,
    order: I64,
    out: F64,
) -> None:
    """Weights (B, N) at normalised chart points (B, D) by :class:`Tree`; the sum runs in the tree's order."""
    row, stack = np.empty(poly.shape[0]), np.empty(DEPTH, np.int64)
    held, squares = np.empty(centers.shape[0], np.int64), np.empty(centers.shape[0])
    for b in range(points.shape[0]):
        point = points[b]
        _plane(point, degree, poly, row, out[b])
        stack[0], height, count = 0, 1, 0
        while height > 0:
            height -= 1
            node = stack[height]
            squared = 0.0
            for a in range(point.shape[0]):
                squared += (point[a] - middles[node, a]) ** 2
            if squared >= reaches[node] * reaches[node]:
                continue
            if children[node, 0] >= 0:
                stack[height], stack[height + 1] = children[node, 1], children[node, 0]
                height += 2
                continue
            among = order[spans[node, 0] : spans[node, 1]]
            count = _gather(point, among, centers, radii, held, squares, count)
        _sum(kernel, radii, radial, held, squares, count, out[b])


@kernel
def active(points: F64, kernel: int, centers: F64, radii: F64, out: I64) -> None:
    """Number of centers (B,) whose radial function is not zero at normalised chart points (B, D)."""
    for b in range(points.shape[0]):
        out[b] = 0
        for c in range(centers.shape[0]):
            squared = 0.0
            for a in range(points.shape[1]):
                squared += (points[b, a] - centers[c, a]) ** 2
            out[b] += radial_basis.phi(kernel, np.sqrt(squared) / radii[c]) != 0.0


@kernel
def radial_matrix(kernel: int, points: F64, centers: F64, radii: F64, out: F64) -> None:
    """Radial functions of centers (C, D) at points (B, D): the system Q of seed 1 §3.1, written to ``out`` (B, C)."""
    for b in range(points.shape[0]):
        for c in range(centers.shape[0]):
            squared = 0.0
            for a in range(points.shape[1]):
                squared += (points[b, a] - centers[c, a]) ** 2
            out[b, c] = radial_basis.phi(kernel, np.sqrt(squared) / radii[c])
