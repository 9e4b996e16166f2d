"""Method ``corrected``: smooth weights, then a fixed form of correction until the goal is met. Exact and smooth.

Source: ``docs/math.md``, section "Corrected blending".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from verbs.blend.cardinal import basis_weights
from verbs.conventions import F64
from verbs.goal import Goal
from verbs.kernels import correction as kernels
from verbs.kernels import measure as measures
from verbs.verb import Basis, Verb

__all__ = ["SATURATION", "STEPS", "Corrected"]

SATURATION = 0.15
"""Longest step's residual, as a share of the greatest distance between two examples' goals."""

STEPS = 8
"""Most steps; six are enough everywhere we looked, the others are margin that costs nothing where it is not used."""

STOP = 1e-10
"""Residual (m, or ranges) at which correcting ends, far below what anybody can see."""

DAMPING_M2 = 1e-6
DAMPING_RANGES = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """Smooth basis and correction of one verb.

    Parameters
    ----------
    basis : Basis
        Smooth weights to start from.
    goal : Goal
    held : (S, N) float64
        Orthonormal directions that the correction leaves alone: the sum of weights and each style adverb.
    scale : (3,) float64
    rules : (4,) float64
        See :func:`verbs.kernels.correction.step`.
    """

    basis: Basis
    goal: Goal
    held: F64
    scale: F64
    rules: F64

    @classmethod
    def of_verb(cls, verb: Verb, *, basis: str = "smooth", steps: int = STEPS) -> Corrected:
        """Prepare a verb's correction on top of one of its bases."""
        goal = Goal.of_verb(verb)
        style = [k for k in range(len(verb.adverbs)) if k not in verb.measure.axes]
        fixed = np.concatenate([np.ones((len(verb.examples), 1)), verb.values[:, style]], axis=1)
        held = np.ascontiguousarray(np.linalg.qr(fixed)[0].T)
        points = goal.points(verb.values)
        span = points.max(axis=0) - points.min(axis=0)
        if verb.measure.kind == measures.VELOCITY:
            scale, damping = 1.0 / np.where(span > 0, span, 1.0), DAMPING_RANGES
        else:
            scale, damping = np.ones(3), DAMPING_M2
        # The farthest pair, not the bounding box: turning the whole verb must change nothing.
        size = float(pdist(scale * points).max())
        rules = np.array([SATURATION * size, damping, STOP, steps])
        return cls(verb.bases[basis], goal, held, scale, rules)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D) inside the domain."""
        weights = basis_weights(self.basis, adverbs)
        self.correct(weights, self.goal.points(adverbs))
        return weights

    def correct(self, weights: F64, goals: F64) -> None:
        """Correct weights (B, N) in place toward goals (B, 3)."""
        goal, verb = self.goal, self.goal.verb
        rules = (self.held, self.scale, self.rules)
        if verb.measure.kind == measures.POSITION:
            kernels.correct_positions(
                weights, goals, *rules, verb.rotation_mode, goal.starts, goal.chain, goal.references, goal.offsets
            )
        elif verb.measure.kind == measures.JUMP:
            kernels.correct_jumps(weights, goals, *rules, goal.roots)
        elif verb.measure.kind == measures.VELOCITY:
            kernels.correct_velocities(weights, goals, *rules, goal.walk, goal.turns, verb.phases, goal.log_lengths)
