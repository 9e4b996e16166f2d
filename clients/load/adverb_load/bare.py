"""A minimal stream server: one loop that sends the same bytes to every socket, without animation.

Its cost is the lower bound for any server on the same web server. Run it with ``python -m adverb_load.bare``.
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

import numpy as np
import uvicorn
from adverb_client.records import F32, record_dtype
from adverb_client.wire import MESSAGE_HEADER, POSES, WIRE

from adverb_load.websocket import SUBPROTOCOL

__all__ = ["Bare"]

Message = Mapping[str, Any]
Send = Callable[[Message], Awaitable[None]]
Receive = Callable[[], Awaitable[Message]]


class Bare:
    """An ASGI app with the part of the stream protocol that the load client needs.

    Parameters
    ----------
    record : bytes
        The record of every socket at every tick.
    opened : str
        The answer to every ``open``.
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
        await send({"type": "websocket.send", "text": json.dumps(self._hello())})
        try:
            while (message := await receive())["type"] != "websocket.disconnect":
                if message.get("text") is not None:
                    await self._answer(json.loads(message["text"]), send)
        finally:
            self._sends.discard(send)

    def _hello(self) -> Message:
        now_ns = self._epoch_ns + time.monotonic_ns()
        return {"op": "hello", "session": "bare", "server_time_ns": now_ns, "max_channels": 1, "grace_s": 0.0}

    async def _answer(self, message: Message, send: Send) -> None:
        if message["op"] == "open":
            await send({"type": "websocket.send", "text": self._opened})
            self._sends.add(send)
        elif message["op"] == "ping":
            pong = {"op": "pong", "t": message["t"], "server_time_ns": self._epoch_ns + time.monotonic_ns()}
            await send({"type": "websocket.send", "text": json.dumps(pong)})

    async def _tick(self) -> None:
        """Send the same bytes to all sockets, ``fps`` times per second, on an absolute schedule."""
        start, tick = time.monotonic(), 0
        while True:
            tick = max(tick + 1, int((time.monotonic() - start) * self._fps))  # missed ticks are skipped
            due_s = start + tick / self._fps
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            due_ns = self._epoch_ns + int(due_s * 1e9)
            message = {
                "type": "websocket.send",
                "bytes": MESSAGE_HEADER.pack(POSES, WIRE, 1, tick & 0xFFFFFFFF, due_ns, 0) + self._record,
            }
            for send in list(self._sends):
                try:
                    send(message).send(None)  # type: ignore[attr-defined]
                except StopIteration:
                    continue
                except Exception:
                    self._sends.discard(send)


def record_of(joints: int) -> bytes:
    """A record of f32 with identity rotations."""
    record = np.zeros(1, record_dtype(F32, joints))
    record["version"], record["duration"] = 1, 1.0
    record["rotations"][..., 3] = 1.0
    return record.tobytes()


def opened_of(joints: int, fps: int) -> str:
    """The ``opened`` message of a channel with a number of joints."""
    names = [f"joint{k}" for k in range(joints)]
    skeleton = {"names": names, "parents": list(range(-1, joints - 1)), "offsets": [[0.0, 0.0, 0.0]] * joints}
    message = {"op": "opened", "channel": 0, "verb": "bare", "version": 1, "method": "none", "skeleton": skeleton}
    message |= {"adverbs": [], "joints": names, "encoding": "f32", "space": "local", "frame": "gltf", "fps": fps}
    message |= {"looping": True, "keytimes": [], "follow": None, "resumed": False}
    return json.dumps(message | {"record_bytes": len(record_of(joints))})


def main() -> None:
    """Serve until a signal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", type=int, default=22, help="joints of the record (%(default)s)")
    parser.add_argument("--fps", type=int, default=60, help="ticks per second (%(default)s)")
    chosen = parser.parse_args()
    app = Bare(record_of(chosen.joints), opened_of(chosen.joints, chosen.fps), chosen.fps)
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
    listener.listen(2048)  # before it reports that it is ready
    sys.stderr.write(f"bare server is ready on http://127.0.0.1:{listener.getsockname()[1]} (no animation)\n")
    sys.stderr.flush()
    with listener:
        uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    main()
