"""JSON and binary records → answers. What does not fit is a :class:`DecodeError`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError
from adverb_client.models import Adverb, Event, Example, Health, Pose, Poses, Sequence, Skipped, Verb, VerbSummary
from adverb_client.records import CLAMPED, LAST
from adverb_client.skeleton import Skeleton

__all__ = [
    "health",
    "parsed",
    "pose",
    "pose_of_records",
    "poses",
    "poses_of_records",
    "sequence",
    "sequence_of_records",
    "verb",
    "verbs",
]

T = TypeVar("T")
Json = Mapping[str, Any]
Records = npt.NDArray[np.void]


def parsed(content: bytes, build: Callable[[Any], T]) -> T:
    """Read JSON and build an answer of it.

    Raises
    ------
    DecodeError
        If it is no JSON, or something that the answer needs is missing or of another shape.
    """
    try:
        return build(json.loads(content))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as err:
        raise DecodeError(f"an answer that cannot be read: {type(err).__name__}: {err}"[:500]) from err


def verbs(told: Json) -> tuple[VerbSummary, ...]:
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
        for row in told["verbs"]
    )


def verb(told: Json) -> Verb:
    """All about one verb."""
    return Verb(
        told["name"],
        told["version"],
        told["description"],
        told["looping"],
        tuple(
            Adverb(row["name"], row["unit"], row["min"], row["max"], row["style"], row.get("description", ""))
            for row in told["adverbs"]
        ),
        Skeleton.from_json(told["skeleton"]),
        tuple(Example(row["name"], row["adverbs"], tuple(row["keytimes"])) for row in told["examples"]),
        dict(zip(told["keytime_names"], told["keytime_phases"], strict=True)),
        tuple(told["methods"]),
        told["default_method"],
        told["measure"],
        told["quality"],
        told,
    )


def health(told: Json) -> Health:
    """Readiness."""
    skipped = tuple(Skipped(row["file"], row["problem"]) for row in told.get("skipped", ()))
    return Health(told["ready"], told["verbs"], skipped)


def pose(told: Json) -> Pose:
    """One pose of JSON."""
    tried = told.get("tried")
    return Pose(
        told["verb"],
        told["version"],
        told["phase"],
        told["time"],
        told["duration"],
        _f32(told["root"], (3,)),
        _f32(told["rotations"], (-1, 4)),
        told["error"],
        told["clamped"],
        told["method"],
        told["measured"],
        _where_told(told, "positions", (-1, 3)),
        _where_told(told, "root_velocity", (3,)),
        _weights(told),
        told.get("met"),
        None if tried is None else tuple(tried),
    )


def poses(told: Json) -> Poses:
    """Many poses of JSON, turned into columns."""
    rows = [pose(row) for row in told["poses"]]

    def column(name: str) -> Any:
        values = [getattr(row, name) for row in rows]
        return None if values[0] is None else np.stack(values)

    def numbers(name: str) -> npt.NDArray[np.float32]:
        return np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in rows], np.float32)

    measured = {name: np.array([(row.measured or {})[name] for row in rows]) for name in rows[0].measured or {}}
    return Poses(
        told["verb"],
        told["version"],
        numbers("phase"),
        numbers("time_s"),
        numbers("duration_s"),
        column("root"),
        column("rotations"),
        numbers("error"),
        np.array([row.clamped for row in rows], bool),
        told["method"],
        measured,
        column("positions"),
        column("root_velocity"),
        column("weights"),
    )


def sequence(told: Json) -> Sequence:
    """A whole motion of JSON."""
    frames = told["frames"]
    errors = told.get("errors") or [told["error"]] * frames
    return Sequence(
        told["verb"],
        told["version"],
        told["fps"],
        told["duration"],
        np.array(told["phases"], np.float64).reshape(frames),
        np.array(told["times"], np.float64).reshape(frames),
        _f32(told["root"], (frames, 3)),
        _f32(told["rotations"], (frames, -1, 4)),
        np.array([np.nan if error is None else error for error in errors], np.float64).reshape(frames),
        told["clamped"],
        told["method"],
        told["measured"],
        tuple(Event(row["name"], row["phase"], row["time"]) for row in told["events"]),
        _where_told(told, "positions", (frames, -1, 3)),
        _where_told(told, "root_velocity", (frames, 3)),
        _weights(told),
    )


def pose_of_records(verb: str, rows: Records) -> Pose:
    """One pose of a binary record."""
    return poses_of_records(verb, rows)[0]


def poses_of_records(verb: str, rows: Records) -> Poses:
    """Many poses of binary records, as views of what was received."""
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
    )


def sequence_of_records(verb: str, rows: Records, *, fps: float, cycles: int | None) -> Sequence:
    """A whole motion of binary records.

    Parameters
    ----------
    verb : str
    rows : (F,) records
    fps : float
    cycles : int or None
        Of a motion at constant adverbs, whose duration every record tells; None of a track.
    """
    if not rows["flags"][-1] & LAST:
        raise DecodeError("the last record of a sequence is not flagged so; the answer was cut")
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
    )


def _f32(numbers: Any, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    return np.array(numbers, np.float32).reshape(shape)


def _where_told(told: Json, name: str, shape: tuple[int, ...]) -> npt.NDArray[np.float32] | None:
    return None if told.get(name) is None else _f32(told[name], shape)


def _weights(told: Json) -> npt.NDArray[np.float64] | None:
    return None if told.get("weights") is None else np.array(told["weights"], np.float64)
