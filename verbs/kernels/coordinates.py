"""Adverbs to normalised chart coordinates, batched: where distances between adverbs are taken."""

from __future__ import annotations

from verbs.conventions import F64, I64
from verbs.kernels import chart as charts
from verbs.kernels.compile import kernel

__all__ = ["normalise"]


@kernel
def normalise(adverbs: F64, kind: int, axes: I64, bend: F64, shift: F64, scale: F64, out: F64) -> None:
    """Normalised coordinates of adverbs (B, D), written to ``out`` (B, D); the chart's fields as in ``verbs.Chart``."""
    for b in range(adverbs.shape[0]):
        charts.to_chart(kind, axes, bend, adverbs[b], out[b])
        for a in range(adverbs.shape[1]):
            out[b, a] = (out[b, a] - shift[a]) * scale[a]
