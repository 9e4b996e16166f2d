"""Threads: a pool for evaluation, and daemon threads for calls that wait for the database or a disk.

A pose takes some tens of microseconds, and a switch to a thread as much again, so poses stay on the loop. Work of more
than half a millisecond goes to a thread; kernels release the interpreter lock there. Threads and queues are bounded:
requests beyond the limits are answered 503.
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
from anyio.lowlevel import RunVar

from service.errors import Overloaded

__all__ = ["INLINE_US", "MAX_QUEUED", "THREADS", "WAIT_S", "Pool", "run_in_own_thread", "run_in_thread"]

INLINE_US = 500.0
"""Longest work that stays on the event loop, µs."""

THREADS = 4
"""Threads of requests; the store has three connections for them and the tasks of the server."""

MAX_QUEUED = 64
"""Largest number of calls of requests that wait for a thread."""

WAIT_S = 5.0
"""Longest wait of a request for a thread, seconds."""

Result = TypeVar("Result")


class _Turns:
    """Turns of requests on the threads of one event loop."""

    def __init__(self) -> None:
        self._free, self._queued = asyncio.Semaphore(THREADS), 0

    async def take(self) -> None:
        """Wait for a turn; raises :class:`Overloaded` where the queue is full or the wait too long."""
        if self._queued >= MAX_QUEUED:
            raise Overloaded(
                f"{MAX_QUEUED} calls wait for the store already", headers={"Retry-After": "1"}, limit=MAX_QUEUED
            )
        self._queued += 1
        try:
            async with asyncio.timeout(WAIT_S):
                await self._free.acquire()
        except TimeoutError:
            raise Overloaded(f"the store is busy for {WAIT_S:g} s", headers={"Retry-After": "1"}) from None
        finally:
            self._queued -= 1

    def end(self) -> None:
        """End a turn."""
        self._free.release()


_turns: RunVar[_Turns] = RunVar("adverb_turns")


async def run_in_thread(work: Callable[[], Result]) -> Result:
    """Run a function of a request, which may wait for the database or a disk, in one of :data:`THREADS` threads.

    Raises :class:`Overloaded` where :data:`MAX_QUEUED` others wait, or none becomes free within :data:`WAIT_S`. A
    cancelled request keeps its thread until the function returns.
    """
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns()
        _turns.set(turns)
    await turns.take()
    return await _run(work, turns.end)


async def run_in_own_thread(work: Callable[[], Result]) -> Result:
    """Run a function of a task of the server in a thread that requests cannot occupy.

    Only for tasks of which there are few; requests use :func:`run_in_thread`.
    """
    return await _run(work, lambda: None)


async def _run(work: Callable[[], Result], ended: Callable[[], None]) -> Result:
    """Run a function in a daemon thread, which does not delay the end of the process as a pool's thread would.

    Compiling kernels takes half a minute on a fresh machine; a server that is stopped meanwhile ends at once.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Result] = loop.create_future()
    context = copy_context()  # log lines of the thread have the id of the request

    def finish(result: Result | None, err: BaseException | None) -> None:
        ended()
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

    try:
        threading.Thread(target=run, name="adverb-thread", daemon=True).start()
    except BaseException:  # no thread can be started
        ended()
        raise
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
