"""The body model of the pose solver: skeleton, rest pose, stiffness, limits and masses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, I64, Floats
from verbs.kernels import fk
from verbs.skeleton import Skeleton

__all__ = ["Figure", "Pose", "skeleton_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """One pose: root position and local rotations.

    Parameters
    ----------
    root : (3,) float64
        Position of the root, metres.
    rotations : (J, 4) float64
        Local rotations, unit quaternions.
    """

    root: F64
    rotations: F64


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """The body model of the pose solver.

    Parameters
    ----------
    skeleton : Skeleton
        The joints.
    rest : Pose
        The rest pose.
    stiffness : (J, 3) float64
        Cost of one radian about each joint's own axes; 0 where the joint is locked.
    lower, upper : (J, 3) float64
        Soft limits of the rotation vector about the rest pose, radians.
    mass_shares : (J,) float64
        Weights of the joint positions whose sum is the centre of mass; they sum to 1.
    """

    skeleton: Skeleton
    rest: Pose
    stiffness: F64
    lower: F64
    upper: F64
    mass_shares: F64

    def joints(self, *names: str) -> I64:
        """Indices of the named joints."""
        return np.array([self.skeleton.index(name) for name in names], np.int64)

    def forward(self, pose: Pose) -> tuple[F64, F64]:
        """Global rotations (J, 4) and positions (J, 3) of a pose."""
        return fk.forward(pose.root, pose.rotations, self.skeleton.parents, self.skeleton.offsets)

    def centre_of_mass(self, positions: Floats) -> F64:
        """Centre of mass (..., 3) of joint positions (..., J, 3)."""
        return np.asarray(np.einsum("j,...jk->...k", self.mass_shares, positions))


def skeleton_of(
    joints: Mapping[str, tuple[str | None, tuple[float, float, float]]], tips: Mapping[str, tuple[float, float, float]]
) -> Skeleton:
    """Skeleton of joints, each with its parent (None: the root) and offset in metres, and of the tips of some."""
    names = tuple(joints)
    ends = [name for name in names if name in tips]
    return Skeleton(
        names=names,
        parents=np.array([-1 if parent is None else names.index(parent) for parent, _ in joints.values()], np.int64),
        offsets=np.array([offset for _, offset in joints.values()]),
        tip_parents=np.array([names.index(name) for name in ends], np.int64),
        tip_offsets=np.array([tips[name] for name in ends]),
    )
