"""Mirror a whole verb source: its clips, its adverbs, its effector, contacts and mends."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from verbs.authoring.reading import read_motions
from verbs.authoring.source import Source, SourceExample, read
from verbs.authoring.toml_text import toml_dump
from verbs.clips.mirror import Mirrored, mirror
from verbs.clips.pairs import find_pairs
from verbs.conventions import METRES_PER_UNIT
from verbs.errors import SourceError
from verbs.io import bvh
from verbs.skeleton import Skeleton

__all__ = ["mirror_source"]

_AXES = ("up_axis", "forward_axis")
"""Keys that are left out: what is written has +Y up and +Z forward."""

_SIDEWAYS = {
    "position": ("x",),
    "velocity": ("x",),
    "angular_velocity": ("y", "z"),  # an axial vector
    "orientation": ("yaw", "roll", "azimuth"),
    "displacement": ("x", "direction"),
    "root_motion": ("sideways", "turn"),
    "foot_speed": ("sideways",),
}
"""Axes of each kind of measure that change their sign."""

_UNSAFE = re.compile(r"[^\w .-]")
"""What is not taken from the name of a clip into that of its file."""

_WORD = re.compile(r"\b(left|right|Left|Right|LEFT|RIGHT)\b")
_OTHER = {"left": "right", "Left": "Right", "LEFT": "RIGHT"}
_OTHER |= {value: key for key, value in _OTHER.items()}


def mirror_source(folder: str | Path, output: str | Path, table: Mapping[str, str] | None = None) -> list[Mirrored]:
    """Write the mirror image of a verb source into a new folder.

    Every file is written as BVH in the source's unit. In ``verb.toml``, measured adverbs that point sideways change
    their sign (x of ``joint_position``, direction of ``jump``, turn and sideways speed of ``root_velocity``); the
    effector and the joints of contacts and mends become their partners; left and right in the names of keytimes are
    exchanged. The name gains ``_mirrored``. Everything else is kept, apart from comments.

    Parameters
    ----------
    folder, output : str or Path
        ``output`` must not exist, or be an empty folder.
    table : mapping of str to str, optional
        Pairs of joints whose names do not show that they are one.

    Returns
    -------
    mirrored : list of Mirrored
        One for each example.

    Raises
    ------
    SourceError
        The source is wrong, or ``output`` is not empty.
    MotionFileError, UnknownName, OutOfRange
        A file cannot be read or written, or joints cannot be paired.
    """
    source, output = read(folder), Path(output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise SourceError(output, "is not empty; name a new folder")
    factor = 1.0 / METRES_PER_UNIT[source.length_unit]
    done = []
    motions, *_ = read_motions(source, lambda stage, count, total: None)
    for example, motion in zip(source.examples, motions, strict=True):
        mirrored = mirror(motion, table)
        path = output / _file(source, example)
        path.parent.mkdir(parents=True, exist_ok=True)
        bvh.write(mirrored.motion.scaled(factor), path, decimals=8)
        done.append(mirrored)
    given = tomllib.loads(source.path.read_text("utf-8-sig"))
    text = toml_dump(_mirrored_table(source, given, done[0].motion.skeleton, table))
    (output / "verb.toml").write_text(text, encoding="utf-8")
    return done


def _file(source: Source, example: SourceExample) -> Path:
    """Path of an example's BVH file in the mirrored source; a clip of a file with several gets one of its own."""
    path = example.file.relative_to(source.path.parent.resolve())
    return path.with_name(f"{_UNSAFE.sub('_', example.clip)}.bvh") if example.clip else path.with_suffix(".bvh")


def _mirrored_table(
    source: Source, given: dict[str, Any], skeleton: Skeleton, table: Mapping[str, str] | None
) -> dict[str, Any]:  # fmt: skip
    """The parsed ``verb.toml`` of the mirror image."""
    partner = find_pairs(skeleton, table).partner

    def other(name: str) -> str:
        return skeleton.names[partner[skeleton.names.index(name)]] if name in skeleton.names else name

    out = {**given, "name": f"{source.name}_mirrored", "mirrored_from": source.name}
    if isinstance(out.get("units"), dict):
        out["units"] = {key: value for key, value in out["units"].items() if key not in _AXES}
    out = {key: value for key, value in out.items() if key not in _AXES}
    for key in {"effector", "root"} & out.keys():
        out[key] = other(out[key])
    out["keytime_names"] = [_exchanged(name) for name in source.keytime_names]
    out["adverb"] = [_mirrored_adverb(row, other) for row in out["adverb"]]
    for key in {"contact", "mend"} & out.keys():
        out[key] = [_mirrored_row(row, other) for row in out[key]]
    signs = _signs(source)
    out["example"] = [
        {**{key: value for key, value in row.items() if key != "clip"}, "file": _file(source, example).as_posix(),
         "adverb_values": [sign * value + 0.0 for sign, value in zip(signs, example.values, strict=True)]}
        for row, example in zip(given["example"], source.examples, strict=True)
    ]  # fmt: skip
    if source.goal:
        goal = given["goal"]
        out["goal"] = {**goal, "origin": _flipped(goal["origin"]), "axes": [_flipped(axis) for axis in goal["axes"]]}
    return out


def _mirrored_row(row: dict[str, Any], other: Any) -> dict[str, Any]:
    """A ``[[contact]]`` or ``[[mend]]`` table of the mirror image."""
    out = dict(row)
    if "joint" in row:
        out["joint"] = other(row["joint"])
    if "degrees" in row:
        out["degrees"] = -row["degrees"]
    return out


def _exchanged(text: str) -> str:
    """A name with left and right exchanged."""
    return _WORD.sub(lambda found: _OTHER[found.group()], text)


def _mirrored_adverb(row: dict[str, Any], other: Any) -> dict[str, Any]:
    """An ``[[adverb]]`` table of the mirror image."""
    if "measure" not in row:
        return row
    measure = dict(row["measure"])
    for key in {"joint", "toward"} & measure.keys():
        measure[key] = other(measure[key])
    if "at" in measure:
        measure["at"] = _exchanged(measure["at"])
    if "between" in measure:
        measure["between"] = [_exchanged(name) for name in measure["between"]]
    return {**row, "measure": measure}


def _flipped(vector: list[float]) -> list[float]:
    return [-vector[0] + 0.0, *vector[1:]]


def _signs(source: Source) -> list[float]:
    """Sign of each adverb in the mirror image."""
    signs = [1.0] * len(source.adverbs)
    measured = [k for k, adverb in enumerate(source.adverbs) if not adverb.style]
    if source.measure == "joint_position" and not source.goal:
        for k in measured[:1] if len(measured) == 3 else measured:
            signs[k] = -1.0 if len(measured) == 3 or source.adverbs[k].name == "x" else 1.0
    elif source.measure == "jump":
        signs[measured[1]] = -1.0
    elif source.measure == "root_velocity":
        signs[measured[1]] = signs[measured[2]] = -1.0
    for k, adverb in enumerate(source.adverbs):
        if adverb.measure is not None:
            signs[k] = -1.0 if adverb.measure.axis in _SIDEWAYS.get(adverb.measure.kind, ()) else 1.0
    return signs
