"""The engine: one thread that handles commands in order, prepares ticks ahead of time, and sends them when due.

The event loop hands it commands and never waits for it. Commands are handled between two ticks: while a prepared tick
waits to be sent, they wait too, so that no message overtakes the records that it concerns.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import anyio
import structlog

__all__ = ["Engine", "Work"]

COMMANDS_S = 0.004
"""Time for commands between two ticks, seconds; the others come after the next tick."""

JOIN_S = 10.0

log = structlog.get_logger("adverb.stream")


class Work(Protocol):
    """What the engine does; all of it in its thread."""

    def start_s(self) -> float | None:
        """When the preparation of the next tick has to start, on the monotonic clock; None without channels."""

    def prepare(self) -> Any:
        """Prepare the next tick; it has ``due_s``."""

    def send(self, prepared: Any) -> None:
        """Send a prepared tick."""

    def idle(self, now_s: float) -> float:
        """Do what is due from time to time, and send what waits; return the seconds until it is called again."""


class Engine:
    """The thread of all streams of a server process.

    Parameters
    ----------
    work : Work
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._commands: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._wake, self._stopping = threading.Event(), False

    def post(self, command: Callable[..., None], *arguments: Any, wake: bool = True) -> None:
        """Hand over a command; without ``wake`` it is handled with the next tick or soon after."""
        self._commands.append((command, arguments))
        if wake:
            self._wake.set()

    async def run(self) -> None:
        """Run the thread until cancelled; raises what it raised."""
        failed: list[BaseException] = []
        ended = anyio.Event()
        token = anyio.lowlevel.current_token()

        def work() -> None:
            try:
                while not self._stopping:
                    self.turn()
            except BaseException as err:
                failed.append(err)
                anyio.from_thread.run_sync(ended.set, token=token)

        thread = threading.Thread(target=work, name="adverb-engine", daemon=True)
        self._stopping = False
        thread.start()
        try:
            await ended.wait()
            raise failed[0]
        finally:
            self._stopping = True
            self._wake.set()
            with anyio.CancelScope(shield=True):
                await anyio.to_thread.run_sync(thread.join, JOIN_S)

    def turn(self) -> None:
        """Handle commands, then prepare and send a tick if its time has come, else wait."""
        self._wake.clear()
        self.handle(COMMANDS_S)
        now_s = time.monotonic()
        longest_s = self._work.idle(now_s)
        start_s = self._work.start_s()
        if start_s is not None and start_s <= now_s:
            prepared = self._work.prepare()
            if (left_s := prepared.due_s - time.monotonic()) > 0:
                time.sleep(left_s)
            self._work.send(prepared)
        elif not self._commands:
            self._wake.wait(longest_s if start_s is None else min(start_s - now_s, longest_s))

    def handle(self, seconds: float) -> None:
        """Handle commands for so long; a command that fails is logged and has no other effect."""
        end_s = time.monotonic() + seconds
        while self._commands:
            command, arguments = self._commands.popleft()
            try:
                command(*arguments)
            except Exception:
                log.exception("stream command failed", command=getattr(command, "__name__", "?"))
            if time.monotonic() > end_s:
                return
