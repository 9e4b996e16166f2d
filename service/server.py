"""One server process: a socket, uvicorn with the settings that were measured best, a clean end."""

from __future__ import annotations

import asyncio
import gc
import ipaddress
import signal
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from service import logs
from service.app import create_app
from service.catalog import Catalog
from service.settings import Settings
from service.stream.hub import Hub

__all__ = ["CannotServe", "Server", "config_of", "serve"]

UNSENT_BYTES = 16_384
"""Unsent bytes of a WebSocket beyond which poses are dropped."""

DRAIN_S = 0.2
"""Time for goodbyes to be written before connections are closed."""

SWITCH_S = 0.001
"""Longest time for which a thread keeps the interpreter while the event loop waits for it; Python's own is 5 ms."""


class CannotServe(Exception):
    """The server cannot start; the message says why and what to do."""


def serve(settings: Settings, *, say: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT; running requests may finish, for ``shutdown_s`` at most.

    Parameters
    ----------
    settings : Settings
    say : callable
        Told, once, where the server is, and which files it could not use.

    Raises
    ------
    CannotServe
        Before anything is served.
    """
    if settings.data is not None and not settings.data.is_dir():
        raise CannotServe(f"the data folder {settings.data} does not exist; make it, or name another (--data)")
    listener = _listen(settings)
    logs.configure(settings)
    sys.setswitchinterval(SWITCH_S)
    host, port = listener.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host

    def ready(catalog: Catalog) -> None:
        # What is loaded stays. Looking through all of it for garbage, as Python would, stops everybody for 50 ms.
        gc.collect()
        gc.freeze()
        for row in catalog.skipped:
            say(f"warning: {row.file} is not served: {row.problem}")
        count = len(catalog.entries)
        say(f"Adverb is ready on http://{shown}:{port} ({count} verb{'s' * (count != 1)}; docs at /docs)")

    app = create_app(settings, on_ready=ready)
    # uvicorn stops on these signals and then raises them once more for whoever handled them before: nobody.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    with listener:
        Server(config_of(app, settings), app.state.serving.hub).run(sockets=[listener])


class Sockets(WebSocketsSansIOProtocol):
    """uvicorn's WebSockets with short buffers: what lies in a buffer is old by the time it is read."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Keep at most :data:`UNSENT_BYTES` here, and as much in the kernel."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=UNSENT_BYTES)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            connection = transport.get_extra_info("socket")
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)


def config_of(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """The settings of uvicorn that were measured best for this app."""
    return uvicorn.Config(
        app,
        loop="uvloop",
        http="httptools",
        ws=Sockets,
        ws_per_message_deflate=False,
        ws_max_size=65_536,
        ws_ping_interval=20.0,
        access_log=False,
        log_config=None,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=settings.shutdown_s,
    )


class Server(uvicorn.Server):
    """uvicorn, which tells streams that it is about to stop before it closes them."""

    def __init__(self, config: uvicorn.Config, hub: Hub) -> None:
        super().__init__(config)
        self._hub = hub

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop listening, say goodbye, then let requests end."""
        for server in self.servers:
            server.close()
        self._hub.drain()
        await asyncio.sleep(DRAIN_S)
        await super().shutdown(sockets)


def _listen(settings: Settings) -> socket.socket:
    """Open the listening socket, so that a taken port is told before verbs are loaded."""
    try:
        found = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as err:
        raise CannotServe(f"the host '{settings.host}' is not known: {err.strerror or err}") from err
    family, _, _, _, address = found[0]
    if not settings.allow_public and not all(_is_loopback(str(row[4][0])) for row in found):
        raise CannotServe(
            f"other machines can reach {settings.host}, and there are no keys yet: anyone could use this server; "
            "if that is what you want, say so: --allow-public, or ADVERB_ALLOW_PUBLIC=true"
        )
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
    except OSError as err:
        listener.close()
        raise CannotServe(
            f"port {settings.port} on {settings.host} cannot be used: {err.strerror or err}; "
            "stop what uses it, or choose another (--port, ADVERB_PORT; 0 takes a free one)"
        ) from err
    return listener


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback
