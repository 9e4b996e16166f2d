"""A group: one version of a verb with the characters that are blended by one method."""

from __future__ import annotations

import numpy as np

from service.catalog.catalog import Entry
from service.stream.kernels import passed_keytimes
from service.wire import Step
from verbs.conventions import F32, I64
from verbs.runtime.characters import Characters

__all__ = ["Group"]


class Group:
    """The characters of one version of a verb, blended by one method.

    Parameters
    ----------
    entry : Entry
    method : str

    Attributes
    ----------
    events : list of dict
        Name and phase of each keytime, as events report them.
    """

    def __init__(self, entry: Entry, method: str) -> None:
        self.entry = entry
        self.characters = Characters(entry.evaluator, method)
        verb = entry.verb
        self.events = [
            {"name": name, "phase": phase} for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True)
        ]

    @property
    def key(self) -> tuple[str, int, str]:
        """Verb, version and method."""
        return self.entry.verb.name, self.entry.version, self.characters.method

    def check(self, goal: F32) -> None:
        """Raise :class:`verbs.errors.OutOfRange` unless these are adverbs of the verb, finite and not too large."""
        self.characters.row(goal.astype(np.float64))

    def passed(self, step: Step, wanted: I64) -> tuple[list[int], list[int]]:
        """Rows and keytimes of the events of a step, in order; rows whose ``wanted`` (B,) is 0 are left out."""
        verb = self.entry.verb
        room = 2 * len(verb.phases) * int(np.count_nonzero(step.progress["passed"]))
        if not room:
            return [], []
        rows, marks = np.empty((2, room), np.int64)
        count = passed_keytimes(step.progress, wanted, verb.phases, verb.looping, rows, marks, np.empty(room))
        return rows[:count].tolist(), marks[:count].tolist()
