"""The follow window: phases around the effector's keytime at which a paused pose can be on a moving goal.

Away from its keytime the examples' effectors nearly coincide, and weights that reach a goal there would be huge. The
window is where they are not: where, over points of the domain, they stay within :data:`GROWTH` of those at the keytime.

Source: ``docs/math.md``, section "Follow window".
"""

from __future__ import annotations

import numpy as np

from verbs.blend.cardinal import basis_weights
from verbs.blend.corrected import Corrected
from verbs.conventions import F64
from verbs.kernels import following
from verbs.kernels import measure as measures
from verbs.kernels.corrected_position import correct_positions, effector_positions

__all__ = ["follow_window"]

GROWTH = 1.5
"""How much larger than at the keytime the sum of absolute weights may become."""

REACHED_M = 1e-6
SAMPLES = 96
STEP = 0.01
"""Phases that are tried lie so far apart."""


def follow_window(method: Corrected) -> tuple[float, float] | None:
    """First and last phase (from, to) of the window; None for verbs that are not measured by a joint's position."""
    verb = method.goal.verb
    if verb.measure.kind != measures.POSITION:
        return None
    adverbs = _inside(method)
    middle = float(verb.phases[verb.measure.keytime])
    largest, _ = _forced(method, adverbs, middle)
    found = []
    for direction in (-STEP, STEP):
        phase = middle
        while 0.0 <= phase + direction <= 1.0:
            size, miss = _forced(method, adverbs, phase + direction)
            if size > GROWTH * largest or miss > REACHED_M:
                break
            phase += direction
        found.append(phase)
    return found[0], found[1]


def _inside(method: Corrected) -> F64:
    """Adverbs (S, D) inside the domain: random means of a few examples, and the examples themselves, in its chart."""
    verb = method.goal.verb
    chart, rng = verb.domain.chart, np.random.default_rng(0)
    points = chart.points(verb.values)
    shares = rng.dirichlet(np.full(len(points), 0.3), SAMPLES)
    return chart.adverbs(np.concatenate([points, shares @ points]))


def _forced(method: Corrected, adverbs: F64, phase: float) -> tuple[float, float]:
    """Largest sum of absolute weights, and largest miss (m), of poses at a phase that are forced to their goals."""
    goal, verb = method.goal, method.goal.verb
    chain = goal.chain._replace(roots=np.empty_like(goal.chain.roots), rows=np.empty_like(goal.chain.rows))
    joints = verb.skeleton.chain(verb.measure.effector)[:-1]
    following.chain_at(phase, verb.curves, joints, chain.roots, chain.rows)
    weights, goals = basis_weights(method.basis, adverbs), goal.points(adverbs)
    correct_positions(weights, goals, method.correction, chain)
    points = np.empty_like(goals)
    effector_positions(weights, chain, points)
    return float(np.abs(weights).sum(axis=1).max()), float(np.linalg.norm(points - goals, axis=1).max())
