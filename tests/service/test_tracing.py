"""Requests and streams are followed by their ids through the log, and by traces into a collector."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from websockets.sync.client import connect

import verbs.library
from service import tracing
from service.run.listener import CannotServe, check
from service.settings import Settings
from tests.service.run.test_supervisor import until

ARM3 = Path(verbs.library.__file__).parent / "arm3.verb"

CALLER = "0af7651916cd43dd8448eb211c80319c"
"""Id of a trace that a caller has begun."""


@contextmanager
def collector() -> Iterator[tuple[str, list]]:
    """Address of a collector on a real socket, and the spans that it has received."""
    spans: list = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            assert self.path == "/v1/traces"
            for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
                for scope in resource.scope_spans:
                    spans.extend(scope.spans)
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}", spans
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class Logged:
    """A server whose log is JSON."""

    def __init__(self, warm, folder, **settings):
        (folder / "data").mkdir()
        self._path = folder / "log"
        given = {"data": folder / "data", "refiners": 0, "log_json": "true", "log_level": "debug", **settings}
        environment = os.environ | {f"ADVERB_{name.upper()}": str(value) for name, value in given.items()}
        with self._path.open("wb") as log:
            self.process = warm.start("serve", "--port", "0", environment=environment, stderr=log)
        until(lambda: "Adverb is ready on " in self._path.read_text())
        self.base = self._path.read_text().partition("Adverb is ready on ")[2].partition(" ")[0]

    def stop(self) -> int:
        """End the server; return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=60)

    def lines(self, event: str) -> list[dict]:
        """Log lines of an event."""
        rows = [json.loads(line) for line in self._path.read_text().splitlines() if line.startswith("{")]
        return [row for row in rows if row["event"] == event]

    def line(self, event: str, **fields) -> dict:
        """The log line of an event with these fields; waits for it."""

        def found():
            return [row for row in self.lines(event) if fields.items() <= row.items()]

        until(found)
        (row,) = found()
        return row


@pytest.fixture
def start(warm, tmp_path):
    started = []

    def begin(**settings):
        started.append(Logged(warm, tmp_path, **settings))
        return started[-1]

    yield begin
    for one in started:
        one.process.end()


def attributes(span) -> dict:
    return {pair.key: pair.value.string_value or pair.value.int_value for pair in span.attributes}


def test_a_request_is_found_in_the_log_by_its_id(start):
    server = start()
    headers = {"Content-Type": "application/octet-stream", "X-Request-Id": "upload-7"}
    answer = httpx.post(f"{server.base}/v1/verbs", content=ARM3.read_bytes(), headers=headers)
    assert answer.status_code == 201
    assert answer.headers["x-request-id"] == "upload-7"
    published = server.line("version published", request_id="upload-7")
    assert (published["verb"], published["version"]) == ("arm3", answer.json()["version"])
    done = server.line("request", request_id="upload-7")
    assert (done["route"], done["status"]) == ("/v1/verbs", 201)
    other = httpx.get(f"{server.base}/v1/verbs").headers["x-request-id"]
    assert server.line("request", request_id=other)["http_method"] == "GET"
    assert "trace_id" not in done


def test_a_stream_is_found_in_the_log_by_its_id_and_its_closing_is_counted(start):
    server = start(stream_channels=1, streams_per_address=1)
    url = server.base.replace("http", "ws") + "/v1/stream"
    with connect(url, subprotocols=["adverb.v1"]) as stream:
        session = json.loads(stream.recv(timeout=60))["session"]
        opened = server.line("stream opened", stream=session[:8])
        assert opened["request_id"] == stream.response.headers["x-request-id"]
        with connect(url, subprotocols=["adverb.v1"]) as second, pytest.raises(Exception, match="4029"):
            second.recv(timeout=60)
    assert server.line("stream left", stream=session[:8])["for_good"]
    log = server._path.read_text()
    assert session not in log  # who has a whole id can resume the session
    assert 'adverb_stream_closes_total{code="4029"} 1.0' in httpx.get(f"{server.base}/metrics").text


def test_traces_reach_the_collector_and_continue_those_of_the_caller(start):
    with collector() as (address, spans):
        server = start(traces_url=address, traces_share=1.0)
        body = {"adverbs": {"x": 0.4, "y": 0.3}, "method": "rbf"}
        headers = {"traceparent": f"00-{CALLER}-b7ad6b7169203331-01", "X-Request-Id": "pose-1"}
        assert httpx.post(f"{server.base}/v1/verbs/arm3/pose?x=1", json=body, headers=headers).status_code == 200
        unsampled = {"traceparent": f"00-{CALLER[::-1]}-b7ad6b7169203331-00"}
        assert httpx.get(f"{server.base}/v1/verbs", headers=unsampled).status_code == 200
        assert httpx.get(f"{server.base}/livez").status_code == 200
        assert httpx.get(f"{server.base}/v1/verbs/nope").status_code == 404
        assert server.stop() == 0  # spans that wait are sent at the end
        (pose,) = [span for span in spans if span.trace_id.hex() == CALLER]
        found = attributes(pose)
        assert pose.name == "POST /v1/verbs/{verb}/pose"
        assert (found["adverb.verb"], found["adverb.method"]) == ("arm3", "rbf")
        assert (found["adverb.request_id"], found["http.response.status_code"]) == ("pose-1", 200)
        assert pose.parent_span_id.hex() == "b7ad6b7169203331"
        assert server.line("request", request_id="pose-1")["trace_id"] == CALLER
        assert {span.name for span in spans} == {pose.name, "GET /v1/verbs/{verb}"}


def test_a_collector_that_is_away_costs_spans_only(start):
    server = start(traces_url="http://127.0.0.1:9", traces_share=1.0)
    assert httpx.get(f"{server.base}/v1/verbs").status_code == 200
    assert server.stop() == 0


def test_nothing_of_the_sdk_is_imported_without_an_address():
    code = (
        "import sys; from service.app import create_app; from service.settings import Settings; create_app(Settings());"
        "print([name for name in sys.modules if name.startswith(('opentelemetry.sdk', 'opentelemetry.exporter'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[]"


def test_missing_packages_are_reported_at_the_start(monkeypatch):
    monkeypatch.setattr(tracing, "find_spec", lambda name: None)
    with pytest.raises(CannotServe, match=r"pip install 'adverb\[traces\]'"):
        check(Settings(traces_url="http://collector:4318"))
    check(Settings())


@pytest.mark.parametrize("url", ["collector:4318", "ftp://a", "http://", "http://user:secret@a", "http://a/?key=1"])
def test_an_address_of_a_collector_has_no_secrets(url):
    with pytest.raises(ValueError, match="traces_url"):
        Settings(traces_url=url)
