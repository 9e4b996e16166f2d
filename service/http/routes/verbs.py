"""Verb routes: list and describe."""

from __future__ import annotations

import orjson
from fastapi import APIRouter, Request
from starlette.responses import Response

from service.http.context import served, state_of
from service.http.documented import READING, VerbName, problems
from service.http.negotiation import JSON, header
from service.http.response_models import VerbAnswer, VerbList
from verbs.runtime import describe

__all__ = ["router"]

router = APIRouter(prefix="/v1/verbs", tags=["verbs"])


@router.get(
    "", operation_id="list_verbs", response_model=VerbList, responses=problems("not_ready"), summary="List the verbs"
)
async def verbs(request: Request) -> Response:
    """List the verbs that are served, with their versions and adverbs."""
    entries = state_of(request).current().entries.values()
    rows = [describe.summary(entry.verb, version=entry.version) for entry in entries]
    return Response(orjson.dumps({"verbs": rows}), media_type=JSON)


@router.get(
    "/{verb}",
    operation_id="describe_verb",
    response_model=VerbAnswer,
    responses={**problems(*READING), 304: {"description": "Not modified"}},
    summary="Describe a verb",
)
async def verb(request: Request, verb: VerbName) -> Response:
    """Describe one verb: adverbs and their ranges, skeleton, examples, domain, methods, measured quality.

    The answer carries an `ETag`; with it as `If-None-Match` an unchanged verb is answered 304.
    """
    _, entry = served(request, verb)
    headers = {"ETag": entry.etag, "Cache-Control": "no-cache"}
    known = header(request, b"if-none-match").decode("latin-1")
    if entry.etag in (part.strip().removeprefix("W/") for part in known[:1_000].split(",")):
        return Response(status_code=304, headers=headers)
    return Response(entry.description, media_type=JSON, headers=headers)
