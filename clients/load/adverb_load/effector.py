"""What poses reach, measured again from what a client knows: the skeleton, and which joint is measured when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Reach"]

Numbers = npt.NDArray[np.float64]
AXES = ["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class Reach:
    """How far an effector is from where it was asked to be.

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
    def of(cls, verb: Mapping[str, Any]) -> Reach | None:
        """Of a verb as ``GET /v1/verbs/{verb}`` tells of it; None where its adverbs are not an effector's x, y, z."""
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
        """Where the effector is, (..., 3), in poses of root (..., 3) and local rotations (..., J, 4)."""
        place, turn = root, None
        for joint, offset in zip(self.chain, self.offsets, strict=True):
            own = rotations[..., joint, :]
            turn = own if turn is None else _mul(turn, own)
            place = place + _turned(turn, offset)
        return place

    def errors(self, asked: Numbers, root: Numbers, rotations: Numbers) -> Numbers:
        """Distance (...,) between asked places (..., 3) and the effector."""
        return np.asarray(np.linalg.norm(self.points(root, rotations) - asked, axis=-1))


def _mul(a: Numbers, b: Numbers) -> Numbers:
    """Product of quaternions x, y, z, w."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    scalar = a[..., 3:] * b[..., 3:] - np.sum(a[..., :3] * b[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def _turned(q: Numbers, v: Numbers) -> Numbers:
    """A vector turned by quaternions."""
    cross = 2.0 * np.cross(q[..., :3], v)
    return np.asarray(v + q[..., 3:] * cross + np.cross(q[..., :3], cross))
