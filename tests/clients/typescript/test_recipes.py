"""Figures whose weights are streamed: the client advances their phase and evaluates their poses."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest

from service.catalog.catalog import Catalog, Entry
from tests.clients.typescript.node import Driver
from tests.service.stream.conftest import Server
from verbs import Evaluator, library

TOLERANCE_M = 1e-5
GOAL, OTHER = {"x": -0.3, "y": 1.2, "z": 0.45}, {"x": -0.1, "y": 1.1, "z": 0.5}
RECIPE = {"encoding": "weights", "events": False, "loop": True}


@pytest.fixture(scope="module")
def reach():
    return Evaluator(library.load("reach"))


def miss_m(evaluator, row, goal):
    """Distance of the last joint from that of the library's pose, metres."""
    pose = evaluator.pose(goal, phase=row["phase"], plant=False)
    return float(np.abs(np.asarray(row["hand"]) - evaluator.positions(pose)[1][0, -1]).max())


def test_poses_are_the_servers_and_need_few_messages(address, reach):
    with Driver(address, verb="reach", options={"adverbs": GOAL, **RECIPE}) as driver:
        rows = [driver.until("pose") for _ in range(60)]
        assert max(row["phase"] for row in rows) > min(row["phase"] for row in rows) + 0.3
        assert max(miss_m(reach, row, GOAL) for row in rows if not row["inTransition"]) < TOLERANCE_M
        driver.send("stats")
        driver.until("stats")
        for _ in range(100):
            driver.until("pose")
        driver.send("stats")
        stats = driver.until("stats")
        assert stats["messagesPerS"] < 2
        assert stats["channels"] == 1


def test_goals_and_settings_are_followed(address, reach):
    with Driver(address, verb="reach", options={"adverbs": GOAL, **RECIPE}) as driver:
        driver.until("pose")
        driver.send("set", adverbs=OTHER, halfLife=0.02)
        driver.until("pose", lambda row: miss_m(reach, row, OTHER) < TOLERANCE_M)
        driver.send("set", playing=False, phase=0.25)
        driver.until("pose", lambda row: abs(row["phase"] - 0.25) < 1e-6 and miss_m(reach, row, OTHER) < TOLERANCE_M)


def test_a_connection_that_is_cut_is_resumed(proxy, reach):
    with Driver(proxy.url, verb="reach", options={"adverbs": GOAL, **RECIPE}) as driver:
        driver.until("pose")
        proxy.cut()
        driver.until("connection", lambda row: row["connection"] == "lost")
        before = driver.until("pose")["phase"]
        driver.until("pose", lambda row: row["phase"] != before)  # the motion continues without a server
        driver.send("set", adverbs=OTHER)
        driver.until("connection", lambda row: row["connection"] == "open")
        driver.until("pose", lambda row: miss_m(reach, row, OTHER) < TOLERANCE_M)


def test_a_new_version_is_downloaded(all_verbs):
    entry = all_verbs.entries["reach"]
    server = Server(Catalog(MappingProxyType({"reach": entry}), ())).start()
    try:
        with Driver(f"http://127.0.0.1:{server.port}", verb="reach", options=RECIPE) as driver:
            assert driver.until("pose")["version"] == 1
            newer = Catalog(MappingProxyType({"reach": Entry.of_verb(entry.verb, path=entry.path, version=2)}), ())
            server.call(server.state.set_catalog, newer)
            driver.until("pose", lambda row: row["version"] == 2)
    finally:
        server.stop()


def test_parts_of_a_pose_cannot_be_evaluated(address):
    with Driver(address, verb="reach", options={"encoding": "weights", "space": "global"}) as driver:
        assert driver.until("failed")["code"] == "bad_request"
