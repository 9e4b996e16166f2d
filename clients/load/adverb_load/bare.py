"""The least a stream server can be: one loop that sends the same bytes to every socket, without any animation.

What it costs is the floor for everything that is built on the same web server. ``python -m adverb_load.bare`` runs it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import sys
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import uvicorn

from adverb_load.records import HEADER, POSES, WIRE
from adverb_load.websocket import SUBPROTOCOL

__all__ = ["Bare"]

Message = Mapping[str, Any]
Send = Callable[[Message], Awaitable[None]]
Receive = Callable[[], Awaitable[Message]]


class Bare:
    """An ASGI app that speaks as much of the stream as the load's client needs.

    Parameters
    ----------
    record : bytes
        The record that every socket gets in every tick.
    opened : str
        The answer to whatever a client opens.
    fps : int
    """

    def __init__(self, record: bytes, opened: str, fps: int) -> None:
        self._record, self._opened, self._fps = record, opened, fps
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._sends: set[Send] = set()
        self._joining: list[Send] = []
        self._ticking: asyncio.Task[None] | None = None

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "websocket":
            return
        if self._ticking is None:
            self._ticking = asyncio.create_task(self._tick())
        await receive()
        await send({"type": "websocket.accept", "subprotocol": SUBPROTOCOL})
        await send({"type": "websocket.send", "text": json.dumps({"op": "hello", "session": "bare"})})
        try:
            while (message := await receive())["type"] != "websocket.disconnect":
                if message.get("text") is not None:
                    await self._answer(json.loads(message["text"]), send)
        finally:
            self._sends.discard(send)

    async def _answer(self, asked: Message, send: Send) -> None:
        if asked["op"] == "open":
            await send({"type": "websocket.send", "text": self._opened})
            self._sends.add(send)
        elif asked["op"] == "ping":
            pong = {"op": "pong", "t": asked["t"], "server_time_ns": self._epoch_ns + time.monotonic_ns()}
            await send({"type": "websocket.send", "text": json.dumps(pong)})

    async def _tick(self) -> None:
        """Send the same bytes to everybody, ``fps`` times a second, on an absolute schedule."""
        start, tick = time.monotonic(), 0
        while True:
            tick = max(tick + 1, int((time.monotonic() - start) * self._fps))  # what was missed is not made up for
            due_s = start + tick / self._fps
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            due_ns = self._epoch_ns + int(due_s * 1e9)
            message = {
                "type": "websocket.send",
                "bytes": HEADER.pack(POSES, WIRE, 1, tick & 0xFFFFFFFF, due_ns, 0) + self._record,
            }
            for send in list(self._sends):
                try:
                    send(message).send(None)  # type: ignore[attr-defined]
                except StopIteration:
                    continue
                except Exception:
                    self._sends.discard(send)


def main() -> None:
    """Serve until told to stop: two files name the record and the answer to `open`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", required=True, help="the record, hexadecimal")
    parser.add_argument("--opened", required=True, help="the answer to `open`, JSON")
    parser.add_argument("--fps", type=int, default=60)
    chosen = parser.parse_args()
    app = Bare(bytes.fromhex(chosen.record), chosen.opened, chosen.fps)
    config = uvicorn.Config(
        app,
        loop="uvloop",
        http="httptools",
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=65_536,
        ws_ping_interval=20.0,
        access_log=False,
        log_config=None,
        log_level="warning",
        server_header=False,
        lifespan="off",
        timeout_graceful_shutdown=2,
    )
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.bind(("127.0.0.1", 0))
    listener.listen(2048)  # before it says that it is ready
    sys.stderr.write(f"bare server is ready on http://127.0.0.1:{listener.getsockname()[1]} (no animation)\n")
    sys.stderr.flush()
    with listener:
        uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    main()
