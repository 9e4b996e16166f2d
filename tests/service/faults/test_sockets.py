"""Sockets: many half-open ones, no file descriptor left, two servers on one port."""

import os
import resource
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest

from service import cli
from tests.service.run.test_supervisor import LONGEST_S, Running, until
from tests.warm import children, status

POSE = {"adverbs": {"x": 0.4, "y": 0.3}}
HALF_OPEN = 2_000
FEW_FILES = 128


@pytest.fixture
def start(warm, tmp_path):
    """Start servers; their processes end with the test."""
    with ExitStack() as stack:

        def begin(**options) -> Running:
            data = tmp_path / "data"
            data.mkdir()
            running = Running(warm, data, **options)
            stack.callback(running.process.end)
            return running

        yield begin


def files_of(server: int) -> int:
    return len(os.listdir(f"/proc/{server}/fd"))


def posed(running: Running, **options) -> int:
    return httpx.post(f"{running.base}/v1/verbs/arm3/pose", json=POSE, timeout=LONGEST_S, **options).status_code


@contextmanager
def dialling(port: int, count: int):
    """Another process with many connections."""
    command = [sys.executable, str(Path(__file__).with_name("dialler.py")), str(port), str(count)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_thousands_of_half_open_sockets_are_closed_and_disturb_no_request(start, record_property):
    running = start(ADVERB_REQUEST_S="3").wait()
    assert posed(running) == 200
    (server,) = children(running.process.pid, "adverb-server")
    before = files_of(server)
    with dialling(int(running.base.rpartition(":")[2]), HALF_OPEN) as process, httpx.Client() as client:
        assert process.stdout.readline() == "open\n"
        until(lambda: files_of(server) > before + HALF_OPEN - 100)
        for _ in range(20):  # on one connection, and each on its own
            assert client.post(f"{running.base}/v1/verbs/arm3/pose", json=POSE, timeout=5.0).status_code == 200
            assert posed(running) == 200
        assert int(process.stdout.readline()) == HALF_OPEN
        assert process.wait(LONGEST_S) == 0
    until(lambda: files_of(server) <= before)
    assert posed(running) == 200
    record_property("half-open sockets", HALF_OPEN)


def few_files() -> None:
    """`adverb serve` that may open few files."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (FEW_FILES, FEW_FILES))
    cli.main()


@pytest.mark.parametrize("workers", [1, 2])
def test_servers_without_file_descriptors_answer_on_open_connections_and_recover(start, workers):
    running = start(workers=workers, target=f"{__name__}:few_files", ADVERB_REQUEST_S="60").wait()
    address = ("127.0.0.1", int(running.base.rpartition(":")[2]))
    servers = children(running.process.pid, "adverb-server")
    with httpx.Client(timeout=LONGEST_S) as client, ExitStack() as stack:
        assert client.post(f"{running.base}/v1/verbs/arm3/pose", json=POSE).status_code == 200
        for _ in range(2 * workers * FEW_FILES):  # further ones wait in the kernel, or are closed
            stack.enter_context(socket.create_connection(address, LONGEST_S))
        until(lambda: all(files_of(server) > FEW_FILES - 5 for server in servers))
        began_s, used_s = time.monotonic(), processor_s(servers)
        while time.monotonic() - began_s < 1.0:
            assert client.post(f"{running.base}/v1/verbs/arm3/pose", json=POSE).status_code == 200
            time.sleep(0.02)
        assert processor_s(servers) - used_s < 0.5 * workers  # it does not try without a pause
        ready = client.get(f"{running.base}/readyz").json()
        assert (ready["ready"], ready["skipped"]) == (True, [])
        stack.close()
        assert posed(running) == 200  # the sockets are closed: the server accepts again
    assert children(running.process.pid, "adverb-server") == servers  # none was restarted


def processor_s(processes) -> float:
    """Processor time of processes so far, seconds."""
    ticks = sum(sum(map(int, status(process)[11:13])) for process in processes)
    return ticks / os.sysconf("SC_CLK_TCK")
