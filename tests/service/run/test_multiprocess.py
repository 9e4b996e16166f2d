"""`adverb serve --workers 2`: two real processes on one port, which count together and end together."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.service.conftest import ARM
from tests.service.run.test_server import START, Lines, refused

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("processes")]

PATIENCE_S = 120.0
STREAMS = 12


class Running:
    """A server of two processes, and the lines that it logs."""

    def __init__(self, data: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", START, "serve", "--workers", "2", "--port", "0", "--data", str(data), "--log-json"],
            stderr=subprocess.PIPE,
            env={**os.environ, "ADVERB_REFINERS": "0", "ADVERB_SHUTDOWN_S": "5", "TMPDIR": str(data)},
            cwd=Path(__file__).parents[3],
        )
        self.lines, self.base = Lines(self.process.stderr), ""

    def wait(self) -> None:
        """Wait until it is ready."""
        said = r"^Adverb is ready on (http://127\.0\.0\.1:\d+) \(\d+ verbs, 2 processes; docs at /docs\)$"
        self.base = self.lines.until(said)[1]

    def pids(self) -> list[int]:
        """Processes in the order in which they were started."""
        self.lines.more()
        logged = [json.loads(line) for line in self.lines.seen if line.startswith("{")]
        return [line["pid"] for line in logged if line["event"] == "server started"]

    def metrics(self) -> dict[str, float]:
        """Samples by name and labels, from whichever process answers."""
        text = httpx.get(f"{self.base}/metrics").text
        families = text_string_to_metric_families(text)
        return {
            sample.name + "".join(f",{key}={value}" for key, value in sorted(sample.labels.items())): sample.value
            for family in families
            for sample in family.samples
        }


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.05)


def gone(pid: int) -> bool:
    """Whether a process ended; one that nobody waited for has no command any more."""
    try:
        return not Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return True


def answering(running: Running) -> set[str]:
    """Processes that listen, as the kernel lists them."""
    port = f":{int(running.base.rpartition(':')[2]):04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {row[9] for row in rows if row[1].endswith(port) and row[3] == "0A"}


def stays(stream) -> bool:
    """Whether a stream's server lives: it answers a ping."""
    try:
        stream.send('{"op": "ping", "t": 1}')
        while json.loads(stream.recv(timeout=PATIENCE_S))["op"] != "pong":
            pass
    except ConnectionClosed:
        return False
    return True


@pytest.fixture
def running(tmp_path):
    server = Running(tmp_path)
    try:
        yield server
    finally:
        server.process.kill()
        server.process.communicate()


def test_two_processes_count_as_one_and_outlive_each_other(running):
    running.wait()
    batch = {"items": [{"adverbs": ARM}] * 5, "method": "rbf"}
    for _ in range(20):  # each on a connection of its own, wherever it lands
        assert httpx.post(f"{running.base}/v1/verbs/arm3/poses", json=batch).status_code == 200
    with ExitStack() as stack:
        url = running.base.replace("http", "ws") + "/v1/stream"
        streams = [stack.enter_context(connect(url, subprotocols=["adverb.v1"])) for _ in range(STREAMS)]
        until(lambda: running.metrics()["adverb_streams"] == STREAMS)
        before = running.metrics()
        assert before["adverb_poses_total,method=rbf,verb=arm3"] == 100
        assert before["adverb_pose_error_meters_count,method=rbf,verb=arm3,version=1"] == 100
        assert before["adverb_verb_version,verb=arm3"] == 1
        assert {f"process_resident_memory_bytes,process={slot}" for slot in (0, 1)} <= before.keys()
        assert not [name for name in before if "pid=" in name]

        os.kill(running.pids()[0], signal.SIGKILL)
        until(lambda: len(running.pids()) == 3)
        alive = [stream for stream in streams if stays(stream)]
        assert 0 < len(alive) < STREAMS  # both had some, except once in 2^11 times
        until(lambda: running.metrics()["adverb_streams"] == len(alive))
        assert running.metrics()["adverb_poses_total,method=rbf,verb=arm3"] == 100
        until(lambda: len(answering(running)) == 2)

        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(timeout=PATIENCE_S) == 0
        for stream in alive:
            while json.loads(stream.recv(timeout=PATIENCE_S))["op"] != "drain":
                pass
            with pytest.raises(ConnectionClosed) as closed:
                stream.recv(timeout=PATIENCE_S)
            assert closed.value.rcvd.code == 1012
    assert all(gone(pid) for pid in running.pids())
    with pytest.raises(httpx.ConnectError):
        httpx.get(running.base)


def test_processes_end_with_their_parent(running):
    until(running.pids)
    (child,) = running.pids()
    assert not gone(child)
    running.process.kill()
    running.process.wait()
    until(lambda: gone(child))


def test_a_port_in_use_is_said_by_the_parent():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert refused("--workers", "2", "--port", str(port)).startswith(f"error: port {port} on 127.0.0.1 cannot")


def test_a_first_process_that_cannot_start_ends_all(tmp_path, monkeypatch):
    monkeypatch.setenv("ADVERB_DATABASE_URL", "mysql://nobody@127.0.0.1/nowhere")  # a kind that there is not
    assert "before it was ready" in refused("--workers", "2", "--port", "0", "--data", str(tmp_path))
