"""Worker processes beside a server: started, watched, started again where they die, ended with it."""

from __future__ import annotations

import asyncio
import os
import platform
import re
import sys
import time
from contextlib import suppress

import structlog

from service.settings import Settings

__all__ = ["name_of", "supervise"]

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
SOUND_S = 60.0
"""A worker that lived so long died of something new: it is started again at once."""

LAST_WORDS_S = 10.0

log = structlog.get_logger("adverb.children")


async def supervise(settings: Settings) -> None:
    """Keep ``settings.refiners`` workers running until cancelled."""
    async with asyncio.TaskGroup() as group:
        for number in range(settings.refiners):
            group.create_task(_keep(settings, name_of(number)))


def name_of(number: int) -> str:
    """Name of a worker beside this process: another one than beside any other server, of any machine."""
    node = re.sub(r"[^A-Za-z0-9-]+", "-", platform.node()).strip("-")[:40]
    return f"{node or 'server'}.{os.getpid()}.{number}"


async def _keep(settings: Settings, name: str) -> None:
    pause_s = FIRST_PAUSE_S
    while True:
        started = time.monotonic()
        process = await _start(settings, name)
        log.info("worker started", worker=name, pid=process.pid)
        try:
            code = await process.wait()
        except asyncio.CancelledError:
            await _end(process)
            raise
        if time.monotonic() - started > SOUND_S:
            pause_s = FIRST_PAUSE_S
        log.warning("worker died; starting another", worker=name, code=code, pause_s=pause_s)
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


async def _start(settings: Settings, name: str) -> asyncio.subprocess.Process:
    command = "from service.cli import main; main()"
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", command, "worker", "--name", name, "--parent", str(os.getpid())),
        stdin=asyncio.subprocess.DEVNULL,
        env={**os.environ, **settings.environment(), "OPENBLAS_NUM_THREADS": "1"},
        start_new_session=True,  # a terminal's Ctrl-C is the server's; the worker is told by the server
    )


async def _end(process: asyncio.subprocess.Process) -> None:
    """Ask a worker to stop; end it where it does not."""
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), LAST_WORDS_S)
    except TimeoutError:
        process.kill()
        await process.wait()
