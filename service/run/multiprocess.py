"""Several server processes on one port, as one server: started, watched, started again where they die, ended together.

uvicorn's own supervisor is not used: it starts a plain ``uvicorn.Server``, without our goodbyes to streams, starts the
dead again without a pause, and does not say when all are ready. Here a process is the same as a single server, with
three differences: its port is shared, its metrics lie in files, and workers that refine are the parent's.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import structlog

from service.run import logs
from service.run.listener import CannotServe, Patience, check, greeting, listen
from service.run.supervisor import FIRST_PAUSE_S, LONGEST_PAUSE_S, SOUND_S, supervise
from service.settings import Settings

__all__ = ["main", "serve"]

METRICS = "PROMETHEUS_MULTIPROC_DIR"
"""Environment variable by which the metrics library learns of the folder that processes share."""

LAST_WORDS_S = 5.0
"""How much longer than ``shutdown_s`` a process may take to end before it is ended."""

log = structlog.get_logger("adverb.processes")


def serve(settings: Settings, *, say: Callable[[str], None]) -> None:
    """Serve with ``settings.workers`` processes until SIGTERM or SIGINT.

    Parameters
    ----------
    settings : Settings
    say : callable
        Told which files cannot be used and where the server is, when every process is ready; before that, now and then,
        that it takes long.

    Raises
    ------
    CannotServe
        Before anything is served.
    """
    if not sys.platform.startswith("linux"):
        raise CannotServe("only Linux spreads connections over processes that share a port; use --workers 1")
    check(settings)
    with listen(settings) as placeholder, TemporaryDirectory(prefix="adverb-metrics-") as metrics:
        # Nobody else may take the port, and ours may share it. It does not listen, so no connection comes here.
        placeholder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        logs.configure(settings)
        patience = Patience(say)
        try:
            asyncio.run(_Server(settings, placeholder, Path(metrics), patience.say).run())
        finally:
            patience.end()


class _Server:
    """The parent: it serves nothing itself, and loads nothing that serving needs.

    Parameters
    ----------
    settings : Settings
    placeholder : socket
        Bound to the port.
    metrics : Path
        Empty folder for the processes' metrics.
    say : callable
    """

    def __init__(
        self, settings: Settings, placeholder: socket.socket, metrics: Path, say: Callable[[str], None]
    ) -> None:
        own = {"port": placeholder.getsockname()[1], "refiners": 0}
        self._environment = settings.model_copy(update=own).environment() | {METRICS: str(metrics)}
        self._settings, self._placeholder, self._metrics, self._say = settings, placeholder, metrics, say
        self._first, self._facts = asyncio.Event(), dict[str, Any]()
        self._unready = set(range(settings.workers))

    async def run(self) -> None:
        """Keep everything running until a signal comes, then end it; raises :class:`CannotServe`."""
        keeping = asyncio.create_task(self._keep_all())
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, lambda: keeping.cancelling() or keeping.cancel())
        try:
            await keeping
        except asyncio.CancelledError:
            log.info("ended")
        except ExceptionGroup as group:
            raise group.exceptions[0] from None

    async def _keep_all(self) -> None:
        """Start one process alone, for it publishes the files of the data folder; then all others."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._keep(0))
            await self._first.wait()
            for slot in range(1, self._settings.workers):
                group.create_task(self._keep(slot))
            if self._settings.data is not None:
                group.create_task(supervise(self._settings))

    async def _keep(self, slot: int) -> None:
        """Start a process, and again where it dies, with pauses that grow while it does not live for long."""
        pause_s = FIRST_PAUSE_S
        while True:
            started = time.monotonic()
            process = await self._start(slot)
            try:
                await self._watch(slot, process)
            except asyncio.CancelledError:
                await _end(process, self._settings.shutdown_s + LAST_WORDS_S)
                raise
            finally:
                self._bury(slot)
            if not self._first.is_set():
                raise CannotServe(f"a server process ended (code {process.returncode}) before it was ready; see above")
            if time.monotonic() - started > SOUND_S:
                pause_s = FIRST_PAUSE_S
            log.warning("server died; starting another", process=slot, code=process.returncode, pause_s=pause_s)
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    async def _start(self, slot: int) -> asyncio.subprocess.Process:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "service.run.multiprocess", str(slot)),
            stdin=asyncio.subprocess.PIPE,  # it ends when this closes, however the parent ended
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, **self._environment},
            start_new_session=True,  # a terminal's Ctrl-C is the parent's
        )
        self._metrics.joinpath(f"{slot}.pid").write_text(str(process.pid), encoding="ascii")
        log.info("server started", process=slot, pid=process.pid)
        return process

    async def _watch(self, slot: int, process: asyncio.subprocess.Process) -> None:
        """Take note when a process is ready, and wait until it ends."""
        assert process.stdout is not None
        line = await process.stdout.readline()
        if line:
            self._ready(slot, json.loads(line))
        await process.wait()

    def _ready(self, slot: int, facts: dict[str, Any]) -> None:
        """Take note that a process is ready; say so when all are for the first time."""
        if not self._first.is_set():
            self._facts = facts
            self._first.set()
        starting = bool(self._unready)
        self._unready.discard(slot)
        if starting and not self._unready:
            for line in greeting(self._placeholder, **self._facts, processes=self._settings.workers):
                self._say(line)

    def _bury(self, slot: int) -> None:
        """Forget the live numbers of a process that ended; what it counted stays."""
        from prometheus_client.multiprocess import mark_process_dead

        self._metrics.joinpath(f"{slot}.pid").unlink(missing_ok=True)
        mark_process_dead(slot, str(self._metrics))  # type: ignore[no-untyped-call]


async def _end(process: asyncio.subprocess.Process, patience_s: float) -> None:
    """Ask a process to stop; end it where it does not."""
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), patience_s)
    except TimeoutError:
        log.warning("server does not end; ending it", pid=process.pid)
        process.kill()
        await process.wait()


def main() -> None:
    """Serve as one of several processes: ``python -m service.run.multiprocess SLOT``, started by :func:`serve`."""
    slot = sys.argv[1]
    from prometheus_client import values

    # A slot's next process goes on from its counters, so that there are never more files than processes.
    values.ValueClass = values.MultiProcessValue(partial(int, slot))  # type: ignore[no-untyped-call]
    from service.catalog.catalog import Catalog
    from service.run import server

    def ready(catalog: Catalog) -> None:
        facts = {"verbs": len(catalog.entries), "skipped": [(row.file, row.problem) for row in catalog.skipped]}
        os.write(sys.stdout.fileno(), json.dumps(facts).encode() + b"\n")

    settings = Settings()
    logs.configure(settings)
    threading.Thread(target=_end_with_parent, name="adverb-parent", daemon=True).start()
    try:
        server.run(settings, listen(settings, shared=True), on_ready=ready)
    except CannotServe as err:
        sys.exit(f"error: process {slot}: {err}")


def _end_with_parent() -> None:
    """Wait until the parent is gone, then stop as if asked to."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
