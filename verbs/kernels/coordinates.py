"""Adverbs to normalised chart coordinates, and back, batched: where distances between adverbs are taken."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import chart as charts
from verbs.kernels.compile import kernel

__all__ = ["denormalise", "normalise"]


@kernel
def normalise(adverbs: F64, kind: int, axes: I64, bend: F64, shift: F64, scale: F64, out: F64) -> None:
    """Normalised coordinates of adverbs (B, D), written to ``out`` (B, D); the chart's fields as in ``verbs.Chart``."""
    for b in range(adverbs.shape[0]):
        charts.to_chart(kind, axes, bend, adverbs[b], out[b])
        for a in range(adverbs.shape[1]):
            out[b, a] = (out[b, a] - shift[a]) * scale[a]


@kernel
def denormalise(points: F64, kind: int, axes: I64, bend: F64, shift: F64, scale: F64, out: F64) -> None:
    """Adverbs of normalised coordinates (B, D), written to ``out`` (B, D): the inverse of :func:`normalise`."""
    bent = np.empty(points.shape[1])
    for b in range(points.shape[0]):
        for a in range(points.shape[1]):
            bent[a] = points[b, a] / scale[a] + shift[a]
        charts.from_chart(kind, axes, bend, bent, out[b])
