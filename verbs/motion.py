"""One captured or authored motion: a skeleton moving over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, MAX_FRAMES
from verbs.errors import SkeletonMismatch
from verbs.skeleton import Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A skeleton moving over time, sampled at a fixed rate.

    Parameters
    ----------
    skeleton : Skeleton
        The joints.
    fps : float
        Frames per second.
    root : (F, 3) float64
        Position of the root joint, metres, in the space of the motion.
    rotations : (F, J, 4) float64
        Local rotation of every joint, unit quaternions (x, y, z, w).

    Raises
    ------
    SkeletonMismatch
        If the shapes do not fit the skeleton or each other, or a value is not finite.
    """

    skeleton: Skeleton
    fps: float
    root: F64
    rotations: F64

    def __post_init__(self) -> None:
        frames = len(self.root)
        if not 1 <= frames <= MAX_FRAMES:
            raise SkeletonMismatch(f"a motion has 1 to {MAX_FRAMES} frames, not {frames}")
        if self.root.shape != (frames, 3) or self.rotations.shape != (frames, len(self.skeleton), 4):
            raise SkeletonMismatch(
                f"{len(self.skeleton)} joints and {frames} frames, "
                f"but root {self.root.shape} and rotations {self.rotations.shape}"
            )
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise SkeletonMismatch(f"a motion's rate must be above zero, not {self.fps}")
        if not (np.isfinite(self.root).all() and np.isfinite(self.rotations).all()):
            raise SkeletonMismatch("a motion's values must be finite")

    def __len__(self) -> int:
        return len(self.root)

    def scaled(self, factor: float) -> Motion:
        """The motion with all lengths multiplied by a factor; itself for 1."""
        if factor == 1.0:
            return self
        own = self.skeleton
        skeleton = Skeleton(own.names, own.parents, own.offsets * factor, own.tip_parents, own.tip_offsets * factor)
        return Motion(skeleton, self.fps, self.root * factor, self.rotations)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame, seconds."""
        return (len(self.root) - 1) / self.fps
