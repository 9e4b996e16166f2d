"""What a refinement may not guards: exactness, sum of absolute weights, curvature of the weights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from verbs.authoring.basis import solve_smooth
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.quality.smoothness import smoothness
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Basis, Verb

__all__ = ["Guards", "evaluator_with", "plain_basis", "point_curvature"]

NODES, POINTS, CURVED, SPACING = 31, 3_000, 600, 1.0 / 60.0
"""Nodes on a side of the slices; random points, and those at which curvature is evaluated; the distance of their
neighbours along each axis of the chart."""

SEED_STREAM = 5


def plain_basis(verb: Verb) -> Basis:
    """The verb's smooth basis without pseudo-examples."""
    basis, count = verb.bases["smooth"], len(verb.examples)
    points = np.array(basis.centers[:count])
    return solve_smooth(basis.chart, points, np.eye(count), radius=float(basis.radii[0]), degree=basis.degree)


def evaluator_with(verb: Verb, basis: Basis) -> Evaluator:
    """The verb prepared with another smooth basis."""
    return Evaluator(replace(verb, bases={**verb.bases, "smooth": basis}))


def point_curvature(evaluator: Evaluator, points: F64) -> F64:
    """Curvature (B,) of the corrected weights at normalised chart points (B, D): |Σ (w − w')| / 2D over neighbours.

    The 2·D neighbours lie :data:`SPACING` away along each axis. Points do not follow the axes of the slices.
    """
    dims = points.shape[1]
    steps = SPACING * np.concatenate([np.zeros((1, dims)), np.eye(dims), -np.eye(dims)])
    around = (points[:, None] + steps).reshape(-1, dims)
    adverbs = evaluator.verb.domain.chart.adverbs(around)
    weights = evaluator.blend(adverbs, method="corrected").weights.reshape(len(points), len(steps), -1)
    bend = 2 * dims * weights[:, 0] - weights[:, 1:].sum(axis=1)
    return np.asarray(np.linalg.norm(bend, axis=-1) / (2 * dims), np.float64)


@dataclass(frozen=True, slots=True)
class Guards:
    """Figures that are limited.

    Parameters
    ----------
    error_max : float
        In the unit of the measure.
    weight_sum_max : float
    slices_mean, points_mean, points_high : float
        Mean curvature on slices and at random points, and its 99.5th percentile there.
    """

    error_max: float
    weight_sum_max: float
    slices_mean: float
    points_mean: float
    points_high: float

    @classmethod
    def of_evaluator(cls, evaluator: Evaluator, seed: int, goals: F64) -> Guards:
        """Evaluate a prepared verb, at goals (B, D) and at random points of the domain."""
        verb = evaluator.verb
        adverbs = random_points(verb, np.random.default_rng([seed, SEED_STREAM]), POINTS)
        blend = evaluator.blend(np.concatenate([goals, adverbs]), method="corrected")
        at = point_curvature(evaluator, verb.domain.chart.points(adverbs[:CURVED]))
        slices_mean = smoothness(evaluator, "corrected", nodes=NODES)[0]
        sums = np.abs(blend.weights).sum(axis=1)
        return cls(float(blend.error.max()), float(sums.max()), slices_mean, float(at.mean()),
                   float(np.percentile(at, 99.5)))  # fmt: skip

    def exceeded(self, plain: Guards, *, sums: float = 1.2, mean: float = 1.08, high: float = 1.3) -> str:
        """The first limit that is exceeded against the plain basis; empty if none is."""
        limits = (
            ("error", self.error_max, 1e-8),
            ("sum of absolute weights", self.weight_sum_max, sums * plain.weight_sum_max),
            ("curvature on slices", self.slices_mean, mean * plain.slices_mean),
            ("curvature at points", self.points_mean, mean * plain.points_mean),
            ("largest curvature at points", self.points_high, high * plain.points_high),
        )
        return next((name for name, value, limit in limits if not value <= limit), "")
