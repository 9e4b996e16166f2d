"""Effector positions and errors of poses, computed from the description of the verb, independent of the server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Effector"]

Numbers = npt.NDArray[np.float64]
AXES = ["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class Effector:
    """An effector's chain of joints, and the phase at which it is measured.

    Parameters
    ----------
    joints : int
    chain : list of int
        Joints from the root to the effector's parent.
    offsets : (L, 3) float64
        Position of the next joint of the chain in each joint's frame, metres.
    phase : float
        Canonical time at which it is measured.
    """

    joints: int
    chain: list[int]
    offsets: Numbers
    phase: float

    @classmethod
    def of(cls, verb: Mapping[str, Any]) -> Effector | None:
        """The effector of a verb of ``GET /v1/verbs/{verb}``; None if its adverbs are not x, y, z of a joint."""
        measure, skeleton = verb["measure"], verb["skeleton"]
        if measure["kind"] != "joint_position" or measure["adverbs"] != AXES:
            return None
        parents, joint = skeleton["parents"], skeleton["names"].index(measure["effector"])
        path = [joint]
        while parents[path[0]] >= 0:
            path.insert(0, parents[path[0]])
        return cls(
            len(parents),
            path[:-1],
            np.array([skeleton["offsets"][below] for below in path[1:]], np.float64).reshape(-1, 3),
            verb["keytime_phases"][verb["keytime_names"].index(measure["keytime"])],
        )

    def points(self, root: Numbers, rotations: Numbers) -> Numbers:
        """Position of the effector (..., 3) in poses of root (..., 3) and local rotations (..., J, 4)."""
        position, rotation = root, None
        for joint, offset in zip(self.chain, self.offsets, strict=True):
            own = rotations[..., joint, :]
            rotation = own if rotation is None else _mul(rotation, own)
            position = position + _rotate(rotation, offset)
        return position

    def global_points(self, root: Numbers, rotations: Numbers) -> Numbers:
        """The same from global rotations."""
        position = root
        for joint, offset in zip(self.chain, self.offsets, strict=True):
            position = position + _rotate(rotations[..., joint, :], offset)
        return position

    def errors(self, goals: Numbers, root: Numbers, rotations: Numbers) -> Numbers:
        """Distance (...,) between goals (..., 3) and the effector."""
        return np.asarray(np.linalg.norm(self.points(root, rotations) - goals, axis=-1))


def _mul(a: Numbers, b: Numbers) -> Numbers:
    """Product of quaternions x, y, z, w."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    scalar = a[..., 3:] * b[..., 3:] - np.sum(a[..., :3] * b[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def _rotate(q: Numbers, v: Numbers) -> Numbers:
    """A vector rotated by quaternions."""
    cross = 2.0 * np.cross(q[..., :3], v)
    return np.asarray(v + q[..., 3:] * cross + np.cross(q[..., :3], cross))
