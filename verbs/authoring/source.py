"""A verb source: a folder with ``verb.toml`` and one motion file per example, read and checked.

The folder alone is checked here; whether the motions fit together is checked by :mod:`verbs.authoring.fit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from verbs import units
from verbs.authoring import toml_values
from verbs.authoring.source_contacts import SourceContact, read_contacts
from verbs.authoring.source_measures import SourceMeasure, check_mixing, read_measure
from verbs.authoring.source_mends import SourceMend, SourceRetarget, read_mends, read_retarget
from verbs.clips.orientation import AXES
from verbs.conventions import MAX_ADVERBS, MAX_EXAMPLES, MAX_KEYS, MAX_KEYTIMES, MAX_MAGNITUDE, METRES_PER_UNIT
from verbs.errors import SourceError
from verbs.io.joint_tracks import STRETCH_M
from verbs.kernels.chart import CHARTS
from verbs.kernels.measure import ADVERBS, MEASURES
from verbs.verb import NAME

__all__ = ["Source", "SourceAdverb", "SourceExample", "parse", "read"]

MAX_FILE_NAME = 255  # bytes

ROTATIONS = ("quaternion", "rotation_vector")

VERB_MEASURES = tuple(name for name, number in MEASURES.items() if number != ADVERBS)
"""Measures of a whole verb; where adverbs name measures of their own, the source has the measure ``adverbs``."""

TAILS = ("constant", "affine")
"""Polynomial parts of the smooth basis, by degree."""

_KEYS = {
    "name", "description", "looping", "climbing", "samples", "root", "effector", "effector_keytime_index", "measure",
    "keytime_names", "units", "adverb", "example", "tetrahedra", "simplices", "chart", "rotations", "goal",
    "contact", "contacts", "tail", "mend", "retarget", "stretch_m",
}  # fmt: skip

_TABLE_KEYS = {
    "adverb": {"name", "unit", "description", "style", "measure"},
    "example": {"file", "clip", "keytimes", "adverb_values"},
    "units": {"length", "time", "adverb_angle", "up_axis", "forward_axis"},
    "goal": {"origin", "axes"},
    "contact": {"joint", "part", "intervals"},
}
"""Keys with a meaning, at the top level and in each table."""

_AXES = {"up_axis", "forward_axis"}
"""Keys with a meaning that are kept as provenance too."""

_CLOSE = 0.8
"""Similarity (:mod:`difflib`) from which on an unknown key counts as a misspelling; captured sources stay below 0.7."""


@dataclass(frozen=True, slots=True)
class SourceAdverb:
    """One ``[[adverb]]``: name, unit, description, whether it is a style adverb, and the measure that it names."""

    name: str
    unit: str
    description: str
    style: bool
    measure: SourceMeasure | None = None


@dataclass(frozen=True, slots=True)
class SourceExample:
    """One ``[[example]]``: its file, keytimes in seconds, adverb values, and the animation if the file has several."""

    file: Path
    keytimes: tuple[float, ...]
    values: tuple[float, ...]
    clip: str = ""

    @property
    def name(self) -> str:
        """Name of the example: its animation's, or its file's without the ending."""
        return self.clip or self.file.stem


@dataclass(frozen=True, slots=True)
class Source:
    """A checked ``verb.toml``.

    ``axes`` are up and forward in the motion files. ``goal`` is empty, or an origin and one axis per measured adverb,
    three numbers each: where the adverbs of a sheet lie in space. ``has_contacts`` is false where contacts are turned
    off; ``contacts`` are those that replace what detection finds. ``mends`` and ``retarget`` change the clips first.
    ``provenance`` keeps every key that has no meaning here; ``warnings`` name likely misspellings.
    """

    path: Path
    name: str
    description: str
    looping: bool
    climbing: bool
    samples: int
    root: str | None
    effector: str | None
    effector_keytime: int
    measure: str
    keytime_names: tuple[str, ...]
    length_unit: str
    axes: tuple[str, str]
    stretch_m: float
    chart: str | None
    rotations: str
    adverbs: tuple[SourceAdverb, ...]
    examples: tuple[SourceExample, ...]
    simplices: tuple[tuple[int, ...], ...]
    goal: tuple[tuple[float, ...], ...]
    has_contacts: bool
    contacts: tuple[SourceContact, ...]
    tail: str
    mends: tuple[SourceMend, ...]
    retarget: SourceRetarget | None
    provenance: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


def read(folder: str | Path) -> Source:
    """Read and check ``verb.toml`` in a folder.

    Raises
    ------
    SourceError
        Naming the file, the example where there is one, what is wrong and what to do.
    """
    path = Path(folder) / "verb.toml"
    return parse(path, toml_values.load(path))


def parse(path: Path, table: dict[str, Any]) -> Source:
    """Check the parsed text of a ``verb.toml`` at ``path``, which need not exist; raises :class:`SourceError`."""
    toml_values.check(path, table)
    warnings = _misspelled(table)
    try:
        return replace(_read(path, table), warnings=warnings)
    except SourceError as err:
        if not warnings:
            raise
        raise SourceError(path, "; ".join([err.problem, *warnings]), example=err.example) from err


def _misspelled(table: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for each unknown key that is close to a known one."""
    found: list[str] = []
    for name, rows, known in (
        ("", table, _KEYS | _AXES),
        *((name, table.get(name), known) for name, known in _TABLE_KEYS.items()),
    ):
        for row in rows if isinstance(rows, list) else [rows]:
            for key in row if isinstance(row, dict) else ():
                near = [] if key in known else get_close_matches(key.lower(), known, 1, _CLOSE)
                where = f" in {f'[[{name}]]' if isinstance(rows, list) else f'[{name}]'}" if name else ""
                line = f"unknown key '{key}'{where}; did you mean '{near[0]}'?" if near else ""
                if line and line not in found:
                    found.append(line)
    return tuple(found)


