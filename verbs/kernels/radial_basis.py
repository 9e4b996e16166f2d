"""Radial basis functions, polynomial features and the evaluation of a cardinal basis.

A basis maps a point of the adverb space to one weight per example:

    w(p) = Σ_c φ(|p − p_c| / h_c) · radial[c] + Σ_l π_l(p) · poly[l]

with centers p_c (the examples first, pseudo-examples after them), radii h_c and polynomial features π_l.

Source: Rose, Sloan, Cohen 2001, equation 2; the radial functions are those of the scattered-data literature
(G. E. Fasshauer, "Meshfree Approximation Methods with MATLAB", 2007, chapters 8 and 11).
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel as compiled

__all__ = [
    "BIHARMONIC",
    "BSPLINE",
    "CUBIC",
    "KERNELS",
    "MULTIQUADRIC",
    "THIN_PLATE",
    "WENDLAND",
    "features",
    "phi",
]

BSPLINE, MULTIQUADRIC, BIHARMONIC, THIN_PLATE, CUBIC, WENDLAND = range(6)

KERNELS = {
    "bspline": BSPLINE,
    "multiquadric": MULTIQUADRIC,
    "biharmonic": BIHARMONIC,
    "thin_plate": THIN_PLATE,
    "cubic": CUBIC,
    "wendland": WENDLAND,
}
"""Kernel numbers as the artifact stores them; never renumber."""


@compiled
def phi(kernel: int, r: float) -> float:  # noqa: PLR0911 - one line per function reads best
    """Radial function at scaled distance r = d/h ≥ 0.

    ``bspline`` has support 2 and the value 2/3 at 0, as in seed 1 §3.1; ``wendland`` (C², positive definite to
    three dimensions) has support 2 as well, so that both share one meaning of the radius.
    """
    if kernel == BSPLINE:
        if r >= 2.0:
            return 0.0
        if r >= 1.0:
            return (2.0 - r) ** 3 / 6.0
        return 2.0 / 3.0 - r * r + 0.5 * r * r * r
    if kernel == MULTIQUADRIC:
        return -np.sqrt(r * r + 1.0)
    if kernel == BIHARMONIC:
        return -r
    if kernel == THIN_PLATE:
        return r * r * np.log(r) if r > 0.0 else 0.0
    if kernel == CUBIC:
        return r * r * r
    half = 0.5 * r
    return (1.0 - half) ** 4 * (4.0 * half + 1.0) if half < 1.0 else 0.0


@compiled
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


@compiled
def evaluate(
    point: F64, kernel: int, degree: int, centers: F64, radii: F64, radial: F64, poly: F64, row: F64, out: F64
) -> None:
    """Weights (N,) at one ``point`` (D,), written to ``out``.

    Parameters
    ----------
    point : (D,) float64
        Normalised chart coordinates.
    kernel, degree : int
        Number of the radial function; degree of the polynomial part.
    centers : (C, D) float64
    radii : (C,) float64
        Scale h_c of each center's radial function.
    radial : (C, N) float64
    poly : (L, N) float64
    row : (L,) float64
        Scratch.
    out : (N,) float64
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
        value = phi(kernel, np.sqrt(squared) / radii[c])
        if value != 0.0:
            for i in range(out.shape[0]):
                out[i] += value * radial[c, i]
