"""The load scripts against a real server on a free port."""

import json
import subprocess
import sys

import pytest
from adverb_load.client import Load
from adverb_load.crowd import run_crowd

from tests.clients.load import LOAD


def script(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(LOAD / "streams.py"), *arguments], capture_output=True, text=True, timeout=180, check=False
    )


@pytest.mark.parametrize("encoding", ["f32", "q48"])
def test_a_load_has_no_gaps_and_no_decode_errors(server, encoding):
    load = ["--sockets", "2", "--channels", "2", "--seconds", "1", "--steer", "20", "--encoding", encoding]
    done = script("--url", server.url, *load, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["gaps"], found["decode_errors"], found["codes"], found["closes"]) == (0, 0, {}, {})
    assert found["expected"] == 120
    assert found["delivered"] > 30  # a busy machine skips ticks
    assert found["records"] == 2 * found["delivered"]
    assert found["decoded"] > 0
    assert found["steered"] > 20
    assert found["lateness_ms"]["p50"] > 0


@pytest.mark.parametrize(("encoding", "within_m"), [("f32", 1e-5), ("q48", 1e-3), ("q32", 3e-2)])
@pytest.mark.parametrize(("steer_hz", "bulk"), [(0.0, False), (20.0, False), (20.0, True)])
def test_the_crowd_client_measures_errors(server, encoding, within_m, steer_hz, bulk):
    events = not bulk  # both options of a crowd together
    load = Load(server.url, "reach", encoding, 2, 3, method="corrected", steer_hz=steer_hz, bulk=bulk, events=events)
    found = run_crowd(load, seconds=1.0, settle_s=0.2, probe=server.cpu_s)
    assert (found.gaps, found.wrong, found.codes) == (0, 0, {})  # goals are held back where this machine is busy
    assert found.expected == 360
    assert 90 < found.delivered <= 366  # a busy machine skips ticks
    assert found.delivered == 3 * found.messages
    assert found.server_cpu_s > 0
    assert found.lateness_ms.p50 > 0
    assert found.steered == 0 if steer_hz == 0 else found.steered > 60
    assert found.samples > 0
    assert found.measured_m < within_m


def test_the_server_survives_chaos(server):
    done = script("--url", server.url, "--chaos", "--sockets", "6", "--seconds", "2", "--seed", "5")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the server survived" in done.stdout


def test_a_missing_server_is_an_error():
    done = script("--url", "ws://127.0.0.1:1/v1/stream", "--seconds", "1")
    assert done.returncode == 2
    assert done.stderr.startswith("error: no server responds at http://127.0.0.1:1: ")


def test_a_missing_verb_is_an_error(server):
    done = script("--url", server.url, "--verb", "dance", "--seconds", "1")
    assert done.returncode == 2
    assert "unknown_verb" in done.stderr


def test_help_has_examples():
    done = script("--help")
    assert done.returncode == 0
    assert "--chaos --sockets 30" in done.stdout
