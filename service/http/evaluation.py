"""Checked requests → evaluated poses: the calls into the library, and where they run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from service import wire
from service.catalog.catalog import Entry
from service.errors import BadBody, BatchTooLarge
from service.http.request_models import BatchRequest, Options, PoseRequest, SequenceRequest
from service.http.response_json import Evaluated, Motion
from service.state import ServerState
from verbs.conventions import F64
from verbs.errors import OutOfRange, RequestError
from verbs.runtime import describe, error_bound
from verbs.runtime import sequence as sequences
from verbs.runtime.evaluate import Poses

__all__ = ["Batch", "binary_batch", "json_batch", "pose", "poses", "records", "sequence"]

MAX_WALKED_CYCLES = 20_000.0
"""Cycles that one call may have walked through, all poses together: about a second of work."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Poses that are asked for in one call.

    Parameters
    ----------
    options : Options
    adverbs : (B, D) array, or list of mappings
    at : (B,) float64
        Phases, or seconds.
    given_time : bool
    """

    options: Options
    adverbs: F64 | list[dict[str, float]]
    at: F64
    given_time: bool


async def pose(state: ServerState, entry: Entry, asked: PoseRequest) -> Evaluated:
    """One pose; on the event loop, unless it has a long way to walk."""
    entry.check(method=asked.method)
    evaluator, joints = entry.evaluator, entry.joints(asked.joints)

    def work() -> Evaluated:
        instant = {"phase": asked.phase, "time_s": asked.time}
        if asked.max_error is None:
            found = evaluator.pose(asked.adverbs, method=asked.method, **instant)
            return Evaluated(found, *describe.in_space(evaluator, found, asked.space, joints))
        met = error_bound.escalate(evaluator, evaluator.adverbs(asked.adverbs), asked.max_error, method=asked.method)
        found = evaluator.pose_of(met.blend, **instant)
        if met.turns is not None:
            found = error_bound.apply_polish(evaluator, found, met.turns)
        return Evaluated(found, *describe.in_space(evaluator, found, asked.space, joints), met.tried)

    cost = 0.0
    if entry.verb.looping:
        cost = entry.cost_us(1, asked.phase or (asked.time or 0.0) / entry.shortest_s)
    found = await state.pool.run(cost, work)
    state.metrics.count_poses(entry, found.poses.blend, 1)
    return found


def json_batch(state: ServerState, asked: BatchRequest, query: Mapping[str, Any]) -> Batch:
    """Poses of a JSON body."""
    given = [name for name, value in query.items() if value is not None]
    if given:
        raise RequestError(f"'{given[0]}' stands in the query; with a JSON body, give it in the body")
    _check_size(len(asked.items), state.settings.max_batch_json, "in JSON; send rows of float32 for more")
    timed = {item.get("time") is not None for item in asked.items}
    phased = any(item.get("phase") is not None for item in asked.items)
    if len(timed) == 2 or (True in timed and phased):
        raise RequestError("some items give a time and some a phase, or one gives both; give all the same")
    times = True in timed
    name: Literal["time", "phase"] = "time" if times else "phase"
    at = [item.get(name) or 0.0 for item in asked.items]
    return Batch(asked, [item["adverbs"] for item in asked.items], np.array(at, np.float64), times)


def binary_batch(state: ServerState, entry: Entry, content: bytes, query: Mapping[str, Any]) -> Batch:
    """Poses of a binary body: rows of adverbs and phase."""
    names = [adverb.name for adverb in entry.verb.adverbs]
    width = len(names) + 1
    if not content or len(content) % (4 * width):
        raise BadBody(
            f"the body is {len(content)} bytes long; it must be one or more rows of {width} little-endian float32, "
            f"{4 * width} bytes each: {', '.join(names)}, phase"
        )
    count = len(content) // (4 * width)
    _check_size(count, state.settings.max_batch, "")
    rows = np.frombuffer(content, "<f4").reshape(count, width).astype(np.float64)
    options = Options(**{name: value for name, value in query.items() if value is not None})
    return Batch(options, np.ascontiguousarray(rows[:, :-1]), np.ascontiguousarray(rows[:, -1]), False)


async def poses(state: ServerState, entry: Entry, batch: Batch) -> Evaluated:
    """A batch of poses in one call of the library; a long one in a thread."""
    options, evaluator = batch.options, entry.evaluator
    entry.check(method=options.method)
    joints = entry.joints(options.joints)
    named = isinstance(batch.adverbs, list)

    def work() -> Evaluated:
        instant: dict[str, Any] = {"time_s" if batch.given_time else "phase": batch.at}
        found = evaluator.pose(batch.adverbs, method=options.method, **instant)
        return Evaluated(found, *describe.in_space(evaluator, found, options.space, joints))

    cycles = _cycles(entry, batch)
    found = await state.pool.run(entry.cost_us(len(batch.at), cycles) + 4.0 * len(batch.at) * named, work)
    state.metrics.count_poses(entry, found.poses.blend, len(batch.at))
    return found


async def sequence(state: ServerState, entry: Entry, asked: SequenceRequest) -> Motion:
    """A whole motion; a long one in a thread."""
    entry.check(method=asked.method)
    evaluator, joints = entry.evaluator, entry.joints(asked.joints)
    limit = state.settings.max_sequence_frames

    def work() -> Motion:
        found = _frames(entry, asked, limit)
        shown = Evaluated(found, *describe.in_space(evaluator, found, asked.space, joints))
        whole = float(found.duration_s[0]) * asked.cycles if asked.adverbs is not None else float(found.time_s[-1])
        events = sequences.events(evaluator, found)
        return Motion(shown, asked.fps, whole, events, tracked=asked.track is not None)

    frames = asked.fps * entry.longest_s * asked.cycles * (1 if asked.track is None else 3)
    motion = await state.pool.run(entry.cost_us(int(frames), float(asked.cycles)), work)
    state.metrics.count_poses(entry, motion.frames.poses.blend, len(motion.frames.turns))
    return motion


async def records(state: ServerState, entry: Entry, found: Evaluated, *, crowd: bool) -> bytes:
    """Binary records: of a crowd, one channel each; else of one character over time, the last one flagged."""

    def work() -> bytes:
        channels = np.arange(len(found.turns)) % 65_536 if crowd else 0
        return wire.encode(found.poses, found.turns, entry.version, channels=channels, ended=not crowd).tobytes()

    return await state.pool.run(0.01 * found.turns.size, work)


def _frames(entry: Entry, asked: SequenceRequest, limit: int) -> Poses:
    evaluator, method, cycles = entry.evaluator, asked.method, asked.cycles
    if asked.track is None:
        assert asked.adverbs is not None  # the schema sees to it
        rows = evaluator.adverbs(asked.adverbs)
        return sequences.sequence(evaluator, rows, asked.fps, cycles=cycles, method=method, max_frames=limit)
    times = np.array([point.time for point in asked.track], np.float64)
    rows = evaluator.adverbs([point.adverbs for point in asked.track])
    return sequences.tracked(evaluator, times, rows, asked.fps, cycles=cycles, method=method, max_frames=limit)


def _cycles(entry: Entry, batch: Batch) -> float:
    """Cycles that a batch walks through; refused where they are too many."""
    if not entry.verb.looping:
        return 0.0
    total = float(batch.at.sum()) / (entry.shortest_s if batch.given_time else 1.0)
    if total > MAX_WALKED_CYCLES:
        raise OutOfRange(
            f"the batch goes through {total:.0f} cycles, all poses together; {MAX_WALKED_CYCLES:.0f} are allowed"
        )
    return total


def _check_size(count: int, limit: int, advice: str) -> None:
    if count > limit:
        raise BatchTooLarge(f"{count} poses are asked for; at most {limit} are allowed {advice}".rstrip(), limit=limit)
