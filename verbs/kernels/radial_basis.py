"""Radial basis functions, polynomial features and the evaluation of a cardinal basis.

A basis maps a point of the adverb space to one weight per example:

    w(p) = Σ_c φ(|p − p_c| / h_c) · radial[c] + Σ_l π_l(p) · poly[l]

with centers p_c (the examples first, pseudo-examples after them), radii h_c and polynomial features π_l.

Source: Rose, Sloan, Cohen 2001, equation 2; the radial functions are those of the scattered-data literature
(G. E. Fasshauer, "Meshfree Approximation Methods with MATLAB", 2007, chapters 8 and 11).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels import columns
from verbs.kernels.chart import ChartArrays, chart_columns, to_chart
from verbs.kernels.compile import kernel

__all__ = [
    "BIHARMONIC",
    "BSPLINE",
    "COMPACT",
    "CUBIC",
    "MULTIQUADRIC",
    "RADIAL_BASES",
    "SUPPORT",
    "THIN_PLATE",
    "WENDLAND",
    "BasisArrays",
    "cardinal",
    "cardinal_batch",
    "evaluate",
    "evaluate_at",
    "feature_columns",
    "features",
    "phi",
    "polynomial_matrix",
    "radial_matrix",
]

BSPLINE, MULTIQUADRIC, BIHARMONIC, THIN_PLATE, CUBIC, WENDLAND = range(6)

RADIAL_BASES = {
    "bspline": BSPLINE,
    "multiquadric": MULTIQUADRIC,
    "biharmonic": BIHARMONIC,
    "thin_plate": THIN_PLATE,
    "cubic": CUBIC,
    "wendland": WENDLAND,
}
"""Numbers of the radial functions as the artifact stores them; never renumber."""

COMPACT = frozenset({BSPLINE, WENDLAND})
"""Radial functions that are zero beyond :data:`SUPPORT` radii; the others are zero nowhere."""

SUPPORT = 2.0


class BasisArrays(NamedTuple):
    """A cardinal basis's arrays; see :class:`verbs.verb.Basis`.

    Parameters
    ----------
    chart : ChartArrays
    radial_basis, degree : int
        Number of the radial function; degree of the polynomial part.
    centers : (C, D) float64
    radii : (C,) float64
        Scale h_c of each center's radial function.
    radial : (C, N) float64
    poly : (L, N) float64
    """

    chart: ChartArrays
    radial_basis: int
    degree: int
    centers: F64
    radii: F64
    radial: F64
    poly: F64


@kernel
def _bspline(r: float) -> float:
    """Cubic B-spline, as in Rose, Sloan, Cohen 2001, section 3.1: support 2, and 2/3 at 0."""
    if r >= 2.0:
        return 0.0
    if r >= 1.0:
        return (2.0 - r) ** 3 / 6.0
    return 2.0 / 3.0 - r * r + 0.5 * r * r * r


@kernel
def _thin_plate(r: float) -> float:
    return r * r * np.log(r) if r > 0.0 else 0.0


@kernel
def _wendland(r: float) -> float:
    """Wendland's C² function, positive definite to three dimensions, stretched to the support 2 of the B-spline."""
    half = 0.5 * r
    return (1.0 - half) ** 4 * (4.0 * half + 1.0) if half < 1.0 else 0.0


@kernel
def phi(radial_basis: int, r: float) -> float:
    """Radial function of a number in :data:`RADIAL_BASES` at scaled distance r = d/h ≥ 0."""
    if radial_basis == BSPLINE:
        value = _bspline(r)
    elif radial_basis == MULTIQUADRIC:
        value = -np.sqrt(r * r + 1.0)
    elif radial_basis == BIHARMONIC:
        value = -r
    elif radial_basis == THIN_PLATE:
        value = _thin_plate(r)
    elif radial_basis == CUBIC:
        value = r * r * r
    else:
        value = _wendland(r)
    return value


@kernel
def radial_matrix(radial_basis: int, points: F64, centers: F64, radii: F64) -> F64:
    """Radial functions (B, C) of centers (C, D), each scaled by its radius (C,), at points (B, D).

    At the centers themselves this is the matrix Q of Rose, Sloan, Cohen 2001, section 3.1.
    """
    out = np.empty((points.shape[0], centers.shape[0]))
    for b in range(points.shape[0]):
        for c in range(centers.shape[0]):
            squared = 0.0
            for a in range(points.shape[1]):
                squared += (points[b, a] - centers[c, a]) ** 2
            out[b, c] = phi(radial_basis, np.sqrt(squared) / radii[c])
    return out


@kernel
def features(point: F64, degree: int, out: F64) -> int:
    """Write the monomials of ``point`` (D,) up to ``degree`` (0, 1 or 2) into ``out``; return how many.

    Order: the coordinates (degree ≥ 1), then the products x_a·x_b with a ≤ b (degree 2), the constant last.
    """
    dims = point.shape[0]
    count = 0
    if degree >= 1:
        for a in range(dims):
            out[count] = point[a]
            count += 1
    if degree >= 2:
        for a in range(dims):
            for b in range(a, dims):
                out[count] = point[a] * point[b]
                count += 1
    out[count] = 1.0
    return count + 1


