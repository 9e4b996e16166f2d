"""Corrected blending of verbs that are measured by their root's velocity.

Source: ``docs/math.md``, section "Corrected blending".
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import root_velocity
from verbs.kernels.compile import kernel
from verbs.kernels.correction import SQUARE, Correction, squared_distance, step
from verbs.kernels.root_velocity import Cycle
from verbs.kernels.timewarp import Clock

__all__ = ["correct_velocities", "velocity_jacobian"]


@kernel
def velocity_jacobian(weights: F64, strides: F64, clock: Clock, point: F64, jacobian: F64) -> None:
    """Forward speed, turn rate, sideways speed (3,) over a cycle and their Jacobian (3, N) in weights (N,).

    This lays out the strides (K, N, 4) at each call; :func:`correct_velocities` does that once for many.
    """
    cycle = root_velocity.cycle_of(strides, clock)
    rows, turns, (phases, log_lengths, _) = cycle
    times, full, steps, shares, whole = root_velocity.scratch(cycle)
    root_velocity.mean_speeds(weights, rows, turns, phases, log_lengths, times, full, steps, point)
    root_velocity.speed_derivatives(rows, turns, phases, log_lengths, times, steps, point, shares, whole)
    for a in range(3):
        for i in range(weights.shape[0]):
            jacobian[a, i] = whole[a, i]


@kernel
def correct_velocities(weights: F64, goals: F64, correction: Correction, cycle: Cycle) -> None:
    """Correct weights (B, N) in place until cycles have the speeds of goals (B, 3).

    Steps end as in :func:`verbs.kernels.corrected_position.correct_positions`.
    """
    rows, turns, (phases, log_lengths, _) = cycle
    fixed, scale, saturation, damping, stop, most = correction
    times, full, steps, shares, jacobian = root_velocity.scratch(cycle)
    point = np.empty(3)
    for b in range(weights.shape[0]):
        for _ in range(most):
            root_velocity.mean_speeds(weights[b], rows, turns, phases, log_lengths, times, full, steps, point)
            squared = squared_distance(goals[b], point, scale)
            if np.sqrt(squared) < stop:
                break
            root_velocity.speed_derivatives(rows, turns, phases, log_lengths, times, steps, point, shares, jacobian)
            step(weights[b], goals[b], point, jacobian, fixed, scale, (saturation, damping, stop))
            if SQUARE * squared < stop:
                break
