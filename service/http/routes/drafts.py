"""Draft routes: clips on their way to a verb."""

from __future__ import annotations

from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Path, Query, Request
from starlette.responses import FileResponse, Response

from service import wire
from service.errors import ReadOnly
from service.http import evaluation, response_json
from service.http.context import caller_of, state_of, trace_of
from service.http.documented import EVALUATING, body, forms, problems
from service.http.draft_models import DraftAnswer, DraftChange, DraftList, DraftPublication
from service.http.negotiation import (
    JSON,
    OBJECT_BYTES,
    OCTETS,
    ZIP,
    accepted,
    header,
    if_match,
    media_type,
    read_model,
    sliced,
)
from service.http.request_models import PoseRequest, SequenceRequest
from service.http.response_models import PoseAnswer, SequenceAnswer, UploadAnswer
from service.http.routes.versions import READ_ONLY, version_json
from service.state import ServerState
from service.store.records import Draft
from service.upload.drafts import Drafts
from verbs.errors import RequestError

__all__ = ["drafts_of", "numbers", "router"]

router = APIRouter(prefix="/v1/drafts", tags=["drafts"])

_READING = ("unknown_draft", "read_only", "store_unavailable", "not_ready", "artifact_damaged")
_CHANGING = (*_READING, "revision_changed", "bad_request", "invalid_draft", "bad_upload", "overloaded")
_EVALUATING = (
    *(code for code in EVALUATING if code not in ("unknown_verb", "unknown_version")),
    *(*_READING, "draft_not_built", "bad_request"),
)
_BODY = {
    "requestBody": {
        "required": True,
        "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in (ZIP, OCTETS)},
    },
}

Id = Annotated[str, Path(max_length=32, description="Id of a draft, as `GET /v1/drafts` lists them.")]
Text = Annotated[str | None, Query(max_length=200)]


@router.post(
    "",
    operation_id="create_draft",
    status_code=201,
    response_model=DraftAnswer,
    responses=problems(
        *("read_only", "store_unavailable", "not_ready", "too_many_drafts", "bad_upload", "bad_request"),
        *("body_too_large", "unsupported_media_type", "overloaded"),
    ),
    openapi_extra=_BODY,
    summary="Make a draft of clips",
)
async def create(
    request: Request,
    name: Annotated[
        str | None, Query(pattern="^[a-z][a-z0-9_-]{0,62}$", description="Name of the verb. Default: of the folder.")
    ] = None,
    effector: Text = None,
    measure: Text = None,
    unit: Text = None,
    pattern: Annotated[
        str | None, Query(max_length=200, description="Style adverbs from file names, as of `adverb init`.")
    ] = None,
    annotated: Annotated[
        list[str] | None, Query(max_length=2_000, description="Keytimes of a clip: `FILE@0,1.2,2.4`, seconds.")
    ] = None,
    keytime_names: Annotated[str | None, Query(max_length=4_000, description="Names, separated by commas.")] = None,
) -> Response:
    """Make a draft of a zip of motion files, with or without `verb.toml`.

    Keytimes, adverbs, unit and axes are proposed; clips that cannot be used are listed with the reason.
    """
    drafts = drafts_of(request)
    media_type(request, ZIP, OCTETS)
    names = tuple(part.strip() for part in keytime_names.split(",")) if keytime_names else ()
    query = {
        **{"name": name, "effector": effector, "measure": measure, "unit": unit, "pattern": pattern},
        "annotated": [_annotation(text) for text in annotated or ()],
        "keytime_names": names,
    }
    draft, document = await drafts.create(request.stream(), query)
    return _answer(drafts, draft, document, 201, {"Location": f"/v1/drafts/{draft.id}"})


