"""Scale a motion: all lengths by one factor."""

from __future__ import annotations

from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["scaled"]


def scaled(motion: Motion, factor: float) -> Motion:
    """A motion with all lengths multiplied by a factor; the motion itself for 1."""
    if factor == 1.0:
        return motion
    own = motion.skeleton
    skeleton = Skeleton(own.names, own.parents, own.offsets * factor, own.tip_parents, own.tip_offsets * factor)
    return Motion(skeleton, motion.fps, motion.root * factor, motion.rotations)
