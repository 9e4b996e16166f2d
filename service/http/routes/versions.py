"""Version routes: upload, list, download, activate, delete."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Request
from fastapi import Path as InPath
from starlette.requests import ClientDisconnect
from starlette.responses import Response

from service.catalog.store_sync import StoreSync
from service.compute import run_in_thread
from service.errors import ReadOnly
from service.http.context import state_of
from service.http.documented import VerbName, forms, problems
from service.http.negotiation import JSON, OCTETS, header, media_type
from service.http.response_models import UploadAnswer, VersionAnswer, VersionsAnswer
from service.state import ServerState
from service.store.store import Version
from verbs.errors import RequestError

__all__ = ["router"]

ZIP = "application/zip"
WHO = "a client"

router = APIRouter(prefix="/v1/verbs", tags=["versions"])

_CHANGING = ("read_only", "version_conflict", "bad_request", "store_unavailable", "not_ready")
_BODY = {
    "requestBody": {
        "required": True,
        "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in (OCTETS, ZIP)},
    }
}
Number = Annotated[int, InPath(ge=1, le=2**31 - 1, description="Number of a version.")]


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
    state = state_of(request)
    sync = _store_sync(state)
    media_type(request, OCTETS, ZIP)
    expected = _expected(request)
    async with _received(request, state) as (content, result):
        made = await state.builder.make(content, result)

        def publish() -> Version:
            return sync.store.publish(
                *(made.verb, result), author=WHO, reason="upload", quality=made.quality, expected=expected
            )

        version = await run_in_thread(publish)
    await state.refresh()
    answer = {**_told(version, version.number), "warnings": made.warnings}
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
    state = state_of(request)
    sync, expected = _store_sync(state), _expected(request)
    await run_in_thread(lambda: sync.store.delete(verb, author=WHO, reason="delete", expected=expected))
    await state.refresh()
    return Response(status_code=204)


@router.get(
    "/{verb}/versions",
    operation_id="list_versions",
    response_model=VersionsAnswer,
    responses=problems("unknown_verb", "read_only", "store_unavailable", "not_ready"),
    summary="List the versions of a verb",
)
async def versions(request: Request, verb: VerbName) -> Response:
    """List versions with author, reason and quality, and the one that is served."""
    store = _store_sync(state_of(request)).store
    rows, pointers = await run_in_thread(lambda: (store.versions(verb), store.current()))
    current = pointers[verb].number if verb in pointers else None
    answer = {
        "verb": verb,
        "current": current,
        "versions": [_told(row, current) for row in sorted(rows, key=lambda row: -row.number)],
    }
    headers = {} if current is None else {"ETag": f'"{current}"'}
    return Response(orjson.dumps(answer), 200, headers, JSON)


@router.post(
    "/{verb}/versions/{number}/activate",
    operation_id="activate_version",
    response_model=VersionAnswer,
    responses=problems("unknown_verb", "unknown_version", *_CHANGING),
    summary="Serve another version",
)
async def activate(request: Request, verb: VerbName, number: Number) -> Response:
    """Roll a verb back or forward. Streams change to the version between two frames."""
    state = state_of(request)
    sync, expected = _store_sync(state), _expected(request)
    version = await run_in_thread(
        lambda: sync.store.activate(verb, number, author=WHO, reason="activate", expected=expected)
    )
    await state.refresh()
    return Response(orjson.dumps(_told(version, version.number)), 200, {"ETag": f'"{version.number}"'}, JSON)


@router.get(
    "/{verb}/versions/{number}",
    operation_id="download_version",
    response_class=Response,
    responses={**forms(OCTETS), **problems("unknown_verb", "unknown_version", "read_only", "store_unavailable")},
    summary="Download a version",
)
async def download(request: Request, verb: VerbName, number: Number) -> Response:
    """Return the artifact of a version."""
    from starlette.responses import FileResponse

    store = _store_sync(state_of(request)).store
    path = await run_in_thread(lambda: store.path(store.version(verb, number)))
    return FileResponse(path, media_type=OCTETS, filename=f"{verb}.verb")


def _store_sync(state: ServerState) -> StoreSync:
    state.current()  # not before everything is loaded
    if state.store_sync is None:
        raise ReadOnly("this server was started without a data folder, and keeps nothing; start it with --data")
    return state.store_sync


def _expected(request: Request) -> int | None:
    """Version number of ``If-Match``; None if it is absent or ``*``."""
    given = header(request, b"if-match").decode("latin-1").strip()
    if given in ("", "*"):
        return None
    number = given.removeprefix("W/").strip('"')
    if not number.isdigit() or len(number) > 9:
        raise RequestError(f"If-Match is {given[:40]}; it must be the number of a version in quotes, or *")
    return int(number)


@asynccontextmanager
async def _received(request: Request, state: ServerState) -> AsyncIterator[tuple[Path, Path]]:
    """Files for the request's body and for the verb built from it; both are removed afterwards."""
    folder = state.uploads
    name = secrets.token_hex(8)
    content, result = folder / f"{name}.upload", folder / f"{name}.verb"
    try:
        with content.open("xb") as file:
            while True:
                message: Any = await request.receive()
                if message["type"] == "http.disconnect":
                    raise ClientDisconnect
                file.write(message.get("body", b""))
                if not message.get("more_body", False):
                    break
        yield content, result
    finally:
        content.unlink(missing_ok=True)
        result.unlink(missing_ok=True)


def _told(version: Version, current: int | None) -> dict[str, Any]:
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
        "quality": dict(version.quality),
    }
