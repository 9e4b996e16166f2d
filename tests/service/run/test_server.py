"""The command `adverb serve`: a real server in a process of its own, and what stops it from starting."""

import json
import os
import re
import selectors
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from service import cli
from service.run.listener import Patience, listen
from service.settings import Settings
from tests.service.conftest import ARM
from verbs import cli as library_cli

START = "from service.cli import main; main()"
LONGEST_START_S = 300.0  # kernels may have to be compiled first


class Lines:
    """Lines of a pipe, each waited for no longer than until a deadline."""

    def __init__(self, pipe):
        self.pipe, self.seen = pipe, []
        self.selector = selectors.DefaultSelector()
        self.selector.register(pipe, selectors.EVENT_READ)
        os.set_blocking(pipe.fileno(), False)
        self.rest = b""

    def more(self) -> bool:
        """Read what there is; whether there may be more later."""
        chunk = self.pipe.read()
        *lines, self.rest = (self.rest + (chunk or b"")).split(b"\n")
        self.seen += [line.decode() for line in lines]
        return chunk != b""

    def until(self, pattern: str) -> re.Match:
        end = time.monotonic() + LONGEST_START_S
        while time.monotonic() < end:
            self.selector.select(timeout=0.5)
            assert self.more(), f"the server ended: {self.seen}"
            for line in self.seen:
                if found := re.search(pattern, line):
                    return found
        raise AssertionError(f"not within {LONGEST_START_S} s: {self.seen}")


@pytest.fixture
def running(data_dir):
    """A server on a free port: its address, its process and its lines."""
    environment = {**os.environ, "ADVERB_DATA": "/nowhere", "ADVERB_LOG_JSON": "true"}
    process = subprocess.Popen(
        [sys.executable, "-c", START, "serve", "--port", "0", "--data", str(data_dir)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        cwd=Path(__file__).parents[3],
    )
    try:
        lines = Lines(process.stderr)
        found = lines.until(r"^Adverb is ready on (http://127\.0\.0\.1:\d+) \((\d+) verbs; docs at /docs\)$")
        yield found, process, lines
    finally:
        process.kill()
        process.communicate()


def test_it_says_where_it_is_answers_and_ends_cleanly(running):
    found, process, lines = running
    with httpx.Client(base_url=found[1]) as client:
        assert len(client.get("/v1/verbs").json()["verbs"]) == int(found[2])
        answer = client.post(
            "/v1/verbs/arm3/pose", json={"adverbs": ARM}, headers={"Accept": "application/octet-stream"}
        )
        assert len(answer.content) == 100
        assert "server" not in answer.headers
        assert client.post("/v1/verbs/arm3/sequence", json={"adverbs": ARM}).json()["frames"] > 10
        assert client.get("/readyz").json()["skipped"][0]["file"] == "cut.verb"
    assert any(line.startswith("warning: cut.verb is not served: ") for line in lines.seen)
    logged = [json.loads(line) for line in lines.seen if line.startswith("{")]
    assert {"verb file skipped", "ready"} <= {line["event"] for line in logged}
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=20) == 0
    assert process.stdout.read() == b""


def refused(*arguments: str) -> str:
    """What the command says when it does not start."""
    result = CliRunner().invoke(library_cli.app, ["serve", *arguments])
    assert result.exit_code == 1
    assert result.stdout == ""
    return result.stderr


def test_a_port_in_use_is_said_with_the_way_out():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = refused("--port", str(port))
    assert said.startswith(f"error: port {port} on 127.0.0.1 cannot be used: ")
    assert "--port" in said


def test_a_missing_data_folder_is_said(tmp_path):
    assert f"the data folder {tmp_path / 'no'} does not exist" in refused("--data", str(tmp_path / "no"))


def test_a_wrong_setting_is_named(monkeypatch):
    monkeypatch.setenv("ADVERB_PORT", "many")
    assert refused().startswith("error: ADVERB_PORT (--port): ")
    monkeypatch.delenv("ADVERB_PORT")
    assert "ADVERB_LOG_LEVEL (--log-level)" in refused("--log-level", "loud")


def test_an_unknown_host_is_said():
    assert "the host 'no.such.host.invalid' is not known" in refused("--host", "no.such.host.invalid", "--port", "0")


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_public_address_needs_a_yes_in_so_many_words(host):
    said = refused("--host", host, "--port", "0")
    assert "there are no keys yet" in said
    assert "--allow-public" in said


def test_a_yes_opens_a_public_address():
    with listen(Settings(host="0.0.0.0", port=0, allow_public=True)) as listener:
        assert listener.getsockname()[1] > 0


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.8.9.1"])
def test_loopback_needs_no_yes(host):
    with listen(Settings(host=host, port=0)) as listener:
        assert listener.getsockname()[1] > 0


def test_the_command_has_the_library_s_commands_and_its_own():
    assert cli.main
    said = CliRunner().invoke(library_cli.app, ["--help"]).stdout
    assert "serve" in said
    assert "build" in said


def test_it_ends_where_there_can_be_no_store(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-c", START, "serve", "--port", "0", "--data", str(tmp_path)],
        env={**os.environ, "ADVERB_DATABASE_URL": "mysql://nobody@127.0.0.1/nowhere"},
        cwd=Path(__file__).parents[3],
        capture_output=True,
        timeout=LONGEST_START_S,
        check=False,
    )
    assert ended.returncode == 1
    assert b"mysql" in ended.stderr
    assert ended.stderr.splitlines()[-1].startswith(b"error: verbs cannot be loaded")


def test_it_ends_at_once_while_verbs_are_still_loading(tmp_path):
    slow = f"""import time
from service.catalog.store_sync import StoreSync

StoreSync.load = lambda self: time.sleep(600)
{START}"""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, "-c", slow, "serve", "--port", str(port), "--data", str(tmp_path)],
        cwd=Path(__file__).parents[3],
    )
    try:
        with httpx.Client(transport=httpx.HTTPTransport(retries=12), base_url=f"http://127.0.0.1:{port}") as client:
            assert client.get("/livez", timeout=LONGEST_START_S).status_code == 200
            assert client.get("/readyz").json()["code"] == "not_ready"
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == 0
    finally:
        process.kill()
        process.wait()


def test_a_long_start_is_told_of_until_it_is_over():
    told, end = [], time.monotonic() + 30.0
    patience = Patience(told.append, (0.001, 0.01))
    while len(told) < 3 and time.monotonic() < end:
        time.sleep(0.001)
    patience.send("ready")
    patience.end()
    count = len(told)
    time.sleep(0.1)
    assert len(told) == count
    assert re.fullmatch(r"starting, 0 s so far; kernels are compiled at the first start, .*", told[0])
    assert set(told[1:-1]) == {"starting, 0 s so far"}
    assert told[-1] == "ready"


def test_a_short_start_says_nothing_of_itself():
    told = []
    patience = Patience(told.append)
    patience.send("ready")
    assert told == ["ready"]
