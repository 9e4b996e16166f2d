"""Authentication of every request and handshake, as pure ASGI: the key, and the scope that the request needs."""

from __future__ import annotations

from starlette.types import ASGIApp, Receive, Scope, Send

from service.access import scopes
from service.access.access import ANYONE, CALLER, Access, Caller
from service.access.limits import Limits, address_of
from service.errors import NotReady, ServiceError, Unauthenticated
from service.http.guard import refuse

__all__ = ["Authenticate"]

SUBPROTOCOL = "adverb.bearer."
"""Prefix of the subprotocol by which a browser sends a key."""

_WITHOUT = {"WWW-Authenticate": 'Bearer realm="adverb"'}


class Authenticate:
    """Answer 401 to a request without a valid key, and 403 to one whose key does not have the scope.

    Parameters
    ----------
    app : ASGI application
    access : Access
    limits : Limits
        Requests are counted per caller, and answered with 429 beyond.
    open_metrics, open_docs : bool
        Whether these need no key.
    """

    def __init__(self, app: ASGIApp, *, access: Access, limits: Limits, open_metrics: bool, open_docs: bool) -> None:
        self.app, self._access = app, access
        self._limits = limits if limits.counts_requests else None
        self._open = {scopes.OPEN}
        self._open |= ({scopes.METRICS} if open_metrics else set()) | ({scopes.DOCS} if open_docs else set())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request or handshake, and pass it on."""
        if scope["type"] in ("http", "websocket"):
            try:
                caller = scope[CALLER] = await self._caller(scope)
                if self._limits is not None:
                    await self._limits.request(caller, address_of(scope))
            except ServiceError as err:
                await refuse(err, scope, receive, send)
                return
        await self.app(scope, receive, send)

    async def _caller(self, scope: Scope) -> Caller:
        access = self._access
        if access.loaded and not access.required:
            return ANYONE
        needed = scopes.needed(scope.get("method", "GET"), scope["path"])
        if needed in self._open:
            return ANYONE
        if not access.loaded:
            raise NotReady("keys are being loaded", headers={"Retry-After": "1"})
        key = _key(scope)
        if key is None:
            raise Unauthenticated(
                "this server needs a key; send the header `Authorization: Bearer KEY` (`adverb keys create` makes one)",
                headers=_WITHOUT,
            )
        caller = await access.find(key)
        if needed not in (scopes.ANY, scopes.METRICS, scopes.DOCS):
            access.check(caller, needed)
        return caller


def _key(scope: Scope) -> str | None:
    """The key of a request: of the header, or of a handshake's subprotocol; empty if it cannot be read."""
    found: str | None = None
    for name, value in scope["headers"]:
        if name == b"authorization":
            kind, _, key = value.decode("latin-1").partition(" ")
            if found is not None or kind.lower() != "bearer":
                return ""
            found = key.strip()
    if found is None and scope["type"] == "websocket":
        offered = [name for name in scope.get("subprotocols", ()) if name.startswith(SUBPROTOCOL)]
        found = offered[0].removeprefix(SUBPROTOCOL) if offered else None
    return found
