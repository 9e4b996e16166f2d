"""Motions seen from their ground: that of a verb that climbs is an inclined plane under the character."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import contacts, quat
from verbs.kernels import pose as kernels
from verbs.runtime.evaluate import Blend, Evaluator

__all__ = ["from_ground", "gradient"]


def gradient(evaluator: Evaluator, blend: Blend) -> F64:
    """Rise (B, 2) of the ground per metre to the side and per metre ahead; zero where the ground is level."""
    out = np.zeros((len(blend.weights), 2))
    if evaluator.verb.root_motion == kernels.STRIDE:
        contacts.gradient(blend.weights, evaluator.verb.strides, out)
    return out


def from_ground(evaluator: Evaluator, blend: Blend, phases: F64, rotations: F64, positions: F64) -> tuple[F64, F64]:
    """Rotate a motion of one blend, so that its ground is level.

    The ground lies below the root and rises with the gradient of the blend, which turns with the heading. Distances
    over the ground are those along the plane, and heights those above it.

    Parameters
    ----------
    evaluator : Evaluator
    blend : Blend
        One row.
    phases : (F,) float64
        Unwrapped and rising, from 0.
    rotations, positions : (F, J, 4), (F, J, 3) float64
        Global ones of the motion in the world.

    Returns
    -------
    rotations, positions : (F, J, 4), (F, J, 3) float64
        As given where the ground is level.
    """
    across, ahead = gradient(evaluator, blend)[0]
    if across == 0.0 and ahead == 0.0:
        return rotations, positions
    verb, size = evaluator.verb, len(phases)
    weights = np.ascontiguousarray(np.broadcast_to(blend.weights[0], (size, blend.weights.shape[1])))
    path, heading = np.zeros((size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (size, 1, 1))
    kernels.travel(weights, verb.strides, phases, verb.looping, True, path, heading)
    steepness = np.hypot(across, ahead)
    axis = np.array([ahead, 0.0, -across]) / steepness  # about it, the direction uphill rotates down to level
    level = quat.exp(np.arctan(steepness) * quat.rotate(heading[:, 0], axis))
    steps = quat.rotate(level[1:], np.diff(path, axis=0))
    over = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]) * np.array([1.0, 0.0, 1.0])
    moved = quat.rotate(level[:, None], positions - path[:, None]) + over[:, None]
    return quat.mul(level[:, None], rotations), np.asarray(moved)
