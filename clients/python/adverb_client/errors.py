"""What can go wrong, in one tree.

::

    AdverbError                     code, status, detail
    ├── TransportError              the server cannot be reached, or the connection broke
    │   └── TimedOut                it did not answer in time
    ├── DecodeError                 what arrived is not what the specification says
    ├── StreamClosed                the stream is closed; close_code says why
    └── Refused                     the server says no: title, known, limit, mistakes, request_id, …
        ├── UnknownName             `known` lists the names that exist
        │   ├── UnknownVerb
        │   ├── UnknownVersion
        │   ├── UnknownAdverb
        │   ├── UnknownJoint
        │   ├── UnknownMethod
        │   ├── UnknownSpace
        │   └── UnknownRefinement
        ├── BadRequest
        │   ├── MalformedBody
        │   ├── InvalidRequest      `mistakes` say where
        │   ├── OutOfRange
        │   ├── BadUpload
        │   └── BadMessage          of a stream
        ├── Conflict                the server is in another state than the caller believes
        │   ├── VersionConflict
        │   ├── AlreadyRefining
        │   └── ReadOnly
        ├── TooLarge                `limit` is what is allowed
        │   ├── BodyTooLarge
        │   └── BatchTooLarge
        ├── WrongRoute
        │   ├── NotFound
        │   ├── MethodNotAllowed
        │   ├── NotAcceptable
        │   └── UnsupportedMediaType
        ├── Unavailable             `retry_after_s`
        │   ├── NotReady
        │   ├── Overloaded
        │   └── StoreUnavailable
        ├── InternalError           report it with `request_id`
        └── ChannelError            of a stream: `channel`
            ├── UnknownChannel
            ├── ChannelInUse
            ├── TooManyChannels
            ├── SkeletonMismatch
            └── UnknownSession

Each leaf under :class:`Refused` stands for one of the server's stable codes; a code that this client does not know
comes as a plain :class:`Refused`.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AdverbError",
    "AlreadyRefining",
    "BadMessage",
    "BadRequest",
    "BadUpload",
    "BatchTooLarge",
    "BodyTooLarge",
    "ChannelError",
    "ChannelInUse",
    "Conflict",
    "DecodeError",
    "InternalError",
    "InvalidRequest",
    "MalformedBody",
    "MethodNotAllowed",
    "Mistake",
    "NotAcceptable",
    "NotFound",
    "NotReady",
    "OutOfRange",
    "Overloaded",
    "ReadOnly",
    "Refused",
    "SkeletonMismatch",
    "StoreUnavailable",
    "StreamClosed",
    "TimedOut",
    "TooLarge",
    "TooManyChannels",
    "TransportError",
    "Unavailable",
    "UnknownAdverb",
    "UnknownChannel",
    "UnknownJoint",
    "UnknownMethod",
    "UnknownName",
    "UnknownRefinement",
    "UnknownSession",
    "UnknownSpace",
    "UnknownVerb",
    "UnknownVersion",
    "UnsupportedMediaType",
    "VersionConflict",
    "WrongRoute",
    "refusal",
]


class AdverbError(Exception):
    """Root of all errors of this package.

    Attributes
    ----------
    detail : str
        What is wrong, for people.
    code : str
        What is wrong, for programs; stable.
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
    """The server did not answer in time."""

    code = "timed_out"


class DecodeError(AdverbError):
    """What arrived is not what the specification says."""

    code = "decode"


class StreamClosed(AdverbError):
    """The stream is closed and will not come back by itself.

    Attributes
    ----------
    close_code : int or None
        The WebSocket close code, where the server gave one.
    """

    code = "stream_closed"

    def __init__(self, detail: str, close_code: int | None = None) -> None:
        super().__init__(detail)
        self.close_code = close_code


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake in a request: where it stands, and what is wrong with it."""

    at: str
    problem: str


class Refused(AdverbError):
    """The server understood who asked what, and says no.

    Parameters
    ----------
    detail, code, status
        As in :class:`AdverbError`.
    title : str
        The kind of problem, in words.
    known : tuple of str
        Names or media types that exist, where one of them was expected.
    limit : int or None
        What is allowed at most.
    mistakes : tuple of Mistake
        Where a body does not fit.
    request_id : str or None
        The server's log has it.
    retry_after_s : float or None
        When to ask again.
    channel : int or None
        Of a stream: which channel it is about.
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
        mistakes: tuple[Mistake, ...] = (),
        request_id: str | None = None,
        retry_after_s: float | None = None,
        channel: int | None = None,
    ) -> None:
        super().__init__(detail)
        self.code = code or type(self).code
        self.status, self.title, self.known, self.limit = status, title, known, limit
        self.mistakes, self.request_id, self.retry_after_s, self.channel = mistakes, request_id, retry_after_s, channel


