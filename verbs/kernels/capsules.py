"""Overlap of capsules: line segments with a radius.

Source: C. Ericson, "Real-Time Collision Detection", 2005, section 5.1.9 (closest points of two segments).
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["depths", "segment_distance"]

PARALLEL = 1e-12
"""Squared length, m², below which a segment is a point."""


@kernel
def _dot(a: F64, b: F64) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def segment_distance(p1: F64, q1: F64, p2: F64, q2: F64) -> float:
    """Distance between the segments p1 q1 and p2 q2; the points are (3,)."""
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e, f = _dot(d1, d1), _dot(d2, d2), _dot(d2, r)
    s, t = 0.0, 0.0
    if a > PARALLEL and e <= PARALLEL:
        s = min(max(-_dot(d1, r) / a, 0.0), 1.0)
    elif a <= PARALLEL and e > PARALLEL:
        t = min(max(f / e, 0.0), 1.0)
    elif a > PARALLEL:
        b, c = _dot(d1, d2), _dot(d1, r)
        across = a * e - b * b
        if across > 1e-12 * a * e:
            s = min(max((b * f - c * e) / across, 0.0), 1.0)
        t = (b * s + f) / e
        if t < 0.0:
            t, s = 0.0, min(max(-c / a, 0.0), 1.0)
        elif t > 1.0:
            t, s = 1.0, min(max((b - c) / a, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        gap = r[k] + s * d1[k] - t * d2[k]
        total += gap * gap
    return np.sqrt(total)


@kernel
def depths(ends: F64, radii: F64, pairs: I64, out: F64) -> None:
    """Largest overlap (F,) of any pair of capsules in each frame; negative is the gap of the closest pair.

    Parameters
    ----------
    ends : (F, C, 2, 3) float64
    radii : (C,) float64
    pairs : (P, 2) int64
        Capsules that are compared; P ≥ 1.
    out : (F,) float64
    """
    for frame in range(ends.shape[0]):
        deepest = -np.inf
        for p in range(pairs.shape[0]):
            i, j = pairs[p, 0], pairs[p, 1]
            one, other = ends[frame, i], ends[frame, j]
            gap = segment_distance(one[0], one[1], other[0], other[1])
            deepest = max(deepest, radii[i] + radii[j] - gap)
        out[frame] = deepest
