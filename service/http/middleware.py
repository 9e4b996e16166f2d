"""Middleware of every request, as pure ASGI: request ids, metrics, error responses, body limits."""

from __future__ import annotations

import re
import secrets
import time
from dataclasses import dataclass
from itertools import count

import structlog
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import errors
from service.metrics import NONE, UNMATCHED, Metrics

__all__ = ["SCOPE_KEY", "BodyLimit", "Observe", "Trace"]

SCOPE_KEY = "adverb.trace"

CLIENT_DISCONNECTED = 499
"""Status that is counted for a request whose client disconnected before the response."""

HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
"""Headers of every response: a page of another site cannot load it as a script or an image, and no address leaks."""

_UPLOADS = re.compile(r"/v1/(?:verbs|drafts|verbs/[^/]+/examples)")
_REQUEST_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")

log = structlog.get_logger("adverb.request")


@dataclass(slots=True)
class Trace:
    """Labels of a request: handlers set verb and method once they are known to exist."""

    request_id: str
    verb: str = NONE
    method: str = NONE


class Observe:
    """Assign a request id, measure the duration, count the response, and turn uncaught errors into problems."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics) -> None:
        self.app, self.metrics = app, metrics
        # A new id is a random number of the process and a count: a random number for each takes as long as a pose.
        self._prefix, self._count = secrets.token_hex(4), count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        trace = Trace(_request_id(scope) or f"{self._prefix}{next(self._count):08x}")
        scope[SCOPE_KEY] = trace
        status = 0

        async def sending(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] += [(b"x-request-id", trace.request_id.encode()), *HEADERS]
            await send(message)

        try:
            await self.app(scope, receive, sending)
        except ClientDisconnect:
            status = CLIENT_DISCONNECTED
        except Exception as err:
            log.exception("request failed", request_id=trace.request_id, path=scope["path"], verb=trace.verb)
            if status:
                raise  # part of the response was sent; the server closes the connection
            await errors.response_of(err)(scope, receive, sending)
        finally:
            route = getattr(scope.get("route"), "path", UNMATCHED)
            self.metrics.observe_request(route, trace.verb, trace.method, time.perf_counter() - started)
            self.metrics.count_request(route, _known_method(scope["method"]), status)


class BodyLimit:
    """Refuse a body that is too long, by its declared length or as soon as it exceeds the limit.

    Parameters
    ----------
    limit : int
        Bytes.
    upload_limit : int
        Bytes, of the paths that take uploads.
    """

    def __init__(self, app: ASGIApp, *, limit: int, upload_limit: int) -> None:
        self.app, self.limit, self.upload_limit = app, limit, upload_limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["method"] == "GET":
            await self.app(scope, receive, send)
            return
        limit = self.upload_limit if _UPLOADS.fullmatch(scope["path"]) else self.limit
        for name, value in scope["headers"]:
            if name == b"content-length" and (not value.isdigit() or len(value) > 18 or int(value) > limit):
                await errors.response_of(_refusal(limit))(scope, receive, send)
                return
        received = 0

        async def receiving() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:
                raise _refusal(limit)
            return message

        await self.app(scope, receiving, send)


def _refusal(limit: int) -> errors.BodyTooLarge:
    return errors.BodyTooLarge(f"a body may have at most {limit} bytes", limit=limit)


def _request_id(scope: Scope) -> str:
    """The client's own id if it has allowed characters only, else nothing."""
    for name, value in scope["headers"]:
        if name == b"x-request-id" and _REQUEST_ID.fullmatch(value):
            return str(value, "ascii")
    return ""


def _known_method(method: str) -> str:
    """An HTTP method as a metric label; unknown methods are counted as ``other``."""
    return method if method in ("GET", "POST", "HEAD", "PUT", "PATCH", "DELETE", "OPTIONS") else "other"
