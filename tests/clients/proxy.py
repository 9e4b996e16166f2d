"""A proxy on loopback between a client and a server, for clients in any language."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress

PATIENCE_S = 60.0


class Proxy:
    """A proxy on loopback whose connections can be slow, stall or break.

    Attributes
    ----------
    delay_s : callable
        Delay of the next part of a connection, seconds.
    """

    def __init__(self, port: int) -> None:
        self.target = port
        self.delay_s: Callable[[], float] = lambda: 0.0
        self.accepting, self.connections = True, 0
        self._pass = asyncio.Event()
        self._pass.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(started,), daemon=True)
        self._thread.start()
        assert started.wait(PATIENCE_S)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def cut(self) -> None:
        """Break all connections."""
        self._call(lambda: [writer.transport.abort() for writer in list(self._writers)])

    def stall(self) -> None:
        """Pass nothing, as a network that loses every packet."""
        self._call(self._pass.clear)

    def resume(self) -> None:
        """Pass what was held back."""
        self._call(self._pass.set)

    def close(self) -> None:
        self.cut()
        self._call(self._loop.stop)
        self._thread.join(PATIENCE_S)

    def _call(self, what: Callable[[], object]) -> None:
        self._loop.call_soon_threadsafe(what)

    def _run(self, started: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(asyncio.start_server(self._accept, "127.0.0.1", 0))
        self.port = server.sockets[0].getsockname()[1]
        started.set()
        self._loop.run_forever()
        server.close()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0))
        self._loop.close()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self.accepting:
            writer.transport.abort()
            return
        self.connections += 1
        there, back = await asyncio.open_connection("127.0.0.1", self.target)
        ways = (self._forward(reader, back), self._forward(there, writer))
        with suppress(OSError, asyncio.CancelledError):
            await asyncio.gather(*ways)

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            while content := await reader.read(4096):
                if delay := self.delay_s():
                    await asyncio.sleep(delay)
                await self._pass.wait()
                writer.write(content)
                await writer.drain()
        except OSError:
            pass  # the other side broke the connection
        finally:
            self._writers.discard(writer)
            writer.close()
