"""The command `adverb serve`: a real command line, its messages, and its errors."""

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
from service.catalog.store_sync import StoreSync
from service.run import fork
from service.run.listener import listen
from service.run.progress import Progress
from service.settings import Settings
from tests.service.conftest import ARM
from tests.warm import children, descendants, lives
from verbs import cli as library_cli

START = "from service.cli import main; main()"
LONGEST_START_S = 300.0  # kernels may have to be compiled first
OCTETS = {"Content-Type": "application/octet-stream"}

STOPPED = f"""import sys, time
from service.run import warmup

def load():
    sys.stderr.write("loading\\n")
    sys.stderr.flush()
    time.sleep(600)

warmup.load_serving = load
{START}"""


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


def test_it_reports_its_address_answers_and_ends_cleanly(running):
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
    """Standard error of a command that does not start."""
    result = CliRunner().invoke(library_cli.app, ["serve", *arguments])
    assert result.exit_code == 1
    assert result.stdout == ""
    return result.stderr


def test_a_port_in_use_is_reported_with_alternatives():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        error = refused("--port", str(port))
    assert error.startswith(f"error: port {port} on 127.0.0.1 cannot be used: ")
    assert "--port" in error


def test_a_missing_data_folder_is_reported(tmp_path):
    assert f"the data folder {tmp_path / 'no'} does not exist" in refused("--data", str(tmp_path / "no"))


@pytest.mark.parametrize("command", ["serve", "worker"])
def test_a_data_folder_that_is_a_file_is_reported(tmp_path, command):
    file = tmp_path / "reach.verb"
    file.write_bytes(b"")
    result = CliRunner().invoke(library_cli.app, [command, "--data", str(file)])
    assert result.exit_code == 1
    assert f"{file} is a file, and --data is the folder that holds verbs" in result.stderr


def test_a_wrong_setting_is_named(monkeypatch):
    monkeypatch.setenv("ADVERB_PORT", "many")
    assert refused().startswith("error: ADVERB_PORT (--port): ")
    monkeypatch.delenv("ADVERB_PORT")
    assert "ADVERB_LOG_LEVEL (--log-level)" in refused("--log-level", "loud")


def test_an_unknown_host_is_reported():
    assert "the host 'no.such.host.invalid' is not known" in refused("--host", "no.such.host.invalid", "--port", "0")


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_public_address_needs_an_explicit_option(host):
    error = refused("--host", host, "--port", "0")
    assert "there are no keys yet" in error
    assert "--allow-public" in error


def test_the_option_opens_a_public_address():
    with listen(Settings(host="0.0.0.0", port=0, allow_public=True)) as listener:
        assert listener.getsockname()[1] > 0


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.8.9.1"])
def test_loopback_needs_no_option(host):
    with listen(Settings(host=host, port=0)) as listener:
        assert listener.getsockname()[1] > 0


def test_the_command_has_the_library_s_commands_and_its_own():
    assert cli.main
    error = CliRunner().invoke(library_cli.app, ["--help"]).stdout
    assert "serve" in error
    assert "build" in error


def test_it_ends_where_there_can_be_no_store(warm, tmp_path):
    environment = {**os.environ, "ADVERB_DATABASE_URL": "mysql://nobody@127.0.0.1/nowhere"}
    arguments = ["serve", "--port", "0", "--data", str(tmp_path)]
    process = warm.start(*arguments, environment=environment, stderr=subprocess.PIPE)
    lines = process.stderr.read()
    assert process.wait(LONGEST_START_S) == 1
    process.end()
    assert b"mysql" in lines
    assert lines.splitlines()[-1].startswith(b"error: verbs cannot be loaded")


def slow() -> None:
    """A command whose verbs never finish loading."""
    StoreSync.load = lambda self: time.sleep(600)
    cli.main()


def test_it_ends_at_once_while_verbs_are_still_loading(warm, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    arguments = ["serve", "--port", str(port), "--data", str(tmp_path)]
    process = warm.start(*arguments, target=f"{__name__}:slow")
    try:
        with httpx.Client(transport=httpx.HTTPTransport(retries=12), base_url=f"http://127.0.0.1:{port}") as client:
            assert client.get("/livez", timeout=LONGEST_START_S).status_code == 200
            assert client.get("/readyz").json()["code"] == "not_ready"
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == 0
    finally:
        process.end()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_cleanly_while_modules_are_loaded(data_dir, number):
    """A real command line, which needs a second of imports at least; the signal comes when the port is bound."""
    command = [sys.executable, "-c", STOPPED, "serve", "--port", "0", "--data", str(data_dir)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, cwd=Path(__file__).parents[3])
    try:
        process.stderr.readline()
        process.send_signal(number)
        assert process.wait(timeout=LONGEST_START_S) == 0
        assert b"server started" not in process.stderr.read()
    finally:
        process.kill()
        process.communicate()


def test_without_fork_it_serves_in_one_process_and_spawns_the_others(warm, tmp_path):
    environment = {**os.environ, "ADVERB_REFINERS": "1"}
    arguments = ["serve", "--port", "0", "--data", str(tmp_path)]
    process = warm.start(*arguments, environment=environment, stderr=subprocess.PIPE, target=f"{__name__}:without_fork")
    try:
        lines = Lines(process.stderr)
        base = lines.until(r"Adverb is ready on (http://\S+)")[1]
        lines.until("worker '.*' is ready")
        upload = httpx.post(f"{base}/v1/verbs", content=b"x", headers=OCTETS, timeout=LONGEST_START_S)
        assert upload.json()["code"] == "bad_upload"
        assert children(process.pid, "adverb-server") == []
        below = descendants(process.pid)
        process.terminate()
        assert process.wait(timeout=40) == 0
        assert not any(map(lives, below))
    finally:
        process.end()


def without_fork() -> None:
    """A command on a system that cannot fork safely."""
    fork.AVAILABLE = False
    cli.main()


def test_without_fork_there_is_one_server_only(monkeypatch):
    monkeypatch.setattr(fork, "AVAILABLE", False)
    assert "use --workers 1" in refused("--workers", "2", "--port", "0")


def test_a_long_start_is_reported_until_it_is_over():
    lines, end = [], time.monotonic() + 30.0
    progress = Progress(lines.append, (0.001, 0.01))
    while len(lines) < 3 and time.monotonic() < end:
        time.sleep(0.001)
    progress.close()
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert re.fullmatch(r"starting, 0 s so far; kernels are compiled at the first start, .*", lines[0])
    assert set(lines[1:]) == {"starting, 0 s so far"}
    assert len(lines) >= 3


def test_a_short_start_is_not_reported():
    lines = []
    Progress(lines.append).close()
    assert lines == []
