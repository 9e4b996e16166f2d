"""Refinement routes: start, list, show, follow, cancel."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from functools import partial
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Query, Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from service.access.access import Caller
from service.access.limits import address_of
from service.compute import run_in_thread
from service.errors import AlreadyRefining, Overloaded, ReadOnly
from service.http.context import caller_of, state_of
from service.http.documented import VerbName, body, problems
from service.http.negotiation import JSON, OBJECT_BYTES, read_model
from service.http.request_models import RefinementRequest
from service.http.response_models import RefinementAnswer, RefinementList
from service.refinement.errors import AlreadyRunning
from service.refinement.job_spec import RefinementSpec
from service.refinement.queue import Refinements
from service.state import ServerState
from service.store.records import StoreUnavailable
from service.store.store import Job
from verbs import refine_quality
from verbs.blend.methods import default_method

__all__ = ["router"]

router = APIRouter(prefix="/v1", tags=["refinements"])

FOLLOW_S = 0.5
"""Polling interval of a job that a client follows."""

ENDED = {"published", "not_better", "failed", "cancelled", "given_up"}


@router.post(
    "/verbs/{verb}/refinements",
    operation_id="refine_verb",
    status_code=202,
    response_model=RefinementAnswer,
    responses=problems(
        "unknown_verb", "read_only", "already_refining", "store_unavailable", "not_ready", "malformed_body",
        "invalid_request", "out_of_range", "unsupported_media_type",
    ),
    openapi_extra=body(RefinementRequest),
    summary="Refine a verb",
)  # fmt: skip
async def start(request: Request, verb: VerbName) -> Response:
    """Queue a refinement: a worker adds pseudo-examples where the verb is worst, and publishes a better result.

    For quality these are exact weights that move better, at goals where the motion is worst; for errors, weights that
    meet the goal, where the error is largest.

    The new version becomes current only if the version that the refinement started from still is.
    """
    state = state_of(request)
    refinements = _refinements(state)
    entry = state.current().entry(verb)
    content = await read_model(request, RefinementRequest, most=OBJECT_BYTES)
    exact = default_method(entry.verb) == "corrected"
    given = content.model_dump(by_alias=True, exclude_unset=True, exclude_none=True)
    spec = RefinementSpec.of_request(given, exact=exact)
    if spec.aim == "quality":
        refine_quality.check(entry.verb)
    caller = caller_of(request)
    try:
        async with state.limits.refinement(caller, address_of(request.scope), spec.budget_s):
            job = await run_in_thread(lambda: refinements.start(verb, entry.version, spec, caller.author))
    except AlreadyRunning as err:
        raise AlreadyRefining(str(err), refinement=err.job) from err
    return Response(orjson.dumps(_job_json(job)), 202, {"Location": f"/v1/refinements/{job.id}"}, JSON)


@router.get(
    "/refinements",
    operation_id="list_refinements",
    response_model=RefinementList,
    responses=problems("read_only", "store_unavailable", "not_ready", "invalid_request"),
    summary="List refinements",
)
async def refinements(
    request: Request,
    verb: Annotated[str | None, Query(max_length=64, description="Only those of this verb.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List refinements, the newest first."""
    known = _refinements(state_of(request))
    rows = await run_in_thread(lambda: known.jobs(verb=verb, limit=limit))
    return Response(orjson.dumps({"refinements": [_job_json(job) for job in rows]}), media_type=JSON)


@router.get(
    "/refinements/{id}",
    operation_id="show_refinement",
    response_model=RefinementAnswer,
    responses=problems("unknown_refinement", "read_only", "store_unavailable", "not_ready"),
    summary="Show a refinement",
)
async def refinement(request: Request, id: str) -> Response:
    """Show a refinement: its state, pseudo-examples, and the error after each of them."""
    known = _refinements(state_of(request))
    return Response(orjson.dumps(_job_json(await run_in_thread(lambda: known.job(id)))), media_type=JSON)


@router.delete(
    "/refinements/{id}",
    operation_id="cancel_refinement",
    response_model=RefinementAnswer,
    responses=problems("unknown_refinement", "read_only", "store_unavailable", "not_ready"),
    summary="Cancel a refinement",
)
async def cancel(request: Request, id: str) -> Response:
    """Stop a refinement after its current step without publishing. One that has ended is returned unchanged."""
    known, author = _refinements(state_of(request)), caller_of(request).author
    job = await run_in_thread(lambda: known.cancel(id, author=author))
    return Response(orjson.dumps(_job_json(job)), media_type=JSON)


@router.get(
    "/refinements/{id}/events",
    operation_id="follow_refinement",
    response_class=StreamingResponse,
    responses={
        200: {"description": "Server-sent events", "content": {"text/event-stream": {"schema": {"type": "string"}}}},
        **problems(
            "unknown_refinement", "read_only", "store_unavailable", "not_ready", "too_many_streams", "overloaded"
        ),
    },
    summary="Follow a refinement",
)
async def follow(request: Request, id: str) -> Response:
    """Send an event with the refinement whenever it changes; the last event when it has ended.

    The response ends before where the key is revoked or expires, and where the server stops. It is limited as a stream.
    """
    state = state_of(request)
    known = _refinements(state)
    return _Followed(state, caller_of(request), known, await run_in_thread(lambda: known.job(id)))


class _Followed(StreamingResponse):
    """The events of a job; limits apply while they are sent."""

    def __init__(self, state: ServerState, caller: Caller, known: Refinements, job: Job) -> None:
        self._state, self._caller, self._known, self._revoked = state, caller, known, False
        headers = {"Cache-Control": "no-cache", "X-Accel-Buffering": "no"}
        super().__init__(self._events(job), media_type="text/event-stream", headers=headers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response; raises :class:`TooManyStreams` or :class:`Overloaded` before it begins."""
        limits, access = self._state.limits, self._state.access
        with limits.follower(self._caller, address_of(scope)), access.watching(self._caller, self._end):
            await super().__call__(scope, receive, send)

    def _end(self, code: int, reason: str) -> None:
        """End the response; code and reason are those of streams."""
        del code, reason
        self._revoked = True

    async def _events(self, job: Job) -> AsyncIterator[bytes]:
        sent_at_s, quiet = 0.0, 0
        while not (self._revoked or self._state.hub.draining):
            if job.updated_at_s != sent_at_s:
                sent_at_s, quiet = job.updated_at_s, 0
                name = b"end" if job.state in ENDED else b"progress"
                yield b"event: " + name + b"\ndata: " + orjson.dumps(_job_json(job)) + b"\n\n"
            elif quiet * FOLLOW_S >= 15:
                quiet = 0
                yield b": no change\n\n"
            if job.state in ENDED:
                return
            quiet += 1
            await asyncio.sleep(FOLLOW_S)
            with suppress(StoreUnavailable, Overloaded):  # the next turn tries again
                job = await run_in_thread(partial(self._known.job, job.id))


def _refinements(state: ServerState) -> Refinements:
    state.current()  # not before everything is loaded
    if state.refinements is None:
        raise ReadOnly("this server was started without a data folder, and refines nothing; start it with --data")
    return state.refinements


def _job_json(job: Job) -> dict[str, Any]:
    return {
        "id": job.id,
        "verb": job.verb,
        "state": job.state,
        "request": dict(job.request),
        "progress": dict(job.progress),
        "version_before": job.version_before,
        "version_after": job.version_after,
        "detail": job.detail,
        "created_at": job.created_at_s,
        "updated_at": job.updated_at_s,
    }
