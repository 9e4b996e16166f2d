"""The joints of a character: names, parents, offsets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from verbs.conventions import F64, I64, MAX_JOINTS, freeze
from verbs.errors import SkeletonMismatch, UnknownName

_NO_TIPS = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """A tree of joints in depth-first order.

    Parameters
    ----------
    names : tuple of str, length J
        Unique joint names, the root first.
    parents : (J,) int64
        Index of each joint's parent, smaller than its own; -1 for the root.
    offsets : (J, 3) float64
        Position of each joint in its parent's frame in the rest pose, metres. The root's is zero.
    tip_parents : (T,) int64
        Joints that end in a tip without rotation of its own (BVH's End Site): fingers, toes, crown.
    tip_offsets : (T, 3) float64
        Position of each tip in its joint's frame, metres.

    Raises
    ------
    SkeletonMismatch
        If lengths disagree, a name stands twice, or a parent does not stand before its child.
    """

    names: tuple[str, ...]
    parents: I64
    offsets: F64
    tip_parents: I64 = field(default_factory=lambda: _NO_TIPS)
    tip_offsets: F64 = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        freeze(self)
        count = len(self.names)
        if not 1 <= count <= MAX_JOINTS:
            raise SkeletonMismatch(f"a skeleton has 1 to {MAX_JOINTS} joints, not {count}")
        if self.parents.shape != (count,) or self.offsets.shape != (count, 3):
            raise SkeletonMismatch(
                f"{count} joint names, but parents {self.parents.shape} and offsets {self.offsets.shape}"
            )
        if self.tip_offsets.shape != (len(self.tip_parents), 3):
            raise SkeletonMismatch("tip_parents and tip_offsets differ in length")
        if len(set(self.names)) != count:
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise SkeletonMismatch(f"joint name '{twice}' stands twice")
        order = np.arange(count)
        if self.parents[0] != -1 or np.any(self.parents[1:] < 0) or np.any(self.parents >= order):
            raise SkeletonMismatch("each joint's parent must stand before it, and only the first is a root")
        if len(self.tip_parents) and not (0 <= self.tip_parents.min() <= self.tip_parents.max() < count):
            raise SkeletonMismatch("a tip belongs to a joint that does not exist")
        if not (np.isfinite(self.offsets).all() and np.isfinite(self.tip_offsets).all()):
            raise SkeletonMismatch("an offset is not finite")

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Index of a joint by name; raises :class:`UnknownName` with the names that exist."""
        try:
            return self.names.index(name)
        except ValueError:
            raise UnknownName("joint", name, self.names) from None

    def chain(self, joint: int) -> I64:
        """Joint indices from the root down to ``joint``, both included."""
        links = []
        while joint >= 0:
            links.append(joint)
            joint = int(self.parents[joint])
        return np.array(links[::-1], np.int64)

    def difference(self, other: Skeleton, *, tolerance_m: float = 1e-4) -> str | None:
        """How another skeleton differs from this one, or None where they are the same.

        Offsets may differ by ``tolerance_m`` (files round), names and parents not at all.
        """
        if self.names != other.names:
            missing = [name for name in self.names if name not in other.names]
            extra = [name for name in other.names if name not in self.names]
            if missing or extra:
                parts = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"adds {', '.join(extra)}"] * bool(extra)
                return "; ".join(parts)
            return "has the same joints in another order"
        if not np.array_equal(self.parents, other.parents):
            joint = int(np.argmax(self.parents != other.parents))
            return f"gives joint '{self.names[joint]}' another parent"
        gaps = np.abs(self.offsets - other.offsets).max(axis=1)
        if gaps.max() > tolerance_m:
            joint = int(np.argmax(gaps))
            return f"has joint '{self.names[joint]}' at an offset that differs by {gaps[joint] * 1000:.1f} mm"
        return None
