"""What goes wrong → RFC 9457 problem: one table. Nothing else in the service knows statuses of errors.

Every problem has a stable ``code``; ``type`` is where ``/docs`` explains it. The tree of the service's own errors::

    ServiceError
    ├── UnknownHost        the request names a host that this server is not known as
    ├── ForeignOrigin      a browser sent the request for a page of another site
    ├── NotReady           verbs are still being loaded
    ├── Overloaded         too many long calls wait already
    ├── BodyTooLarge       the body is longer than the server takes
    ├── BatchTooLarge      more poses than one call may ask for
    ├── WrongMediaType     the body is of a type that the route does not read
    ├── NotAcceptable      no form that the route can give is accepted
    ├── BadBody            the body cannot be read as what it says it is
    ├── BadUpload          an uploaded verb cannot be served
    ├── VersionConflict    the verb is at another version than the client believes
    ├── UnknownRefinement  there is no such refinement
    ├── AlreadyRefining    the verb is being refined
    ├── ReadOnly           the server was started without a data folder
    ├── StoreUnavailable   the database or the artifacts cannot be reached
    ├── BadMessage         a stream's message cannot be read as one
    ├── UnknownChannel     no such channel is open in this stream
    ├── ChannelInUse       the channel is open already
    ├── TooManyChannels    a stream has as many channels as it may
    └── UnknownSession     there is no such session to resume
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, NoReturn

import orjson
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from service.store import records
from service.store.records import StoreError
from verbs.errors import OutOfRange, RequestError, SkeletonMismatch, UnknownName, VerbError

__all__ = [
    "PROBLEMS",
    "AlreadyRefining",
    "BadBody",
    "BadMessage",
    "BadUpload",
    "BatchTooLarge",
    "BodyTooLarge",
    "ChannelInUse",
    "ForeignOrigin",
    "NotAcceptable",
    "NotReady",
    "Overloaded",
    "Problem",
    "ReadOnly",
    "ServiceError",
    "StoreUnavailable",
    "TooManyChannels",
    "UnknownChannel",
    "UnknownHost",
    "UnknownRefinement",
    "UnknownSession",
    "VersionConflict",
    "WrongMediaType",
    "code_of",
    "install",
    "invalid",
    "problem",
    "response_of",
]

MEDIA_TYPE = "application/problem+json"

MAX_LISTED = 16
"""Mistakes that one answer lists."""


class ServiceError(Exception):
    """Root of what goes wrong in the service itself; ``extra`` goes into the problem."""

    def __init__(self, detail: str, *, headers: dict[str, str] | None = None, **extra: Any) -> None:
        self.detail, self.headers, self.extra = detail, headers or {}, extra
        super().__init__(detail)


class UnknownHost(ServiceError):
    """The request names a host that this server is not known as."""


class ForeignOrigin(ServiceError):
    """A browser sent the request for a page of another site."""


class NotReady(ServiceError):
    """Verbs are still being loaded and kernels compiled."""


class Overloaded(ServiceError):
    """Too many long calls wait already."""


class BodyTooLarge(ServiceError):
    """The body is longer than the server takes."""


class BatchTooLarge(ServiceError):
    """More poses, or frames, than one call may ask for."""


class WrongMediaType(ServiceError):
    """The body is of a type that the route does not read."""


class NotAcceptable(ServiceError):
    """The client accepts none of the forms that the route can give."""


class BadBody(ServiceError):
    """The body cannot be read as what it says it is."""


class BadUpload(ServiceError):
    """An uploaded verb cannot be served."""


class VersionConflict(ServiceError):
    """The verb is at another version than the client believes."""


class UnknownRefinement(ServiceError):
    """There is no such refinement."""


class AlreadyRefining(ServiceError):
    """The verb is being refined."""


class ReadOnly(ServiceError):
    """The server was started without a data folder, and keeps nothing."""


class StoreUnavailable(ServiceError):
    """The database or the artifacts cannot be reached; what is loaded is served on."""


class BadMessage(ServiceError):
    """A stream's message cannot be read as one."""


class UnknownChannel(ServiceError):
    """No such channel is open in this stream."""


class ChannelInUse(ServiceError):
    """The channel is open already."""


class TooManyChannels(ServiceError):
    """A stream, or the server, has as many channels as it may."""


class UnknownSession(ServiceError):
    """There is no such session here, or its grace time is over."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One row of the table: status, stable code, title, and what a client should do about it."""

    status: int
    code: str
    title: str
    advice: str


