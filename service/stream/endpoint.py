"""WebSocket endpoint ``/v1/stream``: one task per connection reads and replies; the tick loop sends poses."""

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
from service.stream.transport import TRANSPORT, StreamProtocol
from service.wire import OP_ADVERBS
from verbs.errors import VerbError

__all__ = ["SUBPROTOCOL", "route"]

SUBPROTOCOL = "adverb.v1"
MAX_CHANNEL = 65_535
TOO_MANY = 4029

log = structlog.get_logger("adverb.stream")

MAX_CONSECUTIVE = 32
"""Messages of one client that are handled before the event loop runs other tasks."""

_FINAL = {1000, 1001}
"""Close codes of a client that does not resume. 1005 is not one: a lost connection has it too."""


def route(hub: Hub) -> WebSocketRoute:
    """The route; its endpoint is plain ASGI, since every layer in between costs time per frame."""
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
            reason = "the server is stopping" if hub.draining else "the server has its maximum number of streams"
            await send({"type": "websocket.close", "code": 1012 if hub.draining else TOO_MANY, "reason": reason})
            return
        with anyio.CancelScope() as reading:
            transport: StreamProtocol | None = scope.get("extensions", {}).get(TRANSPORT)
            connection = Connection(send, reading, transport)
            reader = _Reader(hub, connection)
            if transport is not None:
                transport.on_binary = reader.handle_binary
            try:
                await reader.run(receive)
            finally:
                with anyio.CancelScope(shield=True):
                    await hub.leave(connection, for_good=reader.left)
        if connection.ending is not None:
            code, reason = connection.ending
            with (
                anyio.move_on_after(5.0),
                suppress(Exception),
            ):  # the connection may be lost
                await send({"type": "websocket.close", "code": code, "reason": reason})


class _Reader:
    """Reads and handles the messages of one connection."""

    def __init__(self, hub: Hub, connection: Connection) -> None:
        self.hub, self.connection, self.left, self._busy = hub, connection, False, True
        self.session: Session = hub.join(connection)

    async def run(self, receive: Receive) -> None:
        """Send ``hello``, then handle messages until the client disconnects."""
        self.session.send_text(
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
            self._busy = False
            message = await receive()
            self._busy = True
            if message["type"] == "websocket.disconnect":
                self.left = message.get("code") in _FINAL
                return
            await self._handle(message)
            count += 1
            if count % MAX_CONSECUTIVE == 0:
                await asyncio.sleep(0)
            await self._wait_for_reader()

    def handle_binary(self, content: bytes) -> bool:
        """Handle a binary message on arrival; False if earlier messages are pending."""
        if self._busy or self.connection.pending:
            return False
        self._set_adverbs(content)
        return True

    async def _wait_for_reader(self) -> None:
        """Wait until pending messages are sent, so that a client that does not read is not read either.

        ASGI has no event for free buffer space, so this polls.
        """
        pause, end = 0.005, time.monotonic() + self.hub.settings.stream_slow_s
        while not self.connection.flush() and not self.connection.lost:
            if time.monotonic() > end:
                self.connection.end(TOO_SLOW, f"the client read nothing for {self.hub.settings.stream_slow_s:g} s")
            await asyncio.sleep(pause)
            pause = min(2 * pause, 0.1)

    async def _handle(self, message: Any) -> None:
        content = message.get("text")
        if content is None:
            self._set_adverbs(message["bytes"])
            return
        channel = _channel_of(content)
        try:
            await self._apply(_parsed(content))
        except (ServiceError, VerbError) as err:
            self._send_error(channel, *errors.code_of(err))
        except Exception:
            log.exception("stream message failed", session=self.session.id)
            self._send_error(channel, "internal_error", "internal error; the server's log has the details")

    def _set_adverbs(self, content: bytes) -> None:
        channel: int | None = None
        try:
            channel, row = _parsed_adverbs(content)
            self.hub.set_adverbs(self.session, channel, row)
        except (ServiceError, VerbError) as err:
            self._send_error(channel, *errors.code_of(err))

    def _send_error(self, channel: int | None, code: str, detail: str) -> None:
        self.session.send_text({"op": "error", "channel": channel, "code": code, "detail": detail})

    async def _apply(self, message: Open | Set | Switch | Close | Ping | Resume) -> None:
        hub, session = self.hub, self.session
        match message:
            case Open():
                await hub.open(session, message)
            case Set():
                await hub.set(session, message)
            case Switch():
                await hub.switch(session, message)
            case Close():
                await hub.close(session, message.channel)
            case Ping():
                session.send_text({"op": "pong", "t": message.t, "server_time_ns": hub.server_time_ns()})
            case Resume():
                self.session = await hub.resume(session, message.session, message.last_seq)


def _parsed(content: str) -> Open | Set | Switch | Close | Ping | Resume:
    try:
        return CLIENT.validate_json(content)
    except ValidationError as err:
        first = err.errors(include_url=False, include_input=False)[0]
        at = ".".join(str(part) for part in first["loc"])[:200]
        raise BadMessage(f"{at}: {first['msg']}" if at else str(first["msg"])) from err


def _channel_of(content: str) -> int | None:
    """Channel of a text message, also of an invalid one."""
    try:
        channel = orjson.loads(content).get("channel")
    except (orjson.JSONDecodeError, AttributeError):
        return None
    return channel if type(channel) is int and 0 <= channel <= MAX_CHANNEL else None


def _parsed_adverbs(content: bytes) -> tuple[int, tuple[float, ...]]:
    if len(content) < 8 or len(content) % 4 or content[0] != OP_ADVERBS:
        raise BadMessage(
            f"a binary message is 0x10, 0, channel as u16, then the verb's adverbs as f32; it has {len(content)} bytes"
        )
    _, _, channel, *row = struct.unpack(f"<BBH{len(content) // 4 - 1}f", content)
    return channel, tuple(row)
