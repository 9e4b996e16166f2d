"""`adverb serve`: a parent that forks servers, refiners and sandboxes, restarts them, and ends together with them."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from service.run.restart import FIRST_PAUSE_S, LONGEST_PAUSE_S, STABLE_S, Pauses
from tests.service.catalog.conftest import ZIP, zipped_arm
from tests.service.conftest import ARM
from tests.service.run.test_server import OCTETS, Lines, refused
from tests.warm import COMMAND, Warm, children, descendants, lives

pytestmark = [pytest.mark.slow]

LONGEST_S = 120.0
STREAMS = 12
SERVER, REFINER, SANDBOX = "adverb-server", "adverb-refiner", "adverb-sandbox"


class Running:
    """A supervisor, what it has forked, and the lines that they log."""

    def __init__(
        self, warm: Warm, data: Path, workers: int = 1, refiners: int = 0, target: str = COMMAND, **environment: str
    ) -> None:
        self.workers, self.refiners, self.data, self.base = workers, refiners, data, ""
        own = {"ADVERB_REFINERS": str(refiners), "ADVERB_SHUTDOWN_S": "5", "TMPDIR": str(data), **environment}
        arguments = ["serve", "--workers", str(workers), "--port", "0", "--data", str(data), "--log-json"]
        given = {"environment": {**os.environ, **own}, "stderr": subprocess.PIPE, "target": target}
        self.process = warm.start(*arguments, **given)
        self.lines = Lines(self.process.stderr)

    def wait(self) -> "Running":
        """Wait until all servers and refiners are ready."""
        many = f", {self.workers} processes" if self.workers > 1 else ""
        ready = rf"^Adverb is ready on (http://127\.0\.0\.1:\d+) \(\d+ verbs{many}; docs at /docs\)$"
        self.base = self.lines.until(ready)[1]
        if self.refiners:
            until(lambda: len(self.logged("worker ready")) == self.refiners)
        return self

    def logged(self, event: str) -> list[dict]:
        """Lines of an event, in order."""
        self.lines.more()
        rows = [json.loads(line) for line in self.lines.seen if line.startswith("{")]
        return [row for row in rows if row["event"] == event]

    def pids(self) -> list[int]:
        """Servers in the order in which they were started."""
        return [row["pid"] for row in self.logged("server started")]

    def upload(self, content: bytes = b"noise", **options) -> httpx.Response:
        return httpx.post(f"{self.base}/v1/verbs", content=content, headers=OCTETS, timeout=LONGEST_S, **options)

    def metrics(self) -> dict[str, float]:
        """Samples by name and labels, from whichever process answers."""
        text = httpx.get(f"{self.base}/metrics").text
        families = text_string_to_metric_families(text)
        return {
            sample.name + "".join(f",{key}={value}" for key, value in sorted(sample.labels.items())): sample.value
            for family in families
            for sample in family.samples
        }


def until(holds: Callable[[], object], *, seconds: float = LONGEST_S) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


def listening(running: Running) -> set[str]:
    """Inodes of the listening sockets on the server's port."""
    port = f":{int(running.base.rpartition(':')[2]):04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {row[9] for row in rows if row[1].endswith(port) and row[3] == "0A"}


def open_files(pid: int) -> dict[int, str]:
    """What the file descriptors of a process refer to."""
    found = {}
    for path in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            found[int(path.name)] = os.readlink(path)
    return found


def survives(stream) -> bool:
    """Whether a stream's server lives: it answers a ping."""
    try:
        stream.send('{"op": "ping", "t": 1}')
        while True:
            message = stream.recv(timeout=LONGEST_S)
            if isinstance(message, str) and json.loads(message)["op"] == "pong":
                return True
    except ConnectionClosed:
        return False


