"""What happens to every request, as pure ASGI: a wrapper per layer would cost as much as the request itself."""

from __future__ import annotations

import re
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass

import structlog
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import errors
from service.metrics import NONE, UNMATCHED, Metrics

__all__ = ["SCOPE_KEY", "BodyLimit", "Observe", "Trace"]

SCOPE_KEY = "adverb.trace"

CLIENT_LEFT = 499
"""Counted status of a request whose client left before it was read; nothing was answered."""

_REQUEST_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")

log = structlog.get_logger("adverb.request")


@dataclass(slots=True)
class Trace:
    """What is told about a request: handlers name the verb and the method once they know that they exist."""

    request_id: str
    verb: str = NONE
    method: str = NONE


class Observe:
    """Give each request an id, time it, count it, and answer what nobody caught with a problem."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics) -> None:
        self.app, self.metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        trace = Trace(_request_id(scope))
        scope[SCOPE_KEY] = trace
        status = 0

        async def sending(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"].append((b"x-request-id", trace.request_id.encode()))
            await send(message)

        try:
            await self.app(scope, receive, sending)
        except ClientDisconnect:
            status = CLIENT_LEFT
        except Exception as err:
            log.exception("request failed", request_id=trace.request_id, path=scope["path"], verb=trace.verb)
            if status:
                raise  # half an answer cannot be taken back; the server closes the connection
            await errors.response_of(err)(scope, receive, sending)
        finally:
            route = getattr(scope.get("route"), "path", UNMATCHED)
            self.metrics.observe_request(route, trace.verb, trace.method, time.perf_counter() - started)
            self.metrics.count_request(route, _known_method(scope["method"]), status)


class BodyLimit:
    """Refuse a body that is too long: at once where it says so, else as soon as that much has come.

    Parameters
    ----------
    limit : int
        Bytes.
    others : mapping of str to int
        Limits of paths that have their own.
    """

    def __init__(self, app: ASGIApp, *, limit: int, others: Mapping[str, int]) -> None:
        self.app, self.limit, self.others = app, limit, others

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["method"] == "GET":
            await self.app(scope, receive, send)
            return
        limit = self.others.get(scope["path"], self.limit)
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
    return errors.BodyTooLarge(f"a body may be {limit} bytes long at most", limit=limit)


def _request_id(scope: Scope) -> str:
    """The client's own id where it is harmless to repeat, else a new one."""
    for name, value in scope["headers"]:
        if name == b"x-request-id" and _REQUEST_ID.fullmatch(value):
            return str(value, "ascii")
    return secrets.token_hex(8)


def _known_method(method: str) -> str:
    """An HTTP method as a label; clients may send any word."""
    return method if method in ("GET", "POST", "HEAD", "PUT", "PATCH", "DELETE", "OPTIONS") else "other"
