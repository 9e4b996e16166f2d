"""Errors of the service, and the table that maps errors to RFC 9457 problems.

Every problem has a stable ``code``; ``type`` links to its description in ``/docs``. The errors of the service::

    ServiceError
    ├── UnknownHost        the ``Host`` of the request is not a name of this server
    ├── ForeignOrigin      a browser sent the request for a page of another site
    ├── Unauthenticated    the request has no key, or none that is valid
    ├── MissingScope       the key does not have the scope that the request needs
    ├── TooManyRequests    the limit of requests of a key or an address is reached
    ├── TooManyStreams     the limit of streams of a key or an address is reached
    ├── NotReady           verbs are still being loaded
    ├── Overloaded         the queue of long calls is full
    ├── BodyTooLarge       the body is longer than the limit
    ├── BatchTooLarge      the request has more poses than the limit
    ├── WrongMediaType     the route does not accept the media type of the body
    ├── NotAcceptable      the client accepts no media type of the route
    ├── BadBody            the body does not match its media type
    ├── BadUpload          an uploaded verb is invalid
    ├── VersionConflict    another version is current than the client expects
    ├── UnknownDraft       no draft has this id
    ├── TooManyDrafts      the limit of drafts is reached
    ├── InvalidDraft       values cannot be stored in a draft
    ├── DraftNotBuilt      the clips of a draft make no verb
    ├── DraftChanged       the draft has another revision than the client expects
    ├── NoSource           no source of the verb is stored
    ├── UnknownRefinement  no refinement has this id
    ├── AlreadyRefining    another refinement of the verb is unfinished
    ├── ReadOnly           the server was started without a data folder
    ├── StoreUnavailable   the database or the artifacts cannot be reached
    ├── BadMessage         a message of a stream is invalid
    ├── UnknownChannel     the channel is not open in this stream
    ├── ChannelInUse       the channel is open already
    ├── TooManyChannels    the limit of channels is reached
    └── UnknownSession     the session cannot be resumed
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
    "ArtifactDamaged",
    "BadBody",
    "BadMessage",
    "BadUpload",
    "BatchTooLarge",
    "BodyTooLarge",
    "ChannelInUse",
    "DraftChanged",
    "DraftNotBuilt",
    "ForeignOrigin",
    "InvalidDraft",
    "MissingScope",
    "NoSource",
    "NotAcceptable",
    "NotReady",
    "Overloaded",
    "Problem",
    "ReadOnly",
    "ServiceError",
    "StoreUnavailable",
    "TooManyChannels",
    "TooManyDrafts",
    "TooManyRequests",
    "TooManyStreams",
    "Unauthenticated",
    "UnknownChannel",
    "UnknownDraft",
    "UnknownHost",
    "UnknownRefinement",
    "UnknownSession",
    "VersionConflict",
    "WrongMediaType",
    "code_of",
    "install",
    "invalid",
    "mistakes_of",
    "problem",
    "response_of",
]

MEDIA_TYPE = "application/problem+json"

MAX_LISTED = 16
"""Largest number of mistakes in one response."""

MAX_MADE = 200
"""Largest number of mistakes that pydantic may list: it takes 3 µs for each, and a body of 1 MiB can have 90,000."""


class ServiceError(Exception):
    """Root of the errors of the service; ``extra`` is added to the problem."""

    def __init__(self, detail: str, *, headers: dict[str, str] | None = None, **extra: Any) -> None:
        self.detail, self.headers, self.extra = detail, headers or {}, extra
        super().__init__(detail)


class UnknownHost(ServiceError):
    """The ``Host`` of the request is not a name of this server."""


class ForeignOrigin(ServiceError):
    """A browser sent the request for a page of another site."""


class Unauthenticated(ServiceError):
    """The request has no key, or none that is valid."""


class MissingScope(ServiceError):
    """The key does not have the scope that the request needs."""


class TooManyRequests(ServiceError):
    """The limit of requests of a key or an address is reached."""


class TooManyStreams(ServiceError):
    """The limit of streams of a key or an address is reached."""


class NotReady(ServiceError):
    """Verbs are still being loaded and kernels compiled."""


class Overloaded(ServiceError):
    """The queue of long calls is full."""


class BodyTooLarge(ServiceError):
    """The body is longer than the limit."""


class BatchTooLarge(ServiceError):
    """The request has more poses or frames than the limit."""


class WrongMediaType(ServiceError):
    """The route does not accept the media type of the body."""


class NotAcceptable(ServiceError):
    """The client accepts no media type of the route."""


class BadBody(ServiceError):
    """The body does not match its media type."""


class BadUpload(ServiceError):
    """An uploaded verb is invalid."""


class VersionConflict(ServiceError):
    """Another version is current than the client expects."""


class UnknownDraft(ServiceError):
    """No draft has this id."""


class TooManyDrafts(ServiceError):
    """The limit of drafts, or of their bytes, is reached."""


class InvalidDraft(ServiceError):
    """Values that cannot be stored in a draft, or not added to a source."""


class DraftNotBuilt(ServiceError):
    """The clips of a draft make no verb."""


class DraftChanged(ServiceError):
    """The draft has another revision than the client expects."""


class NoSource(ServiceError):
    """No source of the verb is stored."""


class UnknownRefinement(ServiceError):
    """No refinement has this id."""


class AlreadyRefining(ServiceError):
    """Another refinement of the verb is unfinished."""


class ReadOnly(ServiceError):
    """The server was started without a data folder, and is read-only."""


class StoreUnavailable(ServiceError):
    """The database or the artifacts cannot be reached; loaded verbs are still served."""


class ArtifactDamaged(ServiceError):
    """A stored file is missing or damaged."""


class BadMessage(ServiceError):
    """A message of a stream is invalid."""


class UnknownChannel(ServiceError):
    """The channel is not open in this stream."""


class ChannelInUse(ServiceError):
    """The channel is open already."""


class TooManyChannels(ServiceError):
    """The limit of channels of a stream or of the server is reached."""


class UnknownSession(ServiceError):
    """The session is unknown to this server, or its grace time is over."""


@dataclass(frozen=True, slots=True)
class Problem:
    """A row of the table: status, stable code, title, and advice for clients."""

    status: int
    code: str
    title: str
    advice: str


_UNKNOWN = "`known` lists the existing names."

PROBLEMS: dict[str, Problem] = {
    row.code: row
    for row in (
        Problem(400, "malformed_body", "Malformed body", "Send valid JSON (UTF-8), or whole rows of float32."),
        Problem(401, "unauthenticated", "Unauthenticated", "Send `Authorization: Bearer KEY` with a valid key."),
        Problem(403, "missing_scope", "Missing scope", "Use a key with the scope in `scope`."),
        Problem(403, "foreign_origin", "Foreign origin", "Pages of other sites cannot use this server."),
        Problem(404, "unknown_verb", "Unknown verb", _UNKNOWN),
        Problem(404, "unknown_version", "Unknown version", _UNKNOWN),
        Problem(404, "not_found", "Not found", "See /docs for the routes."),
        Problem(405, "method_not_allowed", "Method not allowed", "The header `Allow` lists the methods of this route."),
        Problem(406, "not_acceptable", "Not acceptable", "`known` lists the available media types."),
        Problem(413, "body_too_large", "Body too large", "Send less at once; `limit` is in bytes."),
        Problem(413, "batch_too_large", "Batch too large", "Request fewer at once; `limit` is in poses."),
        Problem(415, "unsupported_media_type", "Unsupported media type", "`known` lists the accepted media types."),
        Problem(421, "unknown_host", "Unknown host", "Use the server's own name, or add this one to its settings."),
        Problem(422, "invalid_request", "Invalid request", "`errors` lists where, and what is allowed."),
        Problem(422, "unknown_adverb", "Unknown adverb", _UNKNOWN),
        Problem(422, "unknown_joint", "Unknown joint", _UNKNOWN),
        Problem(422, "unknown_method", "Unknown method", _UNKNOWN),
        Problem(422, "unknown_space", "Unknown space", _UNKNOWN),
        Problem(422, "unknown_map", "Unknown map", _UNKNOWN),
        Problem(422, "out_of_range", "Out of range", "The detail names the number and its bounds."),
        Problem(422, "bad_request", "Bad request", "The detail gives the reason."),
        Problem(404, "unknown_refinement", "Unknown refinement", "GET /v1/refinements lists the existing ones."),
        Problem(404, "unknown_draft", "Unknown draft", "GET /v1/drafts lists the existing ones."),
        Problem(409, "too_many_drafts", "Too many drafts", "Publish and delete some, or raise the server's limits."),
        Problem(409, "draft_not_built", "Draft not built", "The detail states why its clips make no verb."),
        Problem(409, "no_source", "No source", "Upload the verb as a zip of its source, then add the example."),
        Problem(412, "revision_changed", "Revision changed", "Read revision `current`, and retry with its number."),
        Problem(422, "invalid_draft", "Invalid draft", "`errors` lists the places and problems; nothing was changed."),
        Problem(409, "already_refining", "Already refining", "Follow or cancel the one in `refinement`."),
        Problem(409, "read_only", "Read-only server", "Start the server with a data folder (--data)."),
        Problem(412, "version_conflict", "Version conflict", "Read version `current`, and retry with its number."),
        Problem(
            503, "store_unavailable", "Store unavailable", "Verbs are still served; retry after `Retry-After` seconds."
        ),
        Problem(422, "bad_upload", "Invalid upload", "The detail describes the mistake and its place."),
        Problem(400, "bad_message", "Invalid message", "In streams. See docs/wire.md for messages."),
        Problem(404, "unknown_channel", "Unknown channel", "In streams. Open it first."),
        Problem(409, "channel_in_use", "Channel in use", "In streams. Close it first, or switch it."),
        Problem(422, "skeleton_mismatch", "Skeleton mismatch", "In streams. Open another channel for that verb."),
        Problem(404, "unknown_session", "Unknown session", "In streams. Open new channels."),
        Problem(429, "too_many_requests", "Too many requests", "Retry after `Retry-After` seconds."),
        Problem(429, "too_many_streams", "Too many streams", "Close some, or raise the server's limits."),
        Problem(429, "too_many_channels", "Too many channels", "In streams. Close some, or raise the server's limits."),
        Problem(500, "artifact_damaged", "Artifact damaged", "Upload the file again, or restore it from a backup."),
        Problem(500, "internal_error", "Internal error", "Report it with the request id."),
        Problem(503, "not_ready", "Not ready", "Verbs are being loaded; retry after `Retry-After` seconds."),
        Problem(503, "overloaded", "Overloaded", "Retry after `Retry-After` seconds, or request less at once."),
    )
}
"""All problems of the service, by code."""

_SERVICE_CODES: dict[type[ServiceError], str] = {
    UnknownHost: "unknown_host",
    ForeignOrigin: "foreign_origin",
    Unauthenticated: "unauthenticated",
    MissingScope: "missing_scope",
    TooManyRequests: "too_many_requests",
    TooManyStreams: "too_many_streams",
    NotReady: "not_ready",
    Overloaded: "overloaded",
    BodyTooLarge: "body_too_large",
    BatchTooLarge: "batch_too_large",
    WrongMediaType: "unsupported_media_type",
    NotAcceptable: "not_acceptable",
    BadBody: "malformed_body",
    BadUpload: "bad_upload",
    VersionConflict: "version_conflict",
    UnknownDraft: "unknown_draft",
    TooManyDrafts: "too_many_drafts",
    InvalidDraft: "invalid_draft",
    DraftNotBuilt: "draft_not_built",
    DraftChanged: "revision_changed",
    NoSource: "no_source",
    UnknownRefinement: "unknown_refinement",
    AlreadyRefining: "already_refining",
    ReadOnly: "read_only",
    StoreUnavailable: "store_unavailable",
    ArtifactDamaged: "artifact_damaged",
    BadMessage: "bad_message",
    UnknownChannel: "unknown_channel",
    ChannelInUse: "channel_in_use",
    TooManyChannels: "too_many_channels",
    UnknownSession: "unknown_session",
}
_HTTP_CODES = {404: "not_found", 405: "method_not_allowed", 413: "body_too_large"}


def problem(code: str, detail: str, *, headers: dict[str, str] | None = None, **extra: Any) -> Response:
    """Build the response of a problem."""
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
    """The problem response of an exception."""
    if isinstance(err, ServiceError):
        return problem(_SERVICE_CODES[type(err)], err.detail, headers=err.headers, **err.extra)
    if isinstance(err, VerbError):
        return _of_library(err)
    if isinstance(err, StoreError) and (translated := _of_store(err)) is not err:
        return response_of(translated)
    if isinstance(err, RequestValidationError):
        listed = _mistakes(err.errors())
        return problem("invalid_request", f"{listed[0]['at']}: {listed[0]['problem']}", errors=listed)
    if isinstance(err, HTTPException):
        code = _HTTP_CODES.get(err.status_code, "bad_request" if err.status_code < 500 else "internal_error")
        return problem(code, _detail(err), headers=dict(err.headers or {}))
    return problem("internal_error", "internal error; the server's log has the request id")


def _of_library(err: VerbError) -> Response:
    extra: dict[str, Any] = {"known": list(err.known)} if isinstance(err, UnknownName) else {}
    return problem(*code_of(err), **extra)


def _of_store(err: StoreError) -> Exception:
    """The error of the service for an error of the store."""
    translated: Exception = err
    match err:
        case records.UnknownVerb():
            translated = UnknownName("verb", err.verb, err.known)
        case records.UnknownVersion():
            translated = UnknownName("version", str(err.number), [str(number) for number in err.known])
        case records.UnknownJob():
            translated = UnknownRefinement(f"unknown refinement '{err.id[:64]}'")
        case records.UnknownDraft():
            translated = UnknownDraft(str(err))
        case records.DraftChanged():
            translated = DraftChanged(str(err), current=err.found)
        case records.TooManyDrafts():
            translated = TooManyDrafts(str(err), limit=err.limit)
        case records.Conflict():
            translated = VersionConflict(str(err), current=err.found)
        case records.ArtifactMissing():
            translated = ArtifactDamaged(str(err))
        case records.StoreUnavailable():
            translated = StoreUnavailable(str(err), headers={"Retry-After": "2"})
        case records.InvalidValue():
            translated = RequestError(str(err))
    return translated


def code_of(err: ServiceError | VerbError) -> tuple[str, str]:
    """Stable code and detail of an error, for streams."""
    if isinstance(err, ServiceError):
        return _SERVICE_CODES[type(err)], err.detail
    if isinstance(err, UnknownName):
        code = f"unknown_{err.kind}"
        return code if code in PROBLEMS else "bad_request", str(err)
    if isinstance(err, SkeletonMismatch):
        return "skeleton_mismatch", str(err)
    return "out_of_range" if isinstance(err, OutOfRange) else "bad_request", str(err)


def invalid(err: ValidationError, model: type[BaseModel]) -> NoReturn:
    """Raise :class:`BadBody` if a body is not JSON, otherwise RequestValidationError with its mistakes."""
    mistakes = mistakes_of(err)
    if mistakes[0]["type"] == "json_invalid":
        reason = mistakes[0].get("ctx", {}).get("error", mistakes[0]["msg"])
        raise BadBody(f"the body is not JSON: {reason}") from err
    for row in mistakes:
        if row["type"] == "extra_forbidden" and len(row["loc"]) == 1:
            row["msg"] += f"; known: {', '.join(model.model_fields)}"
    raise RequestValidationError(mistakes) from err


def mistakes_of(err: ValidationError) -> list[Any]:
    """Mistakes as pydantic lists them; instead of more than :data:`MAX_MADE` one that states their number."""
    count = err.error_count()
    if count > MAX_MADE:
        msg = f"{count} mistakes; some are listed where there are at most {MAX_MADE}"
        return [{"type": "too_many_mistakes", "loc": (), "msg": msg}]
    return list(err.errors(include_url=False, include_input=False))


def _mistakes(errors: Iterable[Any]) -> list[dict[str, str]]:
    """Invalid fields and their problems; values are not repeated, as they may be large or secret."""
    listed = list(errors)[:MAX_LISTED]
    return [{"at": ".".join(str(part) for part in row["loc"])[:200] or "body", "problem": row["msg"]} for row in listed]


def _detail(err: HTTPException) -> str:
    if err.status_code == HTTPStatus.NOT_FOUND:
        return "unknown address; /docs lists the routes"
    if err.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        return f"this address accepts only {(err.headers or {}).get('Allow', 'other methods')}"
    return str(err.detail)


def install(app: FastAPI) -> None:
    """Register handlers that return problems for all errors of an app."""

    async def answer(request: Request, err: Exception) -> Response:
        del request
        return response_of(err)

    handler: Callable[[Request, Exception], Any] = answer
    for kind in (ServiceError, VerbError, StoreError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, handler)
