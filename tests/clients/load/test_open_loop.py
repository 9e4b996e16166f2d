"""The open loop: latency counts from the schedule, whatever the server does."""

import asyncio
import threading
from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest
from adverb_load.compare import compare
from adverb_load.engine import run
from adverb_load.http_pool import ResponseParser
from adverb_load.profile import parse
from adverb_load.report_html import page
from adverb_load.report_text import lines_of
from adverb_load.target import Target, is_loopback

STALL_S = 1.0
HEALTH = '[[requests]]\nname = "health"\nroute = "health"\nrate = 100\narrivals = "constant"\naccept = "json"\n'


@contextmanager
def stub_server(respond):
    """A server in a thread; ``respond(number)`` is the pause before a response, seconds, and its bytes."""
    seen, loop = Counter(), asyncio.new_event_loop()

    async def handle(reader, writer):
        try:
            while await reader.readuntil(b"\r\n\r\n"):
                seen["requests"] += 1
                pause_s, content = respond(seen["requests"])
                await asyncio.sleep(pause_s)
                if content is None:
                    writer.transport.abort()
                    return
                writer.write(content)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()

    server = loop.run_until_complete(asyncio.start_server(handle, "127.0.0.1", 0))
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10.0)
        for task in asyncio.all_tasks(loop):
            task.cancel()
        server.close()
        loop.run_until_complete(asyncio.sleep(0))
        loop.close()


def response(body, status="200 OK", extra=""):
    return f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n{extra}\r\n{body}".encode()


def load(url, text, seconds=3.0):
    profile = parse(f"duration_s = {seconds}\nwarmup_s = 0\ninterval_s = 0.5\n{text}", "test")
    return run(profile, Target(url), seed=1)


def test_rates_are_of_the_whole_duration():
    with stub_server(lambda number: (0.0, response("{}"))) as url:
        report = load(url, HEALTH, seconds=1.4)
    found = report["requests"][0]["requests"]
    assert report["interval_s"] == pytest.approx(1.4 / 3)
    assert found["scheduled"] == 140
    assert found["good"] == 140
    assert found["scheduled_per_s"] == 100.0


def test_a_stall_is_charged_to_every_request_that_was_due():
    stalled = []

    def respond(number):
        if number == 50 and not stalled:
            stalled.append(number)
            return STALL_S, response("{}")
        return 0.0, response("{}")

    with stub_server(respond) as url:
        found = load(url, HEALTH + "connections = 1\n")["requests"][0]
    assert found["requests"]["scheduled"] == 300  # the schedule does not wait for the server
    assert found["errors"] == {}
    late = sum(_above(part, 0.2 * STALL_S) for part in found["series"]["latency_s"])
    slow = sum(_above(part, 0.2 * STALL_S) for part in found["series"]["service_s"])
    assert late >= 60  # at 100 a second, 80 were due in the first 0.8 of the stall
    assert slow < 0.2 * late  # who counts from sending misses them
    assert found["summary"]["latency_s"]["p90"] > 5 * found["summary"]["service_s"]["p90"]


def _above(part, seconds):
    buckets, counts = np.array(part["buckets"]), np.array(part["counts"])
    return int(counts[1e-9 * 2.0 ** (buckets / 64.0) > seconds].sum()) if counts.size else 0


def test_errors_are_counted_by_code():
    problem = response('{"code": "overloaded"}', "503 Service Unavailable")

    def respond(number):
        kinds = (response("{}"), problem, response("no JSON"), None)
        return 0.0, kinds[number % 4]

    with stub_server(respond) as url:
        report = load(url, HEALTH, seconds=2.0)
    found = report["requests"][0]
    assert set(found["errors"]) == {"503 overloaded", "connection lost"}
    assert found["errors"]["503 overloaded"] == pytest.approx(50, abs=3)
    assert found["requests"]["faults"] > 40
    assert "503 overloaded" in page(report)
    assert any("malformed responses" in line for line in lines_of(report))


def test_a_server_that_never_responds_gives_timeouts():
    with stub_server(lambda _: (1e3, response("{}"))) as url:
        found = load(url, HEALTH + "timeout_s = 0.2\n", seconds=1.0)["requests"][0]
    assert found["errors"] == {"timeout": 100}
    assert found["summary"]["latency_s"]["p50"] >= 0.2


def test_a_slower_run_is_worse_and_the_same_run_is_noise():
    def at(pause_s):
        with stub_server(lambda _: (pause_s, response("{}"))) as url:
            return load(url, HEALTH, seconds=5.0)

    slow, fast = at(0.25), at(0.0)
    same = compare(slow, slow, fail_over=1.0)
    assert {row.change for row in same.differences} == {0.0}
    assert not same.failed
    found = {row.figure: row for row in compare(fast, slow, fail_over=50.0).differences}
    assert found["latency p50"].verdict == "worse"
    assert found["latency p50"].low > 50.0
    assert [row.figure for row in compare(fast, slow, fail_over=50.0).failed][:1] == ["latency p50"]
    assert not compare(slow, fast, fail_over=50.0).failed
    with pytest.raises(ValueError, match="malformed"):
        compare(fast, {**slow, "requests": [{"name": "health"}]})


@pytest.mark.parametrize("step", [1, 7, 1000])
def test_responses_are_parsed_in_any_pieces(step):
    chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n7;x=1\r\n, world\r\n0\r\n\r\n"
    closing = response("bye", extra="Connection: close\r\n")
    for content, body, stays in ((chunked, b"hello, world", True), (closing, b"bye", False), (response(""), b"", True)):
        parser, found = ResponseParser(), []
        for at in range(0, len(content), step):
            done = parser.feed(content[at : at + step])
            if done is not None:
                found.append(done)
        assert [(reply.status, reply.body, left) for reply, left in found] == [(200, body, stays)]


def test_loopback_addresses():
    assert all(
        map(is_loopback, ("http://127.0.0.1:8000", "http://localhost", "ws://[::1]:80/v1/stream", "http://127.9.9.9"))
    )
    assert not any(map(is_loopback, ("http://10.0.0.1", "https://animation.example", "http://127.0.0.1.example")))
