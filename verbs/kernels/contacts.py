"""Contact of blends: values of the examples over canonical time, summed with the weights."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F32, F64
from verbs.kernels.compile import kernel

__all__ = ["IN_PLACE_M", "contact", "gradient", "heights"]

IN_PLACE_M = 0.05
"""A cycle that travels less than this has no direction in which its ground could rise, metres."""


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
    """Height (B, P) of standing points of blends above their ground: Σ wᵢ of those of the examples (N, P), metres."""
    for b in range(weights.shape[0]):
        for p in range(examples.shape[1]):
            total = 0.0
            for i in range(weights.shape[1]):
                total += weights[b, i] * examples[i, p]
            out[b, p] = total


@kernel
def gradient(weights: F64, strides: F64, out: F64) -> None:
    """Gradient (B, 2) of the ground of blends: its rise per metre to the side and per metre ahead.

    The rise of a cycle over its displacement, in the frame of the heading; zero where a cycle stays in place. At a
    character whose ground has the height y below its root, the ground is a plane: a point that lies d (2,) beside and
    before the root is over ground of the height y + gradient · d.

    Parameters
    ----------
    weights : (B, N) float64
    strides : (K, N, 4) float64
        Steps of the examples, see :func:`verbs.kernels.pose.stride_to`.
    out : (B, 2) float64
        Written.
    """
    for b in range(weights.shape[0]):
        across, ahead, rise = 0.0, 0.0, 0.0
        for k in range(strides.shape[0]):
            for i in range(weights.shape[1]):
                across += weights[b, i] * strides[k, i, 0]
                ahead += weights[b, i] * strides[k, i, 1]
                rise += weights[b, i] * strides[k, i, 3]
        square = across * across + ahead * ahead
        steep = rise / square if square > IN_PLACE_M * IN_PLACE_M else 0.0
        out[b, 0], out[b, 1] = steep * across, steep * ahead
