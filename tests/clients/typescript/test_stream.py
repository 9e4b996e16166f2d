"""The TypeScript client in Node against a server, on networks of all kinds."""

from __future__ import annotations

import itertools
import socket
from contextlib import ExitStack
from types import MappingProxyType

import pytest

from service.catalog.catalog import Catalog
from tests.clients.channel_tests import check_a_new_version
from tests.clients.proxy import Proxy
from tests.clients.typescript.node import Driver
from tests.service.access.conftest import added
from tests.service.stream.conftest import Server
from verbs import library

GOAL = {"x": 0.5, "y": 0.2}
HELD = {"playing": False, "phase": 0.5, "halfLife": 0.0}


def near(point, goal, tolerance_m=1e-4):
    """Whether the hand is on its goal; a paused figure follows it."""
    return all(abs(a - b) < tolerance_m for a, b in zip(point, (goal["x"], goal["y"], 0.0), strict=True))


def open_connections(driver):
    return driver.until("connection", lambda row: row["connection"] == "open")


def test_a_figure_has_the_pose_of_its_goal(address):
    with Driver(address, options={"adverbs": GOAL, **HELD}) as driver:
        assert driver.until("opened")["goal"] == GOAL
        driver.until("pose", lambda row: near(row["hand"], GOAL))
        driver.send("set", adverbs={"y": 0.3})
        driver.until("pose", lambda row: near(row["hand"], {**GOAL, "y": 0.3}))
        driver.send("stats")
        stats = driver.until("stats")
        assert (stats["channels"], stats["connection"]) == (1, "open")
        driver.send("close")
        assert driver.until("closed")["connection"] == "closed"
        assert driver.process.wait(30) == 0


def test_goals_that_are_not_given_are_in_the_middle_of_the_domain(address):
    verb = library.load("arm3")
    middle = verb.domain.chart.adverbs(verb.domain.middle[None])[0]
    with Driver(address, options=HELD) as driver:
        assert list(driver.until("opened")["goal"].values()) == pytest.approx(middle.tolist())


def test_a_server_that_is_down_is_an_error(address):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with Driver(f"http://127.0.0.1:{port}", timeoutMs=500) as driver:
        row = driver.until("failed")
        assert (row["name"], row["code"]) == ("TransportError", "offline")
        assert driver.process.wait(30) == 1


def test_a_server_that_does_not_answer_is_an_error():
    with ExitStack() as stack:
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        driver = stack.enter_context(Driver(f"http://127.0.0.1:{silent.getsockname()[1]}", timeoutMs=300))
        row = driver.until("failed")
        assert (row["name"], row["code"]) == ("TimedOut", "timed_out")


def test_unknown_names_are_errors_with_those_that_exist(address):
    with Driver(address, verb="arm4") as driver:
        row = driver.until("failed")
        assert (row["name"], row["code"], row["status"]) == ("UnknownName", "unknown_verb", 404)
        assert row["known"] == ["arm3", "reach"]
    with Driver(address, options={"adverbs": {"w": 1.0}}) as driver:
        row = driver.until("failed")
        assert (row["code"], row["known"]) == ("unknown_adverb", ["x", "y"])
    with Driver(address, options={"method": "magic"}) as driver:
        assert driver.until("failed")["code"] == "unknown_method"


def test_an_invalid_setting_is_reported_and_changes_nothing(address):
    with Driver(address, options={"adverbs": GOAL, **HELD}) as driver:
        driver.until("pose")
        driver.send("set", fps=500)
        assert driver.until("failed")["name"] in ("BadRequest", "ResponseError")
        driver.until("pose", lambda row: near(row["hand"], GOAL))
        driver.send("switch", verb="reach")
        assert driver.until("failed")["code"] == "skeleton_mismatch"
        assert driver.until("pose")["verb"] == "arm3"


