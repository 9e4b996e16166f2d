"""Whole motions, sampled once for all figures that judge them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.runtime.ground import from_ground
from verbs.runtime.whole_motion import CYCLES, MIDDLE, RATE_HZ

__all__ = ["Sample", "sample"]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One whole motion at 60 Hz, of a loop three cycles.

    Parameters
    ----------
    weights : (N,) float64
    phases : (F,) float64
        Canonical time; beyond 1 in further cycles of a loop.
    rotations, global_rotations : (F, J, 4) float64
        Local and global.
    positions : (F, J, 3) float64
        Joint positions, metres.
    counted : (F,) bool
        Frames that count: of a loop those of its middle cycle, else all.
    """

    weights: F64
    phases: F64
    rotations: F64
    global_rotations: F64
    positions: F64
    counted: npt.NDArray[np.bool_]

    @property
    def accelerations(self) -> F64:
        """Lengths (A, J) of the joints' accelerations in frames that count, m/s²; second differences."""
        second = np.diff(self.positions, n=2, axis=0)[self.counted[1:-1]]
        return np.asarray(np.linalg.norm(second, axis=-1) * RATE_HZ**2, np.float64)

    def over_ground(self, path: F64) -> F64:
        """Speeds (F,) of a path (F, 3) over the ground, m/s: central differences, one-sided at both ends."""
        if len(path) < 2:
            return np.zeros(len(path))
        moved = np.gradient(path[:, [0, 2]], axis=0) * RATE_HZ
        return np.asarray(np.linalg.norm(moved, axis=1), np.float64)


def sample(evaluator: Evaluator, blend: Blend, *, plant: bool = False) -> Sample:
    """Sample the whole motion of a blend of one row, with or without planted feet.

    All figures of :mod:`verbs.quality.motion` take their poses from here. A verb that climbs is seen from its ground.
    """
    looping = evaluator.verb.looping
    length = float(evaluator.pose_of(blend, phase=0.0, plant=False).duration_s[0]) * (CYCLES if looping else 1)
    times = np.arange(max(1, int(length * RATE_HZ + 1e-6)) + 1) / RATE_HZ
    poses = evaluator.pose_of(blend, time_s=times, plant=plant)
    turned, positions = from_ground(evaluator, blend, poses.phase, *evaluator.positions(poses))
    counted = poses.phase // 1.0 == MIDDLE if looping else np.ones(len(poses.phase), np.bool_)
    return Sample(blend.weights[0], poses.phase, poses.rotations, turned, positions, counted)
