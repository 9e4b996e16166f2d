"""Where a motion is in the world: a turn about +Y and a shift on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from adverb_client import quat

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """World = turn · local + shift.

    Parameters
    ----------
    yaw_rad : float
        About +Y; positive turns +Z to +X.
    shift : (3,)
        Metres; y is 0.
    """

    yaw_rad: float
    shift: F64

    @classmethod
    def between(cls, world_root: F64, world_rotation: F64, local_root: F64, local_rotation: F64) -> Placement:
        """The placement that brings a root of a verb (3,), (4,) to one in the world; exact for the same pose."""
        inverse = np.asarray(local_rotation, np.float64) * [-1.0, -1.0, -1.0, 1.0]
        turn = quat.mul(np.asarray(world_rotation, np.float64), inverse)
        yaw = yaw_of(turn)
        shift = np.asarray(world_root, np.float64) - quat.rotate(about_y(yaw), np.asarray(local_root, np.float64))
        return cls(yaw, shift * [1.0, 0.0, 1.0])

    def local(self, point: F64) -> F64:
        """A point of the world (3,) in the frame of the motion."""
        return np.asarray(quat.rotate(about_y(-self.yaw_rad), point - self.shift))

    def world(self, point: F64) -> F64:
        """A point of the motion (3,) in the world."""
        return np.asarray(quat.rotate(about_y(self.yaw_rad), point) + self.shift)


def about_y(yaw_rad: float) -> F64:
    """A rotation (4,) about +Y."""
    return np.array([0.0, math.sin(0.5 * yaw_rad), 0.0, math.cos(0.5 * yaw_rad)])


def yaw_of(rotation: F64) -> float:
    """The turn about +Y that a rotation (4,) contains, −π to π."""
    return math.remainder(2.0 * math.atan2(float(rotation[1]), float(rotation[3])), 2.0 * math.pi)