_UNKNOWN = "The answer's `known` lists the names that exist."

PROBLEMS: dict[str, Problem] = {
    row.code: row
    for row in (
        Problem(400, "malformed_body", "Malformed body", "Send valid JSON (UTF-8), or whole rows of float32."),
        Problem(403, "foreign_origin", "Foreign origin", "Pages of other sites cannot use this server."),
        Problem(404, "unknown_verb", "Unknown verb", _UNKNOWN),
        Problem(404, "unknown_version", "Unknown version", _UNKNOWN),
        Problem(404, "not_found", "Not found", "See /docs for what is served."),
        Problem(405, "method_not_allowed", "Method not allowed", "The header `Allow` lists the methods of this route."),
        Problem(406, "not_acceptable", "Not acceptable", "The answer's `known` lists the media types to accept."),
        Problem(413, "body_too_large", "Body too large", "Send less at once; `limit` is in bytes."),
        Problem(413, "batch_too_large", "Batch too large", "Ask for less at once; `limit` is in poses."),
        Problem(
            415, "unsupported_media_type", "Unsupported media type", "The answer's `known` lists what can be sent."
        ),
        Problem(421, "unknown_host", "Unknown host", "Use the server's own name, or add this one to its settings."),
        Problem(422, "invalid_request", "Invalid request", "The answer's `errors` say where, and what is allowed."),
        Problem(422, "unknown_adverb", "Unknown adverb", _UNKNOWN),
        Problem(422, "unknown_joint", "Unknown joint", _UNKNOWN),
        Problem(422, "unknown_method", "Unknown method", _UNKNOWN),
        Problem(422, "unknown_space", "Unknown space", _UNKNOWN),
        Problem(422, "out_of_range", "Out of range", "The detail says which number, and its bounds."),
        Problem(422, "bad_request", "Request cannot be answered", "The detail says why."),
        Problem(404, "unknown_refinement", "Unknown refinement", "GET /v1/refinements lists those that exist."),
        Problem(409, "already_refining", "Already refining", "Follow or cancel the one that `refinement` names."),
        Problem(409, "read_only", "Server keeps nothing", "Start the server with a data folder (--data)."),
        Problem(412, "version_conflict", "Other version", "Look at version `current`, and try again with its number."),
        Problem(503, "store_unavailable", "Store unavailable", "Verbs are served on; try again after `Retry-After`."),
        Problem(422, "bad_upload", "Upload is no verb", "The detail says what is wrong with it, and where."),
        Problem(400, "bad_message", "Message cannot be read", "In streams. See docs/wire.md for messages."),
        Problem(404, "unknown_channel", "Unknown channel", "In streams. Open it first."),
        Problem(409, "channel_in_use", "Channel in use", "In streams. Close it first, or switch it."),
        Problem(422, "skeleton_mismatch", "Other skeleton", "In streams. Open another channel for that verb."),
        Problem(404, "unknown_session", "Unknown session", "In streams. Open the channels anew."),
        Problem(429, "too_many_channels", "Too many channels", "In streams. Close some, or ask the operator for more."),
        Problem(500, "internal_error", "Internal error", "Report it with the request id."),
        Problem(503, "not_ready", "Not ready", "Verbs are being loaded; ask again after `Retry-After` seconds."),
        Problem(503, "overloaded", "Overloaded", "Ask again after `Retry-After` seconds, or for less at once."),
    )
}
"""Every problem that the service answers with, by code."""

_SERVICE_CODES: dict[type[ServiceError], str] = {
    UnknownHost: "unknown_host",
    ForeignOrigin: "foreign_origin",
    NotReady: "not_ready",
    Overloaded: "overloaded",
    BodyTooLarge: "body_too_large",
    BatchTooLarge: "batch_too_large",
    WrongMediaType: "unsupported_media_type",
    NotAcceptable: "not_acceptable",
    BadBody: "malformed_body",
    BadUpload: "bad_upload",
    VersionConflict: "version_conflict",
    UnknownRefinement: "unknown_refinement",
    AlreadyRefining: "already_refining",
    ReadOnly: "read_only",
    StoreUnavailable: "store_unavailable",
    BadMessage: "bad_message",
    UnknownChannel: "unknown_channel",
    ChannelInUse: "channel_in_use",
    TooManyChannels: "too_many_channels",
    UnknownSession: "unknown_session",
}
_HTTP_CODES = {404: "not_found", 405: "method_not_allowed", 413: "body_too_large"}