def test_a_wrong_key_is_an_error_and_a_revoked_one_an_event(guarded):
    address = f"http://127.0.0.1:{guarded.server.port}"
    for key in (None, "adv_0123456789abcdef_" + "A" * 43, guarded.keys["revoked"]):
        with Driver(address, key=key) as driver:
            row = driver.until("failed")
            assert (row["name"], row["code"], row["status"]) == ("NoAccess", "unauthenticated", 401)
    with Driver(address, key=guarded.keys["refine"]) as driver:
        row = driver.until("failed")
        assert (row["name"], row["code"], row["status"]) == ("NoAccess", "missing_scope", 403)
    with Driver(address, key=guarded.keys["pose"]) as driver:
        driver.until("pose")
        guarded.store.revoke(guarded.keys["pose"].split("_")[1])
        driver.until("unauthenticated")
        driver.send("key", key=guarded.keys["admin"])
        open_connections(driver)
        number = driver.until("pose")["number"]
        driver.until("pose", lambda row: row["number"] > number + 5)


def test_a_key_that_is_revoked_without_a_connection_is_an_event(guarded):
    proxy, key = Proxy(guarded.server.port), added(guarded.store, "pose")
    with ExitStack() as stack:
        stack.callback(proxy.close)
        driver = stack.enter_context(Driver(proxy.url, key=key))
        driver.until("pose")
        proxy.accepting = False
        proxy.cut()
        driver.until("connection", lambda row: row["connection"] == "lost")
        guarded.store.revoke(key.split("_")[1])
        proxy.accepting = True
        driver.until("unauthenticated")
        driver.send("key", key=guarded.keys["admin"])
        open_connections(driver)
        driver.discard()
        driver.until("pose")


def test_a_new_version_continues_the_motion(all_verbs):
    check_a_new_version(all_verbs.entries["arm3"], Driver)


def test_a_connection_that_is_cut_is_resumed(proxy):
    with Driver(proxy.url, options={"adverbs": GOAL, **HELD}) as driver:
        driver.until("pose")
        for _ in range(3):
            driver.discard()
            proxy.cut()
            assert driver.until("connection", lambda row: row["connection"] == "lost")["againInS"] > 0
            driver.send("set", adverbs={"x": 0.45})
            open_connections(driver)
            driver.until("pose", lambda row: near(row["hand"], {**GOAL, "x": 0.45}))
        driver.send("stats")
        stats = driver.until("stats")
        assert (stats["reconnects"], stats["channels"]) == (3, 1)


def test_a_server_that_restarts_gets_the_figures_again(server, proxy):
    with Driver(proxy.url, options={"adverbs": GOAL, **HELD}) as driver:
        driver.until("pose", lambda row: near(row["hand"], GOAL))
        other = Server(Catalog(MappingProxyType({"arm3": server.state.current().entries["arm3"]}), ())).start()
        try:
            proxy.target = other.port
            proxy.cut()
            open_connections(driver)
            driver.discard()
            driver.until("pose", lambda row: near(row["hand"], GOAL))
            driver.send("set", adverbs={"x": 0.4})
            driver.until("pose", lambda row: near(row["hand"], {**GOAL, "x": 0.4}))
        finally:
            other.stop()


def test_a_network_that_loses_everything_for_a_while_is_survived(proxy):
    with Driver(proxy.url, options={"adverbs": GOAL, "speed": 0.5}) as driver:
        driver.until("pose")
        proxy.stall()
        driver.until("connection", lambda row: row["connection"] == "lost" and "ping" in row["detail"])
        proxy.resume()
        open_connections(driver)
        number = driver.until("pose")["number"]
        driver.until("pose", lambda row: row["number"] > number + 5)


def test_on_a_slow_and_unsteady_network_the_phase_never_runs_back(proxy):
    delays = itertools.cycle([0.0, 0.0, 0.03, 0.0, 0.08, 0.0, 0.0, 0.05])
    proxy.delay_s = lambda: next(delays)
    with Driver(proxy.url, options={"adverbs": GOAL, "speed": 0.2, "loop": False}) as driver:
        driver.until("pose")
        phases = [driver.until("pose")["phase"] for _ in range(150)]
        assert phases == sorted(phases)
        assert len(set(phases)) > 75
        last = driver.until("pose")
        assert last["late"] > 1000 / 60 + 10  # the delay follows the network


def test_a_proxy_without_faults_changes_nothing(server, proxy):
    with Driver(proxy.url, options={"adverbs": GOAL, **HELD}) as driver:
        driver.until("pose", lambda row: near(row["hand"], GOAL))
    assert proxy.connections >= 2
