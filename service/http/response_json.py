"""JSON of evaluated poses, in slices that block the event loop for less than a millisecond each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from service.catalog.catalog import Entry
from service.http.mapped import Shown
from verbs.conventions import F64
from verbs.runtime import describe, sequence
from verbs.runtime.evaluate import Poses

__all__ = ["Evaluated", "Motion", "poses_json", "sequence_json", "single_json"]

SLICE_FLOATS = 6_000
"""Numbers in a slice; orjson writes about 20 numbers per microsecond."""

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """Evaluated poses, in the space and with the joints of the request.

    Parameters
    ----------
    poses : Poses
    rotations : (B, J, 4) float32
    positions : (B, J, 3) float32 or None
        Joint positions in global space, metres.
    support : (B,) or (1,) float64 or None
        Support of the blend by the examples; None where the answer is binary.
    tried : tuple of str
        With an error bound: the methods that were tried, in order.
    shown : Shown or None
        The poses on another skeleton, if requested; the other fields are then those of it.
    """

    poses: Poses
    rotations: F32
    positions: F32 | None
    support: F64 | None
    tried: tuple[str, ...] = ()
    shown: Shown | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """An evaluated sequence.

    Parameters
    ----------
    frames : Evaluated
    fps : float
    duration_s : float
    events : list of Event
    tracked : bool
        Whether the adverbs change over time.
    """

    frames: Evaluated
    fps: float
    duration_s: float
    events: list[sequence.Event]
    tracked: bool


def _dump(value: Any) -> bytes:
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)


def _fields(entry: Entry, found: Evaluated, index: int, *, weights: bool) -> dict[str, Any]:
    record = describe.pose_fields(
        entry.evaluator,
        found.poses,
        index,
        found.rotations,
        found.positions,
        support=found.support,
        version=entry.version,
        weights=weights,
    )
    if found.shown is not None:
        record["figures"] = found.shown.figures[index].as_dict()
    return record


def single_json(entry: Entry, found: Evaluated, *, weights: bool, max_error: float | None) -> bytes:
    """JSON of one pose."""
    record = _fields(entry, found, 0, weights=weights)
    if max_error is not None:
        error = record["error"]
        record["met"] = None if error is None else error <= max_error
        record["tried"] = list(found.tried)
    if found.shown is not None:
        record["map"] = found.shown.head
    return _dump(record)


def poses_json(entry: Entry, found: Evaluated, *, weights: bool) -> Iterator[bytes]:
    """JSON of a batch of poses, in slices."""
    head: dict[str, Any] = {"verb": entry.verb.name, "version": entry.version, "method": found.poses.blend.method}
    if found.shown is not None:
        head["map"] = found.shown.head
    size, step = len(found.rotations), _rows_per_slice(found)
    before = _dump(head)[:-1] + b',"poses":['
    for start in range(0, size, step):
        rows = [_fields(entry, found, k, weights=weights) for k in range(start, min(start + step, size))]
        yield before + _dump(rows)[1:-1]
        before = b","
    yield b"]}"


def sequence_json(entry: Entry, motion: Motion, *, weights: bool) -> Iterator[bytes]:
    """JSON of a sequence, column by column; the long columns come last, in slices."""
    poses = motion.frames.poses
    yield _dump(_sequence_head(entry, motion, weights=weights))[:-1]
    columns: list[tuple[str, npt.NDArray[Any]]] = [
        ("times", poses.time_s),
        ("phases", poses.phase),
        ("root", poses.root.astype(np.float32)),
    ]
    if poses.root_velocity is not None:
        columns.append(("root_velocity", poses.root_velocity.astype(np.float32)))
    if motion.frames.positions is not None:
        columns.append(("positions", motion.frames.positions))
    columns.append(("rotations", motion.frames.rotations))
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
    if (support := motion.frames.support) is not None:
        head["support"] = float(support.min())
        if not constant:
            head["supports"] = support
    if weights:
        head["weights"] = blend.weights
    if (shown := motion.frames.shown) is not None:
        head |= {"map": shown.head, "figures": shown.figures[0].as_dict()}
    return head


def _rows_per_slice(found: Evaluated) -> int:
    numbers: int = found.rotations.shape[1] * (4 if found.positions is None else 7)
    return max(1, SLICE_FLOATS // (numbers + 100))  # the other fields of a pose take as long as 100 numbers
