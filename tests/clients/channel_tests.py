"""Tests of one channel of a stream, which the clients of game engines share."""

from __future__ import annotations

import itertools
import queue
import socket
import threading
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType

import numpy as np
import pytest

from service.catalog.catalog import Catalog, Entry
from tests.clients.driver import PATIENCE_S
from tests.clients.proxy import Proxy
from tests.service.access.conftest import added
from tests.service.stream.conftest import Server

GOAL = {"x": 0.5, "y": 0.2}
HELD = {"adverbs": GOAL, "play": False, "phase": 0.5, "half_life": 0.0}
WRONG_KEY = "adv_0123456789abcdef_" + "A" * 43


def near(row, goal, tolerance_m=1e-4):
    """Whether the hand is on its goal; a paused character follows it."""
    return np.abs(np.subtract(row["positions"][-3:], (goal["x"], goal["y"], 0.0))).max() < tolerance_m


def unused_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@contextmanager
def requests():
    """Address of a server that has nothing, and the queue of the paths that it receives."""
    paths = queue.Queue()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            paths.put(self.path)
            self.send_error(404)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", paths
        finally:
            server.shutdown()


def check_a_new_version(entry, drive):
    """A figure continues with the next version of its verb; ``drive`` starts a program with a server's address."""
    name = entry.verb.name
    server = Server(Catalog(MappingProxyType({name: entry}), ())).start()
    try:
        with drive(f"http://127.0.0.1:{server.port}") as driver:
            assert driver.until("pose")["version"] == 1
            newer = Catalog(MappingProxyType({name: Entry.of_verb(entry.verb, path=entry.path, version=2)}), ())
            server.call(server.state.set_catalog, newer)
            assert driver.until("version")["version"] == 2
            driver.until("pose", lambda row: row["version"] == 2)
    finally:
        server.stop()


class ChannelTests:
    """A subclass has the fixture ``drive``, which starts a program with the options of ``open``."""

    def test_streamed_weights_sum_to_one(self, drive):
        with drive(options={**HELD, "encoding": "weights", "support": True}) as driver:
            row = driver.until("pose")
            assert len(row["values"]) == 9
            assert sum(row["values"]) == pytest.approx(1.0, abs=1e-5)
            assert 0.0 <= row["support"] <= 1.0

    def test_a_new_version_continues_the_motion(self, all_verbs, drive):
        check_a_new_version(all_verbs.entries["arm3"], drive)

    def test_a_connection_that_is_cut_is_resumed(self, proxy, drive):
        with drive(proxy.url, options=HELD) as driver:
            driver.until("pose", lambda row: near(row, GOAL))
            for x in (0.45, 0.4, 0.35):
                proxy.cut()
                driver.until("lost")
                driver.send("set", adverbs={"x": x})
                assert driver.until("restored")["resumed"]
                driver.until("pose", lambda row, x=x: near(row, {**GOAL, "x": x}))
            stats = driver.stats()
            assert (stats["reconnects"], stats["resumes"], stats["decode_errors"]) == (3, 3, 0)

    def test_another_server_gets_the_channels_again(self, server, proxy, drive):
        other = Server(Catalog(MappingProxyType({"arm3": server.state.current().entries["arm3"]}), ())).start()
        try:
            with drive(proxy.url, options=HELD) as driver:
                driver.until("pose", lambda row: near(row, GOAL))
                driver.send("aim", adverbs=[0.4, 0.1])
                driver.until("pose", lambda row: near(row, {"x": 0.4, "y": 0.1}))
                proxy.target = other.port
                proxy.cut()
                assert not driver.until("restored")["resumed"]
                number = driver.until("pose")["number"]
                row = driver.until("pose", lambda row: row["number"] > number + 5)
                assert near(row, {"x": 0.4, "y": 0.1})
                driver.send("aim", adverbs=[0.5, 0.2])
                driver.until("pose", lambda row: near(row, GOAL))
        finally:
            other.stop()

    def test_a_silent_network_is_noticed_and_survived(self, proxy, drive):
        with drive(proxy.url, silence=2.5, options={"adverbs": GOAL}) as driver:
            driver.until("pose")
            proxy.stall()
            driver.until("pose", lambda row: row["held"])
            driver.until("lost")
            proxy.resume()
            driver.until("restored")
            number = driver.until("pose")["number"]
            driver.until("pose", lambda row: row["number"] > number + 5)

    def test_an_address_may_have_a_path(self, drive):
        with requests() as (url, paths), drive(f"{url}/characters/adverb/", timeout=30.0):
            assert paths.get(timeout=PATIENCE_S) == "/characters/adverb/v1/stream"
            assert paths.get(timeout=PATIENCE_S) == "/characters/adverb/v1/access"

    def test_a_key_that_is_revoked_without_a_connection_ends_the_stream_until_the_next_one(self, guarded, drive):
        key = added(guarded.store, "pose")
        with (
            closing(Proxy(guarded.server.port)) as proxy,
            drive(proxy.url, key=key, stays=True, options=HELD) as driver,
        ):
            driver.until("pose", lambda row: near(row, GOAL))
            proxy.accepting = False
            proxy.cut()
            driver.until("lost")
            guarded.store.revoke(key.split("_")[1])
            proxy.accepting = True
            assert driver.until("closed")["code"] == "unauthenticated"
            driver.send("set", adverbs={"x": 0.45})
            driver.send("key", key=guarded.keys["admin"])
            driver.until("restored")
            driver.until("pose", lambda row: near(row, {**GOAL, "x": 0.45}))

    def test_on_a_slow_and_unsteady_network_the_phase_never_runs_back(self, proxy, drive):
        delays = itertools.cycle([0.0, 0.0, 0.03, 0.0, 0.08, 0.0, 0.0, 0.05])
        proxy.delay_s = lambda: next(delays)
        with drive(proxy.url, options={"adverbs": GOAL, "speed": 0.2, "loop": False}) as driver:
            driver.until("pose")
            phases = [driver.until("pose")["phase"] for _ in range(100)]
            assert phases == sorted(phases)
            assert len(set(phases)) > 50
            assert driver.until("pose")["delay_s"] > 1 / 60 + 0.01, "the delay does not follow the network"

    def test_keytimes_and_the_end_are_events(self, drive):
        with drive(options={"adverbs": GOAL, "loop": False, "phase": 0.4, "speed": 3.0}) as driver:
            assert driver.until("keytime")["channel"] == 0
            assert driver.until("end")["channel"] == 0
            assert driver.until("pose", lambda row: row["phase"] > 0.999 and row["ended"])
