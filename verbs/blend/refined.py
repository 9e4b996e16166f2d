"""Method ``refined``: the cardinal basis after refinement; and the hybrid of it and a line search.

A verb without pseudo-examples has a refinement with none of them: its basis ``rbf``. A client may request either
method before and after a refinement.

Source: Rose, Sloan, Cohen 2001, sections 4.2 and 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.blend.cardinal import basis_weights
from verbs.blend.search import Search
from verbs.conventions import F64
from verbs.goal import Goal
from verbs.kernels import center_lists as kernels
from verbs.kernels.compile import direct
from verbs.kernels.radial_basis import COMPACT
from verbs.verb import Basis, Verb

__all__ = ["CROSSOVER", "Hybrid", "Refined"]

_cardinal = direct(kernels.cardinal)

CROSSOVER = 40
"""Centers from which on lists are faster than trying all; measured by ``python -m benchmarks.lists``."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined basis: exact at the examples, and nearly so in between, by weights that one sum gives.

    Parameters
    ----------
    basis : Basis
    lists : Grid or None
        Lists of centers; None where there are so few that trying all is faster.
    """

    basis: Basis
    lists: kernels.Grid | None

    @classmethod
    def of_verb(cls, verb: Verb) -> Refined:
        """Take the basis ``refined`` of a verb, or ``rbf`` where it has no pseudo-examples."""
        if "refined" in verb.bases:
            return cls.of_basis(verb.bases["refined"])
        return cls(verb.bases["rbf"], None)  # no lists: the weights of the method ``rbf`` to the bit

    @classmethod
    def of_basis(cls, basis: Basis) -> Refined:
        """Prepare any basis."""
        listed = len(basis.centers) >= CROSSOVER and basis.radial_basis in COMPACT
        return cls(basis, kernels.grid(basis.centers, basis.radii) if listed else None)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D) inside the domain; those of the basis."""
        basis, lists = self.basis, self.lists
        if lists is None:
            return basis_weights(basis, adverbs)
        out = np.empty((len(adverbs), basis.radial.shape[1]))
        _cardinal(np.ascontiguousarray(adverbs, np.float64), basis.arrays, lists, out)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Hybrid:
    """A refined basis evaluated where a line search leads: the remaining errors are small, and smooth enough for it.

    Parameters
    ----------
    refined : Refined
    search : Search
    """

    refined: Refined
    search: Search

    @classmethod
    def of_verb(cls, verb: Verb, *, iterations: int = 1) -> Hybrid:
        """Search on a verb's basis ``refined``, or on ``rbf`` where it has no pseudo-examples."""
        refined = Refined.of_verb(verb)
        return cls(refined, Search(refined.basis, Goal.of_verb(verb), iterations))

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at the sources found for adverbs (B, D)."""
        return self.refined.weights(self.search.sources(adverbs))
