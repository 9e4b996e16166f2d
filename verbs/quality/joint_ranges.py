"""Ranges of joints: the box of rotation vectors that all frames of all examples span."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import quat
from verbs.quality.samples import Sample

__all__ = ["Ranges"]

RIGID_RAD = 1e-3
"""A joint whose rotation vectors vary less than this in all examples is rigid."""


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """Box of each joint but two kinds: the root, whose rotation is a heading, and joints that no example moves.

    Captures often have rigid toes. Planting bends them, and the examples have no information on how far they bend.

    Rotation vectors are those of the rotation from the verb's reference rotation of the joint, so that they stay far
    from half a turn.

    Parameters
    ----------
    references : (J, 4) float64
    low, high : (J, 3) float64
        Radians; infinite where a joint has no box.
    """

    references: F64
    low: F64
    high: F64

    @classmethod
    def of_samples(cls, references: F64, examples: Sequence[Sample]) -> Ranges:
        """Box that the motions of all examples span."""
        vectors = [_vectors(references, one.rotations) for one in examples]
        low = np.min([rows.min(axis=0) for rows in vectors], axis=0)
        high = np.max([rows.max(axis=0) for rows in vectors], axis=0)
        free = np.all(high - low < RIGID_RAD, axis=1)
        free[0] = True
        low[free], high[free] = -np.inf, np.inf
        return cls(references, low, high)

    def excess(self, rotations: F64) -> F64:
        """How far joints leave their box, (F, J), radians: the length of what is outside, at local rotations."""
        vectors = _vectors(self.references, rotations)
        beyond = np.maximum(np.maximum(vectors - self.high, self.low - vectors), 0.0)
        return np.asarray(np.linalg.norm(beyond, axis=-1), np.float64)


def _vectors(references: F64, rotations: F64) -> F64:
    """Rotation vectors (F, J, 3) from the references to local rotations (F, J, 4), radians."""
    return np.asarray(quat.log(quat.mul(quat.conjugate(references), rotations)), np.float64)
