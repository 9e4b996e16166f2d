"""Several server processes: a new connection goes to the one with the fewest characters."""

import json
import os
import signal
import socket
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from websockets.sync.client import connect

from service.run.loads import FEW, PART
from tests.service.conftest import ARM
from tests.service.run.test_supervisor import LONGEST_S, Running, open_files, survives, until

pytestmark = [pytest.mark.slow]

ONE, MANY = 1, 200
PAIRS = 8


def owner(running: Running, client: socket.socket) -> int | None:
    """Server process that holds the other end of a connection; None while it waits to be accepted."""
    port = f":{client.getsockname()[1]:04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    inodes = {f"socket:[{row[9]}]" for row in rows if row[2].endswith(port)}
    alive = [pid for pid in running.pids() if Path(f"/proc/{pid}").exists()]
    return next((pid for pid in alive if inodes & set(open_files(pid).values())), None)


class Streams:
    """Streams and their characters, by process."""

    def __init__(self, running: Running, closing: ExitStack) -> None:
        self.running, self.all, self.closing = running, [], closing

    def add(self, characters: int) -> int:
        """Connect, open characters, and return the process that has them."""
        url = self.running.base.replace("http", "ws") + "/v1/stream"
        stream = self.closing.enter_context(connect(url, subprotocols=["adverb.v1"], compression=None))
        for channel in range(characters):
            request = {"op": "open", "channel": channel, "verb": "arm3", "adverbs": ARM, "fps": 1, "method": "rbf"}
            stream.send(json.dumps(request))
        opened = 0
        while opened < characters:
            message = stream.recv(timeout=LONGEST_S)
            opened += isinstance(message, str) and json.loads(message)["op"] == "opened"
        found = owner(self.running, stream.socket)
        assert found is not None
        self.all.append((stream, found, characters))
        return found

    def sums(self) -> Counter[int]:
        """Characters of each process."""
        sums: Counter[int] = Counter()
        for _, process, characters in self.all:
            sums[process] += characters
        return sums


@pytest.fixture
def streams(warm, tmp_path):
    """Streams of two server processes, which end before the streams are closed."""
    with ExitStack() as closing:
        running = Running(warm, tmp_path, workers=2)
        closing.callback(running.process.end)
        yield Streams(running.wait(), closing)
        running.process.end()


def test_characters_are_balanced_and_a_restarted_process_catches_up(streams):
    """Sockets with 1 and 200 characters alternate: balanced by number, one process would have all large ones."""
    running = streams.running
    for _ in range(PAIRS):
        streams.add(ONE)
        streams.add(MANY)
    low, high = sorted(streams.sums()[pid] for pid in running.pids())
    assert high - low <= MANY + FEW + low // PART, streams.sums()

    killed, other = running.pids()
    os.kill(killed, signal.SIGKILL)
    until(lambda: len(running.pids()) == 3)
    successor = running.pids()[2]
    streams.all = [row for row in streams.all if row[1] == other]
    assert all(survives(stream) for stream, _, _ in streams.all)
    until(lambda: streams.add(ONE) == successor)  # it has loaded its verbs
    while streams.sums()[successor] + MANY <= streams.sums()[other]:
        assert streams.add(MANY) == successor
    assert streams.sums()[successor] >= MANY


def test_connections_do_not_wait_for_a_process_that_is_busy(streams):
    running = streams.running
    holder = streams.add(MANY)
    idle = next(pid for pid in running.pids() if pid != holder)
    os.kill(idle, signal.SIGSTOP)
    try:
        for _ in range(3):
            answer = httpx.post(f"{running.base}/v1/verbs/arm3/pose", json={"adverbs": ARM}, timeout=LONGEST_S)
            assert answer.status_code == 200
    finally:
        os.kill(idle, signal.SIGCONT)
    until(lambda: streams.add(ONE) == idle)
