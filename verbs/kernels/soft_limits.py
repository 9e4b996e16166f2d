"""Bounds of a number without a corner."""

from __future__ import annotations

from verbs.kernels.compile import kernel

__all__ = ["above_zero", "limited"]


@kernel
def above_zero(value: float, soft: float) -> float:
    """max(0, value), smooth within ``soft``, and 0 below."""
    if value <= -soft:
        return 0.0
    if value >= soft:
        return value
    return (value + soft) * (value + soft) / (4.0 * soft)


@kernel
def limited(value: float, most: float) -> float:
    """A number of magnitude below ``most``: unchanged up to a half of it, and smooth."""
    size, half = abs(value), 0.5 * most
    if size <= half:
        return value
    size = most - half * half / size  # the same value and slope at one half
    return size if value > 0.0 else -size
