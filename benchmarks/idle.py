"""Memory of streams that are open and idle: `python -m benchmarks.idle --streams 5000`.

A real server on loopback; the clients are plain sockets that shake hands and then send nothing.
"""

from __future__ import annotations

import argparse
import base64
import os
import resource
import socket
import sys
import time
import urllib.request
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

from adverb_load.process import Served, serve

PROJECT = Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0

FILES = 2_000
"""Open files of this process besides the sockets."""


@dataclass(frozen=True, slots=True)
class Idle:
    """Number of streams, memory of each in bytes of 1,000 to the kB, and open sockets before and after them."""

    streams: int
    kb_each: float
    sockets_before: int
    sockets_after: int


def measure(streams: int) -> Idle:
    """Open so many streams to a new server, and close them.

    Raises
    ------
    RuntimeError
        The system does not allow as many open files, or the server does not count the streams.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = 2 * streams + FILES
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise RuntimeError(f"{streams} streams need a limit of {needed} open files (ulimit -n); it is {hard}")
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, needed), hard))
    command = [sys.executable, "-c", "from service.cli import main; main()", "serve", "--port", "0"]
    environment = {"ADVERB_STREAMS": str(streams + 100), "ADVERB_REFINERS": "0"}
    try:
        with serve(command, core=None, cwd=PROJECT, environment=environment) as server:
            with ExitStack() as stack:  # first uses load what stays
                for _ in range(20):
                    stack.enter_context(stream(server))
                wait_for(server, 20)
            wait_for(server, 0)
            sockets, before = server.sockets(), server.rss_mib()
            with ExitStack() as stack:
                for _ in range(streams):
                    stack.enter_context(stream(server))
                wait_for(server, streams)
                each = (server.rss_mib() - before) * 1024**2 / 1000 / streams
            wait_for(server, 0)
            end = time.monotonic() + PATIENCE_S  # the last request for metrics may still have its connection
            while server.sockets() > sockets and time.monotonic() < end:
                time.sleep(0.05)
            return Idle(streams, each, sockets, server.sockets())
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def stream(server: Served) -> socket.socket:
    """A socket that has done the handshake of a stream."""
    address = urlsplit(server.base)
    made = socket.create_connection((address.hostname, address.port), timeout=PATIENCE_S)
    key = base64.b64encode(os.urandom(16)).decode()
    made.sendall(
        f"GET /v1/stream HTTP/1.1\r\nHost: {address.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: adverb.v1\r\n\r\n".encode()
    )
    head = b""
    while b"\r\n\r\n" not in head:
        got = made.recv(4096)
        if not got:
            raise RuntimeError("the server closed a connection before the end of its handshake")
        head += got
    if not head.startswith(b"HTTP/1.1 101"):
        raise RuntimeError(f"a handshake was answered {head.splitlines()[0].decode('latin-1')!r}")
    return made


def wait_for(server: Served, streams: int) -> None:
    """Wait until the server counts so many open streams."""
    deadline = time.monotonic() + PATIENCE_S
    while (found := counted(server)) != streams:
        if time.monotonic() > deadline:
            raise RuntimeError(f"the server counts {found:g} streams instead of {streams}")
        time.sleep(0.2)


def counted(server: Served) -> float:
    """Open streams, as the server's metrics have them."""
    with urllib.request.urlopen(f"{server.base}/metrics", timeout=PATIENCE_S) as answer:
        lines = answer.read().decode().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("adverb_streams ")))


def main() -> None:
    """Print the memory of each stream."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streams", type=int, default=5_000, help="number of open streams")
    found = measure(parser.parse_args().streams)
    print(
        f"{found.streams:,} idle streams: {found.kb_each:.1f} kB each (goal < 40 kB); "
        f"open sockets {found.sockets_before} before, {found.sockets_after} after they were closed"
    )


if __name__ == "__main__":
    main()
