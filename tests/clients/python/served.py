"""The real server on a real socket, in a thread, with verbs that are loaded already."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from service import packing
from service.app import create_app
from service.catalog.catalog import Catalog
from service.run.server import Server, config_of
from service.settings import Settings


@contextmanager
def serve(catalog: Catalog) -> Iterator[str]:
    """Serve a catalog on a free port; gives the address."""
    settings = Settings()
    app = create_app(settings)

    async def opened() -> None:
        packing.warm()
        app.state.server.set_catalog(catalog)

    app.state.server.run = opened
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        server = Server(config_of(app, settings), app.state.server.hub)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        end = time.monotonic() + 60.0
        while not (server.started and app.state.server.ready.is_set()):
            assert time.monotonic() < end, "the server does not start"
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join(60.0)
