"""Method ``search``: evaluate a basis at other adverbs p', found by line searches, whose blend is measured at p.

Source: Rose, Sloan, Cohen 2001, section 4.2. From p, the search follows −(x_e(p) − p), opposite to the error, and takes
the point of least error; it may be iterated from there. On top of a refined basis it is the paper's hybrid (§4.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.blend.cardinal import basis_weights
from verbs.conventions import F64
from verbs.errors import OutOfRange
from verbs.goal import Goal
from verbs.kernels import measure as measures
from verbs.verb import Basis, Verb

__all__ = ["Search"]

REACH = 2.5
"""Greatest length of a search, in lengths of the error."""

SCANNED = 10
"""Steps of the scan over that length; the search proper is between the neighbours of the best of them."""

SECTIONS = 14
"""Golden sections after it: the last bracket is a thousandth of a step of the scan."""

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A basis, and how often to search along its error.

    Parameters
    ----------
    basis : Basis
    goal : Goal
        What the basis is measured by.
    iterations : int
        Line searches; each has a fixed number of evaluations, so that a query takes the same time everywhere.
    """

    basis: Basis
    goal: Goal
    iterations: int

    @classmethod
    def of_verb(cls, verb: Verb, *, basis: str = "rbf", iterations: int = 1) -> Search:
        """Prepare the search on one of a verb's bases; 0 iterations are the basis itself."""
        if iterations < 0:
            raise OutOfRange(f"{iterations} iterations; give 0 or more")
        return cls(verb.bases[basis], Goal.of_verb(verb), iterations)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) of the basis at the sources found for adverbs (B, D)."""
        return basis_weights(self.basis, self.sources(adverbs))

    def sources(self, adverbs: F64) -> F64:
        """Adverbs p' (B, D) at which to evaluate the basis instead of adverbs (B, D); unmeasured ones are unchanged."""
        sources = adverbs.copy()
        if not self.goal.measurable:
            return sources
        for _ in range(self.iterations):
            points = self.goal.measured(basis_weights(self.basis, sources))
            measured = self._coordinates(self.goal.compare(adverbs, points)[0])
            direction = self._coordinates(adverbs[:, self.goal.verb.measure.axes]) - measured
            self._follow(adverbs, sources, direction)
        return sources

    def _follow(self, adverbs: F64, sources: F64, direction: F64) -> None:
        """Move sources (B, D), in place, along a direction (B, m) to where the error is least."""
        axes = self.goal.verb.measure.axes
        start = self._coordinates(sources[:, axes])
        trial = sources.copy()

        def errors(lengths: F64) -> F64:
            trial[:, axes] = self._adverbs(start + lengths[:, None] * direction)
            return self.goal.compare(adverbs, self.goal.measured(basis_weights(self.basis, trial)))[1]

        scan = np.linspace(0.0, REACH, SCANNED + 1)
        table = np.array([errors(np.full(len(sources), length)) for length in scan])
        best = scan[np.argmin(table, axis=0)]
        low, high = np.maximum(best - scan[1], 0.0), np.minimum(best + scan[1], REACH)
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_left, at_right = errors(left), errors(right)
        for _ in range(SECTIONS):
            lower = at_left < at_right
            low, high = np.where(lower, low, left), np.where(lower, right, high)
            fresh = np.where(lower, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
            left, right = np.where(lower, fresh, right), np.where(lower, left, fresh)
            value = errors(fresh)
            at_left, at_right = np.where(lower, value, at_right), np.where(lower, at_left, value)
        middle = 0.5 * (low + high)
        better = errors(middle) < table.min(axis=0)  # a search never ends at a worse point
        sources[:, axes] = self._adverbs(start + np.where(better, middle, best)[:, None] * direction)

    def _coordinates(self, measured: F64) -> F64:
        """Measured adverbs (B, m) as coordinates in which errors are straight: a jump's direction is an angle."""
        if self.goal.verb.measure.kind != measures.JUMP:
            return measured
        distance, direction, height = measured.T
        direction = direction * self.goal.verb.measure.frame[1, 1]
        return np.stack([distance * np.sin(direction), distance * np.cos(direction), height], axis=1)

    def _adverbs(self, coordinates: F64) -> F64:
        """Measured adverbs (B, m) of such coordinates."""
        if self.goal.verb.measure.kind != measures.JUMP:
            return coordinates
        x, z, height = coordinates.T
        return np.stack([np.hypot(x, z), np.arctan2(x, z) / self.goal.verb.measure.frame[1, 1], height], axis=1)
