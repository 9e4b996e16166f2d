"""Arrays with a row per character, which grow with their number; and frames of some characters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels.character_state import CHARACTER, Records
from verbs.runtime.evaluate import Blend
from verbs.verb import Verb

__all__ = ["CharacterPool", "Frames"]

_LEAST = 16


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """One frame of B characters.

    Parameters
    ----------
    blend : Blend
    progress : (B,) of :data:`verbs.kernels.character_state.PROGRESS`
        Phase, seconds, and what the step passed.
    root : (B, 3) float64
        In the world, metres.
    rotations : (B, J, 4) float64
        Local; the root's in the world.
    in_transition : (B,) bool
    """

    blend: Blend
    progress: Records
    root: F64
    rotations: F64
    in_transition: npt.NDArray[np.bool_]


class CharacterPool:
    """State of each character of a verb; C rows, of which some are free.

    Parameters
    ----------
    verb : Verb

    Attributes
    ----------
    state : (C,) of :data:`verbs.kernels.character_state.CHARACTER`
    goals : (C, D) float64
        Adverbs.
    """

    state: Records
    goals: F64
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
        """Errors (B,) of displayed poses, metres; NaN before the first frame and outside the domain."""
        measured = (self._known[slots] == 1) & (self._clamped[slots] == 0.0)
        return np.where(measured, self._error[slots], np.nan)

    def restless(self, slots: I64) -> int:
        """How many of these need new weights in their next step, or follow their goals: both are more work."""
        moving = (self.goals[slots] != self._seen[slots]) | (self._velocity[slots] != 0.0)
        alone = (self._known[slots] == 0) | (self.state["share"][slots] > 0.0)
        return int(np.count_nonzero(moving.any(axis=1) | alone))

    def remove(self, slot: int) -> None:
        """Remove a character; its slot is free for another."""
        self._free.append(slot)
        self._used[slot] = 0

    def _take(self) -> int:
        """A free slot, its state zeroed."""
        if not self._free:
            self._grow(2 * len(self.state))
        slot = self._free.pop()
        self.state[slot] = np.zeros((), CHARACTER)
        self._used[slot] = 1
        return slot

    def _grow(self, capacity: int) -> None:
        """Make room for so many characters."""
        dims, joints, count = len(self.verb.adverbs), len(self.verb.skeleton), len(self.verb.examples)
        had = len(getattr(self, "state", ()))
        dtypes: dict[str, npt.DTypeLike] = {"state": CHARACTER, "_known": np.int64, "_used": np.int64}
        for name, shape in (
            ("state", ()),
            ("goals", (dims,)),
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
            larger = np.zeros((capacity, *shape), dtypes.get(name, np.float64))
            if had:
                larger[:had] = getattr(self, name)
            setattr(self, name, larger)
        self._free.extend(range(capacity - 1, had - 1, -1))
