"""Adverbs to weights, batched: clamp to the domain, then evaluate a cardinal basis.

Source: Rose, Sloan, Cohen 2001, equation 2; the clamp is ``docs/math.md``, section "Domain".
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import chart as charts
from verbs.kernels import radial_basis
from verbs.kernels.compile import kernel

__all__ = ["cardinal", "clamp"]


@kernel
def clamp(
    adverbs: F64,
    kind: int,
    axes: I64,
    bend: F64,
    shift: F64,
    scale: F64,
    facets: F64,
    middle: F64,
    sharpness: float,
    out: F64,
    moved: F64,
) -> None:
    """Adverbs (B, D) drawn to the domain, written to ``out`` (B, D); ``moved`` (B,) is 1 where that changed them."""
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        charts.to_chart(kind, axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        out[b], moved[b] = adverbs[b], 0.0
        if charts.clamp(point, facets, middle, sharpness):
            moved[b] = 1.0
            for a in range(point.shape[0]):
                point[a] = point[a] / scale[a] + shift[a]
            charts.from_chart(kind, axes, bend, point, out[b])


@kernel
def cardinal(
    adverbs: F64,
    kind: int,
    axes: I64,
    bend: F64,
    shift: F64,
    scale: F64,
    kernel: int,
    degree: int,
    centers: F64,
    radii: F64,
    radial: F64,
    poly: F64,
    out: F64,
) -> None:
    """Weights (B, N) of a cardinal basis at adverbs (B, D), written to ``out``; arrays as in :class:`verbs.Basis`."""
    point, row = np.empty(adverbs.shape[1]), np.empty(poly.shape[0])
    for b in range(adverbs.shape[0]):
        charts.to_chart(kind, axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        radial_basis.evaluate(point, kernel, degree, centers, radii, radial, poly, row, out[b])
