"""Method ``knn``: the nearest of many pseudo-examples, each at the adverbs that it is measured at.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 3; the pseudo-examples, mixes of neighbouring examples with some
weights a little below 0, follow Kovar, Gleicher 2004, "Automated Extraction and Parameterization of Motions in Large
Data Sets", section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from verbs.conventions import F64, I64
from verbs.goal import Goal
from verbs.kernels import neighbours as kernels
from verbs.verb import Chart, Verb

__all__ = ["Knn"]

NEIGHBOURHOOD = 6
"""Examples that one pseudo-example mixes."""

OVERSHOOT = 1.0
"""About every other mix is stretched away from its neighbourhood's mean by up to this share."""

_CHUNK = 512


@dataclass(frozen=True, slots=True, eq=False)
class Knn:
    """Pseudo-examples in a k-d tree.

    Parameters
    ----------
    chart : Chart
        The domain's: distances are taken in its normalised coordinates.
    examples : int
        Number N of examples.
    k : int
        Neighbours that count; the last of them by 0.
    tree : cKDTree
        Positions of the P pseudo-examples; the examples themselves are the first of them.
    members : (P, m) int64
        Examples that each mixes.
    shares : (P, m) float64
        Their weights, summing to 1; at least -overshoot/m.
    """

    chart: Chart
    examples: int
    k: int
    tree: cKDTree
    members: I64
    shares: F64

    @classmethod
    def of_verb(cls, verb: Verb, *, count: int = 10_000, k: int = 6, seed: int = 0) -> Knn:
        """Draw and measure a verb's pseudo-examples.

        Parameters
        ----------
        verb : Verb
        count : int
            Pseudo-examples, the examples included; there are never fewer than examples.
        k : int
            Neighbours; 2 or more, as the last one counts nothing.
        seed : int
            Of the random mixes.
        """
        chart, examples = verb.domain.chart, len(verb.examples)
        points = chart.points(verb.values)
        members, shares = _mixes(points, max(count - examples, 0), np.random.default_rng(seed))
        alone = np.repeat(np.arange(examples)[:, None], members.shape[1], axis=1)
        members = np.concatenate([alone, members])
        shares = np.concatenate([np.eye(1, members.shape[1]).repeat(examples, axis=0), shares])
        positions = np.concatenate([points, chart.points(_measured(verb, members[examples:], shares[examples:]))])
        return cls(chart, examples, min(max(k, 2), len(positions)), cKDTree(positions), members, shares)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D); at those of a pseudo-example, its own weights."""
        distances, nearest = self.tree.query(self.chart.points(adverbs), k=self.k)
        out = np.empty((len(adverbs), self.examples))
        kernels.blend(np.asarray(nearest, np.int64), distances, self.members, self.shares, out)
        return out


def _mixes(points: F64, count: int, rng: np.random.Generator) -> tuple[I64, F64]:
    """Random mixes: the examples (count, m) that take part, and their shares (count, m), summing to 1.

    A mix takes the examples nearest to a random point of their bounding box. Neighbourhoods of the examples
    themselves leave the wide gaps between them empty: the error then doubles on locomotion and jump.
    """
    size = min(NEIGHBOURHOOD, len(points))
    positions = rng.uniform(points.min(axis=0), points.max(axis=0), (count, points.shape[1]))
    members = np.asarray(cKDTree(points).query(positions, k=size)[1], np.int64).reshape(count, size)
    shares = rng.dirichlet(np.ones(size), count)
    stretch = 1.0 + OVERSHOOT * rng.uniform(size=count) * (rng.uniform(size=count) < 0.5)
    return members, 1.0 / size + stretch[:, None] * (shares - 1.0 / size)


def _measured(verb: Verb, members: I64, shares: F64) -> F64:
    """Adverbs (P, D) of mixes: measured where they can be, otherwise the mean of the examples' values."""
    adverbs: F64 = np.einsum("pm,pmd->pd", shares, verb.values[members])
    goal = Goal.of_verb(verb)
    if not goal.measurable:
        return adverbs
    weights = np.empty((_CHUNK, len(verb.examples)))
    for start in range(0, len(members), _CHUNK):
        part = slice(start, start + _CHUNK)
        rows = weights[: len(members[part])]
        kernels.expand(members[part], shares[part], rows)
        adverbs[part, verb.measure.axes] = goal.compare(adverbs[part], goal.measured(rows))[0]
    return adverbs
