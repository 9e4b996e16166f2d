"""Adverbs to weights, batched: clamp to the domain, then evaluate a cardinal basis.

Source: Rose, Sloan, Cohen 2001, equation 2; the clamp is ``docs/math.md``, section "Domain".
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import chart as charts
from verbs.kernels import radial_basis
from verbs.kernels.chart import DomainArrays
from verbs.kernels.compile import kernel
from verbs.kernels.radial_basis import BasisArrays

__all__ = ["cardinal", "clamp"]


@kernel
def clamp(adverbs: F64, domain: DomainArrays, out: F64, moved: F64) -> None:
    """Adverbs (B, D) moved back to the domain, to ``out`` (B, D); ``moved`` (B,) is 1 where that changed them."""
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        charts.to_point(domain.chart, adverbs[b], point)
        out[b], moved[b] = adverbs[b], 0.0
        if charts.clamp(point, domain):
            moved[b] = 1.0
            charts.from_point(domain.chart, point, out[b])


@kernel
def cardinal(adverbs: F64, basis: BasisArrays, out: F64) -> None:
    """Weights (B, N) of a cardinal basis at adverbs (B, D), written to ``out``."""
    point, row = np.empty(adverbs.shape[1]), np.empty(basis.poly.shape[0])
    for b in range(adverbs.shape[0]):
        charts.to_point(basis.chart, adverbs[b], point)
        radial_basis.evaluate(point, basis, row, out[b])
