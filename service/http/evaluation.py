"""Evaluation of validated requests: the calls into the library, on the event loop or in a thread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from service import wire
from service.catalog.catalog import Entry
from service.errors import BadBody, BatchTooLarge
from service.http.mapped import COST_US, PREPARE_US, mapped_poses, prepared
from service.http.negotiation import parsed
from service.http.request_models import BatchRequest, Options, PoseRequest, SequenceRequest
from service.http.response_json import Evaluated, Motion
from service.state import ServerState
from verbs.conventions import F64
from verbs.errors import OutOfRange, RequestError
from verbs.runtime import describe, error_bound
from verbs.runtime import sequence as sequences
from verbs.runtime.evaluate import Poses

__all__ = ["Batch", "binary_batch", "json_batch", "pose", "poses", "records", "sequence"]

MAX_CYCLES = 20_000.0
"""Cycles of a looping verb that one request may integrate, all poses together: about a second of work."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """The poses of one request.

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


async def pose(
    state: ServerState, entry: Entry, request: PoseRequest, *, support: bool, counted: bool = True
) -> Evaluated:
    """Evaluate one pose, with its support if requested; on the event loop unless many cycles have to be integrated.

    Poses of verbs that are not served are not ``counted``.
    """
    entry.check(method=request.method)
    evaluator, joints = entry.evaluator, None if request.map else entry.joints(request.joints)

    def work() -> Evaluated:
        instant: dict[str, Any] = {"phase": request.phase, "time_s": request.time, "plant": request.plant}
        if request.max_error is None:
            found = evaluator.pose(request.adverbs, method=request.method, **instant)
            shares = evaluator.support(found.blend) if support else None
            if request.map:
                return _on_target(entry, found, request, shares)
            return Evaluated(found, *describe.in_space(evaluator, found, request.space, joints), shares)
        met = error_bound.escalate(
            evaluator, evaluator.adverbs(request.adverbs), request.max_error, method=request.method
        )
        found = evaluator.pose_of(met.blend, **instant)
        if met.rotation_vectors is not None:
            found = error_bound.apply_polish(evaluator, found, met.rotation_vectors)
        shares = evaluator.support(found.blend) if support else None
        if request.map:
            return _on_target(entry, found, request, shares, met.tried)
        return Evaluated(found, *describe.in_space(evaluator, found, request.space, joints), shares, met.tried)

    cost = 0.0
    if entry.verb.looping:
        cost = entry.cost_us(1, request.phase or (request.time or 0.0) / entry.shortest_s)
    if request.map:
        cost += COST_US if prepared(entry, request) else PREPARE_US
    found = await state.pool.run(cost, work)
    if counted:
        state.metrics.count_poses(entry, found.poses.blend, 1)
    return found


def json_batch(state: ServerState, content: bytes, query: Mapping[str, Any]) -> Batch:
    """Batch of a JSON body.

    Parsing blocks other requests, so a body with more objects than the largest batch is refused before.
    """
    most, advice = state.settings.max_batch_json, "in JSON; for more, send rows of float32"
    if content.count(b"{") > 1 + 2 * most:
        raise BatchTooLarge(f"at most {most} poses are allowed {advice}", limit=most)
    request = parsed(content, BatchRequest)
    given = [name for name, value in query.items() if value is not None]
    if given:
        raise RequestError(f"'{given[0]}' is in the query; with a JSON body it belongs in the body")
    _check_size(len(request.items), most, advice)
    timed = {item.get("time") is not None for item in request.items}
    phased = any(item.get("phase") is not None for item in request.items)
    if len(timed) == 2 or (True in timed and phased):
        raise RequestError("some items have a time and some a phase, or one has both; all must have the same")
    times = True in timed
    name: Literal["time", "phase"] = "time" if times else "phase"
    at = [item.get(name) or 0.0 for item in request.items]
    return Batch(request, [item["adverbs"] for item in request.items], np.array(at, np.float64), times)


def binary_batch(state: ServerState, entry: Entry, content: bytes, query: Mapping[str, Any]) -> Batch:
    """Batch of a binary body: rows of adverbs and phase."""
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


