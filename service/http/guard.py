"""Checks of `Host` and `Origin`, as pure ASGI: a web page of another site cannot use the server through a browser.

Two attacks are refused. In DNS rebinding a page makes its own name point to this machine; its requests carry that name
as `Host`, which is not in the allow-list. In cross-site requests a page sends a form or opens a WebSocket to this
server; the browser states the page's `Origin`, which is not the address that the request was sent to.

Programs other than browsers send no `Origin` and need no setting. Pages of listed origins may use the server as its own
page does.
"""

from __future__ import annotations

import ipaddress
import platform
from collections.abc import Iterable
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Receive, Scope, Send

from service.errors import ForeignOrigin, ServiceError, UnknownHost, response_of

__all__ = ["Guard", "allowed_names", "refuse"]

SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""

MAX_REMEMBERED = 256
"""Values of `Host` that are remembered as allowed, so that a check costs one look-up."""

_LOOPBACK = ("localhost", "localhost.localdomain")
_DEFAULT_PORTS = {"http": 80, "https": 443, "ws": 80, "wss": 443}
_ANY = "*"


def allowed_names(host: str, listed: str) -> frozenset[str]:
    """Names under which a server may be addressed, besides IP addresses.

    Parameters
    ----------
    host : str
        Address that the server listens on.
    listed : str
        ``ADVERB_ALLOWED_HOSTS``: names separated by commas; ``*`` allows any.
    """
    names = (*_LOOPBACK, host, platform.node(), *listed.split(","))
    return frozenset(name.strip().rstrip(".").lower() for name in names if name.strip())


class Guard:
    """Answer 421 to an unknown `Host`, and 403 to a foreign `Origin` on what changes something and on sockets.

    Parameters
    ----------
    app : ASGI application
    names : iterable of str
        See :func:`allowed_names`.
    origins : iterable of str
        Of pages that may use the server besides its own; ``*`` allows any.
    """

    def __init__(self, app: ASGIApp, *, names: Iterable[str], origins: Iterable[str] = ()) -> None:
        self.app, self._names, self._origins = app, frozenset(names), frozenset(origins)
        self._remembered: set[bytes] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request or handshake, and pass it on."""
        kind = scope["type"]
        if kind not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        try:
            self._check(scope, changes=kind == "websocket" or scope["method"] not in SAFE)
        except ServiceError as err:
            await refuse(err, scope, receive, send)
            return
        await self.app(scope, receive, send)

    def _check(self, scope: Scope, *, changes: bool) -> None:
        host = origin = site = b""
        for name, value in scope["headers"]:
            if name == b"host":
                host = value
            elif name == b"origin":
                origin = value
            elif name == b"sec-fetch-site":
                site = value
        if host and host not in self._remembered:
            self._check_host(host)
        if changes and (origin or site) and not self._allows(origin):
            _check_origin(host, origin, site)

    def _allows(self, origin: bytes) -> bool:
        """Whether a page of a listed origin sent the request."""
        return _ANY in self._origins or (bool(origin) and origin.decode("latin-1").lower() in self._origins)

    def _check_host(self, host: bytes) -> None:
        name, _ = _authority(host.decode("latin-1"))
        if _ANY not in self._names and name not in self._names and not _is_address(name):
            raise UnknownHost(
                f"this server is not known as {name[:100]!r}; if it should be, add the name to ADVERB_ALLOWED_HOSTS"
            )
        if len(self._remembered) < MAX_REMEMBERED:
            self._remembered.add(host)


def _check_origin(host: bytes, origin: bytes, site: bytes) -> None:
    """Raise :class:`ForeignOrigin` where a browser sent the request for a page of another server.

    Schemes are not compared: behind a proxy that ends TLS they differ. A default port may be left out.
    """
    if not origin:
        if site in (b"cross-site", b"same-site"):
            raise ForeignOrigin("the request comes from a page of another site")
        return
    text = origin.decode("latin-1")
    try:
        parts = urlsplit(text)
        name, port = _authority(parts.netloc)
        own_name, own_port = _authority(host.decode("latin-1"))
        default = _DEFAULT_PORTS.get(parts.scheme)
        same = bool(parts.netloc) and name == own_name and (port or default) == (own_port or default)
    except ValueError:
        same = False
    if not same:
        raise ForeignOrigin(f"the request comes from a page of {text[:100]!r}, which is another site than this server")


def _authority(text: str) -> tuple[str, int | None]:
    """Name in lower case and port of ``name:port``; an IPv6 address stands in brackets."""
    text = text.strip().lower()
    name, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        name, port = text, ""
    return name.strip("[]").rstrip("."), int(port) if port.isdecimal() and len(port) <= 5 else None


def _is_address(name: str) -> bool:
    """Whether a name is an IP address, which no page can make point elsewhere."""
    try:
        ipaddress.ip_address(name.partition("%")[0])
    except ValueError:
        return False
    return True


async def refuse(err: ServiceError, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the problem; a WebSocket handshake gets its status in place of 101."""
    if scope["type"] == "http":
        await response_of(err)(scope, receive, send)
        return
    await receive()  # websocket.connect
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008, "reason": err.detail})
        return
    response = response_of(err)
    head = {"status": response.status_code, "headers": response.raw_headers}
    await send({"type": "websocket.http.response.start", **head})
    await send({"type": "websocket.http.response.body", "body": response.body})
