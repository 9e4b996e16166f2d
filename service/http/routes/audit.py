"""Routes about access: who the caller is, and the record of changes."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import orjson
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from service.compute import run_in_thread
from service.errors import ReadOnly
from service.http.context import caller_of, state_of
from service.http.documented import problems
from service.http.negotiation import JSON
from service.http.response_models import AccessAnswer, AuditAnswer
from service.http.routes.versions import READ_ONLY

__all__ = ["router"]

router = APIRouter(prefix="/v1", tags=["access"])


@router.get("/access", operation_id="show_access", response_model=AccessAnswer, summary="Show your access")
async def access(request: Request) -> Response:
    """Show the key of the request, its scopes, and whether the server requires keys."""
    caller = caller_of(request)
    answer = {
        "required": state_of(request).access.required,
        "id": caller.id,
        "name": caller.name,
        "scopes": sorted(caller.scopes),
        "expires_at": caller.expires_at_s,
    }
    return Response(orjson.dumps(answer), media_type=JSON)


@router.get(
    "/audit",
    operation_id="list_changes",
    response_model=AuditAnswer,
    responses=problems("read_only", "store_unavailable", "not_ready", "invalid_request"),
    summary="List changes",
)
async def audit(
    request: Request,
    verb: Annotated[str | None, Query(max_length=64, description="Only those of this verb.")] = None,
    author: Annotated[str | None, Query(max_length=200, description="Only those of this author.")] = None,
    before: Annotated[int | None, Query(ge=1, le=2**62, description="Only those before this number.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List publications, activations, deletions and refinements with their authors, the newest first.

    `author` names the key: `key ID (NAME)`. The next page starts before the last number of this one.
    """
    state = state_of(request)
    state.current()
    if state.store_sync is None:
        raise ReadOnly(READ_ONLY)
    store = state.store_sync.store
    rows = await run_in_thread(lambda: store.events(limit=limit, before=before, verb=verb, author=author))
    listed = [{"id": number, **asdict(event), "at": event.at_s} for number, event in rows]
    for row in listed:
        del row["at_s"]
    return Response(orjson.dumps({"changes": listed}), media_type=JSON)
