"""Skeleton and forward kinematics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from adverb_client import quat
from adverb_client.errors import DecodeError

__all__ = ["MAX_JOINTS", "Skeleton", "Space"]

Space = Literal["local", "global"]
F64 = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.floating[Any]]

MAX_JOINTS = 65_535
"""Largest number of joints that is accepted."""


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """Joints, parents before children.

    Parameters
    ----------
    names : tuple of str
        Names of the J joints.
    parents : (J,) int64
        Index of each joint's parent; -1 for the root, which is the first.
    offsets : (J, 3) float64
        Position in the parent's frame, metres.
    tip_parents : (T,) int64
        Joints that end in a tip (fingers, toes, crown); empty in a stream.
    tip_offsets : (T, 3) float64
        Position of each tip in its joint's frame, metres.

    Attributes
    ----------
    levels : tuple of (…) int64
        Joints at equal depth, from the root's children on; each level is one vectorised step.
    """

    names: tuple[str, ...]
    parents: npt.NDArray[np.int64]
    offsets: F64
    tip_parents: npt.NDArray[np.int64]
    tip_offsets: F64
    levels: tuple[npt.NDArray[np.int64], ...] = field(init=False)

    def __post_init__(self) -> None:
        depths = np.zeros(len(self.names), np.int64)
        for joint in range(1, len(depths)):
            depths[joint] = depths[self.parents[joint]] + 1
        deepest = int(depths.max(initial=0))
        object.__setattr__(self, "levels", tuple(np.flatnonzero(depths == k) for k in range(1, deepest + 1)))

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Index of a joint.

        Raises
        ------
        KeyError
            If the name does not exist.
        """
        if name not in self.names:
            raise KeyError(f"no joint {name!r}; known: {', '.join(self.names)}")
        return self.names.index(name)

    def global_rotations(self, rotations: Numbers) -> F64:
        """Global rotations (..., J, 4) of local rotations (..., J, 4)."""
        found = np.array(self._checked(rotations), np.float64)
        for level in self.levels:
            found[..., level, :] = quat.mul(found[..., self.parents[level], :], found[..., level, :])
        return found

    def positions(self, root: Numbers, rotations: Numbers, space: Space = "local") -> F64:
        """Positions of all joints.

        Parameters
        ----------
        root : (..., 3)
            Position of the root joint, metres.
        rotations : (..., J, 4)
            Rotations of all joints, in the skeleton's order.
        space : str
            Whether the rotations are local to the parent or global.

        Returns
        -------
        (..., J, 3) float64
            Metres.

        Raises
        ------
        ValueError
            If there are not as many rotations as joints.
        """
        turned = self.global_rotations(rotations) if space == "local" else self._checked(rotations)
        steps = quat.rotate(turned[..., self.parents, :], self.offsets)
        positions = np.empty((*turned.shape[:-1], 3))
        positions[..., 0, :] = root
        for level in self.levels:
            positions[..., level, :] = positions[..., self.parents[level], :] + steps[..., level, :]
        return positions

    def tips(self, root: Numbers, rotations: Numbers, space: Space = "local") -> F64:
        """Positions (..., T, 3) of the tips, metres; arguments as of :meth:`positions`."""
        turned = self.global_rotations(rotations) if space == "local" else self._checked(rotations)
        positions = self.positions(root, turned, "global")
        return positions[..., self.tip_parents, :] + quat.rotate(turned[..., self.tip_parents, :], self.tip_offsets)

    def _checked(self, rotations: Numbers) -> Numbers:
        if rotations.shape[-2:] != (len(self), 4):
            raise ValueError(
                f"expected rotations of all {len(self)} joints, (…, {len(self)}, 4), not {rotations.shape}"
            )
        return rotations

    @classmethod
    def from_json(cls, fields: Mapping[str, Any]) -> Skeleton:
        """The skeleton of a JSON object.

        Raises
        ------
        DecodeError
            If the object is not a valid skeleton.
        """
        try:
            names = tuple(str(name) for name in fields["names"])
            parents = np.asarray(fields["parents"], np.int64).reshape(len(names))
            _check_parents(parents)
            tips: Sequence[Mapping[str, Any]] = fields.get("tips", ())
            found = cls(
                names,
                parents,
                np.asarray(fields["offsets"], np.float64).reshape(len(names), 3),
                np.asarray([tip["parent"] for tip in tips], np.int64).reshape(len(tips)),
                np.asarray([tip["offset"] for tip in tips], np.float64).reshape(len(tips), 3),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
            raise DecodeError(f"not a skeleton: {err}") from err
        _check(found)
        return found


def _check_parents(parents: npt.NDArray[np.int64]) -> None:
    """Check that parents precede their children, as forward kinematics requires."""
    count = len(parents)
    if not 1 <= count <= MAX_JOINTS:
        raise DecodeError(f"a skeleton of {count} joints; expected 1 to {MAX_JOINTS}")
    if parents[0] != -1 or (parents[1:] < 0).any() or (parents >= np.arange(count)).any():
        raise DecodeError("a skeleton whose parents do not precede their children")


def _check(found: Skeleton) -> None:
    if ((found.tip_parents < 0) | (found.tip_parents >= len(found))).any():
        raise DecodeError("a skeleton with a tip whose joint does not exist")
    if not (np.isfinite(found.offsets).all() and np.isfinite(found.tip_offsets).all()):
        raise DecodeError("a skeleton with offsets that are not finite")
