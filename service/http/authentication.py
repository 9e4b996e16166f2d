"""Authentication of every request and handshake, as pure ASGI: the key, and the scope that the request needs."""

from __future__ import annotations

from starlette.types import ASGIApp, Receive, Scope, Send

from service.access import scopes
from service.access.access import ANYONE, CALLER, Access, Caller
from service.access.limits import Limits, address_of
from service.errors import NotReady, ServiceError, Unauthenticated
from service.http.guard import refuse

__all__ = ["Authenticate", "LimitAddresses"]

SUBPROTOCOL = "adverb.bearer."
"""Prefix of the subprotocol by which a browser sends a key."""

_UNSCOPED = (scopes.OPEN, scopes.ANY, scopes.METRICS, scopes.DOCS)

_WITHOUT = {"WWW-Authenticate": 'Bearer realm="adverb"'}


class LimitAddresses:
    """Answer 429 to an address beyond its rate, whatever it sends; nothing else about a request is looked at before.

    Parameters
    ----------
    app : ASGI application
    limits : Limits
    """

    def __init__(self, app: ASGIApp, *, limits: Limits) -> None:
        self.app, self._limits = app, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count one request or handshake, and pass it on."""
        if scope["type"] in ("http", "websocket"):
            try:
                await self._limits.request("address", address_of(scope))
            except ServiceError as err:
                await refuse(err, scope, receive, send)
                return
        await self.app(scope, receive, send)


class Authenticate:
    """Answer 401 to a request without a valid key, and 403 to one whose key does not have the scope.

    Parameters
    ----------
    app : ASGI application
    access : Access
    limits : Limits
        Requests are counted per key, and answered with 429 beyond.
    open_metrics, open_docs : bool
        Whether these need no key.
    """

    def __init__(self, app: ASGIApp, *, access: Access, limits: Limits, open_metrics: bool, open_docs: bool) -> None:
        self.app, self._access = app, access
        self._limits = limits if limits.counts("key") else None
        self._open = {scopes.OPEN}
        self._open |= ({scopes.METRICS} if open_metrics else set()) | ({scopes.DOCS} if open_docs else set())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request or handshake, and pass it on."""
        if scope["type"] in ("http", "websocket"):
            try:
                caller = scope[CALLER] = self._known(scope) or await self._caller(scope)
                limits = self._limits
                if limits is not None and caller.id:
                    if limits.counts_in_memory:
                        limits.count("key", caller.id)
                    else:
                        await limits.request("key", caller.id)
            except ServiceError as err:
                await refuse(err, scope, receive, send)
                return
        await self.app(scope, receive, send)

    def _known(self, scope: Scope) -> Caller | None:
        """The caller, where no key is needed or the key was found before; else None."""
        access = self._access
        if not access.loaded:
            return None
        if not access.required:
            return ANYONE
        caller = access.known(_key(scope))
        if caller is not None:
            self._check(caller, _needed(scope))
        return caller

    async def _caller(self, scope: Scope) -> Caller:
        """The caller with the key of a request, which may have to be looked up; see :meth:`Access.find`."""
        needed = _needed(scope)
        if needed in self._open:
            return ANYONE
        if not self._access.loaded:
            raise NotReady("keys are being loaded", headers={"Retry-After": "1"})
        key = _key(scope)
        if key is None:
            raise Unauthenticated(
                "this server needs a key; send the header `Authorization: Bearer KEY` (`adverb keys create` makes one)",
                headers=_WITHOUT,
            )
        caller = await self._access.find(key)
        self._check(caller, needed)
        return caller

    def _check(self, caller: Caller, needed: str) -> None:
        if needed not in caller.scopes and needed not in _UNSCOPED:
            self._access.check(caller, needed)


def _needed(scope: Scope) -> str:
    return scopes.needed(scope.get("method", "GET"), scope["path"])


def _key(scope: Scope) -> str | None:
    """The key of a request: of the header, or of a handshake's subprotocol; empty if it cannot be read."""
    found: str | None = None
    for name, value in scope["headers"]:
        if name == b"authorization":
            kind, _, key = value.decode("latin-1").partition(" ")
            if found is not None or kind.lower() != "bearer":
                return ""
            found = key.strip(" \t")  # other blanks of Unicode are no part of the header's grammar
    if found is None and scope["type"] == "websocket":
        offered = [name for name in scope.get("subprotocols", ()) if name.startswith(SUBPROTOCOL)]
        found = offered[0].removeprefix(SUBPROTOCOL) if offered else None
    return found
