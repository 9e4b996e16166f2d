"""Measures: goals of adverbs, measured points of jumps and walks, and the error between goal and measured point.

Positions of an effector are in :mod:`verbs.kernels.corrected_position`.

Source: ``docs/math.md``, section "Measures"; the locomotion rule is the one that its source files state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import root_velocity
from verbs.kernels.compile import kernel
from verbs.kernels.root_velocity import Cycle

__all__ = [
    "ADVERBS",
    "JUMP",
    "MEASURES",
    "NOTHING",
    "POSITION",
    "VELOCITY",
    "GoalSpace",
    "compare",
    "goals",
    "jumps",
    "root_velocities",
]

NOTHING, POSITION, JUMP, VELOCITY, ADVERBS = range(5)

MEASURES = {"none": NOTHING, "joint_position": POSITION, "jump": JUMP, "root_velocity": VELOCITY, "adverbs": ADVERBS}
"""Measure numbers as the artifact stores them; never renumber. With ``adverbs`` each adverb names a measure of its own,
see :mod:`verbs.kernels.adverb_measures`; such verbs are stored as ``none`` with more facts."""


class GoalSpace(NamedTuple):
    """How measured adverbs and points of the measure's space belong together; see :class:`verbs.verb.Measure`.

    Parameters
    ----------
    kind : int
        A number of :data:`MEASURES`.
    axes : (m,) int64
        Adverbs that are measured.
    origin : (3,) float64
    frame, inverse : (3, m), (m, 3) float64
        A position goal is origin + frame · adverbs; the pseudo-inverse of the frame.
    """

    kind: int
    axes: I64
    origin: F64
    frame: F64
    inverse: F64


@kernel
def jump(weights: F64, roots: F64, out: F64) -> None:
    """Displacement x, z from start to end and rise from start to apex of the root (3,), metres.

    ``roots`` (3, N, 3) are the examples' roots at start, apex and end. All three are linear in the weights.
    """
    out[:] = 0.0
    for i in range(weights.shape[0]):
        out[0] += weights[i] * (roots[2, i, 0] - roots[0, i, 0])
        out[1] += weights[i] * (roots[2, i, 2] - roots[0, i, 2])
        out[2] += weights[i] * (roots[1, i, 1] - roots[0, i, 1])


@kernel
def jumps(weights: F64, roots: F64, out: F64) -> None:
    """:func:`jump` for weights (B, N), written to ``out`` (B, 3)."""
    for b in range(weights.shape[0]):
        jump(weights[b], roots, out[b])


@kernel
def root_velocities(weights: F64, cycle: Cycle, out: F64) -> None:
    """Forward speed (m/s), turn rate (rad/s), sideways speed (m/s) over one cycle (B, 3) of weights (B, N).

    Each step is rotated into the frame that turns at the cycle's mean rate, then averaged over the cycle.
    """
    rows, turns, (phases, log_lengths, _) = cycle
    times, full, steps, _, _ = root_velocity.scratch(cycle)
    for b in range(weights.shape[0]):
        root_velocity.mean_speeds(weights[b], rows, turns, phases, log_lengths, times, full, steps, out[b])


@kernel
def goals(space: GoalSpace, adverbs: F64, out: F64) -> None:
    """Goals (B, 3), in SI, of adverbs (B, D), in their own units: a point of the measure's space.

    A position is ``origin`` + ``frame`` · measured adverbs; for the others the diagonal of ``frame`` holds SI per unit.
    """
    kind, axes, origin, frame = space.kind, space.axes, space.origin, space.frame
    for b in range(adverbs.shape[0]):
        row, goal = adverbs[b], out[b]
        if kind == POSITION:
            for a in range(3):
                goal[a] = origin[a]
                for m in range(axes.shape[0]):
                    goal[a] += frame[a, m] * row[axes[m]]
        elif kind == JUMP:
            distance, direction = frame[0, 0] * row[axes[0]], frame[1, 1] * row[axes[1]]
            goal[0], goal[1], goal[2] = (
                distance * np.sin(direction),
                distance * np.cos(direction),
                frame[2, 2] * row[axes[2]],
            )
        elif kind == VELOCITY:
            for a in range(3):
                goal[a] = frame[a, a] * row[axes[a]]
        else:
            goal[:] = 0.0


@kernel
def compare(space: GoalSpace, adverbs: F64, points: F64, measured: F64, error: F64) -> None:
    """Measured adverbs (B, m), in their units, of points (B, 3), and the distance (B,), in SI, of points and goals."""
    kind, origin, inverse, requested = space.kind, space.origin, space.inverse, np.empty((adverbs.shape[0], 3))
    goals(space, adverbs, requested)
    for b in range(adverbs.shape[0]):
        total = 0.0
        for a in range(3):
            total += (points[b, a] - requested[b, a]) ** 2
        error[b] = np.sqrt(total)
        if kind == POSITION:
            for m in range(inverse.shape[0]):
                measured[b, m] = 0.0
                for a in range(3):
                    measured[b, m] += inverse[m, a] * (points[b, a] - origin[a])
        elif kind == JUMP:
            measured[b, 0] = inverse[0, 0] * np.sqrt(points[b, 0] ** 2 + points[b, 1] ** 2)
            measured[b, 1] = inverse[1, 1] * np.arctan2(points[b, 0], points[b, 1])
            measured[b, 2] = inverse[2, 2] * points[b, 2]
        else:
            for a in range(3):
                measured[b, a] = inverse[a, a] * points[b, a]
