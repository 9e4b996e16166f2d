"""Accepts connections from a socket that several server processes share, while no other process has much less load.

uvloop's own server accepts all connections that wait, one after another. This one accepts one at a time.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import structlog

from service.run.loads import REFRESH_S, Loads

__all__ = ["Acceptor"]

BACKLOG = 2_048
"""Connections that may wait in the kernel, as with uvicorn."""

PAUSE_S = 0.002
"""How long a process leaves a connection to the others, seconds."""

RETRY_S = 1.0
"""Pause after an error such as too many open files, seconds."""

log = structlog.get_logger("adverb.server")


class Acceptor:
    """Accepts connections in the running event loop until it is closed.

    Parameters
    ----------
    listener : socket
        Bound socket that the processes share; it is not closed here.
    loads : Loads
    number : int
        Row of this process.
    protocol : callable
        Makes the protocol of a connection.
    load : callable
        Load of this process, without connections that are being accepted.
    """

    def __init__(
        self,
        listener: socket.socket,
        loads: Loads,
        number: int,
        *,
        protocol: Callable[[], asyncio.Protocol],
        load: Callable[[], int],
    ) -> None:
        self._listener, self._loads, self._number = listener, loads, number
        self._protocol, self._load = protocol, load
        self._loop = asyncio.get_running_loop()
        self._starting: set[asyncio.Task[None]] = set()
        self._paused: asyncio.TimerHandle | None = None
        listener.setblocking(False)
        listener.listen(BACKLOG)
        self._watch()
        self._refresh()

    def close(self) -> None:
        """Accept no more, so that the others do."""
        self._leave()
        self._refreshed.cancel()
        if self._paused is not None:
            self._paused.cancel()

    def write(self) -> None:
        """Write the load of this process; other threads may call it too."""
        if self._counted:
            self._loads.write(self._number, self._load() + len(self._starting))

    def _refresh(self) -> None:
        self.write()
        self._refreshed = self._loop.call_later(REFRESH_S, self._refresh)

    def _watch(self) -> None:
        self._paused, self._counted = None, True
        self._loop.add_reader(self._listener, self._readable)

    def _leave(self) -> None:
        self._counted = False
        self._loop.remove_reader(self._listener)
        self._loads.clear(self._number)

    def _readable(self) -> None:
        """Accept one connection, or leave it to the others for a while."""
        self.write()
        if not self._loads.accepts(self._number):
            self._loop.remove_reader(self._listener)
            self._paused = self._loop.call_later(PAUSE_S, self._watch)
            return
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return  # another process was faster, or the client has left
        except OSError as err:
            log.warning("no connection can be accepted; trying again", problem=str(err), pause_s=RETRY_S)
            self._leave()
            self._paused = self._loop.call_later(RETRY_S, self._watch)
            return
        task = self._loop.create_task(self._start(connection))
        self._starting.add(task)
        task.add_done_callback(self._starting.discard)
        self.write()

    async def _start(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        try:
            await self._loop.connect_accepted_socket(self._protocol, connection)
        except OSError:  # the client has left
            connection.close()
