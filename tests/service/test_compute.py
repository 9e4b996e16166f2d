"""Threads of requests are bounded in number and queue; those of the server's own tasks are apart."""

import asyncio
import threading
from contextlib import suppress

import pytest

from service import compute
from service.compute import MAX_QUEUED, THREADS, run_in_own_thread, run_in_thread
from service.errors import Overloaded

PATIENCE_S = 20.0

pytestmark = pytest.mark.anyio


class Gate:
    """Work that runs until it is opened, and the number of calls that run."""

    def __init__(self):
        self.opened, self._changed, self.running, self.most = threading.Event(), threading.Condition(), 0, 0

    def __call__(self):
        with self._changed:
            self.running += 1
            self.most = max(self.most, self.running)
            self._changed.notify_all()
        assert self.opened.wait(PATIENCE_S)
        with self._changed:
            self.running -= 1

    def full(self):
        """Wait until every thread of requests is busy."""
        with self._changed:
            assert self._changed.wait_for(lambda: self.running == THREADS, PATIENCE_S)


@pytest.fixture
def gate():
    made = Gate()
    yield made
    made.opened.set()


async def test_more_requests_than_threads_and_queue_are_refused(gate):
    tasks = [asyncio.create_task(run_in_thread(gate)) for _ in range(THREADS + MAX_QUEUED)]
    await run_in_own_thread(gate.full)
    with pytest.raises(Overloaded, match="wait for the store"):
        await run_in_thread(lambda: None)
    assert await run_in_own_thread(lambda: "apart") == "apart"
    gate.opened.set()
    await asyncio.gather(*tasks)
    assert gate.most == THREADS
    assert await run_in_thread(lambda: "free") == "free"


async def test_a_request_waits_a_limited_time(gate, monkeypatch):
    monkeypatch.setattr(compute, "WAIT_S", 0.05)
    tasks = [asyncio.create_task(run_in_thread(gate)) for _ in range(THREADS)]
    await run_in_own_thread(gate.full)
    with pytest.raises(Overloaded, match="busy"):
        await run_in_thread(lambda: None)
    gate.opened.set()
    await asyncio.gather(*tasks)


async def test_a_cancelled_request_keeps_its_thread_until_the_work_ends(gate, monkeypatch):
    tasks = [asyncio.create_task(run_in_thread(gate)) for _ in range(THREADS)]
    await run_in_own_thread(gate.full)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    with monkeypatch.context() as patched:
        patched.setattr(compute, "WAIT_S", 0.05)
        with pytest.raises(Overloaded):
            await run_in_thread(lambda: None)
    gate.opened.set()
    assert await run_in_thread(lambda: "free") == "free"


async def test_errors_are_raised_and_free_the_thread():
    def fails():
        raise ValueError("wrong")

    for _ in range(2 * THREADS):
        with pytest.raises(ValueError, match="wrong"):
            await run_in_thread(fails)


async def test_a_thread_that_cannot_start_is_free_again(monkeypatch):
    class Refused:
        def __init__(self, **_):
            pass

        def start(self):
            raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(compute.threading, "Thread", Refused)
        for _ in range(2 * THREADS):
            with suppress(RuntimeError):
                await run_in_thread(lambda: None)
    assert await run_in_thread(lambda: "free") == "free"
