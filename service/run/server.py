"""One server process: a socket, uvicorn with the settings that were measured best, a clean end."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
import sys
from collections.abc import Callable
from typing import Any

import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.catalog.catalog import Catalog
from service.run import logs
from service.run.acceptor import Acceptor
from service.run.http_protocol import BoundedHttp
from service.run.listener import CannotServe, check, greeting, listen
from service.run.loads import NO_ROOM, Loads
from service.run.progress import Progress
from service.run.spawn import supervise
from service.settings import Settings
from service.state import ServerState, Supervise
from service.stream.hub import Hub
from service.stream.transport import StreamProtocol
from service.upload.builder import Sandboxes

__all__ = ["CannotServe", "Server", "SharedServer", "config_of", "run", "serve"]

OTHER_FILES = 1_024
"""Open files besides those of streams."""

DRAIN_S = 0.2
"""Time to write `drain` messages before connections are closed, seconds."""

KEEP_ALIVE_S = 75
"""Time after which an idle connection is closed, seconds; longer than proxies (nginx: 60 s) and clients keep theirs.

A server that closes first may do so while a request is on its way, which then fails.
"""

SWITCH_S = 0.001
"""Longest time that a thread keeps the interpreter lock while the event loop waits, seconds; Python's is 5 ms."""


def serve(settings: Settings, *, report: Callable[[str], None]) -> None:
    """Serve in this process, with refiners and sandboxes as programs of their own; for systems without fork.

    Parameters
    ----------
    settings : Settings
    report : callable
        Receives the lines of :func:`service.run.listener.greeting`; before them, how long the start takes.

    Raises
    ------
    CannotServe
        Before anything is served, or as :func:`run` does.
    """
    if settings.workers > 1:
        raise CannotServe("only Linux distributes connections over processes that share a port; use --workers 1")
    check(settings)
    listener = listen(settings)
    logs.configure(settings)
    progress = Progress(report)

    def ready(catalog: Catalog) -> None:
        progress.close()
        for line in greeting(listener, len(catalog.entries), [(row.file, row.problem) for row in catalog.skipped]):
            report(line)

    try:
        run(settings, listener, on_ready=ready, supervise=supervise)
    finally:
        progress.close()


def run(
    settings: Settings,
    listener: socket.socket,
    *,
    on_ready: Callable[[Catalog], None],
    supervise: Supervise | None = None,
    sandboxes: Sandboxes | None = None,
    loads: Loads | None = None,
    number: int = 0,
) -> None:
    """Serve on a socket, which is closed at the end.

    Parameters
    ----------
    settings : Settings
    listener : socket
    on_ready : callable
        Called with the verbs once requests are answered.
    supervise, sandboxes : optional
        As for :class:`service.state.ServerState`.
    loads, number : optional
        As for :class:`SharedServer`.

    Raises
    ------
    CannotServe
        Verbs cannot be loaded, or the store cannot be followed any more.
    """
    sys.setswitchinterval(SWITCH_S)
    _allow_files(2 * settings.streams + OTHER_FILES)

    def ready(catalog: Catalog) -> None:
        # What is loaded stays. A full collection, as Python would do one, stops all work for 50 ms.
        gc.collect()
        gc.freeze()
        on_ready(catalog)

    app = create_app(settings, on_ready=ready, supervise=supervise, sandboxes=sandboxes)
    # uvicorn re-raises the signal on exit; a no-op handler keeps the exit clean.
    for ending in (signal.SIGTERM, signal.SIGINT):
        signal.signal(ending, lambda *_: None)
    with listener:
        config, state = config_of(app, settings), app.state.server
        server = Server(config, state.hub) if loads is None else SharedServer(config, state, loads, number)
        server.run(sockets=[listener])
    if server.failed:
        raise CannotServe("verbs cannot be loaded and kept up to date; see the log")


def _allow_files(count: int) -> None:
    """Raise the limit of open files to so many, as far as the system allows; a stream has two."""
    if sys.platform != "win32":
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = count if hard == resource.RLIM_INFINITY else min(count, hard)
        if soft != resource.RLIM_INFINITY and wanted > soft:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def config_of(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """The settings of uvicorn that were measured best for this app."""
    protocol = type("Http", (BoundedHttp,), {"patience_s": settings.request_s, "slow_s": settings.stream_slow_s})
    return uvicorn.Config(
        app,
        loop="uvloop",
        http=protocol,
        ws=StreamProtocol,
        ws_per_message_deflate=False,
        ws_max_size=65_536,
        ws_ping_interval=20.0,
        # Without the variable, a client on this machine could state any address for itself.
        proxy_headers=bool(os.environ.get("FORWARDED_ALLOW_IPS")),
        timeout_keep_alive=KEEP_ALIVE_S,
        access_log=False,
        log_config=None,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=settings.shutdown_s,
    )


class Server(uvicorn.Server):
    """uvicorn server that sends `drain` to streams before it closes them."""

    def __init__(self, config: uvicorn.Config, hub: Hub) -> None:
        super().__init__(config)
        self._hub = hub

    @property
    def failed(self) -> bool:
        """Whether a background task of the app has failed, so that verbs are missing or stay old."""
        return bool(self.lifespan.error_occurred)

    async def on_tick(self, counter: int) -> bool:
        """Whether to stop; called ten times a second."""
        return await super().on_tick(counter) or self.failed

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop listening, send `drain` to streams, then wait for requests."""
        for server in self.servers:
            server.close()
        self._hub.drain()
        await asyncio.sleep(DRAIN_S)
        await super().shutdown(sockets)


class SharedServer(Server):
    """Server that accepts connections from a socket that other processes share, see :mod:`service.run.acceptor`.

    Parameters
    ----------
    config : uvicorn.Config
    state : ServerState
    loads : Loads
    number : int
        Row of this process.
    """

    def __init__(self, config: uvicorn.Config, state: ServerState, loads: Loads, number: int) -> None:
        super().__init__(config, state.hub)
        self._state, self._loads, self._number = state, loads, number
        self._acceptor: Acceptor | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the app, then accept connections."""
        await super().startup([])
        assert sockets is not None
        self._acceptor = Acceptor(sockets[0], self._loads, self._number, protocol=self._protocol, load=self._load)
        self._hub.channels.on_characters = self._acceptor.write

    def _load(self) -> int:
        """Characters, or connections where these are more, since most streams open characters a little later."""
        if not self._state.ready.is_set() or self._hub.full:
            return NO_ROOM
        return max(self._hub.characters, len(self.server_state.connections))

    def _protocol(self) -> asyncio.Protocol:
        """Protocol of a new connection, as uvicorn makes it."""
        make: Any = self.config.http_protocol_class
        made: asyncio.Protocol = make(self.config, self.server_state, self.lifespan.state)
        return made

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Leave the socket to the other processes, then shut down."""
        if self._acceptor is not None:
            self._acceptor.close()
        await super().shutdown(sockets)
