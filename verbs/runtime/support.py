"""How well a verb's examples support an answer, 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import support as kernels
from verbs.kernels.compile import direct
from verbs.verb import Verb

__all__ = ["RADIUS_SHARE", "Support"]

RADIUS_SHARE = 0.2
"""The variogram's h in median nearest-neighbour distances: the c of the smooth basis."""

_support = direct(kernels.support)


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Support of blends by the examples of one verb.

    Support is 1 at an example. It is one half where the answer is as uncertain as an example predicted from all
    others, in the median over the examples. Distance from the examples, extrapolation and weights that cancel each
    other lower it. Pseudo-examples do not count: they add no motion.

    Parameters
    ----------
    arrays : SupportArrays
    """

    arrays: kernels.SupportArrays

    @classmethod
    def of_verb(cls, verb: Verb) -> Support:
        """Prepare a verb's examples, in the chart of its domain."""
        chart = verb.domain.chart
        points = chart.points(verb.values)
        squared = np.zeros((len(points), len(points)))
        for column in points.T:
            squared += (column[:, None] - column) ** 2
        nearest = np.sqrt(np.where(np.eye(len(points), dtype=bool), np.inf, squared).min(axis=1))
        radius = RADIUS_SHARE * float(np.median(nearest))
        between = np.sqrt(1.0 + squared / radius**2) - 1.0
        return cls(kernels.SupportArrays(chart.arrays, points, radius, between, _left_out(between)))

    def of(self, adverbs: F64, weights: F64) -> F64:
        """Support (B,) of weights (B, N) at goals (B, D).

        Parameters
        ----------
        adverbs : (B, D) float64, C-contiguous
            As requested, in their units: not clamped.
        weights : (B, N) float64, C-contiguous
            Of any method; each row sums to 1.
        """
        out = np.empty(len(weights))
        _support(adverbs, weights, self.arrays, out)
        return out


def _left_out(between: F64) -> float:
    """Median over the examples of the kriging variance at each one, predicted from the others.

    It is 1 / B_ii, B the inverse of the ordinary kriging system of all examples: O. Dubrule, "Cross validation of
    kriging in a unique neighborhood", Mathematical Geology 15, 1983.
    """
    count = len(between)
    system = np.ones((count + 1, count + 1))
    system[:count, :count], system[count, count] = -between, 0.0
    return float(np.median(1.0 / np.diag(np.linalg.inv(system))[:count]))
