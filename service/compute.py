"""Where evaluation runs: short work on the event loop, long work on a few threads with a bounded queue.

A pose takes some tens of microseconds and a hop to a thread as much again, so poses stay on the loop. What would
hold it up for longer than half a millisecond goes to a thread; kernels there run without the interpreter lock.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar, cast

import anyio
import anyio.to_thread

from service.errors import Overloaded

__all__ = ["INLINE_US", "Pool", "aside"]

INLINE_US = 500.0
"""Longest work that stays on the event loop, µs."""

Result = TypeVar("Result")


async def aside(work: Callable[[], Result]) -> Result:
    """Do work in a thread that the process does not wait for when it ends, as it would for those of a pool.

    Compiling kernels takes half a minute on a fresh machine, and whoever stops the server then means it.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Result] = loop.create_future()

    def tell(result: Result | None, err: BaseException | None) -> None:
        if done.cancelled():
            return
        if err is not None:
            done.set_exception(err)
        else:
            done.set_result(cast(Result, result))

    def run() -> None:
        result, err = None, None
        try:
            result = work()
        except BaseException as raised:
            err = raised
        with suppress(RuntimeError):  # the loop has ended meanwhile: nobody waits any more
            loop.call_soon_threadsafe(tell, result, err)

    threading.Thread(target=run, name="aside", daemon=True).start()
    return await done


class Pool:
    """Threads for long calls.

    Parameters
    ----------
    threads : int
    max_waiting : int
        Calls that may wait for a thread; the next one is refused.
    """

    def __init__(self, *, threads: int, max_waiting: int) -> None:
        self._threads, self._max_waiting = threads, max_waiting
        self._limiter: anyio.CapacityLimiter | None = None
        self._present = 0

    async def run(self, cost_us: float, work: Callable[[], Result]) -> Result:
        """Do work that takes about ``cost_us``; raises :class:`Overloaded` where too many wait."""
        if cost_us <= INLINE_US:
            return work()
        if self._present >= self._threads + self._max_waiting:
            raise Overloaded(
                f"{self._max_waiting} long calls wait already", headers={"Retry-After": "1"}, limit=self._max_waiting
            )
        if self._limiter is None:  # belongs to the loop that runs now
            self._limiter = anyio.CapacityLimiter(self._threads)
        self._present += 1
        try:
            return await anyio.to_thread.run_sync(work, limiter=self._limiter)
        finally:
            self._present -= 1
