"""The Blender add-on's calls of a server, and its thread of live poses."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from adverb_blender.live import Goal, LivePoses
from adverb_blender.rest import Server, ServerError

from tests.service.access.conftest import guarded  # noqa: F401 - a fixture

GOAL = {"x": 0.5, "y": 0.2}
PATIENCE_S = 60.0


def until(take):
    """The first result that is not None."""
    end = time.monotonic() + PATIENCE_S
    while (found := take()) is None:
        assert time.monotonic() < end, "nothing in time"
        time.sleep(0.005)
    return found


@contextmanager
def broken(*contents, length=None):
    """Address of a server that gives one content after the other, then the last one again and again."""
    left = list(contents)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            content = left.pop(0) if len(left) > 1 else left[0]
            self.send_response(200)
            self.send_header("Content-Length", str(length or len(content)))
            self.end_headers()
            self.wfile.write(content)

        def do_POST(self):
            self.rfile.read(int(self.headers["Content-Length"]))
            self.do_GET()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


@pytest.mark.parametrize(
    ("content", "length", "code"), [(b"{", 100, "offline"), (b"<html>", None, "malformed"), (b"[]", None, "malformed")]
)
def test_an_incomplete_or_invalid_answer_is_an_error(content, length, code):
    with broken(content, length=length) as address, pytest.raises(ServerError) as found:
        Server(address).verbs()
    assert found.value.code == code


def test_verbs_poses_and_motions_are_read(address, all_verbs):
    server = Server(address)
    assert sorted(server.verbs()) == sorted(all_verbs.entries)
    assert server.verb("arm3")["skeleton"]["names"] == list(all_verbs.entries["arm3"].verb.skeleton.names)
    assert server.pose("arm3", GOAL, 0.5)["error"] < 1e-6
    motion = server.sequence("arm3", GOAL, 30, space="global")
    assert np.shape(motion["positions"]) == (motion["frames"], 4, 3)
    assert server.motion_file("arm3", GOAL, 30, "text/x-bvh").startswith(b"HIERARCHY")


def test_errors_have_the_code_of_the_server(address):
    with pytest.raises(ServerError, match="unknown_verb") as found:
        Server(address).verb("dance")
    assert found.value.code == "unknown_verb"
    with pytest.raises(ServerError) as found:
        Server("ftp://127.0.0.1").verbs()
    assert found.value.code == "bad_address"


def test_a_server_that_is_down_is_an_error():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(ServerError) as found:
        Server(f"http://127.0.0.1:{port}").verbs()
    assert found.value.code == "offline"


def test_a_wrong_key_is_an_error(guarded):  # noqa: F811
    url = f"http://127.0.0.1:{guarded.server.port}"
    with pytest.raises(ServerError) as found:
        Server(url, "adv_0123456789abcdef_" + "A" * 43).verbs()
    assert found.value.code == "unauthenticated"
    assert Server(url, guarded.keys["pose"]).verbs()


def test_the_newest_goal_is_shown(address):
    live = LivePoses(Server(address))
    for x in np.linspace(0.3, 0.6, 50):
        live.aim(Goal("arm3", (("x", float(x)), ("y", 0.2)), 0.4807692307692308))
    pose = until(lambda: next((pose for pose in [live.take()] if pose and pose["measured"]["x"] > 0.599), None))
    assert pose["measured"]["x"] == pytest.approx(0.6, abs=1e-6)
    live.stop()
    live.join(PATIENCE_S)


def test_a_failed_request_is_reported_and_the_next_one_works(address):
    live = LivePoses(Server(address))
    live.aim(Goal("dance", (), 0.5))
    assert until(lambda: live.error).code == "unknown_verb"
    live.aim(Goal("arm3", tuple(GOAL.items()), 0.5))
    assert until(live.take)["verb"] == "arm3"
    assert live.error is None
    live.stop()
    live.join(PATIENCE_S)


def test_a_goal_whose_request_failed_is_requested_again():
    with broken(b"<html>", b'{"verb": "arm3"}') as address:
        live = LivePoses(Server(address))
        live.aim(Goal("arm3", tuple(GOAL.items()), 0.5))
        assert until(lambda: live.error).code == "malformed"
        assert until(live.take)["verb"] == "arm3"
        assert live.error is None
        live.stop()
        live.join(PATIENCE_S)
