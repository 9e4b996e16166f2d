"""Health routes: liveness, readiness, metrics."""

from __future__ import annotations

from typing import Any

import orjson
from fastapi import APIRouter, Request
from starlette.responses import Response

from service.http.context import state_of
from service.http.documented import problems
from service.http.negotiation import JSON
from service.http.response_models import Live, Ready

__all__ = ["router"]

router = APIRouter(tags=["health"])

METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_TEXT: dict[int | str, dict[str, Any]] = {
    200: {"description": "Prometheus text", "content": {"text/plain": {"schema": {"type": "string"}}}}
}


@router.get("/v2/health/live", operation_id="live_kserve", response_model=Live, summary="Alive (KServe v2)")
@router.get("/livez", operation_id="live", response_model=Live, summary="Alive")
async def live() -> Response:
    """Return 200 while the process runs; verbs may still be loading."""
    return Response(b'{"live":true}', media_type=JSON)


@router.get(
    "/v2/health/ready",
    operation_id="ready_kserve",
    response_model=Ready,
    responses=problems("not_ready"),
    summary="Ready (KServe v2)",
)
@router.get("/readyz", operation_id="ready", response_model=Ready, responses=problems("not_ready"), summary="Ready")
async def ready(request: Request) -> Response:
    """Return 200 once verbs are loaded and kernels compiled, with the data files that cannot be served.

    While the database is unavailable, verbs are served from memory: ready, `degraded`, with the reason as `problem`.
    """
    state = state_of(request)
    catalog, problem = state.current(), state.problem
    answer = {
        "ready": True,
        "degraded": problem is not None,
        "problem": problem,
        "verbs": len(catalog.entries),
        "skipped": [{"file": row.file, "problem": row.problem} for row in catalog.skipped],
    }
    return Response(orjson.dumps(answer), media_type=JSON)


@router.get("/metrics", operation_id="metrics", response_class=Response, responses=_TEXT, summary="Metrics")
def metrics(request: Request) -> Response:
    """Return all metrics in Prometheus text format. Runs in a thread, since it takes milliseconds."""
    state = state_of(request)
    sync = state.store_sync
    state.metrics.set_database(None if sync is None else sync.store.available)
    return Response(state.metrics.text(), headers={"content-type": METRICS_TYPE})
