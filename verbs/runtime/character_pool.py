"""Arrays with a row per character, which grow with their number; and what a step of some characters gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels.character_state import CHARACTER, Crowd, Records
from verbs.kernels.foot_state import FOOT
from verbs.kernels.legs import COMMAND
from verbs.runtime.evaluate import Blend
from verbs.verb import Verb

__all__ = ["CharacterPool", "Frames", "Step"]

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


class Step(NamedTuple):
    """What a step did to B characters.

    Parameters
    ----------
    progress : (B,) of :data:`verbs.kernels.character_state.PROGRESS`
    error : (B,) float64
    clamped, in_transition : (B,) bool
    complete : (P,) int64
        Numbers of the characters whose poses are sums of curves alone, at state, weights and ``Characters.curves``.
    rest : (R,) int64
        Numbers of the others, which are in a transition or follow a goal.
    weights, root, rotations : (R, N), (R, 3), (R, J, 4) float64
        Weights and poses of these, in the world.
    """

    progress: Records
    error: F64
    clamped: npt.NDArray[np.bool_]
    in_transition: npt.NDArray[np.bool_]
    complete: I64
    rest: I64
    weights: F64
    root: F64
    rotations: F64


class StoredFrames:
    """Frames of the characters that are in a transition or follow a goal: S rows, of which some are free.

    Other characters' frames are computed again when a transition needs them, from what ``state`` remembers.

    Attributes
    ----------
    frames : (S, 2, 3 + 4·J) float64
        The last two frames, latest last: root position, then rotations.
    offsets : (S, 2, 3 + 3·J + 5·F) float64
        See :func:`verbs.kernels.inertialization.begin`.
    """

    def __init__(self, joints: int, feet: int) -> None:
        self.frames, self.offsets = np.zeros((0, 2, 3 + 4 * joints)), np.zeros((0, 2, 3 + 3 * joints + 5 * feet))
        self._free: list[int] = []

    def take(self, count: int) -> I64:
        """So many free rows."""
        while len(self._free) < count:
            had = len(self.frames)
            for name in ("frames", "offsets"):
                setattr(self, name, larger(getattr(self, name), max(_LEAST, 2 * had)))
            self._free.extend(range(len(self.frames) - 1, had - 1, -1))
        return np.array([self._free.pop() for _ in range(count)], np.int64)

    def release(self, rows: I64) -> None:
        """Make rows free."""
        self._free.extend(rows.tolist())


class CharacterPool:
    """State of each character of a verb; C rows, of which some are free.

    Parameters
    ----------
    verb : Verb
    feet : int
        Number of feet that can be planted.

    Attributes
    ----------
    crowd : Crowd
        Everything but the frames of characters in transition.
    stored : StoredFrames
    """

    def __init__(self, verb: Verb, feet: int) -> None:
        self.verb = verb
        dims, count, keytimes = len(verb.adverbs), len(verb.examples), len(verb.phases)
        points, times = (np.zeros((0, dims)) for _ in range(5)), (np.zeros((0, keytimes)) for _ in range(2))
        weights, measured = np.zeros((0, 3, count)), np.zeros((0, len(verb.measure.axes)))
        columns = (
            *points, weights, *times, measured, np.zeros(0), np.zeros(0), np.zeros((0, feet), FOOT),
            np.zeros((0, 2, feet, len(COMMAND))),
        )  # fmt: skip
        self.crowd = Crowd._make((np.zeros(0, CHARACTER), np.zeros(0, np.int64), *columns))
        self.stored = StoredFrames(len(verb.skeleton), feet)
        self._used = np.zeros(0, np.bool_)
        self._free: list[int] = []
        self._grow(_LEAST)

    def __len__(self) -> int:
        return len(self._used) - len(self._free)

    @property
    def state(self) -> Records:
        """State (C,) of :data:`verbs.kernels.character_state.CHARACTER`."""
        return self.crowd.state

    @property
    def goals(self) -> F64:
        """Adverbs (C, D) that the characters move to; rows may be written between two steps."""
        return self.crowd.goals

    def taken(self) -> I64:
        """Slots of all characters, in order."""
        return np.flatnonzero(self._used)

    def errors(self, slots: I64) -> F64:
        """Errors (B,) of displayed poses, metres; NaN before the first frame and outside the domain."""
        crowd = self.crowd
        measured = (crowd.known[slots] == 1) & (crowd.clamped[slots] == 0.0)
        return np.where(measured, crowd.error[slots], np.nan)

    def restless(self, slots: I64) -> int:
        """How many of these need new weights in their next step, or follow their goals: both are more work."""
        crowd = self.crowd
        moving = (crowd.goals[slots] != crowd.seen[slots]) | (crowd.velocity[slots] != 0.0)
        alone = (crowd.known[slots] == 0) | (crowd.state["share"][slots] > 0.0)
        return int(np.count_nonzero(moving.any(axis=1) | alone))

    def remove(self, slot: int) -> None:
        """Remove a character; its slot is free for another."""
        self._release(np.array([slot]))
        self._free.append(slot)
        self._used[slot] = False

    def _hold(self, slots: I64, frames: F64) -> None:
        """Store the last two frames (n, 2, 3 + 4·J) of characters from now on."""
        if not len(slots):
            return
        rows = self.stored.take(len(slots))
        self.stored.frames[rows] = frames
        self.state["held"][slots], self.state["calm"][slots] = rows, 0

    def _release(self, slots: I64) -> None:
        """Store the frames of characters no longer."""
        rows = self.state["held"][slots]
        self.stored.release(rows[rows >= 0])
        self.state["held"][slots] = -1

    def _take(self) -> int:
        """A free slot, its state zeroed."""
        if not self._free:
            self._grow(2 * len(self._used))
        slot = self._free.pop()
        self.state[slot] = np.zeros((), CHARACTER)
        self.state["held"][slot] = -1
        self._used[slot] = True
        return slot

    def _grow(self, capacity: int) -> None:
        """Make room for so many characters."""
        had = len(self._used)
        self.crowd = Crowd._make(larger(column, capacity) for column in self.crowd)
        self._used = larger(self._used, capacity)
        self._free.extend(range(capacity - 1, had - 1, -1))


def larger(array: npt.NDArray[Any], rows: int) -> npt.NDArray[Any]:
    """A copy with so many rows, the new ones zero."""
    out = np.zeros((rows, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
