"""A route class that calls its endpoint without FastAPI's dependency resolution, and a response for it."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

__all__ = ["Direct", "Whole"]


class Whole(Response):
    """A response of bytes and a media type, without the conversions of other kinds of content."""

    def __init__(self, content: bytes, media_type: str) -> None:
        self.status_code, self.background, self.body = 200, None, content
        self.raw_headers = [
            (b"content-length", b"%d" % len(content)),
            (b"content-type", media_type.encode("latin-1")),
        ]


class Direct(APIRoute):
    """Calls its endpoint with the request and the path parameters only.

    Resolving dependencies and validating one path parameter takes longer than evaluating a pose. The signature still
    documents the route; the endpoint reads and validates the body, and the app's handlers answer its errors.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.app = self._call

    async def _call(self, scope: Scope, receive: Receive, send: Send) -> None:
        response: Response = await self.endpoint(Request(scope, receive, send), **scope["path_params"])
        await response(scope, receive, send)
