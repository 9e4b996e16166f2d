"""Contacts in ``verb.toml``: ``contacts = false``, and ``[[contact]]`` tables that state what detection cannot find."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verbs.contacts import MAX_POINTS, PARTS
from verbs.conventions import MAX_MAGNITUDE
from verbs.errors import SourceError

__all__ = ["SourceContact", "read_contacts"]

MAX_INTERVALS = 1_000
"""Most intervals of one example in a table."""

Spans = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class SourceContact:
    """One ``[[contact]]``: a foot joint, one of its parts or (None) all, and intervals of examples by name.

    Intervals are in seconds of the motion file; in a loop, one that ends before it begins ends in the next cycle.
    """

    joint: str
    part: str | None
    intervals: Mapping[str, Spans]


def read_contacts(
    path: Path, table: Mapping[str, Any], examples: Sequence[str], *, looping: bool
) -> tuple[bool, tuple[SourceContact, ...]]:
    """Whether a verb has contacts, and those that its source states.

    Raises
    ------
    SourceError
        Naming the table, the example, what is wrong and what to do.
    """
    wanted, rows = table.get("contacts", True), table.get("contact", [])
    if not isinstance(wanted, bool):
        raise SourceError(path, f"key 'contacts' must be true or false, not {wanted!r:.60}")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SourceError(path, "'contact' must be written as [[contact]] tables")
    if len(rows) > MAX_POINTS:
        raise SourceError(path, f"there are {len(rows)} [[contact]] tables; at most {MAX_POINTS} are possible")
    if rows and not wanted:
        raise SourceError(path, "contacts is false, but there are [[contact]] tables; remove one or the other")
    found = tuple(_contact(path, row, k, examples, looping=looping) for k, row in enumerate(rows))
    for k, contact in enumerate(found):
        for other in found[:k]:
            if contact.joint == other.joint and (contact.part == other.part or None in (contact.part, other.part)):
                raise SourceError(path, f"[[contact]] {k} states joint '{contact.joint}' a second time; merge the two")
    return wanted, found


def _contact(path: Path, row: dict[str, Any], k: int, examples: Sequence[str], *, looping: bool) -> SourceContact:
    where = f"[[contact]] {k}"
    joint, part, given = row.get("joint"), row.get("part"), row.get("intervals")
    if not isinstance(joint, str) or not joint:
        raise SourceError(path, f'{where} needs the name of a joint, as joint = "LeftFoot"')
    if part is not None and part not in PARTS:
        raise SourceError(path, f"{where} has the part {part!r:.40}; it must be one of {', '.join(PARTS)}")
    if not isinstance(given, dict) or not given:
        raise SourceError(path, f"{where} needs intervals, as intervals = {{ {examples[0]} = [[0.0, 0.5]] }}")
    intervals = {}
    for name, spans in given.items():
        if name not in examples:
            raise SourceError(
                path, f"{where} has intervals of '{name}', which is no example; examples: {', '.join(examples[:12])}"
            )
        intervals[name] = _spans(path, spans, where, name, looping=looping)
    return SourceContact(joint, part, intervals)


def _spans(path: Path, given: Any, where: str, example: str, *, looping: bool) -> Spans:
    if not isinstance(given, list) or len(given) > MAX_INTERVALS or not all(_is_pair(span) for span in given):
        raise SourceError(
            path, f"{where} needs a list of at most {MAX_INTERVALS} [begin, end] pairs, in seconds", example=example
        )
    spans = [(float(begin), float(end)) for begin, end in given]
    for begin, end in spans:
        if begin == end or (begin > end and not looping):
            raise SourceError(path, f"{where} has the interval {begin} to {end} s; it must end after it begins",
                              example=example)  # fmt: skip
    spans.sort()
    for k, (begin, end) in enumerate(spans):
        last = k + 1 == len(spans)
        wraps, after = begin > end, spans[0 if last else k + 1][0]
        if (wraps and (not last or (k and after < end))) or (not wraps and not last and after < end):
            raise SourceError(path, f"{where} has intervals that overlap at {after} s; merge them", example=example)
    return tuple(spans)


def _is_pair(span: Any) -> bool:
    return (
        isinstance(span, list)
        and len(span) == 2
        and all(isinstance(x, (int, float)) and not isinstance(x, bool) and 0 <= x <= MAX_MAGNITUDE for x in span)
    )
