"""Bounds of HTTP connections, on real sockets."""

from __future__ import annotations

import contextlib
import json
import socket
import time

import pytest

from service.run.http_protocol import HEAD_BYTES
from tests.service.stream.conftest import eventually

PATIENCE_S = 30.0


@pytest.fixture(scope="module")
def server(serve):
    with serve(request_s=0.5, stream_slow_s=0.5) as server:
        yield server


def dialled(server) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), PATIENCE_S)


def answer_of(connection: socket.socket) -> bytes:
    """All bytes until the server closes the connection."""
    found = bytearray()
    with contextlib.suppress(ConnectionResetError):
        read_all(connection, found)
    return bytes(found)


def read_all(connection: socket.socket, found: bytearray | None = None) -> None:
    """Read until the server closes the connection."""
    while part := connection.recv(65_536):
        if found is not None:
            found += part


@pytest.mark.parametrize("start", [b"", b"GET /livez HTTP/1.1\r\nHost: localhost\r\n"], ids=["nothing", "half a head"])
def test_a_head_that_does_not_arrive_closes_the_connection(server, start):
    with dialled(server) as connection:
        connection.sendall(start)
        assert answer_of(connection).startswith(b"HTTP/1.1 408 ")


def test_a_head_byte_by_byte_is_late(server):
    with dialled(server) as connection:
        started = time.monotonic()
        connection.settimeout(0.05)
        found = b""
        for byte in b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: " + b"x" * 10_000:
            try:
                connection.send(bytes([byte]))
                found += connection.recv(100)
            except TimeoutError:
                continue
            except OSError:
                break
            if found:
                break
        assert found.startswith(b"HTTP/1.1 408 ")
        assert time.monotonic() - started < PATIENCE_S


@pytest.mark.parametrize("name", [b"X-Long", b"Cookie"])
def test_a_long_head_is_refused(server, name):
    with dialled(server) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n")
        with contextlib.suppress(OSError):  # the server closes it
            for _ in range(4 * HEAD_BYTES // 1_000):
                connection.sendall(name + b": " + b"x" * 1_000 + b"\r\n")
        assert b"431" in answer_of(connection)[:40]


def test_a_long_path_is_refused(server):
    with dialled(server) as connection:
        with contextlib.suppress(OSError):
            connection.sendall(b"GET /" + b"x" * (4 * HEAD_BYTES))
        assert b"431" in answer_of(connection)[:40]


def test_a_body_that_stops_closes_the_connection(server):
    with dialled(server) as connection:
        connection.sendall(
            b"POST /v1/verbs/arm3/pose HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 100\r\n\r\n{"
        )
        assert b"408" in answer_of(connection)[:40]


def test_requests_of_a_connection_one_after_the_other_and_in_parts(server):
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with dialled(server) as connection:
        for _ in range(3):
            connection.sendall(request[:20])
            connection.sendall(request[20:])
            assert connection.recv(65_536).endswith(b'{"live":true}')
            time.sleep(0.3)  # together longer than a head may take
        connection.sendall(request * 2)
        found = b""
        while found.count(b'{"live":true}') < 2:
            found += connection.recv(65_536)


def test_a_large_body_may_take_longer_than_a_head(server):
    body = b'{"items": [{"adverbs": {"x": 0.4, "y": 0.2}}]}' + b" " * 200_000
    head = b"POST /v1/verbs/arm3/poses HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    with dialled(server) as connection:
        connection.sendall(head + b"Content-Length: %d\r\n\r\n" % len(body))
        for start in range(0, len(body), 20_000):
            connection.sendall(body[start : start + 20_000])
            time.sleep(0.1)
        assert connection.recv(65_536).startswith(b"HTTP/1.1 200 ")


def test_an_idle_connection_outlives_those_of_proxies(server):
    """A server that closes first may do so while a request is on its way; nginx closes after 60 s."""
    config = server.uvicorn.config
    assert config.timeout_keep_alive > 60
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with dialled(server) as connection:
        connection.sendall(request)
        assert connection.recv(65_536).startswith(b"HTTP/1.1 200 ")
        connection.settimeout(2 * server.settings.request_s)
        with pytest.raises(TimeoutError):  # still open when the time of a head has passed
            connection.recv(1)
        connection.settimeout(PATIENCE_S)
        connection.sendall(request)
        assert connection.recv(65_536).startswith(b"HTTP/1.1 200 ")


def asking(cycles: int, *, close: bool = False) -> bytes:
    """A request for a motion of so many cycles, some 220 kB each; the kernel holds up to 4 MB."""
    body = json.dumps({"adverbs": {"slope": 0.0, "damage": 0.5}, "fps": 240, "cycles": cycles}).encode()
    return (
        b"POST /v1/verbs/walk/sequence HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Accept: application/octet-stream\r\nConnection: %s\r\nContent-Length: %d\r\n\r\n%s"
        % (b"close" if close else b"keep-alive", len(body), body)
    )


LARGE = asking(13)
"""A request for 2.8 MB."""


def dialled_narrow(server) -> socket.socket:
    """A connection whose client has a small buffer."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
    connection.settimeout(PATIENCE_S)
    connection.connect(("127.0.0.1", server.port))
    return connection


@pytest.mark.anyio
@pytest.mark.parametrize("request_bytes", [LARGE * 2, LARGE + asking(13, close=True), asking(1) * 40], ids=len)
async def test_a_client_that_does_not_read_is_disconnected(server, request_bytes):
    """Large responses, one after which the connection is closed, and many small ones."""
    connections = server.uvicorn.server_state.connections
    await eventually(lambda: not connections)
    with dialled_narrow(server) as connection:
        connection.sendall(request_bytes)
        await eventually(lambda: any(one.transport.get_write_buffer_size() for one in list(connections)))
        await eventually(lambda: not connections)


@pytest.mark.anyio
async def test_an_idle_client_that_has_not_read_all_is_disconnected(serve, monkeypatch):
    """What is left is in the kernel, which would hold it for minutes."""
    monkeypatch.setattr("service.run.server.KEEP_ALIVE_S", 0.2)
    with serve() as server, dialled_narrow(server) as connection:
        connection.sendall(asking(1))
        await eventually(lambda: server.uvicorn.server_state.total_requests)
        await eventually(lambda: not server.uvicorn.server_state.connections)
        with pytest.raises(ConnectionResetError):
            read_all(connection)


def test_a_client_that_reads_slowly_gets_the_whole_response(server):
    started, found = time.monotonic(), b""
    with dialled_narrow(server) as connection:
        connection.sendall(LARGE + asking(13, close=True))
        while part := connection.recv(65_536):
            if len(found) // 65_536 < len(found + part) // 65_536:
                time.sleep(0.05)
            found += part
    head, _, rest = found.partition(b"\r\n\r\n")
    length = int(next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length: ")).split()[1])
    assert length > 2_800_000
    assert len(rest.partition(b"HTTP/1.1 200 ")[0]) == length
    assert len(found) == 2 * (len(head) + 4 + length) + len(b"connection: close\r\n")
    assert time.monotonic() - started > 4 * server.settings.stream_slow_s
