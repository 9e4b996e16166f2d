"""Node with the built package, and a proxy between it and a server."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[3]
PACKAGE = PROJECT / "clients" / "typescript"
BUILT = PACKAGE / "dist" / "index.js"
NODE = shutil.which("node")
FOLDER = Path(__file__).parent
PATIENCE_S = 60.0


def missing() -> str:
    """Why the package cannot be run; empty if it can."""
    if NODE is None:
        return "Node is not installed"
    if not BUILT.is_file():
        return "the TypeScript client is not built: npm --prefix clients/typescript run build"
    text = subprocess.run([NODE, "--version"], capture_output=True, text=True, check=True).stdout
    major, minor = map(int, text.removeprefix("v").split(".")[:2])
    return "" if (major, minor) >= (20, 16) else "Node is older than 20.16"


def environment() -> dict[str, str]:
    return {**os.environ, "ADVERB_CLIENT": BUILT.as_uri()}


def run(script: str, *arguments: str) -> Any:
    """Output of a script, which prints JSON."""
    assert NODE is not None
    command = [NODE, str(FOLDER / script), *arguments]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Driver:
    """The program ``driver.mjs``."""

    def __init__(self, server: str, verb: str = "arm3", **settings: Any) -> None:
        assert NODE is not None
        arguments = json.dumps({"server": server, "verb": verb, **settings})
        self.rows: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.process = subprocess.Popen(
            [NODE, str(FOLDER / "driver.mjs"), arguments],
            env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Driver:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(BrokenPipeError):
                pipe.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.rows.put(json.loads(line))
        self.rows.put(None)

    def send(self, command: str, **fields: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"command": command, **fields}) + "\n")
        self.process.stdin.flush()

    def until(self, event: str, holds: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """The next event of a name for which a condition holds; others before it are skipped."""
        end, last = time.monotonic() + PATIENCE_S, None
        while (left := end - time.monotonic()) > 0:
            try:
                row = self.rows.get(timeout=left)
            except queue.Empty:
                break
            assert row is not None, f"the program ended before '{event}'; its last event was {last}"
            if row["event"] == event and holds(row):
                return row
            last = row
        raise AssertionError(f"no '{event}' in time; the last event was {last}")

    def discard(self) -> None:
        """Skip the events so far."""
        with suppress(queue.Empty):
            while True:
                self.rows.get_nowait()


class Proxy:
    """A proxy on loopback whose connections can be slow, stall or break.

    Attributes
    ----------
    delay_s : callable
        Delay of the next part of a connection, seconds.
    """

    def __init__(self, port: int) -> None:
        self.target, self.delay_s = port, lambda: 0.0
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
