"""The Godot addon against servers on real sockets, with faults between."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from types import MappingProxyType

import numpy as np
import pytest

from service.catalog.catalog import Catalog
from tests.clients.channel_tests import GOAL, HELD, WRONG_KEY, ChannelTests, near, unused_port
from tests.clients.godot.godot import Driver, run
from tests.service.stream.conftest import Server


@pytest.fixture
def drive(project, address):
    """Starts the driver against a server."""
    return lambda url=address, verb="arm3", **settings: Driver(project, url, verb, **settings)


class TestChannel(ChannelTests):
    pass


@pytest.mark.parametrize(("encoding", "tolerance_m"), [("f32", 1e-5), ("q48", 2e-4), ("q32", 1e-2)])
def test_streamed_poses_are_those_of_the_server(drive, all_verbs, encoding, tolerance_m):
    entry = all_verbs.entries["reach"]
    at = {"x": -0.3, "y": 1.2, "z": 0.4}
    options = {"adverbs": at, "play": False, "phase": 0.25, "encoding": encoding, "plant": False, "method": "rbf"}
    poses = entry.evaluator.pose([at], method="rbf", phase=0.25, plant=False)
    expected = entry.evaluator.positions(poses)[1][0]
    with drive(verb="reach", options=options) as driver:
        row = driver.until("pose", lambda row: row["number"] > 3)
        found = np.reshape(row["positions"], (-1, 3))
        assert np.linalg.norm(found - expected, axis=1).max() <= tolerance_m
        assert driver.stats()["decode_errors"] == 0


def test_a_character_follows_its_goal(drive):
    with drive(options=HELD) as driver:
        assert driver.until("opened")["name"] == "arm3"
        driver.until("pose", lambda row: near(row, GOAL))
        driver.send("set", adverbs={"y": 0.3})
        driver.until("pose", lambda row: near(row, {"x": 0.5, "y": 0.3}))
        driver.send("aim", adverbs=[0.4, 0.1])
        assert driver.until("aimed")["sent"]
        driver.until("pose", lambda row: near(row, {"x": 0.4, "y": 0.1}))
        driver.send("aim", adverbs=[0.4])
        assert not driver.until("aimed")["sent"]
        assert driver.stats()["round_trip_s"] < 1.0
        driver.send("close")
        assert driver.until("ended")["code"] == "closed"


def test_a_byte_budget_is_reported(drive):
    with drive(options={"adverbs": GOAL}) as driver:
        driver.until("pose")
        driver.send("view", budget_kbps=50)
        assert driver.until("stats")["fields"]["budget_kbps"] == 50


def test_a_switch_continues_with_another_verb(drive):
    with drive(verb="reach") as driver:
        driver.until("pose")
        driver.send("switch", verb="locomotion")
        assert driver.until("pose", lambda row: row["verb"] == "locomotion")["values"]
        driver.send("switch", verb="arm3")
        assert driver.until("error")["code"] == "skeleton_mismatch"
        assert driver.until("pose")["verb"] == "locomotion"


def test_unknown_names_are_errors(drive):
    with drive(verb="arm4") as driver:
        assert driver.until("error")["code"] == "unknown_verb"
    with drive(options={"encoding": "weights", "send": "changes"}) as driver:
        assert driver.until("error")["code"] == "unsupported"
    with drive(options={"adverbs": {"w": 1.0}}) as driver:
        assert driver.until("error")["code"] == "unknown_adverb"
    with drive(options=HELD) as driver:
        driver.until("pose")
        driver.send("set", fps=500)
        assert driver.until("error")["code"] in ("out_of_range", "bad_message")
        driver.until("pose", lambda row: near(row, GOAL))


def test_a_server_that_is_down_is_an_error(drive):
    with drive(f"http://127.0.0.1:{unused_port()}", timeout=1.0) as driver:
        assert driver.until("ended")["code"] == "offline"


def test_a_server_that_does_not_answer_is_an_error(drive):
    with ExitStack() as stack:
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        driver = stack.enter_context(drive(url, timeout=0.5, patience=0.5))
        assert driver.until("ended")["code"] == "offline"


def test_a_wrong_key_is_an_error_and_a_revoked_one_ends_the_stream(drive, guarded):
    url = f"http://127.0.0.1:{guarded.server.port}"
    for key in ("", WRONG_KEY, guarded.keys["revoked"]):
        with drive(url, key=key) as driver:
            assert driver.until("ended")["code"] == "unauthenticated"
    with drive(url, key=guarded.keys["refine"], stays=True) as driver:
        assert driver.until("closed")["code"] == "missing_scope"
        driver.send("key", key=guarded.keys["admin"])
        driver.until("pose")
    with drive(url, key=guarded.keys["pose"]) as driver:
        driver.until("pose")
        guarded.store.revoke(guarded.keys["pose"].split("_")[1])
        assert driver.until("lost")["close_code"] == 4401
        assert driver.until("ended")["code"] == "unauthenticated"


def test_poses_and_verb_files_are_read_by_rest(project, address, all_verbs, guarded):
    found = run(project, "vectors", "rest", address, "", "arm3")
    assert (found["pose"]["status"], found["pose"]["fields"]["phase"]) == (200, 0.5)
    size = all_verbs.entries["arm3"].path.stat().st_size
    assert found["file"] == {"status": 200, "problem": "", "size": size}
    found = run(project, "vectors", "rest", address, "", "dance")
    assert (found["pose"]["status"], found["pose"]["fields"]["code"]) == (404, "unknown_verb")
    url = f"http://127.0.0.1:{guarded.server.port}"
    assert run(project, "vectors", "rest", url, WRONG_KEY, "arm3")["pose"]["status"] == 401
    assert run(project, "vectors", "rest", url, guarded.keys["admin"], "arm3")["pose"]["status"] == 200
    found = run(project, "vectors", "rest", f"http://127.0.0.1:{unused_port()}", "", "arm3")
    assert found["pose"]["status"] == 0
    assert found["pose"]["problem"]


def test_a_server_that_stops_is_announced_and_the_next_one_continues(all_verbs, drive, proxy):
    catalog = Catalog(MappingProxyType({"arm3": all_verbs.entries["arm3"]}), ())
    first, second = Server(catalog).start(), Server(catalog).start()
    try:
        proxy.target = first.port
        with drive(proxy.url, options=HELD) as driver:
            driver.until("pose", lambda row: near(row, GOAL))
            proxy.target = second.port
            first.stop()
            assert driver.until("drain")["detail"]
            driver.until("lost")
            driver.until("restored")
            driver.until("pose", lambda row: near(row, GOAL))
    finally:
        second.stop()
