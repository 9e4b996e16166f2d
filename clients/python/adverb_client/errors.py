"""All errors of this package, in one tree.

::

    AdverbError                     code, status, detail
    ├── TransportError              the server cannot be reached, or the connection broke
    │   └── TimedOut                there is no answer in time
    ├── DecodeError                 a response or message does not follow the specification
    ├── StreamClosed                the stream is closed; see close_code
    └── ResponseError           the server answers with an error: known, limit, request_id, …
        ├── UnknownName             `known` lists the names that exist
        │   ├── UnknownVerb
        │   ├── UnknownVersion
        │   ├── UnknownAdverb
        │   ├── UnknownJoint
        │   ├── UnknownMethod
        │   ├── UnknownSpace
        │   ├── UnknownMap
        │   ├── UnknownRefinement
        │   └── UnknownDraft
        ├── BadRequest
        │   ├── MalformedBody
        │   ├── InvalidRequest      see `field_errors`
        │   ├── OutOfRange
        │   ├── BadUpload
        │   ├── InvalidDraft        see `field_errors`
        │   └── BadMessage          of a stream
        ├── Conflict                the state of the server does not allow it
        │   ├── VersionConflict
        │   ├── RevisionChanged
        │   ├── TooManyDrafts
        │   ├── DraftNotBuilt
        │   ├── NoSource
        │   ├── AlreadyRefining
        │   └── ReadOnly
        ├── TooLarge                see `limit`
        │   ├── BodyTooLarge
        │   └── BatchTooLarge
        ├── NoAccess                the key does not allow it
        │   ├── Unauthenticated
        │   └── MissingScope
        ├── WrongAddress            the server refuses the address or the page
        │   ├── UnknownHost
        │   └── ForeignOrigin
        ├── WrongRoute
        │   ├── NotFound
        │   ├── MethodNotAllowed
        │   ├── NotAcceptable
        │   └── UnsupportedMediaType
        ├── Unavailable             `retry_after_s`
        │   ├── NotReady
        │   ├── Overloaded
        │   ├── TooManyRequests
        │   ├── TooManyStreams
        │   └── StoreUnavailable
        ├── ArtifactDamaged         a file of the server is missing or damaged
        ├── InternalError           a fault of the server; report it with `request_id`
        └── ChannelError            of a stream: `channel`
            ├── UnknownChannel
            ├── ChannelInUse
            ├── TooManyChannels
            ├── SkeletonMismatch
            └── UnknownSession

Each leaf under :class:`ResponseError` stands for one of the server's stable codes. An unknown code gives a plain
:class:`ResponseError`.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AdverbError",
    "AlreadyRefining",
    "ArtifactDamaged",
    "BadMessage",
    "BadRequest",
    "BadUpload",
    "BatchTooLarge",
    "BodyTooLarge",
    "ChannelError",
    "ChannelInUse",
    "Conflict",
    "DecodeError",
    "DraftNotBuilt",
    "FieldError",
    "ForeignOrigin",
    "InternalError",
    "InvalidDraft",
    "InvalidRequest",
    "MalformedBody",
    "MethodNotAllowed",
    "MissingScope",
    "NoAccess",
    "NoSource",
    "NotAcceptable",
    "NotFound",
    "NotReady",
    "OutOfRange",
    "Overloaded",
    "ReadOnly",
    "ResponseError",
    "RevisionChanged",
    "SkeletonMismatch",
    "StoreUnavailable",
    "StreamClosed",
    "TimedOut",
    "TooLarge",
    "TooManyChannels",
    "TooManyDrafts",
    "TooManyRequests",
    "TooManyStreams",
    "TransportError",
    "Unauthenticated",
    "Unavailable",
    "UnknownAdverb",
    "UnknownChannel",
    "UnknownDraft",
    "UnknownHost",
    "UnknownJoint",
    "UnknownMap",
    "UnknownMethod",
    "UnknownName",
    "UnknownRefinement",
    "UnknownSession",
    "UnknownSpace",
    "UnknownVerb",
    "UnknownVersion",
    "UnsupportedMediaType",
    "VersionConflict",
    "WrongAddress",
    "WrongRoute",
    "error_class",
]


class AdverbError(Exception):
    """Root of all errors of this package.

    Attributes
    ----------
    detail : str
        Description of the error.
    code : str
        Stable code of the error.
    status : int or None
        HTTP status, where there is one.
    """

    code: str = "error"
    status: int | None = None

    def __init__(self, detail: str) -> None:
        self.detail = detail
        super().__init__(detail)


class TransportError(AdverbError):
    """The server cannot be reached, or the connection broke."""

    code = "transport"


class TimedOut(TransportError):
    """There is no answer in time."""

    code = "timed_out"


class DecodeError(AdverbError):
    """A response or message does not follow the specification."""

    code = "decode"


class StreamClosed(AdverbError):
    """The stream is closed and does not reconnect.

    Attributes
    ----------
    close_code : int or None
        The WebSocket close code, where there is one.
    """

    code = "stream_closed"

    def __init__(self, detail: str, close_code: int | None = None) -> None:
        super().__init__(detail)
        self.close_code = close_code


@dataclass(frozen=True, slots=True)
class FieldError:
    """One invalid field of a request: its place and the problem."""

    at: str
    problem: str


class ResponseError(AdverbError):
    """The server answers a request or message with an error.

    Parameters
    ----------
    detail, code, status
        As in :class:`AdverbError`.
    title : str
        Title of the kind of problem.
    known : tuple of str
        Existing names or media types, where the given one does not exist.
    limit : int or None
        The limit that is exceeded.
    field_errors : tuple of FieldError
        Invalid fields of the body.
    request_id : str or None
        Identifies the request in the server's log.
    retry_after_s : float or None
        Delay before the next attempt, seconds.
    channel : int or None
        Channel of a stream.
    """

    def __init__(
        self,
        detail: str,
        *,
        code: str = "",
        status: int | None = None,
        title: str = "",
        known: tuple[str, ...] = (),
        limit: int | None = None,
        field_errors: tuple[FieldError, ...] = (),
        request_id: str | None = None,
        retry_after_s: float | None = None,
        channel: int | None = None,
    ) -> None:
        super().__init__(detail)
        self.code = code or type(self).code
        self.status, self.title, self.known, self.limit = status, title, known, limit
        self.field_errors, self.request_id, self.retry_after_s, self.channel = (
            field_errors,
            request_id,
            retry_after_s,
            channel,
        )


class UnknownName(ResponseError):
    """The name does not exist; ``known`` lists those that do."""


class NoAccess(ResponseError):
    """The key does not allow the request."""


class Unauthenticated(NoAccess):
    """The request has no key, or none that is valid."""

    code = "unauthenticated"


class MissingScope(NoAccess):
    """The key does not have the scope that the request needs."""

    code = "missing_scope"


class WrongAddress(ResponseError):
    """The server does not answer under this name, or not for this page."""


class UnknownHost(WrongAddress):
    """The server is not known under the host name of the address; see ``ADVERB_ALLOWED_HOSTS``."""

    code = "unknown_host"


class ForeignOrigin(WrongAddress):
    """A browser sent the request for a page of another site."""

    code = "foreign_origin"


class UnknownVerb(UnknownName):
    """No verb of this name is served."""

    code = "unknown_verb"


class UnknownVersion(UnknownName):
    """The verb is not served in this version."""

    code = "unknown_version"


class UnknownAdverb(UnknownName):
    """The verb has no adverb of this name."""

    code = "unknown_adverb"


class UnknownJoint(UnknownName):
    """The skeleton has no joint of this name."""

    code = "unknown_joint"


class UnknownMethod(UnknownName):
    """The verb does not support this blending method."""

    code = "unknown_method"


class UnknownSpace(UnknownName):
    """The space does not exist."""

    code = "unknown_space"


class UnknownMap(UnknownName):
    """The server has no skeleton of this name to map to."""

    code = "unknown_map"


class UnknownRefinement(UnknownName):
    """The refinement does not exist."""

    code = "unknown_refinement"


class UnknownDraft(UnknownName):
    """The draft does not exist."""

    code = "unknown_draft"


class BadRequest(ResponseError):
    """The request is invalid; see ``detail``."""

    code = "bad_request"


class MalformedBody(BadRequest):
    """The body cannot be parsed."""

    code = "malformed_body"


class InvalidRequest(BadRequest):
    """Fields of the body are invalid; see ``field_errors``."""

    code = "invalid_request"


class OutOfRange(BadRequest):
    """A number is outside its bounds."""

    code = "out_of_range"


class BadUpload(BadRequest):
    """Invalid upload."""

    code = "bad_upload"


class InvalidDraft(BadRequest):
    """The changes of a draft, or the added example, are invalid; see ``field_errors``."""

    code = "invalid_draft"


class Conflict(ResponseError):
    """The state of the server does not allow the request."""


class VersionConflict(Conflict):
    """The verb has another version than the request expects."""

    code = "version_conflict"


class RevisionChanged(Conflict):
    """The draft has another revision than the request expects."""

    code = "revision_changed"


class TooManyDrafts(Conflict):
    """The server has the maximum of drafts, or of their bytes; see ``limit``."""

    code = "too_many_drafts"


class DraftNotBuilt(Conflict):
    """The clips of the draft make no verb."""

    code = "draft_not_built"


class NoSource(Conflict):
    """No source of the verb is stored."""

    code = "no_source"


class AlreadyRefining(Conflict):
    """The verb already has a running refinement."""

    code = "already_refining"


class ReadOnly(Conflict):
    """The server is read-only."""

    code = "read_only"


class BadMessage(BadRequest):
    """The server cannot parse a message of the stream."""

    code = "bad_message"


class TooLarge(ResponseError):
    """The request exceeds ``limit``."""


class BodyTooLarge(TooLarge):
    """The body exceeds ``limit`` bytes."""

    code = "body_too_large"


class BatchTooLarge(TooLarge):
    """The batch exceeds ``limit`` poses."""

    code = "batch_too_large"


class WrongRoute(ResponseError):
    """The server does not support this request; it may be of another version than this client."""


class NotFound(WrongRoute):
    """The path does not exist."""

    code = "not_found"


class MethodNotAllowed(WrongRoute):
    """The path does not support this HTTP method."""

    code = "method_not_allowed"


class NotAcceptable(WrongRoute):
    """The server cannot produce this media type."""

    code = "not_acceptable"


class UnsupportedMediaType(WrongRoute):
    """The server cannot read this media type."""

    code = "unsupported_media_type"


class Unavailable(ResponseError):
    """The server is temporarily unavailable; see ``retry_after_s``."""


class NotReady(Unavailable):
    """The server is still loading its verbs."""

    code = "not_ready"


class Overloaded(Unavailable):
    """The server is overloaded."""

    code = "overloaded"


class TooManyRequests(Unavailable):
    """The key or address has its maximum of requests, see ``limit``."""

    code = "too_many_requests"


class TooManyStreams(Unavailable):
    """The key or address has its maximum of streams, see ``limit``."""

    code = "too_many_streams"


class StoreUnavailable(Unavailable):
    """The server cannot reach its database or artifacts."""

    code = "store_unavailable"


class ArtifactDamaged(ResponseError):
    """A file of the server is missing or damaged."""

    code = "artifact_damaged"


class InternalError(ResponseError):
    """A fault of the server; report it with ``request_id``."""

    code = "internal_error"


class ChannelError(ResponseError):
    """The channel or session of a stream does not allow the message."""


class UnknownChannel(ChannelError):
    """The channel is not open."""

    code = "unknown_channel"


class ChannelInUse(ChannelError):
    """The channel is open already."""

    code = "channel_in_use"


class TooManyChannels(ChannelError):
    """The session has the maximum number of channels."""

    code = "too_many_channels"


class SkeletonMismatch(ChannelError):
    """The new verb has other joints."""

    code = "skeleton_mismatch"


class UnknownSession(ChannelError):
    """The session to resume does not exist any more."""

    code = "unknown_session"


def _leaves(kind: type[ResponseError]) -> list[type[ResponseError]]:
    return [kind, *(leaf for child in kind.__subclasses__() for leaf in _leaves(child))]


_BY_CODE: dict[str, type[ResponseError]] = {kind.code: kind for kind in _leaves(ResponseError) if "code" in vars(kind)}


def error_class(code: str) -> type[ResponseError]:
    """The error class of a server's code; :class:`ResponseError` where the code is unknown."""
    return _BY_CODE.get(code, ResponseError)
