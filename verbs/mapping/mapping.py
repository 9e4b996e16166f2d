"""``mapping.toml``: the target skeleton, which joint moves which, scale, ground, and where the effector's goal is."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping as Table
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from verbs.errors import SourceError, UnknownName
from verbs.mapping.presets import PRESETS, preset
from verbs.mapping.rig import Rig

__all__ = ["GOALS", "Mapping", "of_preset", "open_mapping"]

GOALS = ("scaled", "world")
"""Where the effector's goal is: scaled with the body, or where it is for the verb."""

_KEYS: dict[str, tuple[str, ...]] = {
    "": ("preset", "target", "unit", "root", "ground", "effector", "joints"),
    "root": ("joint", "scale", "travel"), "ground": ("feet", "height"), "effector": ("goal",),
}  # fmt: skip

MAX_SCALE, MAX_NUMBER = 1000.0, 1e9


@dataclass(frozen=True, eq=False)
class Mapping:
    """A target and how it is moved.

    Parameters
    ----------
    rig : Rig
    joints : mapping of str to str
        Target joints by source joints, which replace those found by names; an empty target excludes a source joint.
    goal : str
        One of :data:`GOALS`.
    scale : float or None
        Lengths of the target per length of the source; None takes that of the legs.
    travel : float or None
        Scale of the way over the ground; None takes that of lengths.
    feet : bool
        Whether feet are put on the ground.
    root : str or None
        Joint of the hierarchy that is read where the file has several; None takes the largest.
    height : float or None
        Height of the ground as it is stated, in the unit of the file; the rig has it in metres. None: not stated.
    """

    rig: Rig
    joints: Table[str, str] = field(default_factory=dict)
    goal: str = "scaled"
    scale: float | None = None
    travel: float | None = None
    feet: bool = True
    root: str | None = None
    height: float | None = None


def of_preset(name: str, *, goal: str = "scaled") -> Mapping:
    """The mapping to a preset; raises :class:`UnknownName` with the presets that exist."""
    if goal not in GOALS:
        raise UnknownName("goal", goal, GOALS)
    return Mapping(preset(name), goal=goal)


def open_mapping(target: str, *, goal: str | None = None) -> Mapping:
    """A mapping by the name of a preset, a ``mapping.toml``, or a file with a skeleton.

    Parameters
    ----------
    target : str
        One of :data:`verbs.mapping.presets.PRESETS`, or a path.
    goal : str, optional
        Replaces the goal of the mapping.

    Raises
    ------
    UnknownName
        There is no such preset and no such file; or no such goal.
    SourceError, MotionFileError
        The file is wrong.
    """
    from verbs.mapping.reading import TARGETS, read_rig

    if goal is not None and goal not in GOALS:
        raise UnknownName("goal", goal, GOALS)
    path = Path(target)
    if target in PRESETS:
        found = of_preset(target)
    elif not path.is_file():
        raise UnknownName("map", target, (*PRESETS, "a mapping.toml", f"a file that ends in {', '.join(TARGETS)}"))
    elif path.suffix.lower() == ".toml":
        found = _read(path)
    else:
        found = Mapping(read_rig(path))
    return found if goal is None else replace(found, goal=goal)


def _read(path: Path) -> Mapping:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as err:  # ValueError: UTF-8, TOML, or a number of thousands of digits
        raise SourceError(path, f"cannot be read: {err}") from err
    _check_keys(path, table)
    joints = _table(path, table, "joints")
    for source, target in joints.items():
        if not isinstance(target, str):
            raise SourceError(path, f"[joints] {source} must be the name of a target joint, or an empty text")
    goal = _table(path, table, "effector").get("goal", "scaled")
    if goal not in GOALS:
        raise SourceError(path, f"[effector] goal is '{goal}'; it must be one of {', '.join(GOALS)}")
    root, ground = _table(path, table, "root"), _table(path, table, "ground")
    feet = ground.get("feet", True)
    if not isinstance(feet, bool):
        raise SourceError(path, "[ground] feet must be true or false")
    rig, height = _rig(path, table), None
    if "height" in ground:
        height = _number(path, "[ground] height", ground["height"])
        rig = replace(rig, ground=height * rig.metres)
    scale, travel = _scale(path, root.get("scale", "legs"), "legs"), _travel(path, root.get("travel", "scaled"))
    return Mapping(rig, joints, goal, scale, travel, feet, root.get("joint"), height)


def _travel(path: Path, value: object) -> float | None:
    return 1.0 if value == "world" else _scale(path, value, "scaled")


def _rig(path: Path, table: Table[str, Any]) -> Rig:
    from verbs.mapping.reading import read_rig

    name, target, unit = table.get("preset"), table.get("target"), table.get("unit")
    joint = _table(path, table, "root").get("joint")
    if (name is None) == (target is None):
        raise SourceError(path, "give either preset or target")
    if not all(value is None or isinstance(value, str) for value in (name, target, unit, joint)):
        raise SourceError(path, "preset, target, unit and [root] joint must be texts")
    if name is None:
        return read_rig(path.parent / str(target), unit=unit, root=joint)
    if joint is not None:
        raise SourceError(path, "[root] joint is of a target's file; a preset has one root")
    return preset(name)


def _check_keys(path: Path, table: Table[str, Any]) -> None:
    for section, known in _KEYS.items():
        row = table if not section else _table(path, table, section)
        for key in row:
            if key not in known:
                place = f"[{section}] " if section else ""
                raise SourceError(path, f"{place}unknown key '{key}'; known: {', '.join(known)}")


def _table(path: Path, table: Table[str, Any], key: str) -> dict[str, Any]:
    found = table.get(key, {})
    if not isinstance(found, dict):
        raise SourceError(path, f"[{key}] must be a table")
    return found


def _number(path: Path, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= MAX_NUMBER:
        raise SourceError(path, f"{name} must be a number between {-MAX_NUMBER:g} and {MAX_NUMBER:g}")
    return float(value)


def _scale(path: Path, value: object, word: str) -> float | None:
    if value == word:
        return None
    number = _number(path, f"[root]: a scale, '{word}' or a number,", value)
    if not 0.0 < number <= MAX_SCALE:
        raise SourceError(path, f"[root]: a scale must be above 0 and at most {MAX_SCALE:g}")
    return number
