"""Contacts of a verb from its source: found in the examples, replaced where ``[[contact]]`` states them."""

from __future__ import annotations

import numpy as np

from verbs.authoring import contact_detection
from verbs.authoring.source import Source
from verbs.authoring.source_contacts import SourceContact, Spans
from verbs.contacts import PARTS, Contacts
from verbs.conventions import F64
from verbs.errors import SourceError, UnknownName
from verbs.kernels import timewarp
from verbs.motion import Motion
from verbs.verb import Verb

__all__ = ["contacts_of"]

SLACK_S = 1e-3
"""An interval may end this far past its file: files round both numbers."""


def contacts_of(source: Source, verb: Verb, motions: list[Motion], keytimes: F64) -> Contacts | None:
    """Contacts of a verb; None where they are turned off, or where there are no feet.

    Parameters
    ----------
    source : Source
    verb : Verb
    motions : list of Motion, length N
    keytimes : (N, M) float64
        Seconds from the start of each file.

    Raises
    ------
    SourceError
        Naming the ``[[contact]]`` table, the example, what is wrong and what to do.
    """
    if not source.has_contacts:
        return None
    stated = [_stated(source, k, contact, verb, motions, keytimes) for k, contact in enumerate(source.contacts)]
    try:
        return contact_detection.find(verb, stated)
    except UnknownName as err:
        raise SourceError(source.path, f"[[contact]]: {err}") from err


def _stated(
    source: Source, k: int, contact: SourceContact, verb: Verb, motions: list[Motion], keytimes: F64
) -> contact_detection.Stated:
    try:
        joint = verb.skeleton.index(contact.joint)
    except UnknownName as err:
        raise SourceError(source.path, f"[[contact]] {k}: {err}") from err
    intervals = {}
    for i, name in enumerate(verb.examples):
        if name in contact.intervals:
            spans, end = contact.intervals[name], motions[i].duration_s
            _check_inside(source, k, name, spans, end)
            intervals[i] = _phases(verb, spans, keytimes[i])
    return contact_detection.Stated(joint, None if contact.part is None else PARTS.index(contact.part), intervals)


def _check_inside(source: Source, k: int, name: str, spans: Spans, end: float) -> None:
    for span in spans:
        if max(span) > end + SLACK_S:
            raise SourceError(
                source.path,
                f"[[contact]] {k} has the interval {span[0]} to {span[1]} s, but the motion lasts "
                f"from 0 to {end:.5f} s",
                example=name,
            )


def _phases(verb: Verb, spans: Spans, marks: F64) -> F64:
    """Canonical time (R, 2) of spans in seconds of a file whose keytimes are ``marks`` (M,)."""
    tangents = np.empty(len(marks))
    timewarp.slopes(verb.phases, marks, verb.looping, tangents)
    rows = []
    for begin, end in spans:
        first, last = (timewarp.phase_at(verb.phases, marks, tangents, min(at, marks[-1])) for at in (begin, end))
        if begin > end:  # of a loop: it ends in the next cycle
            first, last = (0.0, last) if first >= 1.0 else (first, last + 1.0)
        if last > first:
            rows.append((first, last))
    return np.round(np.array(rows, np.float64).reshape(-1, 2), 9)