@kernel
def polynomial_matrix(points: F64, degree: int) -> F64:
    """Polynomial features (B, L) of points (B, D), in the order of :func:`features`."""
    row = np.empty(1 + points.shape[1] * (points.shape[1] + 3) // 2)
    out = np.empty((points.shape[0], row.shape[0]))
    count = 1
    for b in range(points.shape[0]):
        count = features(points[b], degree, row)
        out[b] = row
    return out[:, :count].copy()


@kernel
def evaluate(points: F64, basis: BasisArrays, out: F64) -> None:
    """Weights (B, N) of a basis at points (B, D) in normalised chart coordinates, written to ``out``."""
    function, degree, centers, radii = basis.radial_basis, basis.degree, basis.centers, basis.radii
    radial, poly, row = basis.radial, basis.poly, np.empty(basis.poly.shape[0])
    for b in range(points.shape[0]):
        evaluate_at(points[b], function, degree, centers, radii, radial, poly, row, out[b])


@kernel
def evaluate_at(
    point: F64, function: int, degree: int, centers: F64, radii: F64, radial: F64, poly: F64, row: F64, out: F64
) -> None:
    """Weights (N,) at one point (D,); arrays as in :class:`BasisArrays`, ``row`` (L,) is scratch.

    Here arrays come one by one: to pass a bundle costs two atomic operations for each array in it, for every point.
    """
    count = features(point, degree, row)
    for i in range(out.shape[0]):
        out[i] = 0.0
    for f in range(count):
        for i in range(out.shape[0]):
            out[i] += row[f] * poly[f, i]
    for c in range(centers.shape[0]):
        squared = 0.0
        for a in range(point.shape[0]):
            squared += (point[a] - centers[c, a]) ** 2
        value = phi(function, np.sqrt(squared) / radii[c])
        if value != 0.0:
            for i in range(out.shape[0]):
                out[i] += value * radial[c, i]


@kernel
def cardinal(adverbs: F64, basis: BasisArrays, out: F64) -> None:
    """Weights (B, N) of a basis at adverbs (B, D), written to ``out``; normalises and evaluates row by row."""
    kind, axes, bend, shift, scale = basis.chart
    function, degree, centers, radii = basis.radial_basis, basis.degree, basis.centers, basis.radii
    radial, poly, row = basis.radial, basis.poly, np.empty(basis.poly.shape[0])
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        to_chart(kind, axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        evaluate_at(point, function, degree, centers, radii, radial, poly, row, out[b])


@kernel
def _distances(points: F64, center: F64, radius: float, out: F64, row: int) -> None:
    """Squared distances of points (D, T) from a center (D,), in radii, to one row."""
    per_square = 1.0 / (radius * radius)
    if points.shape[0] == 3:
        a, b, c = center[0], center[1], center[2]
        for k in range(points.shape[1]):
            x, y, z = points[0, k] - a, points[1, k] - b, points[2, k] - c
            out[row, k] = per_square * (x * x + y * y + z * z)
        return
    for k in range(points.shape[1]):
        out[row, k] = 0.0
    for a in range(points.shape[0]):
        middle = center[a]
        for k in range(points.shape[1]):
            out[row, k] += (points[a, k] - middle) ** 2
    for k in range(points.shape[1]):
        out[row, k] *= per_square


@kernel
def _radials(function: int, out: F64, row: int) -> None:
    """Radial functions of squared distances, in place, for one row."""
    if function == MULTIQUADRIC:  # the only one of correction; this loop vectorises
        for k in range(out.shape[1]):
            out[row, k] = -np.sqrt(out[row, k] + 1.0)
    else:
        for k in range(out.shape[1]):
            out[row, k] = phi(function, np.sqrt(out[row, k]))


@kernel
def feature_columns(points: F64, basis: BasisArrays, out: F64) -> None:
    """Radial functions and polynomial features (C + L, T) at points (D, T); these times [radial; poly] are weights."""
    function, degree, centers, radii = basis.radial_basis, basis.degree, basis.centers, basis.radii
    row = centers.shape[0]
    for c in range(row):
        _distances(points, centers[c], radii[c], out, c)
        _radials(function, out, c)
    if degree >= 1:
        for a in range(points.shape[0]):
            out[row] = points[a]
            row += 1
    if degree >= 2:
        for a in range(points.shape[0]):
            for b in range(a, points.shape[0]):
                out[row] = points[a] * points[b]
                row += 1
    out[row] = 1.0


@kernel
def cardinal_batch(adverbs: F64, basis: BasisArrays, out: F64) -> None:
    """:func:`cardinal` by tiles: one matrix product of features and coefficients each."""
    count, width = columns.tiles(adverbs.shape[0])
    coefficients = np.concatenate((basis.radial, basis.poly))
    rows, points = np.empty((adverbs.shape[1], width)), np.empty((adverbs.shape[1], width))
    known, scratch = np.empty((coefficients.shape[0], width)), np.empty((width, out.shape[1]))
    for t in range(count):
        chart_columns(adverbs, t * width, False, basis.chart, rows, points)
        feature_columns(points, basis, known)
        columns.product(known, coefficients, scratch, t * width, out)
