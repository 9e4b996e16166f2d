"""Blending the nearest of many points that each are a mix of a few examples.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 3 (k nearest neighbours).
"""

from __future__ import annotations

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["blend", "expand"]

COINCIDENT = 1e-12
"""Closer than this (chart units) a point is the neighbour itself."""


@kernel
def expand(members: I64, shares: F64, out: F64) -> None:
    """Weights (P, N) of points that mix examples ``members`` (P, m) with ``shares`` (P, m)."""
    out[:] = 0.0
    for p in range(members.shape[0]):
        for c in range(members.shape[1]):
            out[p, members[p, c]] += shares[p, c]


@kernel
def blend(nearest: I64, distances: F64, members: I64, shares: F64, out: F64) -> None:
    """Weights (B, N) of the blend of neighbours, written to ``out``.

    Neighbour j counts 1/d_j − 1/d_k, normalised: the farthest of the k counts nothing, so that weights
    are continuous where neighbours change. Where all are equally far, all count the same.

    Parameters
    ----------
    nearest : (B, k) int64
        Neighbours by rising distance.
    distances : (B, k) float64
    members : (P, m) int64
        Examples that each neighbour mixes.
    shares : (P, m) float64
    """
    k = nearest.shape[1]
    for b in range(nearest.shape[0]):
        row, far = out[b], distances[b, k - 1]
        row[:] = 0.0
        near = distances[b, 0]
        total = 0.0
        for j in range(k):
            total += near / max(distances[b, j], COINCIDENT) - near / max(far, COINCIDENT)
        for j in range(k):
            share = near / max(distances[b, j], COINCIDENT) - near / max(far, COINCIDENT)
            if near <= COINCIDENT:
                share = 1.0 if j == 0 else 0.0
            elif total < 1e-12:
                share = 1.0 / k
            else:
                share /= total
            if share == 0.0:
                continue
            p = nearest[b, j]
            for c in range(members.shape[1]):
                row[members[p, c]] += share * shares[p, c]
