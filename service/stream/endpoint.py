"""Streams: ``WS /v1/stream``. One task per connection reads and answers; the tick loop writes poses."""

from __future__ import annotations

import asyncio
import struct
import time
from contextlib import suppress
from typing import Any

import anyio
import orjson
import structlog
from pydantic import ValidationError
from starlette.routing import WebSocketRoute
from starlette.types import Receive, Scope, Send

from service import errors
from service.errors import BadMessage, ServiceError
from service.stream.connection import TOO_SLOW, Connection
from service.stream.hub import Hub
from service.stream.messages import CLIENT, Close, Open, Ping, Resume, Set, Switch
from service.stream.session import Session
from service.stream.transport import SOCKET, Sockets
from verbs.errors import VerbError

__all__ = ["SUBPROTOCOL", "route"]

SUBPROTOCOL = "adverb.v1"
OP_AIM = 0x10
MAX_CHANNEL = 65_535
TOO_MANY = 4029

log = structlog.get_logger("adverb.stream")

TURN = 32
"""Messages of one client after which the others get a turn."""

_LEFT = {1000, 1001}
"""Codes with which a client says that it does not come back. 1005 is no such: a lost connection has it too."""


def route(hub: Hub) -> WebSocketRoute:
    """The route; its endpoint speaks ASGI, since every layer in between would be paid per frame."""
    return WebSocketRoute("/v1/stream", _Endpoint(hub), name="stream")


class _Endpoint:
    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        hub = self._hub
        await receive()  # websocket.connect
        offered = scope.get("subprotocols", [])
        accept: dict[str, Any] = {"type": "websocket.accept"}
        if SUBPROTOCOL in offered:
            accept["subprotocol"] = SUBPROTOCOL
        await send(accept)
        if hub.draining or hub.full:
            reason = "the server is stopping" if hub.draining else "the server holds as many streams as it may"
            await send({"type": "websocket.close", "code": 1012 if hub.draining else TOO_MANY, "reason": reason})
            return
        with anyio.CancelScope() as reading:
            socket: Sockets | None = scope.get("extensions", {}).get(SOCKET)
            connection = Connection(send, reading, socket)
            talk = _Talk(hub, connection)
            if socket is not None:
                socket.hear = talk.hear
            try:
                await talk.listen(receive)
            finally:
                with anyio.CancelScope(shield=True):
                    await hub.leave(connection, for_good=talk.left)
        if connection.ending is not None:
            code, reason = connection.ending
            with anyio.move_on_after(5.0), suppress(Exception):  # the client may be gone, in one of several ways
                await send({"type": "websocket.close", "code": code, "reason": reason})


class _Talk:
    """One connection's conversation."""

    def __init__(self, hub: Hub, connection: Connection) -> None:
        self.hub, self.connection, self.left, self._answering = hub, connection, False, True
        self.session: Session = hub.join(connection)

    async def listen(self, receive: Receive) -> None:
        """Say hello, then do what the client asks until it leaves."""
        self.session.say(
            {
                "op": "hello",
                "session": self.session.id,
                "server_time_ns": self.hub.server_time_ns(),
                "max_channels": self.hub.settings.stream_channels,
                "grace_s": self.hub.settings.stream_grace_s,
            }
        )
        count = 0
        while True:
            self._answering = False
            message = await receive()
            self._answering = True
            if message["type"] == "websocket.disconnect":
                self.left = message.get("code") in _LEFT
                return
            await self._hear(message)
            count += 1
            if count % TURN == 0:
                await asyncio.sleep(0)
            await self._breathe()

    def hear(self, content: bytes) -> bool:
        """Do what a binary message asks, right as it comes; False where others come first."""
        if self._answering or self.connection.waiting:
            return False
        self._aim(content)
        return True

    async def _breathe(self) -> None:
        """Do not read faster than the client reads. Nothing tells when there is room again, so this looks."""
        pause, end = 0.005, time.monotonic() + self.hub.settings.stream_slow_s
        while not self.connection.flush() and not self.connection.gone:
            if time.monotonic() > end:
                self.connection.end(TOO_SLOW, f"nothing was read for {self.hub.settings.stream_slow_s:g} s")
            await asyncio.sleep(pause)
            pause = min(2 * pause, 0.1)

    async def _hear(self, message: Any) -> None:
        content = message.get("text")
        if content is None:
            self._aim(message["bytes"])
            return
        channel = _about(content)
        try:
            await self._do(_parsed(content))
        except (ServiceError, VerbError) as err:
            self._complain(channel, *errors.code_of(err))
        except Exception:
            log.exception("stream message failed", session=self.session.id)
            self._complain(channel, "internal_error", "something went wrong inside the server; its log says what")

    def _aim(self, content: bytes) -> None:
        channel: int | None = None
        try:
            channel, row = _aimed(content)
            self.hub.aim(self.session, channel, row)
        except (ServiceError, VerbError) as err:
            self._complain(channel, *errors.code_of(err))

    def _complain(self, channel: int | None, code: str, detail: str) -> None:
        self.session.say({"op": "error", "channel": channel, "code": code, "detail": detail})

    async def _do(self, asked: Open | Set | Switch | Close | Ping | Resume) -> None:
        hub, session = self.hub, self.session
        match asked:
            case Open():
                await hub.open(session, asked)
            case Set():
                await hub.set(session, asked)
            case Switch():
                await hub.switch(session, asked)
            case Close():
                await hub.close(session, asked.channel)
            case Ping():
                session.say({"op": "pong", "t": asked.t, "server_time_ns": hub.server_time_ns()})
            case Resume():
                self.session = await hub.resume(session, asked.session, asked.last_seq)


def _parsed(content: str) -> Open | Set | Switch | Close | Ping | Resume:
    try:
        return CLIENT.validate_json(content)
    except ValidationError as err:
        first = err.errors(include_url=False, include_input=False)[0]
        at = ".".join(str(part) for part in first["loc"])[:200]
        raise BadMessage(f"{at}: {first['msg']}" if at else str(first["msg"])) from err


def _about(content: str) -> int | None:
    """The channel that a message is about, whatever else is wrong with it."""
    try:
        channel = orjson.loads(content).get("channel")
    except (orjson.JSONDecodeError, AttributeError):
        return None
    return channel if type(channel) is int and 0 <= channel <= MAX_CHANNEL else None


def _aimed(content: bytes) -> tuple[int, tuple[float, ...]]:
    if len(content) < 8 or len(content) % 4 or content[0] != OP_AIM:
        raise BadMessage(
            f"a binary message is 0x10, 0, channel as u16, then the verb's adverbs as f32; {len(content)} bytes came"
        )
    _, _, channel, *row = struct.unpack(f"<BBH{len(content) // 4 - 1}f", content)
    return channel, tuple(row)