def problem(code: str, detail: str, *, headers: dict[str, str] | None = None, **extra: Any) -> Response:
    """A problem as a response."""
    row = PROBLEMS[code]
    content = {
        "type": f"/docs#{code}",
        "title": row.title,
        "status": row.status,
        "detail": detail,
        "code": code,
        **extra,
    }
    return Response(orjson.dumps(content), row.status, headers, MEDIA_TYPE)


def response_of(err: Exception) -> Response:
    """The problem that stands for an exception."""
    if isinstance(err, ServiceError):
        return problem(_SERVICE_CODES[type(err)], err.detail, headers=err.headers, **err.extra)
    if isinstance(err, VerbError):
        return _of_library(err)
    if isinstance(err, StoreError) and (said := _of_store(err)) is not err:
        return response_of(said)
    if isinstance(err, RequestValidationError):
        listed = _mistakes(err.errors())
        return problem("invalid_request", f"{listed[0]['at']}: {listed[0]['problem']}", errors=listed)
    if isinstance(err, HTTPException):
        code = _HTTP_CODES.get(err.status_code, "bad_request" if err.status_code < 500 else "internal_error")
        return problem(code, _said(err), headers=dict(err.headers or {}))
    return problem("internal_error", "something went wrong inside the server; its log has the request id")


def _of_library(err: VerbError) -> Response:
    extra: dict[str, Any] = {"known": list(err.known)} if isinstance(err, UnknownName) else {}
    return problem(*code_of(err), **extra)


def _of_store(err: StoreError) -> Exception:
    """What the store says, in the service's words."""
    said: Exception = err
    match err:
        case records.UnknownVerb():
            said = UnknownName("verb", err.verb, err.known)
        case records.UnknownVersion():
            said = UnknownName("version", str(err.number), [str(number) for number in err.known])
        case records.UnknownJob():
            said = UnknownRefinement(f"there is no refinement '{err.id[:64]}'")
        case records.Conflict():
            said = VersionConflict(str(err), current=err.found)
        case records.StoreUnavailable():
            said = StoreUnavailable(str(err), headers={"Retry-After": "2"})
        case records.InvalidValue():
            said = RequestError(str(err))
    return said


def code_of(err: ServiceError | VerbError) -> tuple[str, str]:
    """Stable code and detail of an error, as streams say them."""
    if isinstance(err, ServiceError):
        return _SERVICE_CODES[type(err)], err.detail
    if isinstance(err, UnknownName):
        code = f"unknown_{err.kind}"
        return code if code in PROBLEMS else "bad_request", str(err)
    if isinstance(err, SkeletonMismatch):
        return "skeleton_mismatch", str(err)
    return "out_of_range" if isinstance(err, OutOfRange) else "bad_request", str(err)


def invalid(err: ValidationError, model: type[BaseModel]) -> NoReturn:
    """Raise what a body that does not fit its model deserves: it is no JSON, or it is not what was expected."""
    mistakes = err.errors(include_url=False, include_input=False)
    if mistakes[0]["type"] == "json_invalid":
        reason = mistakes[0].get("ctx", {}).get("error", mistakes[0]["msg"])
        raise BadBody(f"the body is no JSON: {reason}") from err
    for row in mistakes:
        if row["type"] == "extra_forbidden" and len(row["loc"]) == 1:
            row["msg"] += f"; known: {', '.join(model.model_fields)}"
    raise RequestValidationError(mistakes) from err


def _mistakes(errors: Iterable[Any]) -> list[dict[str, str]]:
    """Where and what, for people; what was sent is not repeated, since it may be large or secret."""
    listed = list(errors)[:MAX_LISTED]
    return [{"at": ".".join(str(part) for part in row["loc"])[:200] or "body", "problem": row["msg"]} for row in listed]


def _said(err: HTTPException) -> str:
    if err.status_code == HTTPStatus.NOT_FOUND:
        return "there is nothing at this address; /docs lists what is served"
    if err.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        return f"this address answers {(err.headers or {}).get('Allow', 'other methods')} only"
    return str(err.detail)


def install(app: FastAPI) -> None:
    """Answer every error of an app with its problem."""

    async def answer(request: Request, err: Exception) -> Response:
        del request
        return response_of(err)

    handler: Callable[[Request, Exception], Any] = answer
    for kind in (ServiceError, VerbError, StoreError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, handler)
