"""Heading of a motion from the geometry of its hips and shoulders, never from a joint's local axis."""

from __future__ import annotations

import numpy as np

from verbs.clips import paths
from verbs.clips.pairs import find_pairs
from verbs.errors import OutOfRange
from verbs.motion import Motion

__all__ = ["heading"]


def heading(motion: Motion, frame: int = 0) -> float | None:
    """Angle about +Y, radians, from +Z to where the character faces at a frame; positive towards +X, its left.

    The character faces at right angles to the mean direction from right to left of the first joints of its limbs and
    of the joints below these. None where no joints are paired, or that direction is vertical.
    """
    skeleton = motion.skeleton
    try:
        partner = find_pairs(skeleton).partner
    except OutOfRange:
        return None
    parents = skeleton.parents
    first = [j for j in range(1, len(skeleton)) if partner[j] != j and partner[parents[j]] == parents[j]]
    below = [j for j in range(1, len(skeleton)) if partner[j] != j and parents[j] in first]
    still = Motion(skeleton, motion.fps, motion.root[frame : frame + 1], motion.rotations[frame : frame + 1])
    places = paths.positions(still)[0]
    across = np.zeros(3)
    for joint in first + below:
        mate = int(partner[joint])
        if _is_left(skeleton.names[joint], skeleton.names[mate]):
            across += places[joint] - places[mate]
    flat = float(np.hypot(across[0], across[2]))
    return None if flat < 1e-6 else float(np.arctan2(-across[2], across[0]))


def _is_left(name: str, mate: str) -> bool:
    """Whether the first of two paired names is the left one: where they differ, it has the L."""
    at = next(k for k, (a, b) in enumerate(zip(name, mate, strict=False)) if a != b)
    return name[at] in "lL"
