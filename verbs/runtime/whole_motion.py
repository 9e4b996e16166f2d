"""Whole motions at 60 frames per second: those of the examples, and those of blends."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.runtime.evaluate import Blend, Evaluator

__all__ = ["CYCLES", "MIDDLE", "RATE_HZ", "examples", "one_of", "sampled", "sampled_rotations"]

RATE_HZ = 60.0
"""Frames per second."""

CYCLES, MIDDLE = 3, 1
"""Cycles of a loop that are sampled, and the one that counts, in which no contact is cut off."""


def examples(evaluator: Evaluator) -> list[Blend]:
    """Every example as a blend of itself alone."""
    verb, unmoved = evaluator.verb, np.zeros(1, np.bool_)
    units = np.eye(len(verb.examples))
    return [evaluator.measure("example", units[k : k + 1], verb.values[k : k + 1], unmoved) for k in range(len(units))]


def one_of(blend: Blend, k: int) -> Blend:
    """Row k of a blend."""
    at = slice(k, k + 1)
    return Blend(blend.method, blend.weights[at], blend.measured[at], blend.error[at], blend.clamped[at])


def sampled(evaluator: Evaluator, blend: Blend, *, plant: bool = False) -> tuple[F64, F64]:
    """Canonical time (F,) and joint positions (F, J, 3), metres, of a whole motion, or three cycles, at 60 Hz."""
    phases, _, positions = sampled_rotations(evaluator, blend, plant=plant)
    return phases, positions


def sampled_rotations(evaluator: Evaluator, blend: Blend, *, plant: bool = False) -> tuple[F64, F64, F64]:
    """Canonical time (F,), global rotations (F, J, 4) and positions (F, J, 3) of what :func:`sampled` samples."""
    cycle = float(evaluator.pose_of(blend, phase=0.0, plant=False).duration_s[0])
    length = cycle * (CYCLES if evaluator.verb.looping else 1)
    times = np.arange(max(1, int(length * RATE_HZ + 1e-6)) + 1) / RATE_HZ
    poses = evaluator.pose_of(blend, time_s=times, plant=plant)
    return poses.phase, *evaluator.positions(poses)
