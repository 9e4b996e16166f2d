"""Standard joint names of humanoid skeletons, and which joints of a skeleton have them.

The names are those of Mixamo and of most BVH files of motion capture: ``Hips``, ``LeftUpLeg``, ``LeftLeg``, … A
prefix that ends with a colon (``mixamorig:Hips``) is left out, and upper and lower case do not differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.skeleton import Skeleton

__all__ = ["SIDES", "Humanoid"]

SIDES = ("left", "right")

NEEDED = (
    "hips", "neck", "head",
    *(side + part for side in SIDES for part in ("arm", "forearm", "hand", "upleg", "leg", "foot")),
)  # fmt: skip
"""Joints without which a skeleton is no humanoid with standard names."""


@dataclass(frozen=True, slots=True, eq=False)
class Humanoid:
    """Joints of a humanoid by standard name, in lower case.

    Parameters
    ----------
    skeleton : Skeleton
    joints : mapping of str to int
    """

    skeleton: Skeleton
    joints: Mapping[str, int]

    @classmethod
    def of_skeleton(cls, skeleton: Skeleton) -> Humanoid | None:
        """Joints of a skeleton; None where one of :data:`NEEDED` is missing."""
        names = [name.rpartition(":")[2].lower() for name in skeleton.names]
        known = {name: joint for joint, name in reversed(list(enumerate(names)))}
        return cls(skeleton, known) if all(name in known for name in NEEDED) else None

    def trunk(self) -> list[int]:
        """Joints from the hips to the neck."""
        chain = self.skeleton.chain(self.joints["neck"]).tolist()
        return list(chain[chain.index(self.joints["hips"]) :])

    def tip(self, joint: int) -> F64 | None:
        """Offset (3,) of the end of a bone whose joint is the last one: its tip, or the mean of its children."""
        tips = self.skeleton.tip_offsets[self.skeleton.tip_parents == joint]
        below = self.skeleton.offsets[self.skeleton.parents == joint]
        ends = tips if len(tips) else below
        return np.asarray(ends.mean(axis=0), np.float64) if len(ends) else None