def _read(path: Path, table: dict[str, Any]) -> Source:
    """The source of a parsed ``verb.toml``, checked."""
    reader = _Reader(path)
    rows = reader.tables(table, "adverb", MAX_ADVERBS)
    keytime_names = reader.names(table, "keytime_names")
    adverbs = tuple(_adverb(reader, row, k, keytime_names) for k, row in enumerate(rows))
    names = [adverb.name for adverb in adverbs]
    if len(set(names)) != len(names):
        raise SourceError(path, f"two adverbs have the same name among {', '.join(names)}; give each its own")
    own = [adverb.measure is not None for adverb in adverbs]
    check_mixing(path, table, names, own, [adverb.style for adverb in adverbs])
    rows = reader.tables(table, "example", MAX_EXAMPLES)
    examples = tuple(_example(reader, row, k, len(names), keytime_names) for k, row in enumerate(rows))
    _check_examples(path, examples)
    name = reader.text(table, "name")
    if not NAME.fullmatch(name):
        raise SourceError(path, f"name '{name}' must be lower-case letters, digits, '-' and '_', a letter first")
    measure = "adverbs" if any(own) else reader.choice(table, "measure", VERB_MEASURES, default="none")
    effector_keytime = reader.integer(table, "effector_keytime_index", default=-1)
    if not -1 <= effector_keytime < len(keytime_names):
        raise SourceError(
            path, f"effector_keytime_index is {effector_keytime}; the keytimes are 0 to {len(keytime_names) - 1}"
        )
    looping = reader.flag(table, "looping", default=False)
    climbing = reader.flag(table, "climbing", default=False)
    if climbing and not looping:
        raise SourceError(path, "climbing is for looping verbs: the root of others keeps its height anyway")
    samples = reader.integer(table, "samples", default=0)
    if samples < 0 or samples >= MAX_KEYS:
        raise SourceError(path, f"samples is {samples}; give 1 to {MAX_KEYS - 1}, or leave it out")
    stems = [example.name for example in examples]
    has_contacts, contacts = read_contacts(path, table, stems, looping=looping)
    return Source(
        path=path,
        name=name,
        description=reader.text(table, "description", default=""),
        looping=looping,
        climbing=climbing,
        samples=samples,
        root=reader.text(table, "root", default="") or None,
        effector=reader.text(table, "effector", default="") or None,
        effector_keytime=effector_keytime,
        measure=measure,
        keytime_names=keytime_names,
        length_unit=_units(reader, table),
        axes=_axes(reader, table),
        stretch_m=_stretch(reader, table),
        chart=reader.choice(table, "chart", tuple(CHARTS), default="") or None,
        rotations=reader.choice(table, "rotations", ROTATIONS, default="quaternion"),
        adverbs=adverbs,
        examples=examples,
        simplices=_simplices(reader, table, len(examples), len(adverbs)),
        goal=_goal(reader, table, sum(not adverb.style for adverb in adverbs)),
        has_contacts=has_contacts,
        contacts=contacts,
        tail=reader.choice(table, "tail", TAILS, default="affine"),
        mends=read_mends(path, table, stems, looping=looping),
        retarget=read_retarget(path, table, stems),
        provenance={key: toml_values.kept(path, key, value) for key, value in table.items() if key not in _KEYS},
    )


