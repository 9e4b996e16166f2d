"""Corrected blending toward any number of measured adverbs: the general form of :mod:`verbs.kernels.correction`.

Source: ``docs/math.md``, sections "Corrected blending" and "Measures of adverbs".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.adverb_measures import AdverbProblem, AdverbScratch, measure_adverbs, scratch_of
from verbs.kernels.compile import kernel
from verbs.kernels.correction import Correction

__all__ = ["correct_adverbs"]

PIVOT = 1e-300
"""Least square of a pivot of Cholesky's factors."""

HALVINGS = 12
"""Most halvings of a step that would enlarge the residual."""

ENOUGH = 1e4
"""Square of the residual, in squares of ``stop``, that is too large for a result."""


class Work(NamedTuple):
    """Scratch arrays: residual (m,), Jacobian (m, N), Cholesky's factors (m, m), step and trial weights (N,)."""

    residual: F64
    jacobian: F64
    factors: F64
    step: F64
    trial: F64


@kernel
def _project(jacobian: F64, scale: F64, fixed: F64) -> None:
    """Scale the rows of a Jacobian (m, N), and take out the directions in which the weights must not move."""
    for r in range(jacobian.shape[0]):
        for i in range(jacobian.shape[1]):
            jacobian[r, i] *= scale[r]
        for s in range(fixed.shape[0]):
            share = 0.0
            for i in range(jacobian.shape[1]):
                share += jacobian[r, i] * fixed[s, i]
            for i in range(jacobian.shape[1]):
                jacobian[r, i] -= share * fixed[s, i]


@kernel
def _solve(jacobian: F64, damping: float, factors: F64, residual: F64) -> None:
    """Solve (J Jᵀ + λ) y = residual (m,), in place, by Cholesky's factors (m, m), which are scratch."""
    rows = jacobian.shape[0]
    for a in range(rows):
        for b in range(a + 1):
            total = damping if a == b else 0.0
            for i in range(jacobian.shape[1]):
                total += jacobian[a, i] * jacobian[b, i]
            for c in range(b):
                total -= factors[a, c] * factors[b, c]
            factors[a, b] = np.sqrt(max(total, PIVOT)) if a == b else total / factors[b, b]
    for a in range(rows):
        for c in range(a):
            residual[a] -= factors[a, c] * residual[c]
        residual[a] /= factors[a, a]
    for a in range(rows - 1, -1, -1):
        for c in range(a + 1, rows):
            residual[a] -= factors[c, a] * residual[c]
        residual[a] /= factors[a, a]


@kernel
def _residual(weights: F64, goal: F64, scale: F64, problem: AdverbProblem, scratch: AdverbScratch, work: Work) -> float:
    """Squared length of the scaled residual of weights (N,); it and the Jacobian go to ``work``."""
    measure_adverbs(weights, problem, scratch, work.residual, work.jacobian)
    squared = 0.0
    for r in range(goal.shape[0]):
        work.residual[r] = scale[r] * (goal[r] - work.residual[r])
        squared += work.residual[r] * work.residual[r]
    return squared


@kernel
def _direction(squared: float, correction: Correction, work: Work) -> None:
    """Step (N,) from the residual and the Jacobian in ``work``, which it overwrites."""
    fixed, scale, saturation, damping, _, _ = correction
    shrink = 1.0 / np.sqrt(1.0 + squared / (saturation * saturation))
    _project(work.jacobian, scale, fixed)
    _solve(work.jacobian, damping, work.factors, work.residual)
    for i in range(work.step.shape[0]):
        work.step[i] = 0.0
        for r in range(work.residual.shape[0]):
            work.step[i] += shrink * work.jacobian[r, i] * work.residual[r]


@kernel
def _descend(weights: F64, goal: F64, correction: Correction, problem: AdverbProblem, scratch: AdverbScratch,
             work: Work) -> float:  # fmt: skip
    """Correct weights (N,) in place, and return the squared length of their residual, which never grows."""
    scale, stop = correction.scale, correction.stop
    squared = _residual(weights, goal, scale, problem, scratch, work)
    for _ in range(correction.steps):
        if not squared >= stop * stop:  # NaN ends it too
            break
        _direction(squared, correction, work)
        found, share = squared, 1.0
        for _ in range(HALVINGS + 1):
            work.trial[:] = weights + share * work.step
            found = _residual(work.trial, goal, scale, problem, scratch, work)
            if found < squared:
                break
            share *= 0.5
        if not found < squared:
            break
        weights[:], squared = work.trial, found
    return squared


@kernel
def _tame(weights: F64, fixed: F64) -> None:
    """Replace weights (N,) by their positive parts, with the same sum and the same style adverbs, in place."""
    positive = np.maximum(weights, 0.0)
    positive /= positive.sum()
    for s in range(fixed.shape[0]):
        share = 0.0
        for i in range(weights.shape[0]):
            share += fixed[s, i] * (weights[i] - positive[i])
        positive += share * fixed[s]
    weights[:] = positive


@kernel
def correct_adverbs(weights: F64, goals: F64, correction: Correction, problem: AdverbProblem) -> None:
    """Correct weights (B, N) in place until their measures are goals (B, m), in SI.

    ``correction.scale`` has m numbers here. A step is that of :func:`verbs.kernels.correction.step`, halved until the
    residual is smaller. Where that fails, because examples with nearly the same adverbs differ much and their weights
    are large, correction starts again from the weights' positive parts; the better result counts.
    """
    rows, count = goals.shape[1], weights.shape[1]
    scratch = scratch_of(problem)
    work = Work(np.empty(rows), np.empty((rows, count)), np.zeros((rows, rows)), np.empty(count), np.empty(count))
    again = np.empty(count)
    for b in range(weights.shape[0]):
        again[:] = weights[b]
        squared = _descend(weights[b], goals[b], correction, problem, scratch, work)
        if not squared <= ENOUGH * correction.stop * correction.stop:  # NaN too
            _tame(again, correction.fixed)
            found = _descend(again, goals[b], correction, problem, scratch, work)
            if found < squared or np.isnan(squared):
                weights[b] = again
