"""A route without FastAPI's dependency solving."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

__all__ = ["Direct"]


class Direct(APIRoute):
    """Calls its endpoint with the request and the path's parameters, and with nothing else.

    Opening stacks for dependencies and validating one path parameter takes longer than a pose. The signature still
    makes the documentation; endpoints read and check the body by themselves, and the app answers their errors.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.app = self._answer

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer: Response = await self.endpoint(Request(scope, receive, send), **scope["path_params"])
        await answer(scope, receive, send)
