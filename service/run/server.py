"""One server process: a socket, uvicorn with the settings that were measured best, a clean end."""

from __future__ import annotations

import asyncio
import gc
import signal
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.catalog.catalog import Catalog
from service.run import logs
from service.run.listener import CannotServe, Patience, check, greeting, listen
from service.run.supervisor import supervise
from service.settings import Settings
from service.stream.hub import Hub
from service.stream.transport import StreamProtocol

__all__ = ["CannotServe", "Server", "config_of", "run", "serve"]

DRAIN_S = 0.2
"""Time for goodbyes to be written before connections are closed."""

SWITCH_S = 0.001
"""Longest time for which a thread keeps the interpreter while the event loop waits for it; Python's own is 5 ms."""


def serve(settings: Settings, *, say: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT; running requests may finish, for ``shutdown_s`` at most.

    Parameters
    ----------
    settings : Settings
        More than one of ``workers`` is :mod:`service.run.multiprocess`' business.
    say : callable
        Told where the server is, and which files it could not use; before that, now and then, that it takes long.

    Raises
    ------
    CannotServe
        Before anything is served, or as :func:`run` does.
    """
    check(settings)
    listener = listen(settings)
    logs.configure(settings)
    patience = Patience(say)

    def ready(catalog: Catalog) -> None:
        for line in greeting(listener, len(catalog.entries), [(row.file, row.problem) for row in catalog.skipped]):
            patience.say(line)

    try:
        run(settings, listener, on_ready=ready)
    finally:
        patience.end()


def run(settings: Settings, listener: socket.socket, *, on_ready: Callable[[Catalog], None]) -> None:
    """Serve on a socket, which is closed at the end; ``on_ready`` is told the verbs once requests are answered.

    Raises :class:`CannotServe` where loading verbs or following the store fails for good.
    """
    sys.setswitchinterval(SWITCH_S)

    def ready(catalog: Catalog) -> None:
        # What is loaded stays. Looking through all of it for garbage, as Python would, stops everybody for 50 ms.
        gc.collect()
        gc.freeze()
        on_ready(catalog)

    app = create_app(settings, on_ready=ready, supervise=supervise)
    # uvicorn stops on these signals and then raises them once more for whoever handled them before: nobody.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    with listener:
        server = Server(config_of(app, settings), app.state.server.hub)
        server.run(sockets=[listener])
    if server.failed:
        raise CannotServe("verbs cannot be loaded and kept up to date; the log says why")


def config_of(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """The settings of uvicorn that were measured best for this app."""
    return uvicorn.Config(
        app,
        loop="uvloop",
        http="httptools",
        ws=StreamProtocol,
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

    @property
    def failed(self) -> bool:
        """Whether what the app does beside answering has failed, so that it would never be ready, or go stale."""
        return bool(self.lifespan.error_occurred)

    async def on_tick(self, counter: int) -> bool:
        """Whether to stop; looks ten times a second."""
        return await super().on_tick(counter) or self.failed

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop listening, say goodbye, then let requests end."""
        for server in self.servers:
            server.close()
        self._hub.drain()
        await asyncio.sleep(DRAIN_S)
        await super().shutdown(sockets)
