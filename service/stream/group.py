"""A group: one version of a verb with the characters that are blended by one method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import orjson

from service.catalog.catalog import Entry
from service.packing import Step
from service.stream.kernels import passed_keytimes
from service.stream.messages import Open
from service.stream.rest import Rest
from service.wire import Layout, offsets_in
from verbs.conventions import F32, I64
from verbs.runtime.characters import Characters

__all__ = ["Form", "Group"]

MAX_LAYOUTS = 256
"""Layouts that are kept for further channels."""


class Form(NamedTuple):
    """What a client asks the records of a channel to be.

    Parameters
    ----------
    encoding, space, frame : str
    joints : tuple of str or None
        None for all.
    """

    encoding: str
    space: str
    frame: str
    joints: tuple[str, ...] | None

    @classmethod
    def of(cls, request: Open) -> Form:
        """The form that an `open` asks for."""
        joints = None if request.joints is None else tuple(request.joints)
        return cls(request.encoding, request.space, request.frame, joints)


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
    rest : Rest
        Which of the characters rest.
    """

    def __init__(self, entry: Entry, method: str) -> None:
        self.entry = entry
        self.characters = Characters(entry.evaluator, method)
        self.rest = Rest(self.characters)
        verb = entry.verb
        self._layouts: dict[Form, Layout] = {}
        self._described: dict[int, dict[str, orjson.Fragment]] = {}
        self.events = [
            {"name": name, "phase": phase} for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True)
        ]

    def layout(self, form: Form) -> Layout:
        """Layout of the records of a channel; raises :class:`UnknownName` for a joint that does not exist.

        Channels that ask for the same have one layout, whose joints are stored once.
        """
        found = self._layouts.get(form)
        if found is None:
            joints = self.entry.joints(form.joints)
            if joints is None:
                joints = np.arange(len(self.entry.verb.skeleton))
            count = len(self.entry.verb.examples)
            found = Layout(form.encoding, form.space, form.frame, joints, count)
            if len(self._layouts) < MAX_LAYOUTS:
                self._layouts[form] = found
        return found

    def described(self, layout: Layout) -> dict[str, orjson.Fragment]:
        """JSON of the fields of ``opened`` that all channels of a layout share: skeleton, joints, keytimes."""
        found = self._described.get(id(layout))
        if found is None:
            skeleton = self.entry.verb.skeleton
            values = {
                "skeleton": {
                    "names": skeleton.names,
                    "parents": skeleton.parents,
                    "offsets": offsets_in(skeleton, layout.frame),
                },
                "joints": [skeleton.names[joint] for joint in layout.joints.tolist()],
                "keytimes": self.events,
            }
            options = orjson.OPT_SERIALIZE_NUMPY
            found = {name: orjson.Fragment(orjson.dumps(value, option=options)) for name, value in values.items()}
            if layout in self._layouts.values():
                self._described[id(layout)] = found
        return found

    @property
    def key(self) -> tuple[str, int, str]:
        """Verb, version and method."""
        return self.entry.verb.name, self.entry.version, self.characters.method

    def check(self, goal: F32) -> None:
        """Raise :class:`verbs.errors.OutOfRange` unless these are adverbs of the verb, finite and not too large."""
        with np.errstate(invalid="ignore"):  # a signalling NaN, which the check refuses
            row = goal.astype(np.float64)
        self.characters.row(row)

    def passed(self, step: Step, wanted: I64) -> tuple[list[int], list[int]]:
        """Rows and keytimes of the events of a step, in order; rows whose ``wanted`` (B,) is 0 are left out."""
        verb = self.entry.verb
        room = 2 * len(verb.phases) * int(np.count_nonzero(step.progress["passed"]))
        if not room:
            return [], []
        rows, marks = np.empty((2, room), np.int64)
        count = passed_keytimes(step.progress, wanted, verb.phases, verb.looping, rows, marks, np.empty(room))
        return rows[:count].tolist(), marks[:count].tolist()
