"""Arrays with a row per character: rows are taken, given back, and made more of; and what a frame of some is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels import character_state
from verbs.runtime.evaluate import Blend
from verbs.verb import Verb

__all__ = ["Frames", "Slots"]

_LEAST = 16


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """One frame of B characters.

    Parameters
    ----------
    blend : Blend
    ends : (B, 8) float64
        Phase, seconds and more, see :mod:`verbs.kernels.character_state`.
    root : (B, 3) float64
        In the world, metres.
    rotations : (B, J, 4) float64
        Local; the root's in the world.
    in_transition : (B,) bool
    """

    blend: Blend
    ends: F64
    root: F64
    rotations: F64
    in_transition: npt.NDArray[np.bool_]


class Slots:
    """What is kept of each character of a verb; C rows, of which some are free.

    Parameters
    ----------
    verb : Verb

    Attributes
    ----------
    state : (C, 13) float64
        See :mod:`verbs.kernels.character_state`.
    asked : (C, D) float64
        Goals: adverbs.
    """

    state: F64
    asked: F64
    _shown: F64
    _velocity: F64
    _offsets: F64
    _last: F64
    _weights: F64
    _measured: F64
    _error: F64
    _clamped: F64
    _known: I64
    _seen: F64
    _used: I64

    def __init__(self, verb: Verb) -> None:
        self.verb = verb
        self._free: list[int] = []
        self._grow(_LEAST)

    def __len__(self) -> int:
        return len(self.state) - len(self._free)

    def taken(self) -> I64:
        """Slots of all characters, in order."""
        return np.flatnonzero(self._used)

    def errors(self, slots: I64) -> F64:
        """How far off what was asked (B,) they are shown, metres; NaN before its first frame and out of the domain."""
        told = (self._known[slots] == 1) & (self._clamped[slots] == 0.0)
        return np.where(told, self._error[slots], np.nan)

    def restless(self, slots: I64) -> int:
        """How many of these have to be blended anew in their next step, or held at their goals: that is more work."""
        moving = (self.asked[slots] != self._seen[slots]) | (self._velocity[slots] != 0.0)
        alone = (self._known[slots] == 0) | (self.state[slots, character_state.SHARE] > 0.0)
        return int(np.count_nonzero(moving.any(axis=1) | alone))

    def remove(self, slot: int) -> None:
        """Forget a character; its slot will be another's."""
        self._free.append(slot)
        self._used[slot] = 0

    def _take(self) -> int:
        """A free slot, its state zeroed."""
        if not self._free:
            self._grow(2 * len(self.state))
        slot = self._free.pop()
        self.state[slot] = 0.0
        self._used[slot] = 1
        return slot

    def _grow(self, capacity: int) -> None:
        """Make room for so many characters."""
        dims, joints, count = len(self.verb.adverbs), len(self.verb.skeleton), len(self.verb.examples)
        had = len(getattr(self, "state", ()))
        for name, shape in (
            ("state", (character_state.COLUMNS,)),
            ("asked", (dims,)),
            ("_shown", (dims,)),
            ("_velocity", (dims,)),
            ("_offsets", (2, 3 + 3 * joints)),
            ("_last", (2, 3 + 4 * joints)),
            ("_weights", (count,)),
            ("_measured", (len(self.verb.measure.axes),)),
            ("_error", ()),
            ("_clamped", ()),
            ("_known", ()),
            ("_seen", (dims,)),
            ("_used", ()),
        ):
            larger = np.zeros((capacity, *shape), np.int64 if name in ("_known", "_used") else np.float64)
            if had:
                larger[:had] = getattr(self, name)
            setattr(self, name, larger)
        self._free.extend(range(capacity - 1, had - 1, -1))
