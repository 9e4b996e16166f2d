"""A skeleton, and where its joints are in a pose (forward kinematics)."""

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
"""More joints than this are a mistake."""


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """Joints, parents before children.

    Parameters
    ----------
    names : tuple of str
        J of them.
    parents : (J,) int64
        Index of each joint's parent; -1 for the root, which is the first.
    offsets : (J, 3) float64
        Position in the parent's frame, metres.
    tip_parents : (T,) int64
        Joints that end in a tip (fingers, toes, crown); a stream tells none.
    tip_offsets : (T, 3) float64
        Position of each tip in its joint's frame, metres.

    Attributes
    ----------
    levels : tuple of (…) int64
        Joints that are equally far from the root, from its children on: each level is computed in one go.
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
            If there is none of this name.
        """
        if name not in self.names:
            raise KeyError(f"no joint {name!r}; known: {', '.join(self.names)}")
        return self.names.index(name)

    def global_rotations(self, rotations: Numbers) -> F64:
        """Local rotations (..., J, 4) → rotations (..., J, 4) in the verb's space."""
        turns = np.array(self._checked(rotations), np.float64)
        for level in self.levels:
            turns[..., level, :] = quat.mul(turns[..., self.parents[level], :], turns[..., level, :])
        return turns

    def positions(self, root: Numbers, rotations: Numbers, space: Space = "local") -> F64:
        """Positions of all joints.

        Parameters
        ----------
        root : (..., 3)
            Position of the root joint, metres.
        rotations : (..., J, 4)
            Of all joints, in the skeleton's order.
        space : str
            What the rotations are: local to the parent, or global.

        Returns
        -------
        (..., J, 3) float64
            Metres.

        Raises
        ------
        ValueError
            If the rotations are not those of all joints.
        """
        turns = self.global_rotations(rotations) if space == "local" else self._checked(rotations)
        steps = quat.rotate(turns[..., self.parents, :], self.offsets)
        places = np.empty((*turns.shape[:-1], 3))
        places[..., 0, :] = root
        for level in self.levels:
            places[..., level, :] = places[..., self.parents[level], :] + steps[..., level, :]
        return places

    def tips(self, root: Numbers, rotations: Numbers, space: Space = "local") -> F64:
        """Positions (..., T, 3) of the tips, metres; arguments as of :meth:`positions`."""
        turns = self.global_rotations(rotations) if space == "local" else self._checked(rotations)
        places = self.positions(root, turns, "global")
        return places[..., self.tip_parents, :] + quat.rotate(turns[..., self.tip_parents, :], self.tip_offsets)

    def _checked(self, rotations: Numbers) -> Numbers:
        if rotations.shape[-2:] != (len(self), 4):
            raise ValueError(f"rotations of all {len(self)} joints are needed, (…, {len(self)}, 4): {rotations.shape}")
        return rotations

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Skeleton:
        """What the server tells about a skeleton.

        Raises
        ------
        DecodeError
            If it is no skeleton.
        """
        try:
            names = tuple(str(name) for name in told["names"])
            parents = np.asarray(told["parents"], np.int64).reshape(len(names))
            _check_parents(parents)
            tips: Sequence[Mapping[str, Any]] = told.get("tips", ())
            found = cls(
                names,
                parents,
                np.asarray(told["offsets"], np.float64).reshape(len(names), 3),
                np.asarray([tip["parent"] for tip in tips], np.int64).reshape(len(tips)),
                np.asarray([tip["offset"] for tip in tips], np.float64).reshape(len(tips), 3),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
            raise DecodeError(f"this is no skeleton: {err}") from err
        _check(found)
        return found


def _check_parents(parents: npt.NDArray[np.int64]) -> None:
    """Refuse what forward kinematics could not walk through."""
    count = len(parents)
    if not 1 <= count <= MAX_JOINTS:
        raise DecodeError(f"a skeleton of {count} joints; expected 1 to {MAX_JOINTS}")
    if parents[0] != -1 or (parents[1:] < 0).any() or (parents >= np.arange(count)).any():
        raise DecodeError("a skeleton whose parents do not come before their children")


def _check(found: Skeleton) -> None:
    if ((found.tip_parents < 0) | (found.tip_parents >= len(found))).any():
        raise DecodeError("a skeleton with a tip of no joint")
    if not (np.isfinite(found.offsets).all() and np.isfinite(found.tip_offsets).all()):
        raise DecodeError("a skeleton with offsets that are not finite")
