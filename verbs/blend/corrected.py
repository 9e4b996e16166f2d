"""Method ``corrected``: smooth weights, then correction steps until the goal is met. Exact and smooth.

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
from verbs.kernels import radial_basis
from verbs.kernels.chart import ChartArrays
from verbs.kernels.columns import BATCH
from verbs.kernels.compile import direct
from verbs.kernels.corrected_adverbs import correct_adverbs
from verbs.kernels.corrected_position import PositionProblem, correct_positions
from verbs.kernels.corrected_velocity import correct_velocities
from verbs.kernels.position_batch import correct_positions_batch
from verbs.kernels.sums import Sums, couple
from verbs.verb import Basis, Verb

__all__ = ["SATURATION", "STEPS", "Corrected"]

_correct_positions, _correct_positions_batch = direct(correct_positions), direct(correct_positions_batch)
_cardinal_batch = direct(radial_basis.cardinal_batch)
_correct_jumps = direct(kernels.correct_jumps)
_correct_velocities, _correct_adverbs = direct(correct_velocities), direct(correct_adverbs)

SATURATION = 0.15
"""Longest step's residual, as a share of the greatest distance between two examples' goals."""

STEPS = 8
"""Most steps. Six were enough in every measurement; the others are margin, which costs nothing while unused."""

OWN_STEPS = 40
"""Most steps where adverbs name their own measures: several goals at once are farther from linear."""

STOP = 1e-10
"""Residual (m, or ranges) at which correction ends; far below what is visible."""

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
    correction : Correction
        It leaves the sum of the weights and each style adverb as they are.
    sums : Sums
        What positions depend on; zeros for other measures.
    linear : LinearCorrection
        Correction of jumps in one step; without rows for other measures.
    """

    basis: Basis
    goal: Goal
    correction: kernels.Correction
    sums: Sums
    linear: kernels.LinearCorrection

    @classmethod
    def of_verb(cls, verb: Verb, *, basis: str = "smooth", steps: int = STEPS) -> Corrected:
        """Prepare a verb's correction on top of one of its bases."""
        goal = Goal.of_verb(verb)
        style = [k for k in range(len(verb.adverbs)) if k not in verb.measure.axes]
        fixed = np.concatenate([np.ones((len(verb.examples), 1)), verb.values[:, style]], axis=1)
        directions = np.ascontiguousarray(np.linalg.qr(fixed)[0].T)
        points = goal.points(verb.values)
        span = points.max(axis=0) - points.min(axis=0)
        if verb.measure.kind == measures.VELOCITY:
            scale, damping = 1.0 / np.where(span > 0, span, 1.0), DAMPING_RANGES
        elif verb.measure.kind == measures.ADVERBS and verb.measure.unit != "m":
            scale, damping, steps = _by_dimension(verb, span), DAMPING_RANGES, max(steps, OWN_STEPS)
        else:
            scale, damping = np.ones(goal.width), DAMPING_M2
            steps = max(steps, OWN_STEPS) if verb.measure.kind == measures.ADVERBS else steps
        # The farthest pair, not the bounding box: a rotation of the whole verb must change nothing.
        size = float(pdist(scale * points).max())
        correction = kernels.Correction(directions, scale, SATURATION * size, damping, STOP, steps)
        sums = couple(np.concatenate([goal.chain.roots, goal.chain.rows]), directions)
        rates = kernels.jump_rates(goal.roots) if len(goal.roots) else np.zeros((0, len(verb.examples)))
        return cls(verb.bases[basis], goal, correction, sums, kernels.linear_correction(rates, correction))

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D) inside the domain."""
        if len(adverbs) < BATCH:
            weights = basis_weights(self.basis, adverbs)
        else:
            weights = np.empty((len(adverbs), self.basis.radial.shape[1]))
            _cardinal_batch(np.ascontiguousarray(adverbs, np.float64), self.basis.arrays, weights)
        self.correct(weights, self.goal.points(adverbs))
        return weights

    def correct(self, weights: F64, goals: F64) -> None:
        """Correct C-contiguous weights (B, N) in place toward goals (B, P), as :class:`Goal` makes them."""
        goal, kind = self.goal, self.goal.verb.measure.kind
        goals = np.ascontiguousarray(goals, np.float64)
        if kind == measures.POSITION:
            if len(weights) < BATCH:
                _correct_positions(weights, goals, self.correction, goal.chain)
            else:
                _correct_positions_batch(weights, goals, self.correction, goal.chain, self.sums)
        elif kind == measures.JUMP:
            _correct_jumps(weights, goals, self.linear)
        elif kind == measures.VELOCITY:
            _correct_velocities(weights, goals, self.correction, goal.cycle)
        elif goal.own is not None:
            _correct_adverbs(weights, goals, self.correction, goal.own)

    def problem(self) -> PositionProblem:
        """Arrays with which one compiled call does everything, for a verb that is measured by a joint's position."""
        domain, basis, sums = self.goal.verb.domain.arrays, self.basis.arrays, self.sums
        coefficients = np.concatenate([basis.radial, basis.poly])
        own_chart = not _equal(domain.chart, basis.chart)
        to_sums = np.ascontiguousarray(sums.rows @ coefficients.T)
        to_weights = np.concatenate([coefficients, sums.moves])
        goal = self.goal
        return PositionProblem(
            domain, basis, own_chart, self.correction, goal.chain, goal.space, sums, to_sums, to_weights
        )


def _by_dimension(verb: Verb, span: F64) -> F64:
    """Reciprocal of the widest range of each adverb's dimension (m,), so that those of one dimension share a scale."""
    dimensions = np.array([row.dimension for row in verb.measure.rows])
    widest = np.array([span[dimensions == one].max() for one in dimensions])
    return np.asarray(1.0 / np.where(widest > 0, widest, 1.0))


def _equal(one: ChartArrays, other: ChartArrays) -> bool:
    """Whether two charts give the same coordinates."""
    return one.kind == other.kind and all(map(np.array_equal, one[1:], other[1:]))
