"""What a route finds in a request: the server's state, the verb, and the fields that are logged."""

from __future__ import annotations

from starlette.requests import Request

from service.catalog.catalog import Entry
from service.http.middleware import SCOPE_KEY, Trace
from service.state import Serving

__all__ = ["served", "serving_of", "trace_of"]


def serving_of(request: Request) -> Serving:
    """State of the server that answers a request."""
    serving: Serving = request.scope["app"].state.serving
    return serving


def trace_of(request: Request) -> Trace:
    """Fields that are logged and counted with a request."""
    trace: Trace = request.scope[SCOPE_KEY]
    return trace


def served(request: Request, name: str) -> tuple[Serving, Entry]:
    """State and current version of a verb; labels the request with the verb's name.

    Raises
    ------
    UnknownName
        There is no such verb.
    """
    serving = serving_of(request)
    entry = serving.current().entry(name)
    trace_of(request).verb = entry.verb.name
    return serving, entry
