"""Quality of goal tracking: joint accelerations while the goal of a held pose moves on a circle.

Weights are evaluated every frame at the effector's keytime. A goal on a circle has a constant acceleration; more than
that comes from the method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.domain import inside, random_points
from verbs.errors import RequestError
from verbs.kernels import measure as measures
from verbs.runtime.evaluate import Evaluator

__all__ = ["Follow", "circles", "follow"]

RATE_HZ = 60.0

JITTER = 3.0
"""A frame jitters if its acceleration exceeds the median of its neighbourhood by this factor."""

NEIGHBOURHOOD = 15
"""Frames on either side."""


@dataclass(frozen=True, slots=True)
class Follow:
    """Result of following goals on circles.

    Parameters
    ----------
    method : str
    ratio_median, ratio_max : float
        Largest acceleration of any joint over that of the goal: median and worst of the circles.
    jitter : float
        Share of frames that jitter.
    error_mean_m : float
    """

    method: str
    ratio_median: float
    ratio_max: float
    jitter: float
    error_mean_m: float


def circles(
    evaluator: Evaluator, rng: np.random.Generator, *, count: int = 12, radius_m: float = 0.12, cycle_hz: float = 0.5
) -> F64:
    """Goals (count, F, 3) on circles inside the domain, in random planes, two revolutions each at 60 Hz.

    Raises
    ------
    RequestError
        If the verb's goals are not positions in space, or too few circles of this radius fit into its domain.
    """
    verb = evaluator.verb
    if verb.measure.kind != measures.POSITION or len(verb.adverbs) != 3:
        raise RequestError(f"'{verb.name}' has no goal in space to move on a circle")
    frames = np.arange(round(2.0 / cycle_hz * RATE_HZ))
    angle = 2.0 * np.pi * cycle_hz / RATE_HZ * frames
    kept: list[F64] = []
    for centre in random_points(verb, rng, 4_000):
        first, second = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        around = radius_m * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        path = centre + around @ evaluator.goal.space.inverse.T
        if inside(verb.domain, verb.domain.chart.points(path)).all():
            kept.append(path)
        if len(kept) == count:
            return np.array(kept)
    raise RequestError(f"only {len(kept)} of {count} circles of {radius_m} m fit into the domain of '{verb.name}'")


def follow(evaluator: Evaluator, method: str, paths: F64) -> Follow:
    """Follow goals (C, F, 3), weights evaluated every frame; accelerations (m/s²), jitter and error."""
    verb, ratios, jitters, errors = evaluator.verb, [], [], []
    phase = float(verb.phases[verb.measure.keytime])
    for path in paths:
        poses = evaluator.pose(np.ascontiguousarray(path), phase=np.full(len(path), phase), method=method, plant=False)
        _, positions = evaluator.positions(poses)
        joints = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=-1).max(axis=1) * RATE_HZ**2
        own = np.linalg.norm(np.diff(evaluator.goal.points(path), n=2, axis=0), axis=-1).max() * RATE_HZ**2
        windows = np.lib.stride_tricks.sliding_window_view(joints, 2 * NEIGHBOURHOOD + 1)
        middle = joints[NEIGHBOURHOOD : len(joints) - NEIGHBOURHOOD]
        ratios.append(joints.max() / own)
        jitters.append(np.mean(middle > JITTER * np.median(windows, axis=1)))
        errors.append(poses.blend.error.mean())
    return Follow(
        method, float(np.median(ratios)), float(np.max(ratios)), float(np.mean(jitters)), float(np.mean(errors))
    )
