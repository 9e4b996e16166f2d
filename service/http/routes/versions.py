"""Version routes: upload, list, download, activate, delete; the artifact that is served."""

from __future__ import annotations

from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Path, Query, Request
from starlette.responses import Response

from service.catalog.store_sync import StoreSync
from service.compute import run_in_thread
from service.errors import ArtifactDamaged, ReadOnly
from service.http.context import caller_of, served, state_of
from service.http.documented import READING, VerbName, forms, problems
from service.http.negotiation import JSON, OCTETS, ZIP, header, if_match, media_type
from service.http.response_models import UploadAnswer, VersionAnswer, VersionsAnswer
from service.state import ServerState
from service.store.store import Version
from service.upload.uploads import Uploads

__all__ = ["READ_ONLY", "Number", "router", "version_json"]

READ_ONLY = "this server is read-only; start it with a data folder (--data)"

router = APIRouter(prefix="/v1/verbs", tags=["versions"])

_CHANGING = ("read_only", "version_conflict", "bad_request", "store_unavailable", "not_ready")
_BODY = {
    "requestBody": {
        "required": True,
        "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in (OCTETS, ZIP)},
    }
}
Number = Annotated[int, Path(ge=1, le=2**31 - 1, description="Number of a version.")]


@router.post(
    "",
    operation_id="upload_verb",
    status_code=201,
    response_model=UploadAnswer,
    responses=problems(
        *_CHANGING, "bad_upload", "body_too_large", "unsupported_media_type", "overloaded", "malformed_body"
    ),
    openapi_extra=_BODY,
    summary="Upload a verb",
)
async def upload(request: Request) -> Response:
    """Publish a verb: an artifact (`application/octet-stream`), or a zip of a verb source (`application/zip`).

    A source is built first. The verb's name is the one inside. With `If-Match: "3"` it becomes the next version only
    if version 3 is current.
    """
    uploads = _uploads(request)
    media_type(request, OCTETS, ZIP)
    version, warnings = await uploads.publish(
        request.stream(), author=caller_of(request).author, expected=if_match(request, "version")
    )
    answer = {**version_json(version, version.number), "warnings": warnings}
    headers = {"ETag": f'"{version.number}"', "Location": f"/v1/verbs/{version.verb}"}
    return Response(orjson.dumps(answer), 201, headers, JSON)


@router.delete(
    "/{verb}",
    operation_id="delete_verb",
    status_code=204,
    responses=problems("unknown_verb", *_CHANGING),
    summary="Delete a verb",
)
async def delete(request: Request, verb: VerbName) -> Response:
    """Stop serving a verb. Its versions are kept for a while; activating one serves it again."""
    await _store_sync(request).delete(
        verb, author=caller_of(request).author, reason="delete", expected=if_match(request, "version")
    )
    return Response(status_code=204)


@router.get(
    "/{verb}/versions",
    operation_id="list_versions",
    response_model=VersionsAnswer,
    responses=problems("unknown_verb", "read_only", "store_unavailable", "not_ready"),
    summary="List the versions of a verb",
)
async def versions(request: Request, verb: VerbName) -> Response:
    """List the versions with their authors, reasons and quality, and the current one."""
    store = _store_sync(request).store
    rows, pointers = await run_in_thread(lambda: (store.versions(verb), store.current()))
    current = pointers[verb].number if verb in pointers else None
    answer = {
        "verb": verb,
        "current": current,
        "versions": [version_json(row, current) for row in sorted(rows, key=lambda row: -row.number)],
    }
    headers = {} if current is None else {"ETag": f'"{current}"'}
    return Response(orjson.dumps(answer), 200, headers, JSON)


@router.post(
    "/{verb}/versions/{number}/activate",
    operation_id="activate_version",
    response_model=VersionAnswer,
    responses=problems("unknown_verb", "unknown_version", "artifact_damaged", *_CHANGING),
    summary="Serve another version",
)
async def activate(request: Request, verb: VerbName, number: Number) -> Response:
    """Roll a verb back or forward. Streams change to the version between two frames."""
    sync, expected = _store_sync(request), if_match(request, "version")
    version = await sync.activate(verb, number, author=caller_of(request).author, reason="activate", expected=expected)
    return Response(orjson.dumps(version_json(version, version.number)), 200, {"ETag": f'"{version.number}"'}, JSON)


@router.get(
    "/{verb}/versions/{number}",
    operation_id="download_version",
    response_class=Response,
    responses={
        **forms(OCTETS),
        **problems("unknown_verb", "unknown_version", "read_only", "store_unavailable", "artifact_damaged"),
    },
    summary="Download a version",
)
async def download(request: Request, verb: VerbName, number: Number) -> Response:
    """Return the artifact of a version."""
    from starlette.responses import FileResponse

    store = _store_sync(request).store
    path = await run_in_thread(lambda: store.path(store.version(verb, number)))
    return FileResponse(path, media_type=OCTETS, filename=f"{verb}.verb")


@router.get(
    "/{verb}/artifact",
    operation_id="download_artifact",
    response_class=Response,
    responses={
        **forms(OCTETS),
        **problems(*READING, "unknown_version", "read_only", "store_unavailable", "artifact_damaged"),
        304: {"description": "Not modified"},
    },
    summary="Download the served artifact",
)
async def artifact(
    request: Request,
    verb: VerbName,
    version: Annotated[int | None, Query(ge=1, le=2**31 - 1, description="This version, if another is served.")] = None,
) -> Response:
    """Return the artifact of the version that is served, also of built-in verbs; clients evaluate it themselves.

    The answer carries an `ETag`; with it as `If-None-Match` an unchanged artifact is answered 304.
    """
    from starlette.responses import FileResponse

    entry = served(request, verb)[1]
    if version not in (None, entry.version):
        return await download(request, verb, version)
    try:
        stat = await run_in_thread(entry.path.stat)
    except OSError as err:
        raise ArtifactDamaged(f"the artifact of '{verb}' cannot be read: {err.strerror or err}") from err
    headers = {"Cache-Control": "no-cache"}
    response = FileResponse(entry.path, headers=headers, media_type=OCTETS, stat_result=stat)
    etag, known = response.headers["etag"], header(request, b"if-none-match").decode("latin-1")
    if etag in (part.strip().removeprefix("W/") for part in known[:1_000].split(",")):
        return Response(status_code=304, headers={"ETag": etag, "Cache-Control": "no-cache"})
    return response


def _store_sync(request: Request) -> StoreSync:
    sync = _loaded(request).store_sync
    if sync is None:
        raise ReadOnly(READ_ONLY)
    return sync


def _uploads(request: Request) -> Uploads:
    uploads = _loaded(request).uploads
    if uploads is None:
        raise ReadOnly(READ_ONLY)
    return uploads


def _loaded(request: Request) -> ServerState:
    """State of the server; raises :class:`service.errors.NotReady` until verbs are loaded."""
    state = state_of(request)
    state.current()
    return state


def version_json(version: Version, current: int | None) -> dict[str, Any]:
    """A version as JSON values."""
    return {
        "verb": version.verb,
        "version": version.number,
        "current": version.number == current,
        "sha256": version.sha256,
        "bytes": version.size_bytes,
        "author": version.author,
        "reason": version.reason,
        "created_at": version.created_at_s,
        "parent": version.parent,
        "source": version.source_sha256 is not None,
        "quality": dict(version.quality),
    }
