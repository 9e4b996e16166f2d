"""Support of a blend by its examples, from the kriging variance of the blend's weights.

    V(u) = 2 Σ_i w_i γ(|u − u_i|) − Σ_ij w_i w_j γ(|u_i − u_j|),   γ(r) = √(1 + (r/h)²) − 1
    support = 1 / (1 + V / V₀)

u is the goal and u_i are the examples, in normalised chart coordinates. V is not negative for weights that sum to 1,
since −γ is conditionally positive definite of order 1.

Source: the error variance of a linear predictor under a semivariogram γ, N. Cressie, "Statistics for Spatial Data",
1993, section 3.2; with the weights of the basis it is the squared power function of H. Wendland, "Scattered Data
Approximation", 2005, section 11.1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.chart import ChartArrays, to_chart
from verbs.kernels.compile import kernel

__all__ = ["SupportArrays", "support", "variogram"]


class SupportArrays(NamedTuple):
    """What support needs of a verb.

    Parameters
    ----------
    chart : ChartArrays
    centers : (N, D) float64
        Examples in normalised chart coordinates.
    radius : float
        h of the variogram.
    between : (N, N) float64
        Variogram between the examples: symmetric, 0 on the diagonal.
    half : float
        V₀, the variance at which support is one half.
    """

    chart: ChartArrays
    centers: F64
    radius: float
    between: F64
    half: float


@kernel
def variogram(squared: float, radius: float) -> float:
    """Multiquadric variogram γ of a squared distance."""
    return np.sqrt(1.0 + squared / (radius * radius)) - 1.0


@kernel
def support(adverbs: F64, weights: F64, arrays: SupportArrays, out: F64) -> None:
    """Support (B,) of weights (B, N) at goals (B, D), which are adverbs, inside the domain or not."""
    kind, axes, bend, shift, scale = arrays.chart
    centers, radius, between, half = arrays.centers, arrays.radius, arrays.between, arrays.half
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        to_chart(kind, axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        variance = 0.0
        for i in range(centers.shape[0]):
            own = weights[b, i]
            if own == 0.0:
                continue
            squared = 0.0
            for a in range(point.shape[0]):
                squared += (point[a] - centers[i, a]) ** 2
            mixed = 0.0
            for j in range(i):
                mixed += weights[b, j] * between[i, j]
            variance += 2.0 * own * (variogram(squared, radius) - mixed)
        out[b] = half / (half + max(variance, 0.0))
