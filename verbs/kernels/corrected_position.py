"""The hot path in one call: adverbs to corrected weights, what they reach, and the error.

It runs the same kernels as its parts, one after the other; crossing from Python once instead of six times is what
it is for.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import correction, measure, weights
from verbs.kernels.compile import kernel

__all__ = ["corrected_position"]


@kernel
def corrected_position(
    adverbs: F64,
    out: F64,
    measured: F64,
    error: F64,
    moved: F64,
    kind: int,
    bending: I64,
    bend: F64,
    shift: F64,
    scale: F64,
    facets: F64,
    middle: F64,
    sharpness: float,
    basis_kind: int,
    basis_bending: I64,
    basis_bend: F64,
    basis_shift: F64,
    basis_scale: F64,
    radial_kind: int,
    degree: int,
    centers: F64,
    radii: F64,
    radial: F64,
    poly: F64,
    held: F64,
    units: F64,
    rules: F64,
    mode: int,
    roots: F64,
    rows: F64,
    references: F64,
    offsets: F64,
    axes: I64,
    origin: F64,
    frame: F64,
    inverse: F64,
) -> None:
    """Corrected weights (B, N), measured adverbs (B, m), error (B,) and clamped flags (B,) at adverbs (B, D).

    The rest are the arguments of :func:`weights.clamp`, :func:`weights.cardinal`, :func:`correct.correct_positions`
    and :func:`measure.compare`, in their order.
    """
    inside, points = np.empty_like(adverbs), np.empty((adverbs.shape[0], 3))
    weights.clamp(adverbs, kind, bending, bend, shift, scale, facets, middle, sharpness, inside, moved)
    chart = (basis_kind, basis_bending, basis_bend, basis_shift, basis_scale)
    weights.cardinal(inside, *chart, radial_kind, degree, centers, radii, radial, poly, out)
    measure.goals(measure.POSITION, inside, axes, origin, frame, points)
    correction.correct_positions(out, points, held, units, rules, mode, roots, rows, references, offsets)
    correction.reach_positions(out, mode, roots, rows, references, offsets, points)
    measure.compare(measure.POSITION, adverbs, points, axes, origin, frame, inverse, measured, error)
