"""Mends in ``verb.toml``: ``[[mend]]`` tables that repair clips, and ``[retarget]``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verbs.clips.mends import KINDS
from verbs.clips.reports import Mend
from verbs.conventions import MAX_MAGNITUDE
from verbs.errors import SourceError

__all__ = ["RETARGET_KEYS", "SourceMend", "SourceRetarget", "mend_keys", "read_mends", "read_retarget"]

MAX_MENDS = 10_000

_COMMON = ("kind", "example", "apply")

RETARGET_KEYS = ("skeleton", "example", "effector", "feet", "apply")


@dataclass(frozen=True, slots=True)
class SourceMend:
    """One ``[[mend]]``: a mend, the examples that it is for, and whether it is applied."""

    mend: Mend
    examples: tuple[str, ...]
    applies: bool


@dataclass(frozen=True, slots=True)
class SourceRetarget:
    """``[retarget]``: the example whose skeleton is the verb's, and the examples that are retargeted to it.

    ``effector`` and ``feet``: whether these keep their positions.
    """

    skeleton: str
    examples: tuple[str, ...]
    effector: bool
    feet: bool


def mend_keys(kind: str) -> tuple[str, ...]:
    """Keys of a ``[[mend]]`` table of a kind."""
    one = KINDS[kind]
    return (*_COMMON, *("joint",) * one.has_joint, *("start", "end") * one.has_stretch, *one.options)


def read_mends(
    path: Path, table: Mapping[str, Any], examples: Sequence[str], *, looping: bool
) -> tuple[SourceMend, ...]:  # fmt: skip
    """Mends of a source.

    Raises
    ------
    SourceError
        Naming the table, the key, what is wrong and the values that are known.
    """
    rows = table.get("mend", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SourceError(path, "'mend' must be written as [[mend]] tables")
    if len(rows) > MAX_MENDS:
        raise SourceError(path, f"there are {len(rows)} [[mend]] tables; at most {MAX_MENDS} are possible")
    return tuple(_mend(path, row, f"[[mend]] {k}", examples, looping=looping) for k, row in enumerate(rows))


def read_retarget(path: Path, table: Mapping[str, Any], examples: Sequence[str]) -> SourceRetarget | None:
    """``[retarget]`` of a source; None where there is none, or ``apply = false``.

    Raises
    ------
    SourceError
        Naming the key, what is wrong and the values that are known.
    """
    row = table.get("retarget")
    if row is None:
        return None
    if not isinstance(row, dict):
        raise SourceError(path, "'retarget' must be written as a [retarget] table")
    _check_keys(path, row, "[retarget]", RETARGET_KEYS)
    skeleton = row.get("skeleton")
    if not isinstance(skeleton, str) or skeleton not in examples:
        raise SourceError(
            path, f"[retarget] needs skeleton, the name of the example whose bones are kept, not {skeleton!r:.60}; "
            f"examples: {', '.join(examples[:12])}"
        )  # fmt: skip
    chosen = _examples(path, row, "[retarget]", examples)
    effector, feet, applies = (_flag(path, row, "[retarget]", key) for key in ("effector", "feet", "apply"))
    return SourceRetarget(skeleton, chosen, effector, feet) if applies else None


def _mend(path: Path, row: dict[str, Any], where: str, examples: Sequence[str], *, looping: bool) -> SourceMend:
    kind = row.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise SourceError(path, f"{where} has the kind {kind!r:.40}; it must be one of {', '.join(KINDS)}")
    where = f"{where} of kind '{kind}'"
    _check_keys(path, row, where, mend_keys(kind))
    if kind == "idle" and looping:
        raise SourceError(path, f"{where}: a file of a looping verb is one cycle, which cannot be trimmed")
    joint = row.get("joint")
    if joint is not None and (not isinstance(joint, str) or not joint):
        raise SourceError(path, f"{where} has the joint {joint!r:.40}; give its name")
    start, end = _number(path, row, where, "start"), _number(path, row, where, "end")
    if (start is None) != (end is None) or (start is not None and end is not None and not 0 <= start <= end):
        raise SourceError(path, f"{where} needs both start and end, in seconds of the file, with 0 ≤ start ≤ end")
    if start is not None and joint is None and kind in ("spin", "spike"):
        raise SourceError(path, f"{where} has a start and an end, so it needs a joint too")
    options = {key: _number(path, row, where, key) for key in KINDS[kind].options}
    given = {key: value for key, value in options.items() if value is not None}
    mend = Mend(kind, joint, start, end, given)
    return SourceMend(mend, _examples(path, row, where, examples), _flag(path, row, where, "apply"))


def _check_keys(path: Path, row: Mapping[str, Any], where: str, known: Sequence[str]) -> None:
    for key in row:
        if key not in known:
            raise SourceError(path, f"{where} has the unknown key '{key}'; known: {', '.join(known)}")


def _examples(path: Path, row: Mapping[str, Any], where: str, examples: Sequence[str]) -> tuple[str, ...]:
    """Examples that a table names, one or a list; all where it names none."""
    given = row.get("example", list(examples))
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not names:
        raise SourceError(path, f"{where}: 'example' must be the name of an example, or a list of names")
    for name in names:
        if name not in examples:
            raise SourceError(
                path, f"{where} is for {name!r:.60}, which is no example; examples: {', '.join(examples[:12])}"
            )
    return tuple(dict.fromkeys(names))


def _flag(path: Path, row: Mapping[str, Any], where: str, key: str) -> bool:
    value = row.get(key, True)
    if not isinstance(value, bool):
        raise SourceError(path, f"{where}: '{key}' must be true or false, not {value!r:.40}")
    return value


def _number(path: Path, row: Mapping[str, Any], where: str, key: str) -> float | None:
    value = row.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= MAX_MAGNITUDE:
        raise SourceError(path, f"{where}: '{key}' must be a number, not {value!r:.40}")
    return float(value)
