"""Characters at rest are not stepped.

A client of ``send: "changes"`` advances the phase itself. Where nothing but the phase changes, neither a step nor a
record is needed until a key record is due: a character rests, and the time that it has not been stepped for is counted.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.runtime.character_pool import larger
from verbs.runtime.characters import Characters

__all__ = ["KEY_S", "Rest"]

KEY_S = 3.0
"""Time after which a record is sent also if it does not differ from the one before, seconds."""

Flags = npt.NDArray[np.bool_]


class Rest:
    """Which characters of a group rest.

    Parameters
    ----------
    characters : Characters
    """

    def __init__(self, characters: Characters) -> None:
        self._characters = characters
        self._owed_s: F64 = np.zeros(0)
        self._due: Flags = np.zeros(0, np.bool_)

    def forget(self, slot: int) -> None:
        """Note that a character is removed."""
        if slot < len(self._due):
            self._owed_s[slot], self._due[slot] = 0.0, False

    def hurry(self, slot: int) -> None:
        """Step a character in the next tick in any case."""
        self._fit()
        self._due[slot] = True

    def wake(self, slot: int, step_s: float) -> None:
        """Bring a character up to date before it is changed, and step it in the next tick in any case.

        The last ``step_s`` seconds are a step of their own, so that its last two frames are one tick apart.
        """
        self._fit()
        owed_s, slots = float(self._owed_s[slot]), np.array([slot])
        if owed_s > step_s:
            self._characters.advance_at_rest(slots, owed_s - step_s)
        if owed_s > 0.0:
            self._characters.advance_at_rest(slots, min(step_s, owed_s))
        self._owed_s[slot], self._due[slot] = 0.0, True

    def choose(self, slots: I64, may_rest: Flags, wanted: I64, step_s: float) -> I64:
        """Numbers, in ``slots`` (B,), of the characters to step in a tick; those that rested are brought up to date.

        Parameters
        ----------
        slots : (B,) int64
        may_rest : (B,) bool
        wanted : (B,) int64
            Whether events of a character are reported: it rests only when it is paused.
        step_s : float
            Length of the step, seconds.
        """
        self._fit()
        still, paused = self._characters.at_rest(slots)
        owed_s = self._owed_s[slots]
        rests = still & may_rest & ~self._due[slots] & (paused | (wanted == 0)) & (owed_s + step_s < KEY_S)
        self._owed_s[slots[rests]] += step_s
        chosen = np.flatnonzero(~rests)
        self._due[slots[chosen]] = False
        behind = chosen[owed_s[chosen] > 0.0]
        for length_s in np.unique(owed_s[behind]).tolist():
            self._characters.advance_at_rest(slots[behind[owed_s[behind] == length_s]], length_s)
        self._owed_s[slots[behind]] = 0.0
        return chosen

    def _fit(self) -> None:
        """Have a row for every slot."""
        rows = len(self._characters.state)
        if len(self._due) < rows:
            self._owed_s, self._due = larger(self._owed_s, rows), larger(self._due, rows)
