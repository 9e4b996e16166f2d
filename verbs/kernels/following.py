"""The follow window: weights of a paused character are corrected at its phase, so that the effector is on its goal.

Source: ``docs/math.md``, section "Follow window".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.kernels.character_state import Records
from verbs.kernels.compile import kernel
from verbs.kernels.corrected_position import Chain, correct_positions, effector_positions
from verbs.kernels.correction import Correction
from verbs.kernels.pose import spline_taps

__all__ = ["FADE_S", "NO_WINDOW", "FollowProblem", "chain_at", "follow"]

FADE_S = 0.2
"""Seconds in which a paused pose moves to its goal, or away from it."""

NO_WINDOW = (2.0, -1.0)
"""A follow window that contains no phase."""


class FollowProblem(NamedTuple):
    """What following a goal in the follow window needs; the chain is that of the phase.

    Parameters
    ----------
    start, stop : float
        Phases of the window.
    curves : (K + 3, N, 4 + 4·J) float32
    joints : (L,) int64
        Joints of the chain.
    correction : Correction
    mode : int
    references, offsets : (L, 4), (L, 3) float64
    """

    start: float
    stop: float
    curves: F32
    joints: I64
    correction: Correction
    mode: int
    references: F64
    offsets: F64


@kernel
def chain_at(phase: float, curves: F32, joints: I64, roots: F64, rows: F64) -> None:
    """Every example's root (3, N) and rotation rows (4·L, N) of a chain of joints (L,) at any phase."""
    taps = np.empty(4)
    first = spline_taps(phase, curves.shape[0] - 3, taps)
    roots[:] = 0.0
    rows[:] = 0.0
    for tap in range(4):
        for i in range(curves.shape[1]):
            source = curves[first + tap, i]
            for a in range(3):
                roots[a, i] += taps[tap] * source[a]
            for link in range(joints.shape[0]):
                for a in range(4):
                    rows[4 * link + a, i] += taps[tap] * source[4 + 4 * joints[link] + a]


@kernel
def follow(
    slots: I64,
    step_s: float,
    state: Records,
    targets: tuple[F64, F64],
    weights: F64,
    error: F64,
    problem: FollowProblem,
) -> None:
    """Where a character is paused within the follow window, correct its weights (B, N) at that phase.

    ``targets`` are effector positions (B, 3) inside the domain, and as requested; the distance to the latter becomes
    the error (B,). Elsewhere weights and errors stay, after a fade. A motion that plays on past the window fades from
    its edge, as weights beyond it would be huge.
    """
    goals, requested = targets
    count = weights.shape[1]
    roots, rows = np.empty((3, count)), np.empty((4 * problem.joints.shape[0], count))
    chain = Chain(problem.mode, roots, rows, problem.references, problem.offsets)
    corrected, point = np.empty((1, count)), np.empty((1, 3))
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        paused = row["playing"] * row["speed"] == 0.0
        inside = row["following"] > 0.0 and paused and problem.start <= row["phase"] <= problem.stop
        move = 1.0 if row["fresh"] > 0.0 else step_s / FADE_S
        row["share"] = min(row["share"] + move, 1.0) if inside else max(row["share"] - move, 0.0)
        if row["share"] == 0.0:
            continue
        u = row["share"]
        share = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        chain_at(min(max(row["phase"], problem.start), problem.stop), problem.curves, problem.joints, roots, rows)
        corrected[0] = weights[b]
        correct_positions(corrected, goals[b : b + 1], problem.correction, chain)
        for i in range(count):
            weights[b, i] += share * (corrected[0, i] - weights[b, i])
        if inside:
            effector_positions(weights[b : b + 1], chain, point)
            x, y, z = point[0, 0] - requested[b, 0], point[0, 1] - requested[b, 1], point[0, 2] - requested[b, 2]
            error[b] = np.sqrt(x * x + y * y + z * z)
