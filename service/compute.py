"""Thread pool for evaluation: short calls run on the event loop, long ones on a few threads with a bounded queue.

A pose takes some tens of microseconds, and a switch to a thread as much again, so poses stay on the loop. Work of more
than half a millisecond goes to a thread; kernels release the interpreter lock there.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from contextvars import copy_context
from typing import TypeVar, cast

import anyio
import anyio.to_thread

from service.errors import Overloaded

__all__ = ["INLINE_US", "Pool", "run_in_thread"]

INLINE_US = 500.0
"""Longest work that stays on the event loop, µs."""

Result = TypeVar("Result")


async def run_in_thread(work: Callable[[], Result]) -> Result:
    """Run a function in a daemon thread, which does not delay the end of the process as a pool's thread would.

    Compiling kernels takes half a minute on a fresh machine; a server that is stopped meanwhile ends at once.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Result] = loop.create_future()
    context = copy_context()  # log lines of the thread have the id of the request

    def finish(result: Result | None, err: BaseException | None) -> None:
        if done.cancelled():
            return
        if err is not None:
            done.set_exception(err)
        else:
            done.set_result(cast(Result, result))

    def run() -> None:
        result, err = None, None
        try:
            result = context.run(work)
        except BaseException as raised:
            err = raised
        with suppress(RuntimeError):  # the loop has ended meanwhile: nothing awaits the result
            loop.call_soon_threadsafe(finish, result, err)

    threading.Thread(target=run, name="adverb-thread", daemon=True).start()
    return await done


class Pool:
    """Threads for long calls, with a bounded queue.

    Parameters
    ----------
    threads : int
    max_waiting : int
        Longest queue of calls that wait for a thread; further calls are refused.
    """

    def __init__(self, *, threads: int, max_waiting: int) -> None:
        self._threads, self._max_waiting = threads, max_waiting
        self._limiter: anyio.CapacityLimiter | None = None
        self._active = 0

    async def run(self, cost_us: float, work: Callable[[], Result]) -> Result:
        """Run work that takes about ``cost_us``; raises :class:`Overloaded` if the queue is full."""
        if cost_us <= INLINE_US:
            return work()
        if self._active >= self._threads + self._max_waiting:
            raise Overloaded(
                f"{self._max_waiting} long calls wait already", headers={"Retry-After": "1"}, limit=self._max_waiting
            )
        if self._limiter is None:  # belongs to the loop that runs now
            self._limiter = anyio.CapacityLimiter(self._threads)
        self._active += 1
        try:
            return await anyio.to_thread.run_sync(work, limiter=self._limiter)
        finally:
            self._active -= 1
