"""Parses JSON and binary records to models; malformed input raises :class:`DecodeError`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError
from adverb_client.models import (
    Adverb,
    Example,
    Health,
    KeytimeEvent,
    Mapped,
    Pose,
    Poses,
    QualityMap,
    Sequence,
    SkippedFile,
    Verb,
    VerbSummary,
)
from adverb_client.records import CLAMPED, LAST, supports_of
from adverb_client.skeleton import Skeleton

__all__ = [
    "health",
    "parse_json",
    "pose",
    "pose_of_records",
    "poses",
    "poses_of_records",
    "quality",
    "sequence",
    "sequence_of_records",
    "verb",
    "verbs",
]

T = TypeVar("T")
Json = Mapping[str, Any]
Records = npt.NDArray[np.void]


def parse_json(content: bytes, build: Callable[[Any], T]) -> T:
    """Parse JSON and build a model of it.

    Raises
    ------
    DecodeError
        If the content is not JSON, or a required field is missing or of the wrong type or shape.
    """
    try:
        return build(json.loads(content))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as err:
        raise DecodeError(f"malformed response: {type(err).__name__}: {err}"[:500]) from err


def verbs(fields: Json) -> tuple[VerbSummary, ...]:
    """The list of verbs."""
    return tuple(
        VerbSummary(
            row["name"],
            row["version"],
            row["description"],
            row["looping"],
            tuple(row["adverbs"]),
            row["joints"],
            row["examples"],
            (row["duration"]["min"], row["duration"]["max"]),
            row["default_method"],
        )
        for row in fields["verbs"]
    )


def verb(fields: Json) -> Verb:
    """Description of one verb."""
    return Verb(
        fields["name"],
        fields["version"],
        fields["description"],
        fields["looping"],
        tuple(
            Adverb(row["name"], row["unit"], row["min"], row["max"], row["style"], row.get("description", ""))
            for row in fields["adverbs"]
        ),
        Skeleton.from_json(fields["skeleton"]),
        tuple(Example(row["name"], row["adverbs"], tuple(row["keytimes"])) for row in fields["examples"]),
        dict(zip(fields["keytime_names"], fields["keytime_phases"], strict=True)),
        tuple(fields["methods"]),
        fields["default_method"],
        fields["measure"],
        fields["quality"],
        fields,
    )


def health(fields: Json) -> Health:
    """Readiness."""
    skipped = tuple(SkippedFile(row["file"], row["problem"]) for row in fields.get("skipped", ()))
    return Health(fields["ready"], fields["verbs"], skipped)


def pose(fields: Json) -> Pose:
    """One pose of JSON."""
    tried = fields.get("tried")
    return Pose(
        fields["verb"],
        fields["version"],
        fields["phase"],
        fields["time"],
        fields["duration"],
        _f32(fields["root"], (3,)),
        _f32(fields["rotations"], (-1, 4)),
        fields["error"],
        fields["clamped"],
        fields["method"],
        fields["measured"],
        _optional(fields, "positions", (-1, 3)),
        _optional(fields, "root_velocity", (3,)),
        _weights(fields),
        fields.get("met"),
        None if tried is None else tuple(tried),
        fields.get("support"),
        _mapped(fields),
    )


def poses(fields: Json) -> Poses:
    """Many poses of JSON, as columns."""
    rows = [pose(row) for row in fields["poses"]]
    mapped = [_mapped({**row, "map": fields["map"]}) for row in fields["poses"]] if "map" in fields else []

    def column(name: str) -> Any:
        values = [getattr(row, name) for row in rows]
        return None if values[0] is None else np.stack(values)

    def numbers(name: str) -> npt.NDArray[np.float32]:
        return np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in rows], np.float32)

    measured = {name: np.array([(row.measured or {})[name] for row in rows]) for name in rows[0].measured or {}}
    return Poses(
        fields["verb"],
        fields["version"],
        numbers("phase"),
        numbers("time_s"),
        numbers("duration_s"),
        column("root"),
        column("rotations"),
        numbers("error"),
        np.array([row.clamped for row in rows], bool),
        fields["method"],
        measured,
        column("positions"),
        column("root_velocity"),
        column("weights"),
        column("support"),
        tuple(row for row in mapped if row is not None) or None,
    )


def sequence(fields: Json) -> Sequence:
    """A whole motion of JSON."""
    frames = fields["frames"]
    errors = fields.get("errors") or [fields["error"]] * frames
    supports = fields.get("supports", [fields["support"]] * frames if "support" in fields else None)
    return Sequence(
        fields["verb"],
        fields["version"],
        fields["fps"],
        fields["duration"],
        np.array(fields["phases"], np.float64).reshape(frames),
        np.array(fields["times"], np.float64).reshape(frames),
        _f32(fields["root"], (frames, 3)),
        _f32(fields["rotations"], (frames, -1, 4)),
        np.array([np.nan if error is None else error for error in errors], np.float64).reshape(frames),
        fields["clamped"],
        fields["method"],
        fields["measured"],
        tuple(KeytimeEvent(row["name"], row["phase"], row["time"]) for row in fields["events"]),
        _optional(fields, "positions", (frames, -1, 3)),
        _optional(fields, "root_velocity", (frames, 3)),
        _weights(fields),
        None if supports is None else np.array(supports, np.float64).reshape(frames),
        _mapped(fields),
    )


def pose_of_records(verb: str, rows: Records) -> Pose:
    """One pose of a binary record."""
    return poses_of_records(verb, rows)[0]


def poses_of_records(verb: str, rows: Records) -> Poses:
    """Many poses of binary records, as views of the received bytes."""
    return Poses(
        verb,
        int(rows["version"][0]),
        rows["phase"],
        rows["time"],
        rows["duration"],
        rows["root"],
        rows["rotations"],
        rows["error"],
        (rows["flags"] & CLAMPED).astype(bool),
        support=supports_of(rows["flags"]),
    )


def sequence_of_records(verb: str, rows: Records, *, fps: float, cycles: int | None) -> Sequence:
    """A whole motion of binary records.

    Parameters
    ----------
    verb : str
    rows : (F,) records
    fps : float
    cycles : int or None
        Number of cycles of a motion at constant adverbs; None for a track.
    """
    if not rows["flags"][-1] & LAST:
        raise DecodeError("the last record of a sequence lacks the flag `last`; the response is truncated")
    duration_s = float(rows["time"][-1]) if cycles is None else float(rows["duration"][0]) * cycles
    return Sequence(
        verb,
        int(rows["version"][0]),
        fps,
        duration_s,
        rows["phase"].astype(np.float64),
        rows["time"].astype(np.float64),
        rows["root"],
        rows["rotations"],
        rows["error"].astype(np.float64),
        bool((rows["flags"] & CLAMPED).any()),
        support=supports_of(rows["flags"]),
    )


def _f32(numbers: Any, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    return np.array(numbers, np.float32).reshape(shape)


def _optional(fields: Json, name: str, shape: tuple[int, ...]) -> npt.NDArray[np.float32] | None:
    return None if fields.get(name) is None else _f32(fields[name], shape)


def _mapped(fields: Json) -> Mapped | None:
    """The skeleton of a mapped answer with its figures."""
    head = fields.get("map")
    if head is None:
        return None
    figures = fields["figures"]
    names = ("effector_m", "foot_height_m", "foot_slide_m")
    return Mapped(head["name"], head["goal"], head["scale"], tuple(head["joints"]), *(figures[name] for name in names))


def _weights(fields: Json) -> npt.NDArray[np.float64] | None:
    return None if fields.get("weights") is None else np.array(fields["weights"], np.float64)


def quality(fields: Json) -> QualityMap:
    """A map of quality."""
    return QualityMap(
        verb=fields["verb"],
        version=int(fields["version"]),
        method=fields["method"],
        unit=fields["unit"],
        across=fields["across"],
        up=fields["up"] or "",
        held=dict(fields["held"]),
        columns=np.array(fields["columns"], np.float64),
        rows=np.array(fields["rows"], np.float64),
        error=np.array(fields["error"], np.float64),
        smoothness=np.array(fields["smoothness"], np.float64),
        support=np.array(fields["support"], np.float64),
        info=fields,
    )
