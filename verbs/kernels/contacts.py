"""Contact of blends: values of the examples over canonical time, summed with the weights."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F32, F64
from verbs.kernels.compile import kernel

__all__ = ["contact", "heights"]


@kernel
def contact(weights: F64, phases: F64, values: F32, looping: bool, out: F64) -> None:
    """Contact (B, P) of blends: min(1, max(0, Σ wᵢ cᵢ(phase))), linear between samples.

    Parameters
    ----------
    weights : (B, N) float64
        May be negative.
    phases : (B,) float64
        Canonical time; of a loop also beyond 1. Outside, the value at the nearest end.
    values : (K + 1, N, P) float32
        Contact cᵢ of the examples, 0 to 1.
    looping : bool
    out : (B, P) float64
    """
    intervals = values.shape[0] - 1
    for b in range(weights.shape[0]):
        x = phases[b] - np.floor(phases[b]) if looping else min(max(phases[b], 0.0), 1.0)
        x *= intervals
        k = min(int(x), intervals - 1)
        u = x - k
        for p in range(values.shape[2]):
            total = 0.0
            for i in range(weights.shape[1]):
                total += weights[b, i] * ((1.0 - u) * values[k, i, p] + u * values[k + 1, i, p])
            out[b, p] = min(max(total, 0.0), 1.0)


@kernel
def heights(weights: F64, examples: F64, out: F64) -> None:
    """Height (B, P) of standing points of blends: Σ wᵢ of those of the examples (N, P), metres."""
    for b in range(weights.shape[0]):
        for p in range(examples.shape[1]):
            total = 0.0
            for i in range(weights.shape[1]):
                total += weights[b, i] * examples[i, p]
            out[b, p] = total