@router.get(
    "",
    operation_id="list_drafts",
    response_model=DraftList,
    responses=problems("read_only", "store_unavailable", "not_ready"),
    summary="List the drafts",
)
async def listed(request: Request) -> Response:
    """List the drafts, the last changed first."""
    drafts = drafts_of(request)
    rows = [
        {
            **_head(drafts, draft),
            "name": draft.name,
            "clips": draft.clips,
            "excluded": draft.excluded,
            "built": draft.artifact is not None,
            "bytes": draft.size_bytes,
        }
        for draft in await drafts.listed()
    ]
    return Response(orjson.dumps({"limit": drafts.limit, "drafts": rows}), media_type=JSON)


@router.get(
    "/{id}",
    operation_id="get_draft",
    response_model=DraftAnswer,
    responses={**problems(*_READING), 304: {"description": "Not modified"}},
    summary="Get a draft",
)
async def get(request: Request, id: Id) -> Response:
    """Get a draft: its clips with keytimes, adverbs and mends, and its verb. The `ETag` is its revision."""
    drafts = drafts_of(request)
    draft, document = await drafts.read(id)
    if _known(request, str(draft.revision)):
        return Response(status_code=304, headers={"ETag": f'"{draft.revision}"'})
    return _answer(drafts, draft, document, 200, {"Cache-Control": "no-cache"})


@router.patch(
    "/{id}",
    operation_id="change_draft",
    response_model=DraftAnswer,
    responses=problems(*(*_CHANGING, "malformed_body", "invalid_request", "body_too_large", "unsupported_media_type")),
    openapi_extra=body(DraftChange),
    summary="Change a draft",
)
async def change(request: Request, id: Id) -> Response:
    """Change a draft, and build its verb again; with `If-Match: "3"` only if its revision is 3.

    Where the clips that are left make no verb, `verb` is null and `problem` states why.
    """
    drafts = drafts_of(request)
    expected = if_match(request, "revision")
    content = await read_model(request, DraftChange)
    draft, document = await drafts.change(id, expected, content.model_dump(mode="json", exclude_unset=True))
    return _answer(drafts, draft, document, 200, {})


@router.delete(
    "/{id}",
    operation_id="delete_draft",
    status_code=204,
    responses=problems(*_READING, "revision_changed", "bad_request"),
    summary="Delete a draft",
)
async def delete(request: Request, id: Id) -> Response:
    """Delete a draft with its clips."""
    await drafts_of(request).delete(id, if_match(request, "revision"))
    return Response(status_code=204)


@router.get(
    "/{id}/motion",
    operation_id="draft_motion",
    response_class=Response,
    responses={**forms(OCTETS), **problems(*_READING), 304: {"description": "Not modified"}},
    summary="Motions of a draft's clips",
)
async def motion(request: Request, id: Id) -> Response:
    """Return poses of all readable clips for display: a line of JSON, then float32 (docs/rest.md)."""
    drafts = drafts_of(request)
    path = await drafts.motion(id)
    tag = path.stem[:32]
    if _known(request, tag):
        return Response(status_code=304, headers={"ETag": f'"{tag}"'})
    return FileResponse(path, media_type=OCTETS, headers={"ETag": f'"{tag}"', "Cache-Control": "no-cache"})


@router.post(
    "/{id}/pose",
    operation_id="draft_pose",
    response_model=PoseAnswer,
    responses={**forms(OCTETS), **problems(*_EVALUATING)},
    openapi_extra=body(PoseRequest),
    summary="One pose of a draft",
)
async def pose(request: Request, id: Id) -> Response:
    """Evaluate one pose of the draft's verb, as of a verb; `version` is the draft's revision."""
    state, drafts = state_of(request), drafts_of(request)
    form = accepted(request, JSON, OCTETS)
    content = await read_model(request, PoseRequest, most=OBJECT_BYTES)
    _check_version(content.version)
    entry = await drafts.entry(id)
    found = await evaluation.pose(state, entry, content, support=form == JSON or content.support, counted=False)
    trace_of(request).method = found.poses.blend.method
    if form == OCTETS:
        row = wire.encode_one(found.poses, found.rotations, entry.version, support=found.support)
        return Response(row, media_type=OCTETS)
    text = response_json.single_json(entry, found, weights=content.weights, max_error=content.max_error)
    return Response(text, media_type=JSON)


