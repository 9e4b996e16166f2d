"""Refiners beside a server that has no parent process: started as new programs, restarted, ended with it."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress

import structlog

from service.run.restart import Pauses, name_of
from service.settings import Settings

__all__ = ["supervise"]

END_S = 10.0
"""How long a refiner may take to end before it is killed."""

log = structlog.get_logger("adverb.supervisor")


async def supervise(settings: Settings) -> None:
    """Keep ``settings.refiners`` refiners running until cancelled."""
    async with asyncio.TaskGroup() as group:
        for number in range(settings.refiners):
            group.create_task(_keep(settings, name_of(number)))


async def _keep(settings: Settings, name: str) -> None:
    pauses = Pauses()
    while True:
        pauses.started()
        process = await _start(settings, name)
        log.info("worker started", worker=name, pid=process.pid)
        try:
            code = await process.wait()
        except asyncio.CancelledError:
            await _end(process)
            raise
        pause_s = pauses.next_s()
        log.warning("worker died; starting another", worker=name, code=code, pause_s=pause_s)
        await asyncio.sleep(pause_s)


async def _start(settings: Settings, name: str) -> asyncio.subprocess.Process:
    command = "from service.cli import main; main()"
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", command, "worker", "--name", name, "--parent", str(os.getpid())),
        stdin=asyncio.subprocess.DEVNULL,
        env={**os.environ, **settings.environment(), "OPENBLAS_NUM_THREADS": "1"},
        start_new_session=True,  # a terminal's Ctrl-C is for the server, which ends the refiner
    )


async def _end(process: asyncio.subprocess.Process) -> None:
    """Let a refiner end; kill it where it takes too long."""
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), END_S)
    except TimeoutError:
        process.kill()
        await process.wait()
