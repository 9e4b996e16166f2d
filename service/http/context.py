"""What a route finds in a request: the server's state, the verb, and the fields that are logged."""

from __future__ import annotations

from starlette.requests import Request

from service.access.access import CALLER, Caller
from service.catalog.catalog import Entry
from service.state import ServerState
from service.tracing import SCOPE_KEY, Trace

__all__ = ["caller_of", "served", "state_of", "trace_of"]


def state_of(request: Request) -> ServerState:
    """State of the server that answers a request."""
    state: ServerState = request.scope["app"].state.server
    return state


def trace_of(request: Request) -> Trace:
    """Fields that are logged and counted with a request."""
    trace: Trace = request.scope[SCOPE_KEY]
    return trace


def caller_of(request: Request) -> Caller:
    """Who sent a request."""
    caller: Caller = request.scope[CALLER]
    return caller


def served(request: Request, name: str) -> tuple[ServerState, Entry]:
    """State and current version of a verb; labels the request with the verb's name.

    Raises
    ------
    UnknownName
        There is no such verb.
    """
    state = state_of(request)
    entry = state.current().entry(name)
    trace_of(request).verb = entry.verb.name
    return state, entry
