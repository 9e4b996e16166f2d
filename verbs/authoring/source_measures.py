"""``measure`` of ``[[adverb]]`` tables: what one adverb measures, as ``verb.toml`` names it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from verbs import units
from verbs.adverb_measure import FORMS, Form
from verbs.errors import SourceError

__all__ = ["SourceMeasure", "check_mixing", "read_measure"]

_KEYS = ("kind", "joint", "axis", "at", "between", "toward")

_VERB_KEYS = ("measure", "effector_keytime_index", "goal")
"""Keys of a verb that measure all adverbs together."""

_BONES = ("azimuth", "elevation")


@dataclass(frozen=True, slots=True)
class SourceMeasure:
    """One ``measure = { … }``.

    ``joint`` and ``toward`` are names of joints, empty where there are none. ``begin`` and ``end`` are keytimes by
    number; ``end`` is -1 at a single instant. Both are -1 for the stances of the feet.
    """

    kind: str
    axis: str
    joint: str
    toward: str
    begin: int
    end: int


def read_measure(
    path: Path, row: Mapping[str, Any], name: str, unit: str, keytimes: Sequence[str]
) -> SourceMeasure | None:
    """The measure of an ``[[adverb]]`` table; None where it has none.

    Raises
    ------
    SourceError
        Naming the adverb, the key, what is wrong and the values that are known.
    """
    table, where = row.get("measure"), f"measure of adverb '{name}'"
    if table is None:
        return None
    if not isinstance(table, dict):
        raise SourceError(path, f'{where} must be a table such as {{ kind = "position", joint = "Hand", axis = "x" }}')
    for key in table:
        if key not in _KEYS:
            near = get_close_matches(key.lower(), _KEYS, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(_KEYS)}"
            raise SourceError(path, f"{where} has the unknown key '{key:.40}'; {hint}")
    kind = _choice(path, table, where, "kind", tuple(FORMS), "")
    form, where = FORMS[kind], f"{where}, '{kind}',"
    axis = _choice(path, table, where, "axis", tuple(form.axes), form.default)
    if row.get("style") is True:
        raise SourceError(path, f"adverb '{name}' has style = true and a measure; leave one of them out")
    wanted = form.axes[axis][1]
    if units.dimension(unit) not in ("none", wanted):
        known = " or ".join(units.known_of(wanted))
        raise SourceError(path, f"{where} is a {wanted}, but its unit is '{unit}'; use {known}")
    joint, toward = _joints(path, table, where, kind, form, axis)
    begin, end = _instants(path, table, where, kind, form, keytimes)
    if kind == "foot_speed" and joint and begin < 0:
        raise SourceError(path, f'{where} of one joint needs between = ["…", "…"], the keytimes of its stance')
    if kind == "foot_speed" and not joint and begin >= 0:
        raise SourceError(path, f"{where} between keytimes needs the joint that stands there")
    return SourceMeasure(kind, axis, joint, toward, begin, end)


def check_mixing(
    path: Path, table: Mapping[str, Any], names: Sequence[str], own: Sequence[bool], style: Sequence[bool]
) -> None:
    """Refuse a verb whose adverbs name measures, and that measures them together too or leaves one unmeasured.

    ``own`` are the adverbs that name a measure, ``style`` the style adverbs.
    """
    if not any(own):
        return
    for key in _VERB_KEYS:
        if key in table:
            name = names[list(own).index(True)]
            raise SourceError(
                path, f"'{key}' measures all adverbs together, but adverb '{name}' names a measure of its own; "
                f"leave one of them out"
            )  # fmt: skip
    for name, has, is_style in zip(names, own, style, strict=True):
        if not has and not is_style:
            raise SourceError(path, f"adverb '{name}' has no measure, but others have; give it one, or style = true")


def _choice(path: Path, table: Mapping[str, Any], where: str, key: str, known: Sequence[str], default: str) -> str:
    value = table.get(key, default)
    if not isinstance(value, str) or value not in known:
        found = f"has the {key} {value!r:.40}" if key in table else f"has no {key}"
        raise SourceError(path, f"{where} {found}; it must be one of {', '.join(known)}")
    return value


def _joints(path: Path, table: Mapping[str, Any], where: str, kind: str, form: Form, axis: str) -> tuple[str, str]:
    """Joint, and the joint at the other end of its bone."""
    joint, toward = table.get("joint", ""), table.get("toward", "")
    for key, value in (("joint", joint), ("toward", toward)):
        if not isinstance(value, str) or (key in table and not value):
            raise SourceError(path, f"{where} has the {key} {value!r:.40}; give the name of a joint")
    if form.joint and not joint:
        raise SourceError(path, f"{where} needs a joint")
    if joint and not form.joint and kind != "foot_speed":
        raise SourceError(path, f"{where} has no joint; leave it out")
    if toward and axis not in _BONES:
        raise SourceError(path, f"{where}: only an orientation with axis {' or '.join(_BONES)} has 'toward'")
    return joint, toward


def _instants(
    path: Path, table: Mapping[str, Any], where: str, kind: str, form: Form, keytimes: Sequence[str]
) -> tuple[int, int]:
    """Keytimes by number, the second -1 at a single instant."""
    at, between = table.get("at"), table.get("between")
    if at is not None and between is not None:
        raise SourceError(path, f"{where} has both 'at' and 'between'; leave one of them out")
    if kind == "time_to":
        if at is None:
            raise SourceError(path, f"{where} needs at = one of {', '.join(keytimes[1:])}")
        mark = _keytime(path, where, "at", at, keytimes)
        if mark == 0:
            raise SourceError(path, f"{where} is always 0 at '{at}', the start; name another keytime")
        return 0, mark
    if at is not None:
        if not form.at:
            raise SourceError(path, f'{where} is taken between two keytimes; write between = ["…", "…"]')
        return _keytime(path, where, "at", at, keytimes), -1
    if between is not None:
        if not form.between:
            raise SourceError(path, f'{where} is taken at one keytime; write at = "…"')
        if not isinstance(between, list) or len(between) != 2:
            raise SourceError(path, f"{where}: 'between' must be two names of keytimes, not {between!r:.60}")
        begin, end = (_keytime(path, where, "between", name, keytimes) for name in between)
        if begin >= end:
            raise SourceError(path, f"{where}: '{between[0]}' must come before '{between[1]}'")
        return begin, end
    if kind == "foot_speed":
        return -1, -1
    if form.at:
        raise SourceError(path, f"{where} needs at = one of {', '.join(keytimes)}")
    return 0, len(keytimes) - 1


def _keytime(path: Path, where: str, key: str, name: object, keytimes: Sequence[str]) -> int:
    if not isinstance(name, str) or name not in keytimes:
        raise SourceError(path, f"{where}: '{key}' names {name!r:.60}; the keytimes are {', '.join(keytimes)}")
    return list(keytimes).index(name)
