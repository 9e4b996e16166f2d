"""Sandboxes that a server without a parent starts as new programs; one is started ahead, because it takes seconds."""

from __future__ import annotations

import asyncio
import os
import sys

import orjson
import structlog

from service.errors import BadUpload
from service.upload.builder import MAX_ANSWER_BYTES
from service.upload.sandbox import Job

__all__ = ["Spawned"]

LONGEST_START_S = 180.0
"""Longest time until a sandbox has loaded what it needs; kernels may have to be compiled first."""

log = structlog.get_logger("adverb.building")


class Spawned:
    """Sandboxes as programs of their own, each for one job."""

    def __init__(self) -> None:
        self._spare: asyncio.subprocess.Process | None = None

    async def prepare(self) -> None:
        """Start a sandbox ahead, if there is none; raises :class:`BadUpload` where it does not start."""
        if self._spare is None or self._spare.returncode is not None:
            self._spare = await _started()

    async def work(self, job: Job) -> bytes:
        """Run a job in the sandbox that was started ahead, and return the line that it answers.

        Empty where the sandbox dies before it answers. Where this is cancelled, the sandbox is killed.
        """
        process, self._spare = self._spare, None
        assert process is not None  # it was prepared
        assert process.stdin is not None  # it was started with pipes
        assert process.stdout is not None
        line = b""
        try:
            process.stdin.write(orjson.dumps(job) + b"\n")
            await process.stdin.drain()
            line = await process.stdout.readline()
        except ConnectionError:
            pass
        finally:
            await _kill(process)
        if not line:
            log.warning("sandbox died", code=process.returncode)
        return line

    async def close(self) -> None:
        """End the sandbox that was started ahead."""
        if self._spare is not None:
            await _kill(self._spare)


async def _started() -> asyncio.subprocess.Process:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "service.upload.sandbox"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        limit=MAX_ANSWER_BYTES,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    line = b""
    try:
        async with asyncio.timeout(LONGEST_START_S):
            line = await process.stdout.readline()
    except TimeoutError:
        pass
    finally:
        if not line:  # also where this is cancelled: nothing else refers to the process
            await _kill(process)
    if not line:
        raise BadUpload("the process that reads uploads did not start; see the server's log")
    return process


async def _kill(process: asyncio.subprocess.Process) -> None:
    """Kill a process that may have ended, and wait for its end."""
    if process.returncode is None:
        process.kill()
    await process.wait()
