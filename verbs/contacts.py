"""Contacts of a verb's feet with the ground: points of feet, and when each stands in each example."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F32, F64, I64, freeze
from verbs.errors import IllPosedVerb

__all__ = ["MAX_INTERVALS", "MAX_POINTS", "PARTS", "Contacts"]

PARTS = ("heel", "ball", "toe", "foot")
"""Parts of a foot by number; ``foot`` is the one point of a foot without a toe joint."""

MAX_POINTS, MAX_INTERVALS = 64, 1_000_000
"""Most contact points of a verb, and most intervals of all its points and examples."""


def _check(holds: bool, problem: str) -> None:
    if not holds:
        raise IllPosedVerb(f"contacts: {problem}")


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """When points of the feet stand on the ground.

    The contact of a blend is Σ wᵢ valuesᵢ over canonical time, clipped to [0, 1]
    (:func:`verbs.kernels.contacts.contact`); a point stands where it is above 1/2.

    Parameters
    ----------
    feet : (P,) int64
        Joint that is the foot (the ankle) of each point.
    joints : (P,) int64
        Joint that carries each point.
    parts : (P,) int64
        Indices of :data:`PARTS`.
    offsets : (P, 3) float64
        Position of each point in the frame of its joint, metres.
    heights : (N, P) float64
        Height of each point while it stands, metres: the ground, and the thickness of the sole. In a verb that climbs,
        it is measured from the example's inclined plane (:func:`verbs.kernels.contacts.gradient`), along its normal.
    values : (K + 1, N, P) float32
        Contact at canonical time k / K: 1 while the point stands, 0 while it does not, with smooth ramps that are 1/2
        where an interval begins or ends.
    intervals : (R, 2) float64
        Canonical time at which each contact begins and ends; beyond 1 where it ends in the next cycle of a loop. A
        point of a loop that always stands has the interval 0 to 1.
    owners : (R, 2) int64
        Example and point of each interval, in rising order.

    Raises
    ------
    IllPosedVerb
        If shapes disagree or a number is out of its bounds.
    """

    feet: I64
    joints: I64
    parts: I64
    offsets: F64
    heights: F64
    values: F32
    intervals: F64
    owners: I64

    def __post_init__(self) -> None:
        freeze(self)
        points = self.feet.shape[0] if self.feet.ndim == 1 else 0
        _check(1 <= points <= MAX_POINTS, f"there are 1 to {MAX_POINTS} points")
        _check(self.joints.shape == self.parts.shape == (points,), "joints and parts must be one per point")
        _check(self.offsets.shape == (points, 3), "offsets must be points × 3")
        _check(bool(np.all((self.parts >= 0) & (self.parts < len(PARTS)))), "unknown part")
        _check(len(set(zip(self.feet.tolist(), self.parts.tolist(), strict=True))) == points, "a point stands twice")
        _check(self.values.ndim == 3 and self.values.shape[2] == points, "values must be keys × examples × points")
        _check(bool(np.all((self.values >= 0) & (self.values <= 1))), "values must lie in 0 to 1")
        _check(self.heights.shape == self.values.shape[1:], "heights must be examples × points")
        _check(bool(np.isfinite(self.heights).all() and np.isfinite(self.offsets).all()), "a number is not finite")
        self._check_intervals(points)

    def _check_intervals(self, points: int) -> None:
        count, examples = len(self.intervals), self.values.shape[1]
        _check(count <= MAX_INTERVALS, f"there are at most {MAX_INTERVALS} intervals")
        _check(self.intervals.shape == self.owners.shape == (count, 2), "intervals and owners must be two columns")
        begins, ends = self.intervals[:, 0], self.intervals[:, 1]
        fits = (begins >= 0) & (begins < 1) & (ends > begins) & (ends <= begins + 1)
        _check(bool(fits.all()), "an interval does not begin in 0 to 1 or does not end within a cycle")
        inside = bool(np.all((self.owners >= 0) & (self.owners < np.array([examples, points]))))
        _check(inside, "an interval of an example or a point that does not exist")
        order = self.owners[:, 0] * points + self.owners[:, 1]
        same = np.diff(order) == 0
        _check(bool(np.all(np.diff(order) >= 0)), "intervals must be in the order of examples and points")
        _check(bool(np.all(begins[1:][same] >= ends[:-1][same])), "two intervals of a point overlap")

    def __len__(self) -> int:
        return len(self.feet)

    def of(self, example: int, point: int) -> F64:
        """Intervals (R, 2) of one point in one example, canonical time."""
        chosen = (self.owners[:, 0] == example) & (self.owners[:, 1] == point)
        return np.ascontiguousarray(self.intervals[chosen])

    def subset(self, examples: I64) -> Contacts:
        """Contacts of some of the examples, in the given order."""
        rows = [np.flatnonzero(self.owners[:, 0] == example) for example in examples]
        owners = [np.stack([np.full(len(row), k), self.owners[row, 1]], axis=1) for k, row in enumerate(rows)]
        return Contacts(
            self.feet, self.joints, self.parts, self.offsets, self.heights[examples], self.values[:, examples],
            self.intervals[np.concatenate(rows)], np.concatenate(owners),
        )  # fmt: skip
