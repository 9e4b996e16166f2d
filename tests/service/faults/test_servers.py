"""Signals under load, and two servers on one data folder."""

import json
import os
import signal
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import replace

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.service.run.test_supervisor import LONGEST_S, Running, survives, until
from tests.warm import children, lives
from verbs import library
from verbs.io import artifact

POSE = {"adverbs": {"x": 0.4, "y": 0.3}}
STREAMS = 12
CLIENTS = 4
END_S = 20.0
"""Longest time in which a server ends under load, with the 2 s that requests may take."""


class Load:
    """Requests for one pose, each on its own connection, whose answers must all be equal."""

    def __init__(self, base):
        self.base, self.right, self.wrong, self.lost = base, 0, [], 0
        self._expected = httpx.post(f"{base}/v1/verbs/arm3/pose", json=POSE).content
        self._end = threading.Event()
        self._threads = [threading.Thread(target=self._run) for _ in range(CLIENTS)]

    def __enter__(self):
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        for thread in self._threads:
            thread.join(LONGEST_S)

    def _run(self):
        while not self._end.is_set():
            try:
                answer = httpx.post(f"{self.base}/v1/verbs/arm3/pose", json=POSE, timeout=LONGEST_S)
            except httpx.TransportError:  # the process is gone
                self.lost += 1
                self._end.wait(0.01)
                continue
            if answer.status_code == 200 and answer.content == self._expected:
                self.right += 1
            elif answer.status_code != 503:  # 503: the next process is being started
                self.wrong.append(answer.text)


def drained(stream):
    """Whether a stream gets `drain`, and is then closed as by a server that restarts."""
    with suppress(TimeoutError):
        try:
            while True:
                message = stream.recv(timeout=LONGEST_S)
                if isinstance(message, str) and json.loads(message)["op"] == "drain":
                    break
            while True:
                stream.recv(timeout=LONGEST_S)
        except ConnectionClosed as err:
            return err.rcvd is not None and err.rcvd.code == 1012
    return False


def test_signals_under_load_lose_one_server_s_streams_and_give_no_wrong_answer(warm, tmp_path):
    running = Running(warm, tmp_path, workers=2, ADVERB_SHUTDOWN_S="2")
    with ExitStack() as stack:
        stack.callback(running.process.end)
        running.wait()
        url = running.base.replace("http", "ws") + "/v1/stream"
        streams = [stack.enter_context(connect(url, subprotocols=["adverb.v1"])) for _ in range(STREAMS)]
        for stream in streams:
            stream.send('{"op": "open", "channel": 1, "verb": "arm3"}')
        load = stack.enter_context(Load(running.base))
        until(lambda: load.right > 50)
        os.kill(running.pids()[0], signal.SIGKILL)
        until(lambda: len(running.pids()) == 3)
        alive = [stream for stream in streams if survives(stream)]
        assert 0 < len(alive) < STREAMS
        until(lambda: len(running.logged("ready")) == 3)
        count = load.right
        until(lambda: load.right > count + 50)
        began_s = time.monotonic()
        running.process.send_signal(signal.SIGTERM)
        assert all(drained(stream) for stream in alive)
        assert running.process.wait(timeout=LONGEST_S) == 0
        assert time.monotonic() - began_s < END_S
        assert not any(map(lives, running.pids()))
    assert load.wrong == []


@pytest.fixture
def pair(warm, tmp_path):
    """Two servers on one data folder."""
    folders = [tmp_path / "data", tmp_path / "logs"]
    for folder in folders:
        folder.mkdir()
    servers = [Running(warm, folders[0], TMPDIR=str(folders[1])) for _ in range(2)]
    yield [server.wait() for server in servers]
    for server in servers:
        server.process.end()


def test_two_servers_on_one_folder_publish_in_turn_and_follow_each_other(pair, tmp_path):
    verb, file = library.load("arm3"), tmp_path / "next.verb"

    def served(server):
        return httpx.get(f"{server.base}/v1/verbs/arm3").json()["version"]

    for number in range(2, 8):
        artifact.save(replace(verb, description=f"number {number}"), file)
        answer = pair[number % 2].upload(file.read_bytes())
        assert (answer.status_code, answer.json()["version"]) == (201, number)
        assert served(pair[number % 2]) == number
        until(lambda: served(pair[(number + 1) % 2]) == number)  # noqa: B023
    assert httpx.post(f"{pair[0].base}/v1/verbs/arm3/versions/2/activate").status_code == 200
    until(lambda: served(pair[1]) == 2)
    raced = [httpx.delete(f"{server.base}/v1/verbs/arm3", headers={"If-Match": '"2"'}).status_code for server in pair]
    assert sorted(raced) in ([204, 404], [204, 412])
    until(lambda: all(httpx.get(f"{server.base}/v1/verbs/arm3").status_code == 404 for server in pair))
    for server in children(pair[0].process.pid, "adverb-server"):
        os.kill(server, signal.SIGKILL)
    answer = pair[1].upload(file.read_bytes())
    assert (answer.status_code, answer.json()["version"]) == (201, 7)  # the same bytes are the same version
    until(lambda: len(pair[0].logged("ready")) == 2)
    assert served(pair[0]) == 7


def test_a_mapped_file_that_is_cut_short_ends_no_more_than_its_verb(warm, tmp_path):
    running = Running(warm, tmp_path)
    with ExitStack() as stack:
        stack.callback(running.process.end)
        running.wait()
        (version,) = httpx.get(f"{running.base}/v1/verbs/arm3/versions").json()["versions"]
        os.truncate(tmp_path / "artifacts" / f"{version['sha256']}.verb", 100)

        def gone():
            with suppress(httpx.TransportError):  # the process may read the missing pages before it checks the file
                answer = httpx.post(f"{running.base}/v1/verbs/arm3/pose", json=POSE, timeout=LONGEST_S)
                return answer.status_code == 404
            return False

        def reported():
            with suppress(httpx.TransportError):
                return httpx.get(f"{running.base}/readyz").json().get("skipped")
            return None

        until(gone)
        until(reported)
        (skipped,) = reported()
        assert skipped["file"] == "arm3 version 1"
        assert "is damaged" in skipped["problem"]
        assert httpx.get(f"{running.base}/v1/verbs/reach").status_code == 200
