"""Basis evaluation over few centers: a grid of center lists, and a tree of bounding spheres.

Radial functions of compact support are zero at most centers. Each cell of a grid has the list of the centers whose
support meets it. A query finds its cell and sums over that list, in the order of the centers, so that it differs from
:func:`verbs.kernels.radial_basis.evaluate` by rounding at most. The tree is the recursive clustering that the paper
names for its O(log N); it serves comparison, and methods use the grid.

Source: Rose, Sloan, Cohen 2001, section 4.3 (multiresolution with recursive clustering); ``docs/math.md``,
section "Refinement", has the comparison.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import radial_basis
from verbs.kernels.chart import to_chart
from verbs.kernels.compile import kernel
from verbs.kernels.radial_basis import SUPPORT, BasisArrays

__all__ = ["Grid", "Tree", "active", "cardinal", "cardinal_tree", "cluster", "grid"]

CELLS = {1: 512, 2: 64, 3: 24}
"""Cells to a side of the grid, by the number of axes that it divides."""

MARGIN = 0.15
"""The grid extends this share of its size beyond the centers, as queries do; farther out all centers are tried."""

LEAF = 8
"""Most centers of a leaf of the tree."""

DEPTH = 64


class Grid(NamedTuple):
    """Lists of the centers whose support meets each cell.

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
    """Binary tree of spheres, each of which contains the supports of all centers below it.

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
    counted = Grid(axes, corner, inverse, shape, starts, np.empty(0, np.int64))
    _list(centers, reaches, counted, starts)
    filled = counted._replace(starts=np.cumsum(starts), members=np.empty(int(starts.sum()), np.int64))
    _list(centers, reaches, filled, filled.starts[:-1].copy())
    return filled


@kernel
def _list(centers: F64, reaches: F64, grid: Grid, cursors: I64) -> None:
    """Visit each cell that a center's support meets: count it in ``cursors``, or write it to the grid's ``members``.

    Without members, cells are counted one index higher (``cursors`` is (cells + 1,) then), so that the running sum of
    the counts is where lists start.
    """
    axes, low, inverse, shape, members = grid.axes, grid.low, grid.inverse, grid.shape, grid.members
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
def _gather(point: F64, candidates: I64, centers: F64, radii: F64, found: I64, squares: F64, count: int) -> int:
    """Append the candidates whose support contains a point (D,), and their squared distances; return the new count.

    A millionth more than the support is accepted: the radial function decides there, and gives zero.
    """
    reach = 1.000001 * SUPPORT * SUPPORT
    for m in range(candidates.shape[0]):
        c, squared = candidates[m], 0.0
        for a in range(point.shape[0]):
            squared += (point[a] - centers[c, a]) ** 2
        if squared < reach * radii[c] * radii[c]:
            found[count], squares[count] = c, squared
            count += 1
    return count


@kernel
def _sum(function: int, radii: F64, radial: F64, found: I64, squares: F64, count: int, out: F64) -> None:
    """Add the radial parts of ``count`` centers to ``out`` (N,).

    Distances, functions and sums have a loop each: roots and divisions of several centers then run side by side.
    """
    for k in range(count):
        squares[k] = radial_basis.phi(function, np.sqrt(squares[k]) / radii[found[k]])
    for k in range(count):
        value, c = squares[k], found[k]
        for i in range(out.shape[0]):
            out[i] += value * radial[c, i]


@kernel
def _polynomial(point: F64, degree: int, poly: F64, row: F64, out: F64) -> None:
    """Polynomial part of the weights (N,), in the order of :func:`verbs.kernels.radial_basis.evaluate`."""
    count = radial_basis.features(point, degree, row)
    for i in range(out.shape[0]):
        out[i] = 0.0
    for f in range(count):
        for i in range(out.shape[0]):
            out[i] += row[f] * poly[f, i]


@kernel
def _cell(point: F64, axes: I64, low: F64, inverse: F64, shape: I64) -> int:
    """Cell of a point (D,), or -1 outside the grid; arrays as in :class:`Grid`."""
    cell = 0
    for a in range(axes.shape[0]):
        offset = (point[axes[a]] - low[a]) * inverse[a]
        if not (offset >= 0.0 and offset < shape[a]):
            return -1
        cell = cell * shape[a] + int(offset)
    return cell


@kernel
def cardinal(adverbs: F64, basis: BasisArrays, grid: Grid, out: F64) -> None:
    """Weights (B, N) at adverbs (B, D), as :func:`verbs.kernels.radial_basis.cardinal` by :class:`Grid`."""
    function, degree, centers, radii = basis.radial_basis, basis.degree, basis.centers, basis.radii
    radial, poly, row = basis.radial, basis.poly, np.empty(basis.poly.shape[0])
    axes, low, inverse, shape, starts, members = grid
    found, squares = np.empty(centers.shape[0], np.int64), np.empty(centers.shape[0])
    kind, bent, bend, shift, scale = basis.chart
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        to_chart(kind, bent, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        _polynomial(point, degree, poly, row, out[b])
        cell = _cell(point, axes, low, inverse, shape)
        candidates = members[starts[cell] : starts[cell + 1]] if cell >= 0 else np.arange(centers.shape[0])
        count = _gather(point, candidates, centers, radii, found, squares, 0)
        _sum(function, radii, radial, found, squares, count, out[b])


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
        members = order[begin:end]
        points = centers[members]
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        node = len(middles)
        middles.append(middle)
        bounds.append(float((np.linalg.norm(points - middle, axis=1) + reaches[members]).max()))
        children.append([-1, -1])
        spans.append([begin, end])
        if parent >= 0:
            children[parent][side] = node
        if end - begin > LEAF:
            across = int(np.argmax(np.ptp(points, axis=0)))
            order[begin:end] = members[np.argsort(points[:, across], kind="stable")]
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
def cardinal_tree(points: F64, basis: BasisArrays, tree: Tree, out: F64) -> None:
    """Weights (B, N) at normalised chart points (B, D) by :class:`Tree`; the sum runs in the tree's order."""
    function, degree, centers, radii = basis.radial_basis, basis.degree, basis.centers, basis.radii
    radial, poly, row = basis.radial, basis.poly, np.empty(basis.poly.shape[0])
    middles, reaches, children, spans, order = tree
    found, squares = np.empty(centers.shape[0], np.int64), np.empty(centers.shape[0])
    stack = np.empty(DEPTH, np.int64)
    for b in range(points.shape[0]):
        point = points[b]
        _polynomial(point, degree, poly, row, out[b])
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
            candidates = order[spans[node, 0] : spans[node, 1]]
            count = _gather(point, candidates, centers, radii, found, squares, count)
        _sum(function, radii, radial, found, squares, count, out[b])


@kernel
def active(points: F64, basis: BasisArrays, out: I64) -> None:
    """Number of centers (B,) whose radial function is not zero at normalised chart points (B, D)."""
    values = radial_basis.radial_matrix(basis.radial_basis, points, basis.centers, basis.radii)
    for b in range(points.shape[0]):
        out[b] = 0
        for c in range(values.shape[1]):
            out[b] += values[b, c] != 0.0