@dataclass(frozen=True, slots=True)
class _Reader:
    """Typed access to a parsed table, with messages that name the key."""

    path: Path

    def _get(self, table: Mapping[str, Any], key: str, kind: type, default: Any) -> Any:
        value = table.get(key, default)
        if value is None:
            raise SourceError(self.path, f"key '{key}' is missing")
        if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
            raise SourceError(self.path, f"key '{key}' must be {_KIND_NAMES[kind]}, not {value!r:.60}")
        return value

    def text(self, table: Mapping[str, Any], key: str, *, default: str | None = None) -> str:
        return str(self._get(table, key, str, default))

    def flag(self, table: Mapping[str, Any], key: str, *, default: bool) -> bool:
        return bool(self._get(table, key, bool, default))

    def integer(self, table: Mapping[str, Any], key: str, *, default: int) -> int:
        return int(self._get(table, key, int, default))

    def choice(self, table: Mapping[str, Any], key: str, known: tuple[str, ...], *, default: str) -> str:
        value = self.text(table, key, default=default)
        if value not in (*known, default):
            raise SourceError(self.path, f"{key} is '{value}'; it must be one of {', '.join(known)}")
        return value

    def names(self, table: Mapping[str, Any], key: str) -> tuple[str, ...]:
        values = self._get(table, key, list, None)
        if not 2 <= len(values) <= MAX_KEYTIMES or not all(isinstance(value, str) and value for value in values):
            raise SourceError(
                self.path, f"{key} must list 2 to {MAX_KEYTIMES} names, the first and last instant included"
            )
        if len(set(values)) != len(values):
            raise SourceError(self.path, f"{key} repeats a name: {', '.join(values)}")
        return tuple(values)

    def tables(self, table: Mapping[str, Any], key: str, most: int) -> list[dict[str, Any]]:
        rows = table.get(key, [])
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise SourceError(self.path, f"'{key}' must be written as [[{key}]] tables")
        if not 1 <= len(rows) <= most:
            raise SourceError(self.path, f"there are {len(rows)} [[{key}]] tables; a verb has 1 to {most}")
        return rows

    def numbers(self, row: Mapping[str, Any], key: str, count: int, of: str, where: str) -> tuple[float, ...]:
        values = row.get(key)
        numeric = isinstance(values, list) and all(
            isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
        )
        if not numeric or values is None:
            raise SourceError(self.path, f"'{key}' must be a list of numbers", example=where)
        if len(values) != count:
            raise SourceError(
                self.path, f"'{key}' has {len(values)} numbers, but there are {count} {of}", example=where
            )
        for value in values:
            if not abs(value) <= MAX_MAGNITUDE:  # NaN compares false
                raise SourceError(
                    self.path,
                    f"'{key}' holds {value!r:.24}; numbers must be finite, of magnitude {MAX_MAGNITUDE:,.0f} at most",
                    example=where,
                )
        return tuple(float(value) for value in values)


_KIND_NAMES: dict[type, str] = {str: "a string", bool: "true or false", int: "an integer", list: "a list"}


def _adverb(reader: _Reader, row: dict[str, Any], index: int, keytimes: tuple[str, ...]) -> SourceAdverb:
    name = reader.text(row, "name", default="")
    if not name.isidentifier() or len(name) > 63:
        raise SourceError(
            reader.path, f"adverb {index} has the name '{name}'; use letters, digits and '_', no digit first"
        )
    unit = reader.text(row, "unit", default="")
    if unit and unit not in units.KNOWN:
        raise SourceError(
            reader.path, f"adverb '{name}' has the unknown unit '{unit}'; known: {', '.join(units.KNOWN)}"
        )
    return SourceAdverb(
        name,
        unit,
        reader.text(row, "description", default=""),
        reader.flag(row, "style", default=False),
        read_measure(reader.path, row, name, unit, keytimes),
    )


