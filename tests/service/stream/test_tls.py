"""Under TLS, and where a socket cannot be duplicated, the event loop writes; clients see no difference."""

import ssl
import subprocess
import time
from shutil import which

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from service.stream.transport import StreamProtocol
from tests.service.stream.conftest import Server, eventually, open_stream

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def secured(catalog, tmp_path_factory):
    """A server behind TLS with a certificate of its own."""
    if which("openssl") is None:
        pytest.skip("without openssl no certificate can be made")
    folder = tmp_path_factory.mktemp("tls")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    files = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    subprocess.run([*command, *names, *files], check=True, capture_output=True)
    server = Server(catalog)
    server.uvicorn.config.ssl_certfile, server.uvicorn.config.ssl_keyfile = folder / "cert.pem", folder / "key.pem"
    server.start()
    yield server, ssl.create_default_context(cafile=folder / "cert.pem")
    server.stop()


async def test_a_stopping_server_says_so_where_the_event_loop_writes(serve, monkeypatch):
    monkeypatch.setattr(StreamProtocol, "duplicate", lambda self: None)
    with serve() as server:
        async with open_stream(server) as client:
            await client.open(1, "arm3")
            await client.poses(2)
            server.uvicorn.should_exit = True
            await client.until("drain")
            with pytest.raises(ConnectionClosed) as closed:
                await client.until("never")
    assert closed.value.rcvd.code == 1012


async def test_a_stream_under_tls(secured):
    server, context = secured
    plain = type("Secured", (), {"url": server.url.replace("ws://127.0.0.1", "wss://localhost")})
    async with open_stream(plain, ssl=context, max_size=None) as client:
        for number in range(30):
            await client.open(number, "reach", fps=60)
        await client.set_adverbs(3, -0.2, 1.1, 0.4)
        frames = await client.poses(40, channel=29)
        await client.send("ping", t=4)
        await client.until("pong")
        session = server.hub.sessions[client.hello["session"]]
        assert np.all(np.diff([frame.sequence for frame in frames]) == 1)
        assert frames[-1].of(3).error < 1e-6
        client.socket.transport.pause_reading()
        await eventually(lambda: session.dropped > 60)
        assert len(session.connection.pending) < 300
        client.socket.transport.resume_reading()
        client.frames.clear()
        while not (client.frames and client.frames[-1].time_ns > time.time_ns() - 200_000_000):
            await client.poses(1)
        assert client.frames[-1].dropped > 60
    await eventually(lambda: client.hello["session"] not in server.hub.sessions)
