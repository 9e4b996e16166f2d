"""The app: wiring only."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import anyio
from fastapi import FastAPI
from fastapi.telemetry import TelemetryConfig
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware

from service import errors, tracing
from service.catalog.catalog import Catalog
from service.compute import run_in_own_thread
from service.http import openapi
from service.http.authentication import Authenticate, LimitAddresses
from service.http.guard import Guard, allowed_names
from service.http.middleware import BodyLimit, Observe
from service.http.routes import audit, drafts, examples, health, pages, poses, quality, refinements, verbs, versions
from service.settings import Settings, origins_of
from service.state import ServerState, Supervise
from service.stream import endpoint
from service.upload.builder import Sandboxes

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

__all__ = ["create_app"]

UNTRACED = {"/livez", "/readyz", "/v2/health/live", "/v2/health/ready", "/metrics"}
"""Paths that machines request every few seconds."""


def create_app(
    settings: Settings,
    *,
    on_ready: Callable[[Catalog], None] | None = None,
    supervise: Supervise | None = None,
    sandboxes: Sandboxes | None = None,
) -> FastAPI:
    """Make an app; the options are those of :class:`service.state.ServerState`."""
    state = ServerState(settings, on_ready=on_ready, supervise=supervise, sandboxes=sandboxes)
    provider = tracing.provider_of(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        del app
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(state.run)
            tasks.start_soon(state.metrics.measure_lateness)
            tasks.start_soon(state.hub.run)
            yield
            tasks.cancel_scope.cancel()
        if provider is not None:
            await run_in_own_thread(provider.shutdown)

    origins = origins_of(settings.cors_origins)
    app = FastAPI(
        title="Adverb",
        version=openapi.API_VERSION,
        description=openapi.DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        telemetry=_telemetry(provider),
        middleware=[
            *([_cors(origins)] if origins else []),  # first: a page can read every answer, also an unexpected error
            Middleware(Observe, metrics=state.metrics),
            *([Middleware(LimitAddresses, limits=state.limits)] if state.limits.counts("address") else []),
            Middleware(Guard, names=allowed_names(settings.host, settings.allowed_hosts), origins=origins),
            Middleware(
                Authenticate,
                access=state.access,
                limits=state.limits,
                open_metrics=settings.open_metrics,
                open_docs=settings.open_docs,
            ),
            Middleware(BodyLimit, limit=settings.max_body_bytes, upload_limit=settings.max_upload_bytes),
        ],
    )
    app.state.server = state
    # Not include_router: it nests, and asking five routers for their match takes as long as blending the pose.
    routers = (
        *(poses.router, verbs.router, quality.router, versions.router, refinements.router),
        *(drafts.router, examples.router, audit.router, health.router, pages.router),
    )
    app.router.routes[:0] = [route for router in routers for route in router.routes]
    app.router.routes.insert(0, endpoint.route(state.hub, state.access, state.limits))
    errors.install(app)
    openapi.install(app)
    return app


def _telemetry(provider: TracerProvider | None) -> TelemetryConfig:
    """Trace requests where a provider is set; nothing else is exported."""
    return {
        "tracing": provider is not None,
        "tracer_provider": provider,
        "operation_spans": False,
        "exclude": lambda scope: scope["path"] in UNTRACED,
        "metrics": False,
        "logs": False,
        "auto_configure": False,
    }


def _cors(origins: frozenset[str]) -> Middleware:
    """Let pages of listed origins read the answers; keys are sent in a header, so cookies need no permission."""
    return Middleware(
        CORSMiddleware,
        allow_origins=sorted(origins),
        allow_methods=("GET", "POST", "PUT", "PATCH", "DELETE"),
        allow_headers=("Authorization", "Content-Type", "If-Match", "If-None-Match", "Range", "X-Request-Id"),
        expose_headers=("ETag", "Location", "Retry-After", "Content-Disposition", "X-Request-Id"),
        allow_private_network=True,
    )
