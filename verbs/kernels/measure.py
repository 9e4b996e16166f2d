"""What a blend reaches: the measured point of weights, per kind of measure.

Source: ``docs/math.md``, section "Measures"; the locomotion rule is the one that its source files state.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import root_velocity
from verbs.kernels.compile import kernel
from verbs.kernels.pose import add_turned, finish_rotation, multiply

__all__ = [
    "JUMP",
    "MEASURES",
    "NOTHING",
    "POSITION",
    "VELOCITY",
    "compare",
    "goals",
    "jumps",
    "positions",
    "root_velocities",
]

NOTHING, POSITION, JUMP, VELOCITY = range(4)

MEASURES = {"none": NOTHING, "joint_position": POSITION, "jump": JUMP, "root_velocity": VELOCITY}
"""Measure numbers as the artifact stores them; never renumber."""


@kernel
def position(weights: F64, mode: int, roots: F64, rows: F64, references: F64, offsets: F64, out: F64) -> None:
    """Position (3,) of the effector at its keytime, metres.

    Parameters
    ----------
    weights : (N,) float64
    mode : int
        How rotations blend, see :mod:`verbs.kernels.pose`.
    roots : (N, 3) float64
        Root position of each example at the keytime.
    rows : (L, N, 4) float64
        Rotation rows of the L joints of the chain from the root to the effector's parent.
    references : (L, 4) float64
    offsets : (L, 3) float64
        Offset of the next joint of the chain; the last one is the effector's.
    """
    out[:] = 0.0
    for i in range(weights.shape[0]):
        for a in range(3):
            out[a] += weights[i] * roots[i, a]
    turn, local, product = np.zeros(4), np.empty(4), np.empty(4)
    turn[3] = 1.0
    for j in range(rows.shape[0]):
        local[:] = 0.0
        for i in range(weights.shape[0]):
            for a in range(4):
                local[a] += weights[i] * rows[j, i, a]
        finish_rotation(mode, references[j], local)
        multiply(turn, local, product)
        turn[:] = product
        add_turned(turn, offsets[j], out)


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
def positions(weights: F64, mode: int, roots: F64, rows: F64, references: F64, offsets: F64, out: F64) -> None:
    """:func:`position` for weights (B, N), written to ``out`` (B, 3)."""
    for b in range(weights.shape[0]):
        position(weights[b], mode, roots, rows, references, offsets, out[b])


@kernel
def jumps(weights: F64, roots: F64, out: F64) -> None:
    """:func:`jump` for weights (B, N), written to ``out`` (B, 3)."""
    for b in range(weights.shape[0]):
        jump(weights[b], roots, out[b])


@kernel
def root_velocities(weights: F64, walk: F64, turns: F64, phases: F64, log_lengths: F64, out: F64) -> None:
    """Forward speed (m/s), turn rate (rad/s), sideways speed (m/s) over one cycle (B, 3) of weights (B, N).

    Each step is turned into the frame that turns at the cycle's mean rate, then averaged over the cycle. ``walk`` and
    ``turns`` are those of :func:`verbs.kernels.root_velocity.walk_of`.
    """
    times, full, steps, _, _ = root_velocity.scratch(walk, phases, weights.shape[1])
    for b in range(weights.shape[0]):
        root_velocity.mean_speeds(weights[b], walk, turns, phases, log_lengths, times, full, steps, out[b])


@kernel
def goals(kind: int, adverbs: F64, axes: I64, origin: F64, frame: F64, out: F64) -> None:
    """Goals (B, 3) of adverbs (B, D): what the measured ones ask for, as a point of the measure's space."""
    for b in range(adverbs.shape[0]):
        row, goal = adverbs[b], out[b]
        if kind == POSITION:
            for a in range(3):
                goal[a] = origin[a]
                for m in range(axes.shape[0]):
                    goal[a] += frame[a, m] * row[axes[m]]
        elif kind == JUMP:
            distance, direction = row[axes[0]], row[axes[1]]
            goal[0], goal[1], goal[2] = (
                distance * np.sin(direction),
                distance * np.cos(direction),
                row[axes[2]],
            )
        else:
            for a in range(3):
                goal[a] = row[axes[a]]


@kernel
def compare(
    kind: int,
    adverbs: F64,
    points: F64,
    axes: I64,
    origin: F64,
    frame: F64,
    inverse: F64,
    measured: F64,
    error: F64,
) -> None:
    """Measured adverbs (B, m) of reached points (B, 3), and their distance (B,) from what adverbs (B, D) ask.

    ``inverse`` (m, 3) is the pseudo-inverse of ``frame`` (3, m).
    """
    goal = np.empty((1, 3))
    for b in range(adverbs.shape[0]):
        goals(kind, adverbs[b : b + 1], axes, origin, frame, goal)
        total = 0.0
        for a in range(3):
            total += (points[b, a] - goal[0, a]) ** 2
        error[b] = np.sqrt(total)
        if kind == POSITION:
            for m in range(axes.shape[0]):
                measured[b, m] = 0.0
                for a in range(3):
                    measured[b, m] += inverse[m, a] * (points[b, a] - origin[a])
        elif kind == JUMP:
            measured[b, 0] = np.sqrt(points[b, 0] ** 2 + points[b, 1] ** 2)
            measured[b, 1] = np.arctan2(points[b, 0], points[b, 1])
            measured[b, 2] = points[b, 2]
        else:
            for a in range(3):
                measured[b, a] = points[b, a]
