"""Route that adds an example to a verb."""

from __future__ import annotations

from typing import Annotated

import orjson
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from service.http.context import caller_of
from service.http.documented import VerbName, problems
from service.http.draft_models import ExampleAnswer
from service.http.negotiation import JSON, OCTETS, if_match, media_type
from service.http.routes.drafts import drafts_of, numbers
from service.http.routes.versions import version_json
from verbs.errors import RequestError

__all__ = ["router"]

router = APIRouter(prefix="/v1/verbs", tags=["versions"])

_BODY = {
    "requestBody": {"required": True, "content": {OCTETS: {"schema": {"type": "string", "format": "binary"}}}},
}


@router.post(
    "/{verb}/examples",
    operation_id="add_example",
    status_code=201,
    response_model=ExampleAnswer,
    responses=problems(
        *("unknown_verb", "no_source", "invalid_draft", "read_only", "version_conflict", "bad_request", "not_ready"),
        *(
            "store_unavailable",
            "artifact_damaged",
            "bad_upload",
            "body_too_large",
            "unsupported_media_type",
            "overloaded",
        ),
    ),
    openapi_extra=_BODY,
    summary="Add an example to a verb",
)
async def add(
    request: Request,
    verb: VerbName,
    file: Annotated[str, Query(min_length=1, max_length=200, description="Name of the motion file.")],
    keytimes: Annotated[
        str | None, Query(max_length=4_000, description="Seconds, separated by commas. Default: proposed.")
    ] = None,
    style: Annotated[
        list[str] | None, Query(max_length=16, description="Value of a style adverb, `NAME:VALUE`; one for each.")
    ] = None,
) -> Response:
    """Publish a version with one more example: the current version's source and a motion file.

    Keytimes are aligned from the nearest examples where they are not given; adverbs are measured.
    """
    drafts = drafts_of(request)
    media_type(request, OCTETS)
    times = None if keytimes is None else numbers(keytimes)
    if keytimes is not None and times is None:
        raise RequestError(f"keytimes is {keytimes[:80]!r}; write 0.0,1.2,2.4 with seconds")
    given = {"file": file, "keytimes": times, "styles": dict(_style(text) for text in style or ())}
    version, warnings, example = await drafts.add_example(
        verb, request.stream(), given, expected=if_match(request, "version"), author=caller_of(request).author
    )
    answer = {**version_json(version, version.number), "warnings": warnings, "example": example}
    headers = {"ETag": f'"{version.number}"', "Location": f"/v1/verbs/{version.verb}"}
    return Response(orjson.dumps(answer), 201, headers, JSON)


def _style(text: str) -> tuple[str, float]:
    name, _, value = text.rpartition(":")
    found = numbers(value)
    if not name or found is None or len(found) != 1 or len(text) > 300:
        raise RequestError(f"style is {text[:80]!r}; write NAME:VALUE")
    return name, found[0]
