"""HTML pages: the dashboard and the reference."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.staticfiles import StaticFiles

from service.http import reference
from service.http.context import state_of
from service.settings import origins_of

__all__ = ["router"]

STATIC = Path(__file__).parents[2] / "static"
"""Folder into which `make dashboard` builds the dashboard."""

IMMUTABLE = "public, max-age=31536000, immutable"
"""Names of built files contain a hash of their content."""

router = APIRouter(include_in_schema=False)


def _policy(request: Request, policy: str) -> dict[str, str]:
    """Header of a content security policy, with the pages that may show this one in a frame."""
    allowed = " ".join(["'self'", *sorted(origins_of(state_of(request).settings.frame_ancestors))])
    return {"Content-Security-Policy": f"{policy}; frame-ancestors {allowed}"}


@router.get("/")
async def home(request: Request) -> Response:
    """Return the dashboard, or a list of verbs if the dashboard is not built."""
    page = STATIC / "index.html"
    if page.is_file():
        headers = {**_policy(request, reference.DASHBOARD_POLICY), "Cache-Control": "no-cache"}
        return FileResponse(page, headers=headers)
    headers = _policy(request, reference.CONTENT_POLICY)
    return HTMLResponse(reference.welcome(state_of(request).catalog), headers=headers)


@router.get("/assets/{path:path}")
async def asset(request: Request, path: str) -> Response:
    """Return a file of the dashboard's own folder."""
    files = StaticFiles(directory=STATIC / "assets", check_dir=False)
    answer = await files.get_response(path, request.scope)
    answer.headers.update({"Cache-Control": IMMUTABLE})
    return answer


@router.get("/docs")
async def docs(request: Request) -> HTMLResponse:
    """Return the reference of all routes, made from the OpenAPI document."""
    return HTMLResponse(reference.reference(request.app.openapi()), headers=_policy(request, reference.CONTENT_POLICY))
