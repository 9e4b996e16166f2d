"""Method ``perdof``: one interpolation problem per degree of freedom, as Verbs and Adverbs did it first.

Source: C. Rose, M. Cohen, B. Bodenheimer, "Verbs and Adverbs: Multidimensional Motion Interpolation", 1998, as Rose,
Sloan, Cohen 2001, section 3.1, recall it: every coefficient of every curve has linear and radial coefficients of its
own, fitted to its values in the examples. The cardinal basis (``rbf``) solves for N right sides instead of one per
coefficient and blends afterwards; both are linear in the examples with the same matrices, so their curves are equal.

It serves to show that, and its cost. Its table is (N + D + 1) / N times the size of the curves, in float64.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from verbs.blend.cardinal import basis_weights
from verbs.conventions import F64
from verbs.kernels import radial_basis
from verbs.verb import Basis, Verb

__all__ = ["Cost", "PerDof", "cost"]


@dataclass(frozen=True, eq=False)
class PerDof:
    """A verb's curves, and the interpolation problem that each of their coefficients is.

    Parameters
    ----------
    verb : Verb
    unit : Basis
        Coefficients of N made-up degrees of freedom, each 1 in its own example and 0 in the others.
    """

    verb: Verb
    unit: Basis

    @classmethod
    def of_verb(cls, verb: Verb) -> PerDof:
        """Solve a verb's unit degrees of freedom; those of its curves are solved at their first use."""
        return cls(verb, _solve(verb.bases["rbf"], np.eye(len(verb.examples))))

    @cached_property
    def table(self) -> Basis:
        """Coefficients (C, M) and (L, M) of all M = (K + 3)·(4 + 4·J) coefficients of the curves."""
        curves = self.verb.curves
        examples = curves.transpose(1, 0, 2).reshape(curves.shape[1], -1).astype(np.float64)
        return _solve(self.verb.bases["rbf"], examples)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D).

        The values of the unit degrees of freedom: by linearity, blending any curve with them gives what its own
        problem gives.
        """
        return basis_weights(self.unit, adverbs)

    def coefficients(self, adverbs: F64) -> F64:
        """Blended curve coefficients (B, K + 3, 4 + 4·J) at adverbs (B, D), each from its own problem."""
        rows, _, width = self.verb.curves.shape
        return basis_weights(self.table, adverbs).reshape(len(adverbs), rows, width)


def _solve(basis: Basis, examples: F64) -> Basis:
    """Linear and radial coefficients of degrees of freedom with values (N, M) in the examples, one column each."""
    poly, radial = _fit(*_matrices(basis), examples)
    return replace(basis, radial=radial, poly=poly)


def _matrices(basis: Basis) -> tuple[F64, F64]:
    """Polynomial features (N, L) and radial values (N, N) of the examples at each other."""
    system = radial_basis.radial_matrix(basis.radial_basis, basis.centers, basis.centers, basis.radii)
    return radial_basis.polynomial_matrix(basis.centers, basis.degree), system


def _fit(powers: F64, system: F64, examples: F64) -> tuple[F64, F64]:
    """Plane first, in the least-squares sense; the radial part takes up what is left (the paper's equations 2 to 4)."""
    poly = np.asarray(np.linalg.lstsq(powers, examples, rcond=None)[0], np.float64)
    return poly, np.asarray(np.linalg.solve(system, examples - powers @ poly), np.float64)


@dataclass(frozen=True, slots=True)
class Cost:
    """Times of both methods of computing the same curves; each the least of several runs.

    Parameters
    ----------
    coefficients : int
        Number M of coefficients of one example's curves.
    solve_s, cardinal_solve_s : float
        Seconds to solve all problems, and the cardinal basis alone, from the same matrices.
    query_us, cardinal_query_us : float
        Microseconds for all coefficients at one point; the cardinal method blends them with its weights. A compact
        radial function leaves the former fewer terms than N, so that it need not be slower: what the cardinal method
        saves is the solving, and all coefficients that a pose has no use for.
    pose_us : float
        Microseconds of the cardinal method for the needs of a single pose: weights and four rows of the curves.
    """

    coefficients: int
    solve_s: float
    cardinal_solve_s: float
    query_us: float
    cardinal_query_us: float
    pose_us: float


def cost(verb: Verb, *, runs: int = 7) -> Cost:
    """Measure the cost of one problem per coefficient against that of the cardinal basis.

    Queries of both methods are plain compiled loops on one thread: matrix libraries would measure their threads.
    """
    basis, at = verb.bases["rbf"], np.ascontiguousarray(verb.values.mean(axis=0, keepdims=True))
    curves = verb.curves.transpose(1, 0, 2).reshape(len(verb.examples), -1).astype(np.float64)
    middle = len(verb.curves) // 2
    few = verb.curves[middle : middle + 4].transpose(1, 0, 2).reshape(len(verb.examples), -1).astype(np.float64)
    method = PerDof.of_verb(verb)
    matrices, unit = _matrices(basis), np.eye(len(curves))
    times = dict.fromkeys(("solve", "cardinal solve", "query", "cardinal query", "pose"), np.inf)
    for _ in range(runs + 1):  # in the first run queries solve the table that they use
        for name, work in (
            ("solve", lambda: _fit(*matrices, curves)),
            ("cardinal solve", lambda: _fit(*matrices, unit)),
            ("query", lambda: method.coefficients(at)),
            ("cardinal query", lambda: np.einsum("bn,nm->bm", basis_weights(basis, at), curves)),
            ("pose", lambda: np.einsum("bn,nm->bm", basis_weights(basis, at), few)),
        ):
            started = time.perf_counter()
            work()
            times[name] = min(times[name], time.perf_counter() - started)
    solve, cardinal_solve, query, cardinal_query, pose = times.values()
    return Cost(curves.shape[1], solve, cardinal_solve, 1e6 * query, 1e6 * cardinal_query, 1e6 * pose)