def _example(
    reader: _Reader, row: dict[str, Any], index: int, adverbs: int, keytime_names: tuple[str, ...]
) -> SourceExample:
    file = reader.text(row, "file", default="")
    folder = reader.path.parent.resolve()
    path = (folder / file.replace("\0", "")).resolve()
    if not file or "\0" in file or len(file.encode()) > MAX_FILE_NAME or not path.is_relative_to(folder):
        raise SourceError(reader.path, f"example {index} names the file '{file}'; it must lie in the verb's own folder")
    clip = reader.text(row, "clip", default="")
    where = clip or path.stem
    keytimes = reader.numbers(row, "keytimes", len(keytime_names), "keytime names", where)
    for m in range(1, len(keytimes)):
        if keytimes[m] <= keytimes[m - 1]:
            raise SourceError(
                reader.path,
                f"keytime '{keytime_names[m]}' ({keytimes[m]} s) must come after "
                f"'{keytime_names[m - 1]}' ({keytimes[m - 1]} s)",
                example=where,
            )
    return SourceExample(path, keytimes, reader.numbers(row, "adverb_values", adverbs, "adverbs", where), clip)


def _check_examples(path: Path, examples: tuple[SourceExample, ...]) -> None:
    if len(examples) < 2:
        raise SourceError(
            path, "there is one example; a verb blends at least two: add motions with other adverb values"
        )
    seen: set[str] = set()
    for example in examples:
        if example.name in seen:
            raise SourceError(
                path, "two examples have the same file name; give each motion its own file", example=example.name
            )
        seen.add(example.name)


def _units(reader: _Reader, table: dict[str, Any]) -> str:
    """Unit of length of the motion files; adverbs have units of their own."""
    given = table.get("units", {})
    if not isinstance(given, dict):
        raise SourceError(reader.path, "'units' must be written as a [units] table")
    length = reader.choice(given, "length", tuple(METRES_PER_UNIT), default="m")
    reader.choice(given, "time", ("s",), default="s")
    reader.choice(given, "adverb_angle", ("rad", "deg"), default="rad")
    return length


def _stretch(reader: _Reader, table: dict[str, Any]) -> float:
    """Largest distance of a joint from its mean offset that is dropped from motion files, metres."""
    (metres,) = reader.numbers({"stretch_m": [table.get("stretch_m", STRETCH_M)]}, "stretch_m", 1, "number", "")
    if metres < 0.0:
        raise SourceError(reader.path, f"stretch_m is {metres}; give metres, 0 or more")
    return metres


def _axes(reader: _Reader, table: dict[str, Any]) -> tuple[str, str]:
    """Directions that are up and forward in the motion files; ``[units]`` may hold them too."""
    units = table.get("units", {})
    up, forward = (
        reader.choice(units if key in units else table, key, tuple(AXES), default=usual)
        for key, usual in (("up_axis", "+Y"), ("forward_axis", "+Z"))
    )
    if up[1] == forward[1]:
        raise SourceError(reader.path, f"up_axis is '{up}' and forward_axis '{forward}'; they must be two axes")
    return up, forward


def _simplices(reader: _Reader, table: dict[str, Any], examples: int, dims: int) -> tuple[tuple[int, ...], ...]:
    rows = table.get("simplices", table.get("tetrahedra", []))
    if not isinstance(rows, list):
        raise SourceError(reader.path, "'simplices' must be a list of lists of example indices")
    for row in rows:
        fits = isinstance(row, list) and len(row) == dims + 1 and all(type(item) is int for item in row)
        if not fits or len(set(row)) != len(row) or not all(0 <= item < examples for item in row):
            raise SourceError(
                reader.path, f"simplex {row!r:.60} must be {dims + 1} different example indices below {examples}"
            )
    return tuple(tuple(row) for row in rows)


def _goal(reader: _Reader, table: dict[str, Any], measured: int) -> tuple[tuple[float, ...], ...]:
    """``[goal]`` with ``origin`` (m) and ``axes``, one per measured adverb: goal = origin + Σ adverb · axis."""
    goal = table.get("goal")
    if goal is None:
        return ()
    axes = goal.get("axes") if isinstance(goal, dict) else None
    if not isinstance(axes, list) or len(axes) != measured:
        raise SourceError(
            reader.path, f"[goal] needs origin = [x, y, z] and axes, one [x, y, z] for each of {measured}"
        )
    rows = [{"row": goal.get("origin")}, *({"row": axis} for axis in axes)]
    return tuple(reader.numbers(row, "row", 3, "coordinates", "[goal]") for row in rows)