@pytest.fixture
def start(warm, tmp_path):
    """Start supervisors; all of their processes are ended with the test."""
    started = []

    def begin(**options) -> Running:
        data = tmp_path / f"data{len(started)}"
        data.mkdir()
        started.append(Running(warm, data, **options))
        return started[-1]

    yield begin
    for one in started:
        one.process.end()


def test_two_servers_count_as_one_and_are_restarted(start):
    running = start(workers=2).wait()
    batch = {"items": [{"adverbs": ARM}] * 5, "method": "rbf"}
    for _ in range(20):  # each on a connection of its own, to either server
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
        alive = [stream for stream in streams if survives(stream)]
        assert 0 < len(alive) < STREAMS
        until(lambda: running.metrics()["adverb_streams"] == len(alive))
        assert running.metrics()["adverb_poses_total,method=rbf,verb=arm3"] == 100
        until(lambda: len(running.logged("ready")) == 3)
        assert len(listening(running)) == 1

        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(timeout=LONGEST_S) == 0
        for stream in alive:
            while json.loads(stream.recv(timeout=LONGEST_S))["op"] != "drain":
                pass
            with pytest.raises(ConnectionClosed) as closed:
                stream.recv(timeout=LONGEST_S)
            assert closed.value.rcvd.code == 1012
    assert not any(map(lives, running.pids()))
    assert list(running.data.glob("adverb-metrics-*")) == []
    with pytest.raises(httpx.ConnectError):
        httpx.get(running.base)


def test_one_server_keeps_its_port_while_it_is_restarted(start):
    running = start().wait()
    assert httpx.post(f"{running.base}/v1/verbs/arm3/pose", json={"adverbs": ARM}).status_code == 200
    assert running.metrics()["adverb_verb_version,verb=arm3"] == 1
    assert running.metrics()["process_resident_memory_bytes"] > 0
    os.kill(running.pids()[0], signal.SIGKILL)
    answer = httpx.post(f"{running.base}/v1/verbs/arm3/pose", json={"adverbs": ARM}, timeout=LONGEST_S)
    while answer.status_code == 503:  # it waited in the queue of the port; verbs are loaded a moment later
        answer = httpx.post(f"{running.base}/v1/verbs/arm3/pose", json={"adverbs": ARM}, timeout=LONGEST_S)
    assert answer.status_code == 200
    assert len(running.pids()) == 2
    (death,) = running.logged("server died; starting another")
    assert (death["code"], death["pause_s"]) == (-signal.SIGKILL, FIRST_PAUSE_S)


def test_a_refiner_is_restarted_under_its_name_and_ends_with_sigterm(start):
    running = start(refiners=2).wait()
    first = running.logged("worker started")
    refiners = children(running.process.pid, REFINER)
    assert sorted(row["pid"] for row in first) == refiners
    assert len({row["worker"] for row in first}) == 2
    assert all(os.getpriority(os.PRIO_PROCESS, pid) == 10 for pid in refiners)
    assert os.getpriority(os.PRIO_PROCESS, running.pids()[0]) == 0
    os.kill(first[0]["pid"], signal.SIGKILL)
    until(lambda: len(running.logged("worker ready")) == 3)
    assert running.logged("worker started")[-1]["worker"] == first[0]["worker"]
    below = descendants(running.process.pid)
    assert len(below) == 3
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(timeout=LONGEST_S) == 0
    assert not any(map(lives, below))


def test_all_end_when_the_parent_is_killed(start):
    running = start(workers=2, refiners=1).wait()
    below = descendants(running.process.pid)
    assert len(below) == 3
    running.process.kill()
    running.process.wait()
    until(lambda: not any(map(lives, below)))


