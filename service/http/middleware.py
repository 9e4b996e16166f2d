"""Middleware of every request, as pure ASGI: request ids, metrics, error responses, body limits."""

from __future__ import annotations

import logging
import re
import time

import structlog
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import errors
from service.metrics import UNMATCHED, Metrics
from service.tracing import SCOPE_KEY, RequestIds, Trace, annotate

__all__ = ["BodyLimit", "Observe"]

CLIENT_DISCONNECTED = 499
"""Status that is counted for a request whose client disconnected before the response."""

HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
"""Headers of every response: a page of another site cannot load it as a script or an image, and no address leaks."""

_UPLOADS = re.compile(r"/v1/(?:verbs|drafts|verbs/[^/]+/examples)")

log = structlog.get_logger("adverb.request")
enabled = logging.getLogger("adverb.request").isEnabledFor


class Observe:
    """Assign a request id, measure the duration, count the response, and turn uncaught errors into problems.

    Log lines of a request or a stream have its id as ``request_id``.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics) -> None:
        self.app, self.metrics, self._ids = app, metrics, RequestIds()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or a connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        trace = scope[SCOPE_KEY] = Trace(self._ids.of(scope))
        bound = structlog.contextvars.bind_contextvars(request_id=trace.request_id)
        try:
            if scope["type"] == "http":
                await self._request(trace, scope, receive, send)
            else:
                annotate(scope, trace)
                await self.app(scope, receive, send)
        finally:
            structlog.contextvars.reset_contextvars(**bound)

    async def _request(self, trace: Trace, scope: Scope, receive: Receive, send: Send) -> None:
        started = time.perf_counter()
        status = 0

        async def sending(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] += [(b"x-request-id", trace.request_id.encode()), *HEADERS]
                annotate(scope, trace)  # now: a span ends with the last byte of the body
            await send(message)

        try:
            await self.app(scope, receive, sending)
        except ClientDisconnect:
            status = CLIENT_DISCONNECTED
        except Exception as err:
            log.exception("request failed", path=scope["path"], verb=trace.verb)
            if status:
                raise  # part of the response was sent; the server closes the connection
            await errors.response_of(err)(scope, receive, sending)
        finally:
            seconds = time.perf_counter() - started
            route, http_method = getattr(scope.get("route"), "path", UNMATCHED), _known_method(scope["method"])
            self.metrics.observe_request(route, trace.verb, trace.method, seconds)
            self.metrics.count_request(route, http_method, status)
            if enabled(logging.DEBUG):  # a call of structlog costs 3 µs also where the line is dropped
                labels = {"route": route, "http_method": http_method, "status": status, "verb": trace.verb}
                log.debug("request", **labels, duration_s=round(seconds, 6))


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


def _known_method(method: str) -> str:
    """An HTTP method as a metric label; unknown methods are counted as ``other``."""
    return method if method in ("GET", "POST", "HEAD", "PUT", "PATCH", "DELETE", "OPTIONS") else "other"
