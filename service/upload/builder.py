"""The server's side of building: a queue of uploads, each worked on in a sandbox, a process of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import orjson

from service.errors import BadUpload, DraftNotBuilt, InvalidDraft, Overloaded
from service.store.records import StoreUnavailable
from service.upload.sandbox import Job

__all__ = ["MAX_ANSWER_BYTES", "MAX_UPLOADS", "Builder", "Made", "Sandboxes"]

FIRST_S = 5.0
"""Pause after the server is ready, before a sandbox is started ahead."""

LONGEST_S = 120.0
"""Longest time for one upload, seconds."""

MAX_ANSWER_BYTES = 4 * 1024 * 1024
MAX_UPLOADS = 8
"""Largest number of uploads that are received, wait or are built."""

_KILLED = "reading it takes more memory or time than an upload may, or broke the process that does"


@dataclass(frozen=True, slots=True)
class Made:
    """A verb that was built from an upload."""

    verb: str
    quality: Mapping[str, Any]
    warnings: tuple[str, ...]


class Sandboxes(Protocol):
    """Starts sandboxes: see :mod:`service.upload.forked` and :mod:`service.upload.spawned`."""

    async def prepare(self) -> None:
        """Start a sandbox ahead, where starting takes long."""

    async def work(self, job: Job) -> bytes:
        """Run a job, and return one line of JSON; empty where the sandbox dies. Cancelling kills the sandbox."""

    async def close(self) -> None:
        """End a sandbox that was started ahead."""


class Builder:
    """Builds and checks uploads, one at a time; others wait. Who receives one takes a :meth:`place` for it before.

    Parameters
    ----------
    sandboxes : Sandboxes
    """

    def __init__(self, sandboxes: Sandboxes) -> None:
        self._sandboxes = sandboxes
        self._turn, self._places = asyncio.Lock(), MAX_UPLOADS
        self._taken = asyncio.Event()

    async def run(self) -> None:
        """Keep a sandbox started ahead, until cancelled."""
        try:
            await asyncio.sleep(FIRST_S)
            while True:
                self._taken.clear()
                async with self._turn:
                    await self._sandboxes.prepare()
                await self._taken.wait()
        finally:
            await self._sandboxes.close()

    @contextmanager
    def place(self) -> Iterator[None]:
        """A place for one upload until its files are removed; raises :class:`Overloaded` where none is free."""
        if not self._places:
            raise Overloaded(
                f"{MAX_UPLOADS} uploads are received or built already", headers={"Retry-After": "5"}, limit=MAX_UPLOADS
            )
        self._places -= 1
        try:
            yield
        finally:
            self._places += 1

    async def make(self, upload: Path, result: Path) -> Made:
        """Build a zip of a verb source, or check an artifact; the verb is written to ``result``.

        Raises
        ------
        BadUpload
            It is not a verb; the detail names the problem.
        StoreUnavailable
            The disk is full or read-only.
        """
        answer = await self._run({"upload": str(upload), "result": str(result)})
        return Made(str(answer["verb"]), answer["quality"], tuple(answer["warnings"]))

    async def perform(self, task: str, folder: Path) -> Mapping[str, Any]:
        """Do a task on a draft in a folder, see :mod:`service.upload.drafting.tasks`; return its answer.

        Raises
        ------
        BadUpload, InvalidDraft, DraftNotBuilt
            With the reason.
        StoreUnavailable
            The disk is full or read-only.
        """
        return await self._run({"task": task, "folder": str(folder)})

    async def _run(self, job: Job) -> Mapping[str, Any]:
        """The answer to a job; raises the error that it states."""
        async with self._turn:
            await self._sandboxes.prepare()
            self._taken.set()
            answer = await self._answer(job)
        if "error" not in answer:
            return answer
        match answer.get("kind"):
            case "InvalidDraft":
                raise InvalidDraft(str(answer["error"]), errors=answer["errors"])
            case "NotBuilt":
                raise DraftNotBuilt(str(answer["error"]))
            case "storage":
                raise StoreUnavailable(str(answer["error"]))
        raise BadUpload(str(answer["error"]))

    async def _answer(self, job: Job) -> Mapping[str, Any]:
        """What the sandbox answers; where it does not, an error that stands for it."""
        try:
            async with asyncio.timeout(LONGEST_S):
                line = await self._sandboxes.work(job)
            answer: dict[str, Any] = orjson.loads(line)
        except TimeoutError:
            return {"error": f"it takes longer than {LONGEST_S:g} s"}
        except ValueError:  # no JSON, or too long a line
            return {"error": _KILLED}
        return answer
