"""Which process accepts a connection, and the loop that accepts it."""

import asyncio
import errno
import os
import signal
import socket
import time

import pytest

from service.run import acceptor
from service.run.acceptor import Acceptor
from service.run.loads import NO_ROOM, STALE_S, Loads
from tests.service.stream.conftest import PATIENCE_S, eventually


def accepting(*rows):
    """Which of the processes with these loads may accept."""
    loads = Loads(len(rows))
    for number, load in enumerate(rows):
        if load is not None:
            loads.write(number, load)
    return [number for number, load in enumerate(rows) if load is not None and loads.accepts(number)]


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([0, 0], [0, 1]),
        ([4, 0], [0, 1]),
        ([5, 0], [1]),
        ([200, 1, 3], [1, 2]),
        ([160, 174, 175], [0, 1]),  # 4 and a sixteenth more than the least
        ([5, None], [0]),
        ([None, None, 900], [2]),
        ([NO_ROOM, 1_000], [1]),
        ([NO_ROOM, None], [0]),
        ([NO_ROOM, NO_ROOM], [0, 1]),
        ([NO_ROOM + 5, None], [0]),
    ],
)
def test_the_processes_with_the_least_load_accept(rows, expected):
    assert accepting(*rows) == expected


def test_a_process_that_is_cleared_or_late_does_not_count(monkeypatch):
    loads = Loads(3)
    for number, load in enumerate((7, 1, 2)):
        loads.write(number, load)
    loads.clear(1)
    assert not loads.accepts(0)
    loads.clear(2)
    assert loads.accepts(0)
    loads.write(2, 2)
    now_ns = time.monotonic_ns()
    monkeypatch.setattr("service.run.loads.time.monotonic_ns", lambda: now_ns + int((STALE_S + 0.1) * 1e9))
    assert loads.accepts(0)
    loads.write(2, 2)
    assert not loads.accepts(0)


def test_a_forked_process_shares_the_rows():
    loads = Loads(2)
    loads.write(0, 9)
    child = os.fork()
    if child == 0:
        loads.write(1, 3)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert not loads.accepts(0)


class Recording(Loads):
    """Loads that record what an acceptor was allowed."""

    def __init__(self, count):
        super().__init__(count)
        self.seen = []

    def accepts(self, number):
        allowed = super().accepts(number)
        self.seen.append(allowed)
        return allowed


class Greeting(asyncio.Protocol):
    """Sends a byte."""

    def connection_made(self, transport):
        transport.write(b"x")


class Exhausted(socket.socket):
    """A listening socket that fails once, as without free file descriptors."""

    failed = False

    def accept(self):
        if not self.failed:
            self.failed = True
            raise OSError(errno.EMFILE, "too many open files")
        return super().accept()


async def greeted(address) -> bytes:
    reader, writer = await asyncio.open_connection(*address)
    try:
        return await asyncio.wait_for(reader.readexactly(1), PATIENCE_S)
    finally:
        writer.close()


def test_a_connection_is_left_to_the_process_with_less_load():
    async def run():
        loads = Recording(2)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            one = Acceptor(listener, loads, 0, protocol=Greeting, load=lambda: 10)
            loads.write(1, 0)
            waiting = asyncio.create_task(greeted(listener.getsockname()))
            await eventually(lambda: loads.seen)
            loads.clear(1)
            assert await waiting == b"x"
            assert loads.seen[0] is False
            assert loads.seen.index(True) == len(loads.seen) - 1
            one.close()
            loads.write(1, 2**20)
            assert loads.accepts(1)  # the closed one does not count

    asyncio.run(run())


def test_a_process_without_free_descriptors_leaves_connections_to_others(monkeypatch):
    monkeypatch.setattr(acceptor, "RETRY_S", 0.05)

    async def run():
        loads = Loads(2)
        with Exhausted() as listener:
            listener.bind(("127.0.0.1", 0))
            one = Acceptor(listener, loads, 0, protocol=Greeting, load=lambda: 0)
            waiting = asyncio.create_task(greeted(listener.getsockname()))
            await eventually(lambda: listener.failed)
            one.write()  # by the engine, meanwhile
            loads.write(1, 100)
            assert loads.accepts(1)
            loads.clear(1)
            assert await waiting == b"x"
            one.close()

    asyncio.run(run())
