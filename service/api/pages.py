"""Pages for people."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse

from service import reference
from service.serving import serving_of

__all__ = ["router"]

router = APIRouter(include_in_schema=False)

_HEADERS = {"Content-Security-Policy": reference.CONTENT_POLICY, "X-Content-Type-Options": "nosniff"}


@router.get("/")
async def welcome(request: Request) -> HTMLResponse:
    """Say what is served."""
    return HTMLResponse(reference.welcome(serving_of(request).catalog), headers=_HEADERS)


@router.get("/docs")
async def docs(request: Request) -> HTMLResponse:
    """Give the reference of all routes, made from the OpenAPI document."""
    return HTMLResponse(reference.reference(request.app.openapi()), headers=_HEADERS)
