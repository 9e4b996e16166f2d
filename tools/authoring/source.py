"""Write authored examples as a verb source: BVH files and a verb.toml, the same bytes for the same examples."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from verbs.conventions import F64, Floats
from verbs.io import bvh
from verbs.kernels import fk
from verbs.motion import Motion

__all__ = ["Adverb", "Example", "Source", "measured", "write"]

_AXES = {"x": 0, "y": 1, "z": 2}

_GIVEN = ("root_velocity", "none")
"""Measures whose adverbs are those that the author aims at: a path of constant speeds, or style alone."""


@dataclass(frozen=True, slots=True)
class Adverb:
    """One parameter of a verb; ``style`` marks one whose value cannot be measured from the motion."""

    name: str
    unit: str
    description: str
    style: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """One authored motion.

    Parameters
    ----------
    name : str
        Its file is ``<name>.bvh``.
    motion : Motion
        The motion.
    keytimes : (K,) float64
        Seconds, each on a frame.
    style : tuple of float
        Values of the style adverbs, which stand after the measured ones; of all adverbs of a path's speeds.
    contacts : mapping of (str, str) to list of (float, float)
        Foot joint and part, and the intervals, s, in which it stands; what is not named is detected.
    """

    name: str
    motion: Motion
    keytimes: F64
    style: tuple[float, ...] = ()
    contacts: Mapping[tuple[str, str], list[tuple[float, float]]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A verb to be written.

    Parameters
    ----------
    comment : str
        First lines of verb.toml.
    keys : mapping
        Top-level keys of verb.toml in order; ``name``, ``effector`` and ``effector_keytime_index`` among them, and
        ``goal`` (a mapping with ``origin`` and ``axes``) where the adverbs are coordinates on a sheet.
    adverbs : sequence of Adverb
        Measured adverbs are named x, y or z after the effector's coordinate, unless they lie on a sheet; those of a
        jump are its distance, direction and height.
    examples : iterable of Example
        May be authored lazily.
    decimals : int
        Digits after the point in the BVH files, degrees and metres.
    """

    comment: str
    keys: Mapping[str, object]
    adverbs: tuple[Adverb, ...]
    examples: Iterable[Example]
    decimals: int


def write(source: Source, folder: Path) -> Iterable[str]:
    """Write a verb source into a folder, one step at a time; BVH files that no longer belong to it are removed.

    Yields
    ------
    name : str
        Of each example when its file is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    blocks, written = [], set()
    contacts: dict[tuple[str, str], dict[str, list[list[float]]]] = {}
    for example in source.examples:
        path = folder / f"{example.name}.bvh"
        bvh.write(example.motion, path, decimals=source.decimals)
        values: list[float] = []
        if source.keys["measure"] not in _GIVEN:
            point = measured(source, path, example.keytimes)
            values = [round(float(value), 9) for value in _coordinates(source, point)]
        rows = {"file": path.name, "keytimes": example.keytimes.tolist(), "adverb_values": [*values, *example.style]}
        blocks.append(_table("[[example]]", rows))
        written.add(path)
        for where, spans in example.contacts.items():
            contacts.setdefault(where, {})[example.name] = [list(span) for span in spans]
        yield example.name
    for stale in sorted(set(folder.glob("*.bvh")) - written):
        stale.unlink()
    head = "".join(f"# {line}\n" for line in source.comment.splitlines())
    units = _table("[units]", {"length": "m", "time": "s", "bvh_angle": "deg"})
    adverbs = [_table("[[adverb]]", _adverb_rows(each)) for each in source.adverbs]
    blocks += [
        _table("[[contact]]", {"joint": joint, "part": part, "intervals": intervals})
        for (joint, part), intervals in contacts.items()
    ]
    text = "\n".join([head + _rows(source.keys), units, *adverbs, *blocks])
    (folder / "verb.toml").write_text(text, encoding="utf-8", newline="\n")


def measured(source: Source, path: Path, keytimes: Floats) -> F64:
    """Position (3,) of the effector at its keytime, measured from a written file.

    Of a jump: displacement sideways and forward, and rise of the root.
    """
    motion = bvh.read(path)
    if source.keys["measure"] == "jump":
        start, end = motion.root[[0, -1]]
        return np.array([end[0] - start[0], end[2] - start[2], motion.root[:, 1].max() - start[1]])
    index = source.keys["effector_keytime_index"]
    assert isinstance(index, int)  # a mistake in the authoring code
    frame = round(float(np.asarray(keytimes)[index]) * motion.fps)
    skeleton = motion.skeleton
    positions = fk.forward(motion.root[frame], motion.rotations[frame], skeleton.parents, skeleton.offsets)[1]
    return np.asarray(positions[skeleton.index(str(source.keys["effector"]))])


def _coordinates(source: Source, point: F64) -> F64:
    """Measured adverbs (D,) of a point (3,): its coordinates, or those of the nearest point of the sheet."""
    if source.keys["measure"] == "jump":
        return np.array([np.hypot(*point[:2]), np.arctan2(*point[:2]), point[2]])
    goal = source.keys.get("goal")
    if isinstance(goal, Mapping):
        return np.asarray(np.linalg.lstsq(np.transpose(goal["axes"]), point - goal["origin"])[0])
    return np.array([point[_AXES[each.name]] for each in source.adverbs if not each.style])


def _adverb_rows(adverb: Adverb) -> dict[str, object]:
    rows: dict[str, object] = {"name": adverb.name, "unit": adverb.unit, "description": adverb.description}
    return rows | {"style": True} if adverb.style else rows


def _table(heading: str, rows: Mapping[str, object]) -> str:
    return f"{heading}\n{_rows(rows)}"


def _rows(rows: Mapping[str, object]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in rows.items())


def _value(value: object) -> str:
    # JSON writes strings, numbers, lists and booleans exactly as TOML reads them; inline tables differ.
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_value(each)}" for key, each in value.items()) + "}"
    return json.dumps(value, ensure_ascii=False)