@router.post(
    "/{id}/sequence",
    operation_id="draft_sequence",
    response_model=SequenceAnswer,
    responses={**forms(OCTETS), **problems(*_EVALUATING)},
    openapi_extra=body(SequenceRequest),
    summary="A whole motion of a draft",
)
async def sequence(request: Request, id: Id) -> Response:
    """Evaluate a whole motion of the draft's verb, as of a verb; `version` is the draft's revision."""
    state, drafts = state_of(request), drafts_of(request)
    form = accepted(request, JSON, OCTETS)
    content = await read_model(request, SequenceRequest)
    _check_version(content.version)
    entry = await drafts.entry(id)
    found = await evaluation.sequence(state, entry, content, support=form == JSON or content.support, counted=False)
    trace_of(request).method = found.frames.poses.blend.method
    if form == OCTETS:
        return Response(await evaluation.records(state, entry, found.frames, crowd=False), media_type=OCTETS)
    return sliced(response_json.sequence_json(entry, found, weights=content.weights))


@router.post(
    "/{id}/publish",
    operation_id="publish_draft",
    status_code=201,
    response_model=UploadAnswer,
    responses=problems(
        *(*_CHANGING, "draft_not_built", "malformed_body", "invalid_request", "body_too_large"),
        "unsupported_media_type",
    ),
    openapi_extra=body(DraftPublication),
    summary="Publish a draft",
)
async def publish(request: Request, id: Id) -> Response:
    """Publish the draft's verb with its source, as the next version of its name. The draft stays."""
    drafts = drafts_of(request)
    expected = if_match(request, "revision")
    content = await read_model(request, DraftPublication, most=OBJECT_BYTES)
    version, warnings = await drafts.publish(id, expected, content.name, author=caller_of(request).author)
    answer = {**version_json(version, version.number), "warnings": warnings}
    headers = {"ETag": f'"{version.number}"', "Location": f"/v1/verbs/{version.verb}"}
    return Response(orjson.dumps(answer), 201, headers, JSON)


def drafts_of(request: Request) -> Drafts:
    """Drafts of the server; raises :class:`service.errors.NotReady` or :class:`service.errors.ReadOnly`."""
    state: ServerState = state_of(request)
    state.current()
    if state.drafts is None:
        raise ReadOnly(READ_ONLY)
    return state.drafts


def numbers(text: str) -> list[float] | None:
    """Finite numbers separated by commas; None where one is no number."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    return found if all(abs(number) <= 1e9 for number in found) else None  # also false for NaN


def _annotation(text: str) -> dict[str, Any]:
    file, _, listing = text.rpartition("@")
    times = numbers(listing)
    if not file or times is None or len(text) > 1_000:
        raise RequestError(f"annotated is {text[:80]!r}; write FILE@0.0,1.2,2.4 with seconds")
    return {"file": file, "keytimes": times}


def _check_version(version: int | None) -> None:
    if version is not None:
        raise RequestError("a draft has no versions; leave 'version' out")


def _known(request: Request, tag: str) -> bool:
    """Whether the client has the content with this tag."""
    given = header(request, b"if-none-match").decode("latin-1")[:1_000]
    return f'"{tag}"' in (part.strip().removeprefix("W/") for part in given.split(","))


def _head(drafts: Drafts, draft: Draft) -> dict[str, Any]:
    return {
        "id": draft.id,
        "revision": draft.revision,
        "created_at": draft.created_at_s,
        "changed_at": draft.changed_at_s,
        "expires_at": draft.changed_at_s + drafts.lifetime_s,
    }


def _answer(drafts: Drafts, draft: Draft, document: str, status: int, headers: dict[str, str]) -> Response:
    """A draft as JSON: its row, then its document, which is an object that is not empty."""
    content = orjson.dumps(_head(drafts, draft))[:-1] + b"," + document.encode()[1:]
    return Response(content, status, {"ETag": f'"{draft.revision}"', **headers}, JSON)
