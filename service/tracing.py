"""How a request or a stream is followed: its id, which the log repeats, and optional traces of OpenTelemetry.

Traces need the extra ``traces``. FastAPI makes the span of a request or of a connection; this module configures where
spans are sent. Without an address nothing of the SDK is imported.
"""

from __future__ import annotations

import re
import secrets
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import count
from typing import TYPE_CHECKING

from opentelemetry import trace
from starlette.types import Scope

from service.settings import Settings

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

__all__ = ["NONE", "SCOPE_KEY", "MissingPackage", "RequestIds", "Trace", "annotate", "check", "provider_of", "trace_id"]

SCOPE_KEY = "adverb.trace"

NONE = "none"
"""Label of a request without verb or method."""

_REQUEST_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")

EXPORT_S = 5
"""Longest time of one export of spans, seconds; spans that cannot be sent are dropped."""


class MissingPackage(Exception):
    """Traces are configured, and their packages are not installed."""


@dataclass(slots=True)
class Trace:
    """Labels of a request: handlers set verb and method once they are known to exist."""

    request_id: str
    verb: str = NONE
    method: str = NONE


class RequestIds:
    """Ids of requests: the client's own if it has allowed characters only, else a new one.

    A new id is a random number of the process and a count: a random number for each takes as long as a pose.
    """

    def __init__(self) -> None:
        self._prefix, self._count = secrets.token_hex(4), count()

    def of(self, scope: Scope) -> str:
        """The id of a request or handshake."""
        for name, value in scope["headers"]:
            if name == b"x-request-id" and _REQUEST_ID.fullmatch(value):
                return str(value, "ascii")
        return f"{self._prefix}{next(self._count):08x}"


def annotate(scope: Scope, found: Trace) -> None:
    """Add the labels of a request to its span, where it has one."""
    if scope.get("fastapi.telemetry") is not None:
        span = trace.get_current_span()
        span.set_attribute("adverb.request_id", found.request_id)
        span.set_attribute("adverb.verb", found.verb)
        span.set_attribute("adverb.method", found.method)


def trace_id() -> str | None:
    """Id of the current trace in hexadecimal, if there is one that is recorded."""
    context = trace.get_current_span().get_span_context()
    return f"{context.trace_id:032x}" if context.is_valid and context.trace_flags.sampled else None


def check(settings: Settings) -> None:
    """Raise :class:`MissingPackage` if traces are configured and cannot be sent."""
    if settings.traces_url is not None and not _installed():
        raise MissingPackage(
            "traces are to be sent (ADVERB_TRACES_URL), and the packages for it are missing; "
            "install them: pip install 'adverb[traces]'"
        )


def provider_of(settings: Settings) -> TracerProvider | None:
    """What makes and sends spans, with a thread of its own; None where no address is set.

    A span of a caller decides whether its request is recorded (W3C Trace Context); else a share of requests is.

    Raises
    ------
    MissingPackage
    """
    if settings.traces_url is None:
        return None
    check(settings)
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor
    from opentelemetry.sdk.trace.sampling import ParentBased, TraceIdRatioBased

    made = TracerProvider(
        sampler=ParentBased(TraceIdRatioBased(settings.traces_share)),
        resource=Resource.create({"service.name": "adverb"}),
        shutdown_on_exit=False,
    )
    exporter = OTLPSpanExporter(f"{settings.traces_url.rstrip('/')}/v1/traces", timeout=EXPORT_S)
    made.add_span_processor(BatchSpanProcessor(exporter))
    return made


def _installed() -> bool:
    try:
        return find_spec("opentelemetry.exporter.otlp.proto.http") is not None
    except ModuleNotFoundError:
        return False
