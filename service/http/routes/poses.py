"""Pose routes: one pose, many poses, a whole motion."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from service import wire
from service.catalog.catalog import Entry
from service.fields import MapGoal, Name, Space
from service.http import evaluation, response_json
from service.http.context import served, trace_of
from service.http.direct import Direct, Whole
from service.http.documented import EVALUATING, VerbName, body, forms, problems
from service.http.negotiation import FILES, JSON, OBJECT_BYTES, OCTETS, accepted, media_type, read, read_model, sliced
from service.http.request_models import BatchRequest, PoseRequest, SequenceRequest
from service.http.response_json import Motion
from service.http.response_models import PoseAnswer, PosesAnswer, SequenceAnswer
from service.state import ServerState
from verbs.errors import RequestError
from verbs.io import motion_files
from verbs.mapping.vrm import humanoid_of
from verbs.runtime import sequence as sequences
from verbs.skeleton import Skeleton

__all__ = ["router"]

router = APIRouter(prefix="/v1/verbs/{verb}", tags=["poses"])
_FILE_US = 2_000.0
"""Least time to write a motion file, µs."""

direct = APIRouter(prefix=router.prefix, tags=["poses"], route_class=Direct)


@direct.post(
    "/pose",
    operation_id="pose",
    response_model=PoseAnswer,
    responses={**forms(OCTETS), **problems(*EVALUATING)},
    openapi_extra=body(PoseRequest),
    summary="One pose",
)
async def pose(request: Request, verb: VerbName) -> Response:
    """Evaluate one pose at adverbs and a phase or time, with its error and its support by the examples.

    With `Accept: application/octet-stream` the answer is one binary record (docs/wire.md), channel 0; `positions`,
    `weights`, `measured` and `met` have no place there; `support` has, where it is requested.
    """
    state, entry = served(request, verb)
    form = accepted(request, JSON, OCTETS)
    content = await read_model(request, PoseRequest, most=OBJECT_BYTES)
    if content.version is not None:
        entry = await state.version(entry, content.version)
    found = await evaluation.pose(state, entry, content, support=form == JSON or content.support)
    state.record_usage(entry, content.adverbs, found.poses.blend)
    trace_of(request).method = found.poses.blend.method
    if form == OCTETS:
        return Whole(wire.encode_one(found.poses, found.rotations, entry.version, support=found.support), OCTETS)
    return Whole(response_json.single_json(entry, found, weights=content.weights, max_error=content.max_error), JSON)


@router.post(
    "/poses",
    operation_id="poses",
    response_model=PosesAnswer,
    responses={**forms(OCTETS), **problems(*EVALUATING)},
    openapi_extra=body(BatchRequest, OCTETS),
    summary="Many poses",
)
async def poses(
    request: Request,
    verb: VerbName,
    method: Annotated[Name | None, Query(description="Blending method, of a binary body.")] = None,
    space: Annotated[Space | None, Query(description="Space, of a binary body.")] = None,
    joints: Annotated[list[Name] | None, Query(max_length=1_000, description="Joints, of a binary body.")] = None,
    version: Annotated[int | None, Query(ge=1, description="Version, of a binary body.")] = None,
    plant: Annotated[bool | None, Query(description="Whether feet are planted, of a binary body.")] = None,
    support: Annotated[bool | None, Query(description="Whether records have the support, of a binary body.")] = None,
    target: Annotated[Name | None, Query(alias="map", description="Skeleton of the answer, of a binary body.")] = None,
    map_goal: Annotated[MapGoal | None, Query(description="Goal of the effector, of a binary body.")] = None,
) -> Response:
    """Evaluate a pose for each character of a crowd.

    A binary body (`Content-Type: application/octet-stream`) is one row of little-endian float32 per pose: the
    adverbs in the verb's order, then the phase; its options stand in the query. A binary answer is one record per
    pose, one after the other; a record's channel is its row modulo 65,536.
    """
    state, entry = served(request, verb)
    form = accepted(request, JSON, OCTETS)
    query = {"method": method, "space": space, "joints": joints, "version": version, "plant": plant, "support": support}
    query |= {"map": target, "map_goal": map_goal}
    if media_type(request, JSON, OCTETS) == OCTETS:
        entry = await state.version(entry, version)
        batch = evaluation.binary_batch(state, entry, await read(request), query)
    else:
        batch = evaluation.json_batch(state, await read(request), query)
        entry = await state.version(entry, batch.options.version)
    found = await evaluation.poses(state, entry, batch, support=form == JSON or batch.options.support)
    state.record_usage(entry, batch.adverbs, found.poses.blend, rows=len(batch.at))
    trace_of(request).method = found.poses.blend.method
    if form == OCTETS:
        return Response(await evaluation.records(state, entry, found, crowd=True), media_type=OCTETS)
    return sliced(response_json.poses_json(entry, found, weights=batch.options.weights))


@direct.post(
    "/sequence",
    operation_id="sequence",
    response_model=SequenceAnswer,
    responses={**forms(OCTETS, *FILES), **problems(*EVALUATING)},
    openapi_extra=body(SequenceRequest),
    summary="A whole motion",
)
async def sequence(request: Request, verb: VerbName) -> Response:
    """Evaluate a whole motion at `fps` frames per second, at constant adverbs or along a track of them.

    Frames stand at 0, 1/fps, … up to the last one that is not past the end. As `application/octet-stream` the answer
    is one binary record per frame, channel 0, the last one flagged. Files hold all joints, in metres: `text/x-bvh`,
    `model/gltf-binary` (glTF), `application/x-vrma` (a VRM animation, of humanoids) and `application/x-npz`.
    """
    state, entry = served(request, verb)
    form = accepted(request, JSON, OCTETS, *FILES)
    content = await read_model(request, SequenceRequest)
    entry = await state.version(entry, content.version)
    if form in FILES and (content.joints is not None or content.space != "local"):
        raise RequestError(f"a {FILES[form]} file holds all joints, local; leave 'joints' and 'space' out")
    motion = await evaluation.sequence(state, entry, content, support=form == JSON or content.support)
    track = [point.adverbs for point in content.track or ()]
    state.record_usage(entry, content.adverbs or track, motion.frames.poses.blend, rows=len(track) or 1)
    trace_of(request).method = motion.frames.poses.blend.method
    if form == OCTETS:
        return Response(await evaluation.records(state, entry, motion.frames, crowd=False), media_type=OCTETS)
    if form in FILES:
        return await _motion_file(state, entry, content, motion, form)
    return sliced(response_json.sequence_json(entry, motion, weights=content.weights))


async def _motion_file(
    state: ServerState, entry: Entry, content: SequenceRequest, motion: Motion, form: str
) -> Response:
    """A motion as a file of a media type of :data:`FILES`, written in a thread."""
    whole = sequences.to_motion(entry.evaluator, motion.frames.poses, motion.fps, skeleton=_skeleton(motion))
    name = entry.verb.name
    extras: dict[str, Any] = {"verb": name, "version": entry.version}
    if (shown := motion.frames.shown) is not None:
        extras |= {"map": shown.head["name"], "figures": shown.figures[0].as_dict()}
    extras |= {"adverbs": content.adverbs} if content.adverbs is not None else {}

    def work() -> bytes:
        human = None if shown is None else humanoid_of(shown.rig)
        return motion_files.dump(
            whole, FILES[form], mannequin=content.mannequin, name=name, extras=extras, humanoid=human
        )

    file = await state.pool.run(_FILE_US + 1.0 * whole.rotations.size, work)
    charset = "; charset=utf-8" if form.startswith("text/") else ""
    disposition = f'attachment; filename="{name}.{FILES[form]}"'
    return Response(file, headers={"content-type": form + charset, "content-disposition": disposition})


def _skeleton(motion: Motion) -> Skeleton | None:
    """Skeleton of a motion on another one; None for that of the verb."""
    return None if motion.frames.shown is None else motion.frames.shown.skeleton


router.routes[:0] = direct.routes
