"""HTML pages: the dashboard and the reference."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.staticfiles import StaticFiles

from service.http import reference
from service.http.context import state_of

__all__ = ["router"]

STATIC = Path(__file__).parents[2] / "static"
"""Folder into which `make dashboard` builds the dashboard."""

IMMUTABLE = "public, max-age=31536000, immutable"
"""Names of built files contain a hash of their content."""

router = APIRouter(include_in_schema=False)

_SNIFF = {"X-Content-Type-Options": "nosniff"}
_PAGE = {"Content-Security-Policy": reference.CONTENT_POLICY, **_SNIFF}
_DASHBOARD = {"Content-Security-Policy": reference.DASHBOARD_POLICY, "Cache-Control": "no-cache", **_SNIFF}


@router.get("/")
async def home(request: Request) -> Response:
    """Return the dashboard, or a list of verbs if the dashboard is not built."""
    page = STATIC / "index.html"
    if page.is_file():
        return FileResponse(page, headers=_DASHBOARD)
    return HTMLResponse(reference.welcome(state_of(request).catalog), headers=_PAGE)


@router.get("/assets/{path:path}")
async def asset(request: Request, path: str) -> Response:
    """Return a file of the dashboard's own folder."""
    files = StaticFiles(directory=STATIC / "assets", check_dir=False)
    answer = await files.get_response(path, request.scope)
    answer.headers.update({"Cache-Control": IMMUTABLE, **_SNIFF})
    return answer


@router.get("/docs")
async def docs(request: Request) -> HTMLResponse:
    """Return the reference of all routes, made from the OpenAPI document."""
    return HTMLResponse(reference.reference(request.app.openapi()), headers=_PAGE)