class UnknownName(Refused):
    """No such thing; ``known`` lists those that exist."""


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
    """The verb cannot be blended by this method."""

    code = "unknown_method"


class UnknownSpace(UnknownName):
    """There is no such space."""

    code = "unknown_space"


class UnknownRefinement(UnknownName):
    """No such refinement."""

    code = "unknown_refinement"


class BadRequest(Refused):
    """The request cannot be answered; the detail says why."""

    code = "bad_request"


class MalformedBody(BadRequest):
    """The body cannot be read."""

    code = "malformed_body"


class InvalidRequest(BadRequest):
    """The body does not fit; ``mistakes`` say where."""

    code = "invalid_request"


class OutOfRange(BadRequest):
    """A number is outside its bounds."""

    code = "out_of_range"


class BadUpload(BadRequest):
    """What was uploaded is no verb."""

    code = "bad_upload"


class Conflict(Refused):
    """The server is in another state than the caller believes."""


class VersionConflict(Conflict):
    """The verb is at another version."""

    code = "version_conflict"


class AlreadyRefining(Conflict):
    """The verb is being refined."""

    code = "already_refining"


class ReadOnly(Conflict):
    """The server keeps nothing."""

    code = "read_only"


class BadMessage(BadRequest):
    """A message of a stream that the server cannot read."""

    code = "bad_message"


class TooLarge(Refused):
    """More than the server takes; ``limit`` is what it does take."""


class BodyTooLarge(TooLarge):
    """The body is too long; ``limit`` is in bytes."""

    code = "body_too_large"


class BatchTooLarge(TooLarge):
    """Too many poses at once; ``limit`` is in poses."""

    code = "batch_too_large"


class WrongRoute(Refused):
    """The server does not speak this way: it may be older or newer than this client."""


class NotFound(WrongRoute):
    """There is nothing at this address."""

    code = "not_found"


class MethodNotAllowed(WrongRoute):
    """The address answers other methods."""

    code = "method_not_allowed"


class NotAcceptable(WrongRoute):
    """The server cannot give this form."""

    code = "not_acceptable"


class UnsupportedMediaType(WrongRoute):
    """The server cannot read this form."""

    code = "unsupported_media_type"


class Unavailable(Refused):
    """Not now; ``retry_after_s`` says when."""


class NotReady(Unavailable):
    """Verbs are still being loaded."""

    code = "not_ready"


class Overloaded(Unavailable):
    """Too much to do."""

    code = "overloaded"


class StoreUnavailable(Unavailable):
    """The server's database or artifacts cannot be reached."""

    code = "store_unavailable"


class InternalError(Refused):
    """Something went wrong inside the server; report it with ``request_id``."""

    code = "internal_error"


class ChannelError(Refused):
    """A stream's channel or session is not what the message takes it for."""


class UnknownChannel(ChannelError):
    """The channel is not open."""

    code = "unknown_channel"


class ChannelInUse(ChannelError):
    """The channel is open already."""

    code = "channel_in_use"


class TooManyChannels(ChannelError):
    """The session holds as many channels as it may."""

    code = "too_many_channels"


class SkeletonMismatch(ChannelError):
    """The verb to switch to has other joints."""

    code = "skeleton_mismatch"


class UnknownSession(ChannelError):
    """The session to resume is gone."""

    code = "unknown_session"


def _leaves(kind: type[Refused]) -> list[type[Refused]]:
    return [kind, *(leaf for child in kind.__subclasses__() for leaf in _leaves(child))]


_BY_CODE: dict[str, type[Refused]] = {kind.code: kind for kind in _leaves(Refused) if "code" in vars(kind)}


def refusal(code: str) -> type[Refused]:
    """The class that stands for a server's code; :class:`Refused` where the code is not known."""
    return _BY_CODE.get(code, Refused)
