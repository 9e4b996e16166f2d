"""The C# client against servers on real sockets, with faults between."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack

import numpy as np
import pytest

from tests.clients.channel_tests import GOAL, HELD, WRONG_KEY, ChannelTests, near, unused_port
from tests.clients.csharp.mono import Driver, run
from tests.clients.python.served import serve


@pytest.fixture
def drive(program, address):
    """Starts the driver against a server."""
    return lambda url=address, verb="arm3", **settings: Driver(program, url, verb, **settings)


class TestChannel(ChannelTests):
    pass


# --- REST and evaluator ---


def test_rest_calls_have_answers_and_errors(program, address, all_verbs):
    found = run(program, "rest", address, "{}")
    verb = all_verbs.entries["arm3"].verb
    assert sorted(found["verbs"]) == ["arm3", "locomotion", "reach"]
    assert found["describe"] == list(verb.skeleton.names)
    assert len(found["pose"]) == 3 + 4 * len(verb.skeleton.names)
    assert found["sequence"][0] == 0.0
    assert found["sequence"] == sorted(found["sequence"])
    assert found["artifact"] == all_verbs.entries["arm3"].path.stat().st_size
    assert (found["unknown"]["code"], found["unknown"]["status"]) == ("unknown_verb", 404)
    assert found["unknown"]["request"]
    assert (found["missing"]["status"], found["missing"]["code"]) == (422, "invalid_request")


def test_a_server_that_is_down_is_an_error(program, drive):
    url = f"http://127.0.0.1:{unused_port()}"
    found = run(program, "rest", url, "{}")
    assert [row["code"] for row in found.values()] == ["offline"] * len(found)
    with drive(url, timeout=1.0) as driver:
        assert driver.until("failed")["code"] == "offline"
        assert driver.process.wait(30) == 1


def test_a_server_that_does_not_answer_is_an_error(drive):
    with ExitStack() as stack:
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        driver = stack.enter_context(drive(f"http://127.0.0.1:{silent.getsockname()[1]}", timeout=0.5))
        assert driver.until("failed")["code"] == "offline"


def test_a_thousand_random_poses_are_those_of_the_server(program, all_verbs):
    with serve(all_verbs) as address:
        found = run(program, "server", address, "1000")
    assert found["poses"] >= 1_000
    assert set(found["worst"]) == set(all_verbs.entries)
    assert max(found["worst"].values()) <= 1e-5, found["worst"]


# --- stream ---


@pytest.mark.parametrize(("encoding", "tolerance_m"), [("f32", 1e-5), ("q48", 2e-4), ("q32", 1e-2)])
def test_streamed_poses_are_those_of_the_server(drive, all_verbs, encoding, tolerance_m):
    entry = all_verbs.entries["reach"]
    at = {"x": -0.3, "y": 1.2, "z": 0.4}
    options = {"adverbs": at, "play": False, "phase": 0.25, "encoding": encoding, "plant": False, "method": "rbf"}
    poses = entry.evaluator.pose([at], method="rbf", phase=0.25, plant=False)
    expected = entry.evaluator.positions(poses)[1][0]
    for frame, mirror in (("gltf", 1.0), ("unity", -1.0)):
        with drive(verb="reach", options={**options, "frame": frame}) as driver:
            row = driver.until("pose", lambda row: row["number"] > 3)
            found = np.reshape(row["positions"], (-1, 3)) * (mirror, 1.0, 1.0)
            assert np.linalg.norm(found - expected, axis=1).max() <= tolerance_m
            assert driver.stats()["decode_errors"] == 0


def test_poses_become_those_of_unity(program, drive):
    values = {}
    for frame in ("gltf", "unity"):
        with drive(verb="reach", options={"play": False, "phase": 0.25, "frame": frame}) as driver:
            values[frame] = driver.until("pose", lambda row: row["number"] > 3)["values"]
    found = run(program, "flip", json.dumps(values["gltf"]))
    np.testing.assert_allclose(found, values["unity"], atol=1e-6)
    assert np.abs(np.subtract(found, values["gltf"])).max() > 0.01


def test_a_character_follows_its_goal(drive):
    with drive(options=HELD) as driver:
        assert driver.until("opened")["name"] == "arm3"
        driver.until("pose", lambda row: near(row, GOAL))
        driver.send("set", adverbs={"y": 0.3})
        driver.until("pose", lambda row: near(row, {"x": 0.5, "y": 0.3}))
        driver.send("aim", adverbs=[0.4, 0.1])
        driver.until("pose", lambda row: near(row, {"x": 0.4, "y": 0.1}))
        driver.send("aim many", adverbs=[0.5, -0.1])
        driver.until("pose", lambda row: near(row, {"x": 0.5, "y": -0.1}))
        assert driver.stats()["round_trip"] < 1.0
        driver.send("close")
        assert driver.until("closed")["error"]["code"] == "closed"
        assert driver.process.wait(30) == 0


def test_a_closed_channel_does_not_steer_the_next_one_with_its_number(drive):
    with drive(options=HELD) as driver:
        driver.send("replace")
        assert driver.until("replaced")["number"] == 0
        driver.send("closed aim", adverbs=[0.4, 0.1])
        driver.send("closed aim many", adverbs=[0.4, 0.1])
        driver.send("closed set", adverbs={"x": 0.4})
        driver.send("closed close")
        driver.send("closed switch", verb="arm3")
        assert driver.until("failed")["code"] == "closed"
        driver.send("set", adverbs={"y": 0.3})
        driver.until("pose", lambda row: near(row, {"x": 0.5, "y": 0.3}))


def test_a_byte_budget_is_reported(drive):
    with drive(options={"adverbs": GOAL}) as driver:
        driver.send("view", position=[0.0, 1.0, 2.0], budget=50)
        assert driver.until("stats", lambda row: "fields" in row)["fields"]["budget_kbps"] == 50


def test_a_switch_continues_with_another_verb(drive):
    with drive(verb="reach") as driver:
        driver.send("switch", verb="locomotion")
        assert driver.until("pose", lambda row: row["verb"] == "locomotion")["values"]
        driver.send("switch", verb="arm3")
        assert driver.until("failed")["code"] == "skeleton_mismatch"
        assert driver.until("pose")["verb"] == "locomotion"


def test_unknown_names_are_errors(drive):
    with drive(verb="arm4") as driver:
        assert driver.until("failed")["code"] == "unknown_verb"
        assert driver.process.wait(30) == 1
    with drive(options={"adverbs": {"w": 1.0}}) as driver:
        assert driver.until("failed")["code"] == "unknown_adverb"
    with drive(options=HELD) as driver:
        driver.send("set", fps=500)
        assert driver.until("error")["error"]["code"] in ("out_of_range", "bad_message")
        driver.until("pose", lambda row: near(row, GOAL))


def test_a_wrong_key_is_an_error_and_a_revoked_one_ends_the_stream(program, drive, guarded):
    url = f"http://127.0.0.1:{guarded.server.port}"
    for key in (WRONG_KEY, guarded.keys["revoked"]):
        found = run(program, "rest", url, json.dumps({"key": key}))
        assert {(row["code"], row["status"]) for row in found.values()} == {("unauthenticated", 401)}
        with drive(url, key=key) as driver:
            row = driver.until("failed")
            assert (row["code"], row["status"]) == ("unauthenticated", 401)
    with drive(url, key=guarded.keys["refine"], stays=True) as driver:
        assert driver.until("failed")["code"] == "missing_scope"
        driver.send("key", key=guarded.keys["admin"])
        driver.until("pose")
    with drive(url, key=guarded.keys["admin"], subprotocol=True) as driver:
        driver.until("pose")
    with drive(url, key=guarded.keys["pose"]) as driver:
        driver.until("pose")
        guarded.store.revoke(guarded.keys["pose"].split("_")[1])
        assert driver.until("lost")["close_code"] == 4401
        assert driver.until("closed")["error"]["code"] == "unauthenticated"
        assert driver.process.wait(30) == 0