async def poses(state: ServerState, entry: Entry, batch: Batch, *, support: bool) -> Evaluated:
    """Evaluate a batch in one call of the library; a long one runs in a thread."""
    options, evaluator = batch.options, entry.evaluator
    entry.check(method=options.method)
    joints = None if options.map else entry.joints(options.joints)
    named = isinstance(batch.adverbs, list)

    def work() -> Evaluated:
        instant: dict[str, Any] = {"time_s" if batch.given_time else "phase": batch.at}
        found = evaluator.pose(batch.adverbs, method=options.method, plant=options.plant, **instant)
        shares = evaluator.support(found.blend) if support else None
        if options.map:
            return _on_target(entry, found, options, shares)
        return Evaluated(found, *describe.in_space(evaluator, found, options.space, joints), shares)

    cycles = _cycles(entry, batch)
    cost = entry.cost_us(len(batch.at), cycles) + 4.0 * len(batch.at) * named
    if options.map:
        cost += COST_US * len(batch.at) if prepared(entry, options) else PREPARE_US
    found = await state.pool.run(cost, work)
    state.metrics.count_poses(entry, found.poses.blend, len(batch.at))
    return found


async def sequence(
    state: ServerState, entry: Entry, request: SequenceRequest, *, support: bool, counted: bool = True
) -> Motion:
    """Evaluate a whole motion; a long one runs in a thread. ``counted`` as of :func:`pose`."""
    entry.check(method=request.method)
    evaluator, joints = entry.evaluator, None if request.map else entry.joints(request.joints)
    limit = state.settings.max_sequence_frames

    def work() -> Motion:
        found = _frames(entry, request, limit)
        shares = evaluator.support(found.blend) if support else None
        if request.map:
            shown = _on_target(entry, found, request, shares, fps=request.fps)
        else:
            shown = Evaluated(found, *describe.in_space(evaluator, found, request.space, joints), shares)
        whole = float(found.duration_s[0]) * request.cycles if request.adverbs is not None else float(found.time_s[-1])
        events = sequences.events(evaluator, found)
        return Motion(shown, request.fps, whole, events, tracked=request.track is not None)

    frames = request.fps * entry.longest_s * request.cycles * (1 if request.track is None else 3)
    cost = entry.cost_us(int(frames), float(request.cycles))
    if request.map:
        cost += COST_US * frames if prepared(entry, request) else PREPARE_US
    motion = await state.pool.run(cost, work)
    if counted:
        state.metrics.count_poses(entry, motion.frames.poses.blend, len(motion.frames.rotations))
    return motion


def _on_target(
    entry: Entry, found: Poses, options: Options, support: F64 | None, tried: tuple[str, ...] = (), *,
    fps: float | None = None,
) -> Evaluated:  # fmt: skip
    """Poses on the skeleton that a request names."""
    shown = mapped_poses(entry, found, options, fps=fps)
    return Evaluated(shown.poses, shown.rotations, shown.positions, support, tried, shown)


async def records(state: ServerState, entry: Entry, found: Evaluated, *, crowd: bool) -> bytes:
    """Encode binary records: a channel per pose of a crowd, or frames of one character with the last one flagged."""

    def work() -> bytes:
        channels = np.arange(len(found.rotations)) % 65_536 if crowd else 0
        rows = wire.encode(
            found.poses, found.rotations, entry.version, channels=channels, ended=not crowd, support=found.support
        )
        return rows.tobytes()

    return await state.pool.run(0.01 * found.rotations.size, work)


def _frames(entry: Entry, request: SequenceRequest, limit: int) -> Poses:
    evaluator, fps = entry.evaluator, request.fps
    options: dict[str, Any] = {"cycles": request.cycles, "method": request.method, "plant": request.plant}
    if request.track is None:
        assert request.adverbs is not None  # the model requires adverbs or a track
        rows = evaluator.adverbs(request.adverbs)
        return sequences.sequence(evaluator, rows, fps, max_frames=limit, **options)
    times = np.array([point.time for point in request.track], np.float64)
    rows = evaluator.adverbs([point.adverbs for point in request.track])
    return sequences.tracked(evaluator, times, rows, fps, max_frames=limit, **options)


def _cycles(entry: Entry, batch: Batch) -> float:
    """Cycles that a batch integrates; raises :class:`OutOfRange` if there are too many."""
    if not entry.verb.looping:
        return 0.0
    total = float(batch.at.sum()) / (entry.shortest_s if batch.given_time else 1.0)
    if total > MAX_CYCLES:
        raise OutOfRange(f"the poses of the batch span {total:.0f} cycles; at most {MAX_CYCLES:.0f} are allowed")
    return total


def _check_size(count: int, limit: int, advice: str) -> None:
    if count > limit:
        raise BatchTooLarge(f"{count} poses are requested; at most {limit} are allowed {advice}".rstrip(), limit=limit)
