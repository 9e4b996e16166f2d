"""The server's side of building: a warm process waits, does one upload, and is replaced."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
import structlog

from service.errors import BadUpload, Overloaded

__all__ = ["Builder", "Made"]

FIRST_S = 5.0
"""Time for whoever waited for the server, before a process for uploads is warmed."""

LONGEST_S = 120.0
LONGEST_START_S = 180.0
MAX_ANSWER_BYTES = 4 * 1024 * 1024
MAX_WAITING = 8

log = structlog.get_logger("adverb.building")


@dataclass(frozen=True, slots=True)
class Made:
    """A verb that came out of an upload."""

    verb: str
    quality: Mapping[str, Any]
    warnings: tuple[str, ...]


class Builder:
    """Builds and checks uploads, one at a time, each in a process of its own."""

    def __init__(self) -> None:
        self._turn, self._waiting = asyncio.Lock(), 0
        self._spare: asyncio.subprocess.Process | None = None
        self._taken = asyncio.Event()

    async def run(self) -> None:
        """Have a warm process ready for ever; it ends with this."""
        try:
            await asyncio.sleep(FIRST_S)
            while True:
                self._taken.clear()
                async with self._turn:
                    await self.prepare()
                await self._taken.wait()
        finally:
            await self.close()

    async def prepare(self) -> None:
        """Have a warm process ready; it takes some seconds."""
        if self._spare is None or self._spare.returncode is not None:
            self._spare = await self._start()

    async def make(self, upload: Path, result: Path) -> Made:
        """Build a zip of a verb source, or check an artifact; the verb is written to ``result``.

        Raises
        ------
        BadUpload
            It is no verb; the detail says why.
        Overloaded
            Too many others wait.
        """
        if self._waiting >= MAX_WAITING:
            raise Overloaded(f"{MAX_WAITING} uploads wait already", headers={"Retry-After": "5"})
        self._waiting += 1
        try:
            async with self._turn:
                await self.prepare()
                process, self._spare = self._spare, None
                self._taken.set()
                assert process is not None  # it was prepared
                answer = await self._ask(process, {"upload": str(upload), "result": str(result)})
        finally:
            self._waiting -= 1
        if "error" in answer:
            raise BadUpload(str(answer["error"]))
        return Made(str(answer["verb"]), answer["quality"], tuple(answer["warnings"]))

    async def close(self) -> None:
        """End the process that waits."""
        if self._spare is not None and self._spare.returncode is None:
            self._spare.kill()
            await self._spare.wait()

    async def _start(self) -> asyncio.subprocess.Process:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "service.upload.sandbox"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            limit=MAX_ANSWER_BYTES,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        try:
            answer = await self._read(process, LONGEST_START_S)
        except BaseException:  # cancelled: nobody has it yet
            process.kill()
            await process.wait()
            raise
        if not answer.get("ready"):
            raise BadUpload("the process that reads uploads did not start; the server's log says more")
        return process

    async def _ask(self, process: asyncio.subprocess.Process, job: dict[str, str]) -> dict[str, Any]:
        assert process.stdin is not None  # it was started with one
        try:
            process.stdin.write(orjson.dumps(job) + b"\n")
            await process.stdin.drain()
            return await self._read(process, LONGEST_S)
        except (BrokenPipeError, ConnectionResetError):
            return {"error": "reading it broke the process that reads uploads"}
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()

    async def _read(self, process: asyncio.subprocess.Process, longest_s: float) -> dict[str, Any]:
        """One line of JSON; what stands for it where none comes."""
        assert process.stdout is not None  # it was started with one
        try:
            async with asyncio.timeout(longest_s):
                line = await process.stdout.readline()
            answer: dict[str, Any] = orjson.loads(line)
            return answer
        except TimeoutError:
            process.kill()
            return {"error": f"it takes longer than {longest_s:g} s"}
        except (orjson.JSONDecodeError, ValueError):
            code = await process.wait()
            log.warning("the process that reads uploads died", code=code)
            return {"error": "reading it takes more memory or time than an upload may, or broke the process that does"}
