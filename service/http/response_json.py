"""Poses → JSON bytes, in slices that hold the event loop up for less than a millisecond each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from service.catalog.catalog import Entry
from verbs.runtime import describe, sequence
from verbs.runtime.evaluate import Poses

__all__ = ["Evaluated", "Motion", "poses_json", "sequence_json", "single_json"]

SLICE_FLOATS = 6_000
"""Numbers per slice: orjson writes about 20 of them in a microsecond."""

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """Poses as they were asked for.

    Parameters
    ----------
    poses : Poses
    turns : (B, J, 4) float32
    places : (B, J, 3) float32 or None
    tried : tuple of str
        Where an error bound was given: what was done to meet it, in order.
    """

    poses: Poses
    turns: F32
    places: F32 | None
    tried: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A sequence as it was asked for.

    Parameters
    ----------
    frames : Evaluated
    fps : float
    duration_s : float
    events : list of Event
    tracked : bool
        Whether adverbs change on the way.
    """

    frames: Evaluated
    fps: float
    duration_s: float
    events: list[sequence.Event]
    tracked: bool


def _dump(value: Any) -> bytes:
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)


def _fields(entry: Entry, found: Evaluated, index: int, *, weights: bool) -> dict[str, Any]:
    return describe.pose_fields(
        entry.evaluator, found.poses, index, found.turns, found.places, version=entry.version, weights=weights
    )


def single_json(entry: Entry, found: Evaluated, *, weights: bool, max_error: float | None) -> bytes:
    """One pose."""
    record = _fields(entry, found, 0, weights=weights)
    if max_error is not None:
        error = record["error"]
        record["met"] = None if error is None else error <= max_error
        record["tried"] = list(found.tried)
    return _dump(record)


def poses_json(entry: Entry, found: Evaluated, *, weights: bool) -> Iterator[bytes]:
    """A batch of poses."""
    head = {"verb": entry.verb.name, "version": entry.version, "method": found.poses.blend.method}
    size, step = len(found.turns), _rows_per_slice(found)
    before = _dump(head)[:-1] + b',"poses":['
    for start in range(0, size, step):
        rows = [_fields(entry, found, k, weights=weights) for k in range(start, min(start + step, size))]
        yield before + _dump(rows)[1:-1]
        before = b","
    yield b"]}"


def sequence_json(entry: Entry, motion: Motion, *, weights: bool) -> Iterator[bytes]:
    """A whole motion, column by column; the columns that are long come last, in slices."""
    poses = motion.frames.poses
    yield _dump(_sequence_head(entry, motion, weights=weights))[:-1]
    columns: list[tuple[str, npt.NDArray[Any]]] = [
        ("times", poses.time_s),
        ("phases", poses.phase),
        ("root", poses.root.astype(np.float32)),
    ]
    if poses.root_velocity is not None:
        columns.append(("root_velocity", poses.root_velocity.astype(np.float32)))
    if motion.frames.places is not None:
        columns.append(("positions", motion.frames.places))
    columns.append(("rotations", motion.frames.turns))
    for name, column in columns:
        step = max(1, SLICE_FLOATS // max(1, column[0].size))
        before = f',"{name}":['.encode()
        for start in range(0, len(column), step):
            yield before + _dump(column[start : start + step])[1:-1]
            before = b","
        yield b"]"
    yield b"}"


def _sequence_head(entry: Entry, motion: Motion, *, weights: bool) -> dict[str, Any]:
    poses, verb = motion.frames.poses, entry.verb
    blend = poses.blend
    errors = describe.numbers(blend.error)
    constant = not motion.tracked
    names = [verb.adverbs[axis].name for axis in verb.measure.axes.tolist()] if blend.measured.size else []
    head: dict[str, Any] = {
        "verb": verb.name,
        "version": entry.version,
        "method": blend.method,
        "fps": motion.fps,
        "frames": len(poses.phase),
        "duration": motion.duration_s,
        "clamped": bool(blend.clamped.any()),
        "measured": dict(zip(names, blend.measured[0].tolist(), strict=True)) if constant else None,
        "error": max((error for error in errors if error is not None), default=None),
        "events": [{"name": event.name, "phase": event.phase, "time": event.time_s} for event in motion.events],
    }
    if not constant:
        head["errors"] = errors
    if weights:
        head["weights"] = blend.weights
    return head


def _rows_per_slice(found: Evaluated) -> int:
    numbers: int = found.turns.shape[1] * (4 if found.places is None else 7)
    return max(1, SLICE_FLOATS // (numbers + 100))  # the other fields of a pose weigh as much as 100 numbers
