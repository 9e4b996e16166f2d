"""Easing of arrays; kernels have scalar ones where they need them."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64

__all__ = ["smootherstep"]


def smootherstep(u: F64) -> F64:
    """Quintic from 0 to 1 over [0, 1], of any shape; constant outside, with two derivatives 0 at both ends.

    Source: K. Perlin, "Improving Noise", 2002.
    """
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u * u * u * (10.0 + u * (6.0 * u - 15.0)))
