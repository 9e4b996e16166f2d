"""Method ``rbf``: the cardinal basis of Rose, Sloan, Cohen 2001, section 3.1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import radial_basis
from verbs.kernels.compile import direct
from verbs.verb import Basis, Verb

__all__ = ["Rbf", "basis_weights"]

_cardinal = direct(radial_basis.cardinal)


def basis_weights(basis: Basis, adverbs: F64) -> F64:
    """Weights (B, N) of a basis at adverbs (B, D) inside the domain."""
    out = np.empty((len(adverbs), basis.radial.shape[1]))
    _cardinal(np.ascontiguousarray(adverbs, np.float64), basis.arrays, out)
    return out


@dataclass(frozen=True, slots=True)
class Rbf:
    """The cardinal basis alone: exact at the examples, smooth, and inexact in between."""

    basis: Basis

    @classmethod
    def of_verb(cls, verb: Verb) -> Rbf:
        """Take the basis ``rbf`` of a verb."""
        return cls(verb.bases["rbf"])

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D) inside the domain."""
        return basis_weights(self.basis, adverbs)
