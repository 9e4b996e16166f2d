"""A group: one version of a verb with the characters that are blended by one method."""

from __future__ import annotations

import numpy as np

from service.catalog.catalog import Entry
from service.stream.kernels import passed_keytimes
from service.stream.messages import Open
from service.wire import Layout, Step
from verbs.conventions import F32, I64
from verbs.runtime.characters import Characters

__all__ = ["Group"]

MAX_LAYOUTS = 256
"""Layouts that are kept for further channels."""


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
        self._layouts: dict[tuple[str, str, str, tuple[str, ...] | None], Layout] = {}
        self.events = [
            {"name": name, "phase": phase} for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True)
        ]

    def layout(self, request: Open) -> Layout:
        """Layout of the records of a channel; raises :class:`UnknownName` for a joint that does not exist.

        Channels that ask for the same have one layout, whose joints are stored once.
        """
        names = None if request.joints is None else tuple(request.joints)
        key = request.encoding, request.space, request.frame, names
        found = self._layouts.get(key)
        if found is None:
            joints = self.entry.joints(names)
            if joints is None:
                joints = np.arange(len(self.entry.verb.skeleton))
            count = len(self.entry.verb.examples)
            found = Layout(request.encoding, request.space, request.frame, joints, count)
            if len(self._layouts) < MAX_LAYOUTS:
                self._layouts[key] = found
        return found

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