def test_processes_inherit_nothing_but_what_they_need(start):
    running = start(refiners=1).wait()
    (server,), (refiner,) = (children(running.process.pid, kind) for kind in (SERVER, REFINER))
    (port,) = listening(running)
    parent = open_files(running.process.pid)
    assert f"socket:[{port}]" in parent.values()
    assert not any("state.db" in target for target in parent.values())
    assert len(os.listdir(f"/proc/{running.process.pid}/task")) == 1
    assert f"socket:[{port}]" in open_files(server).values()
    assert f"socket:[{port}]" not in open_files(refiner).values()
    own = {target for target in parent.values() if target.startswith(("socket:", "anon_inode:"))}
    shared = own & set(open_files(server).values())
    assert {target for target in shared if target.startswith("socket:")} == {f"socket:[{port}]"}
    assert not {target for target in own & set(open_files(refiner).values()) if target.startswith("socket:")}


def test_broken_uploads_are_answered_at_once_without_a_warm_process(start):
    running = start().wait()
    running.upload()  # the parent loads what building needs, after all servers are ready
    until(lambda: children(running.process.pid, SANDBOX) == [])
    before = children(running.process.pid)
    took = []
    for _ in range(10):
        started_s = time.monotonic()
        answer = running.upload()
        took.append(time.monotonic() - started_s)
        assert (answer.status_code, answer.json()["code"]) == (422, "bad_upload")
    until(lambda: children(running.process.pid) == before)
    assert sorted(took)[5] < 0.5  # a new program takes seconds; the machine may be busy
    assert running.logged("sandbox died") == []


def test_requests_finish_and_uploads_end_under_sigterm(start, tmp_path):
    running = start(workers=2).wait()
    content = zipped_arm(tmp_path / "source")

    async def load() -> list[object]:
        async with httpx.AsyncClient(base_url=running.base, timeout=LONGEST_S) as client:
            pose = {"adverbs": ARM}
            await asyncio.gather(*(client.post("/v1/verbs/arm3/pose", json=pose) for _ in range(20)))
            batch = {"items": [{"adverbs": ARM}] * 1000, "method": "corrected"}
            calls = [asyncio.create_task(client.post("/v1/verbs/arm3/poses", json=batch)) for _ in range(20)]
            upload = asyncio.create_task(client.post("/v1/verbs", content=content, headers={"Content-Type": ZIP}))
            await asyncio.wait(calls, return_when=asyncio.FIRST_COMPLETED)
            running.process.terminate()
            return await asyncio.gather(*calls, upload, return_exceptions=True)

    *answers, upload = asyncio.run(load())
    assert running.process.wait(timeout=LONGEST_S) == 0
    done = [answer for answer in answers if isinstance(answer, httpx.Response)]
    assert done
    assert {answer.status_code for answer in done} == {200}
    assert all(
        isinstance(answer, httpx.ConnectError | httpx.ReadError | httpx.RemoteProtocolError)
        for answer in answers
        if answer not in done
    )
    assert not isinstance(upload, httpx.Response) or upload.status_code == 201
    assert not any(map(lives, running.pids()))


def test_a_port_in_use_is_reported_by_the_parent():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert refused("--workers", "2", "--port", str(port)).startswith(f"error: port {port} on 127.0.0.1 cannot")


def test_a_first_server_that_cannot_start_ends_all(start):
    running = start(workers=2, ADVERB_DATABASE_URL="mysql://nobody@127.0.0.1/nowhere")  # no supported database
    assert running.process.wait(timeout=LONGEST_S) == 1
    assert running.process.stderr.read().splitlines()[-1].startswith(b"error: verbs cannot be loaded")


def test_pauses_grow_until_a_child_was_stable(monkeypatch):
    now = [1_000.0]
    monkeypatch.setattr("service.run.restart.time.monotonic", lambda: now[0])
    pauses, seen = Pauses(), []
    for _ in range(9):
        pauses.started()
        now[0] += 1.0
        seen.append(pauses.next_s())
    assert seen[:4] == [0.5, 1.0, 2.0, 4.0]
    assert seen[-2:] == [LONGEST_PAUSE_S] * 2
    pauses.started()
    now[0] += STABLE_S + 1.0
    assert pauses.next_s() == FIRST_PAUSE_S
