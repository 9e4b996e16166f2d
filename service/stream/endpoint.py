"""WebSocket endpoint ``/v1/stream``: one task per connection reads and hands over commands; the engine replies."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from functools import partial
from typing import Any

import anyio
import numpy as np
import orjson
import structlog
from pydantic import ValidationError
from starlette.routing import WebSocketRoute
from starlette.types import Receive, Scope, Send

from service.access.access import ANYONE, CALLER, Access, Caller
from service.access.limits import Limits, address_of
from service.errors import BadMessage, TooManyStreams, mistakes_of
from service.stream.connection import TOO_SLOW, Connection, DirectConnection, LoopConnection
from service.stream.hub import Hub
from service.stream.kernels import U16
from service.stream.messages import CLIENT
from service.stream.transport import TRANSPORT, StreamProtocol
from service.tracing import SCOPE_KEY
from service.wire import OP_ADVERBS, OP_MANY
from verbs.conventions import F32

__all__ = ["SUBPROTOCOL", "route"]

SUBPROTOCOL = "adverb.v1"
MAX_CHANNEL = 65_535
TOO_MANY, RESTARTING = 4029, 1012

MAX_CONSECUTIVE = 32
"""Messages of one client that are read before the event loop runs other tasks."""

MAX_TEXT = 2_048
"""Characters of a text message that count as one message there: a long one takes up to a millisecond."""

MAX_BACKLOG = 64
"""Messages of one client that wait for the engine before its next ones are left unread."""

log = structlog.get_logger("adverb.stream")

_FINAL = {1000, 1001}
"""Close codes of a client that does not resume. 1005 is not one: a lost connection has it too."""


def route(hub: Hub, access: Access, limits: Limits) -> WebSocketRoute:
    """The route; its endpoint is plain ASGI, since every layer in between costs time per frame."""
    return WebSocketRoute("/v1/stream", _Endpoint(hub, access, limits), name="stream")


class _Endpoint:
    def __init__(self, hub: Hub, access: Access, limits: Limits) -> None:
        self._hub, self._access, self._limits = hub, access, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        hub = self._hub
        await receive()  # websocket.connect
        offered = scope.get("subprotocols", [])
        request_id = scope[SCOPE_KEY].request_id
        accept: dict[str, Any] = {"type": "websocket.accept", "headers": [(b"x-request-id", request_id.encode())]}
        if SUBPROTOCOL in offered:
            accept["subprotocol"] = SUBPROTOCOL
        await send(accept)
        if hub.draining or hub.full:
            reason = "the server is stopping" if hub.draining else "the server has its maximum number of streams"
            code = RESTARTING if hub.draining else TOO_MANY
            hub.metrics.count_close(code)
            await send({"type": "websocket.close", "code": code, "reason": reason})
            return
        caller = scope.get(CALLER, ANYONE)
        hub.connections += 1
        try:
            with self._limits.stream(caller, address_of(scope)):
                connection = await self._serve(caller, scope, receive, send)
        except TooManyStreams as err:
            hub.metrics.count_close(TOO_MANY)
            await send({"type": "websocket.close", "code": TOO_MANY, "reason": err.detail})
            return
        finally:
            hub.connections -= 1
        if connection.ending is not None:
            code, reason = connection.ending
            hub.metrics.count_close(code)
            if code != RESTARTING:  # else all streams of the server are closed
                log.info("stream closed by the server", code=code, reason=reason, key=caller.id)
            with (
                anyio.move_on_after(5.0),
                suppress(Exception),
            ):  # the connection may be lost
                await send({"type": "websocket.close", "code": code, "reason": reason})

    async def _serve(self, caller: Caller, scope: Scope, receive: Receive, send: Send) -> Connection:
        hub = self._hub
        with anyio.CancelScope() as reading:
            transport: StreamProtocol | None = scope.get("extensions", {}).get(TRANSPORT)
            connection = await _connection(hub, transport, send, reading)
            reader = _Reader(hub, connection)
            hub.post(hub.join, connection, caller.id, scope[SCOPE_KEY].request_id)
            if transport is not None:
                transport.idle, transport.on_adverbs = reader.idle, reader.aim
            try:
                with self._access.watching(caller, connection.end):
                    await reader.run(receive)
            finally:
                if transport is not None:
                    transport.on_adverbs = None
                hub.post(hub.leave, connection, reader.left)
        return connection


async def _connection(hub: Hub, transport: StreamProtocol | None, send: Send, reading: anyio.CancelScope) -> Connection:
    """The sending side: direct where the socket can be duplicated, else by the event loop."""
    loop = asyncio.get_running_loop()
    copy = transport.duplicate() if transport is not None else None
    if transport is None or copy is None:
        return LoopConnection(loop, reading.cancel, send)
    connection = DirectConnection(loop, reading.cancel, copy, transport.close_transport)
    await transport.hand_over(_Writer(hub, connection))
    return connection


class _Writer:
    """Hands what the WebSocket library writes to the engine."""

    def __init__(self, hub: Hub, connection: DirectConnection) -> None:
        self.write = partial(hub.post, hub.write, connection)
        self.close = partial(hub.post, hub.close_connection, connection)


class _Reader:
    """Reads the messages of one connection, and hands them to the engine."""

    def __init__(self, hub: Hub, connection: Connection) -> None:
        self.hub, self.connection, self.left = hub, connection, False

    async def run(self, receive: Receive) -> None:
        """Read messages until the client disconnects."""
        count = 0
        while True:
            message = await receive()
            if message["type"] == "websocket.disconnect":
                self.left = message.get("code") in _FINAL
                return
            self._hand_over(message)
            text = message.get("text")
            count += 1 if text is None else 1 + len(text) // MAX_TEXT
            if count >= MAX_CONSECUTIVE:
                count = 0
                await asyncio.sleep(0)
            await self._wait()

    def idle(self) -> bool:
        """Whether adverbs may be handed over on arrival: few messages wait for the engine, and the client reads."""
        connection = self.connection
        return connection.backlog < MAX_BACKLOG and not connection.pending

    def aim(self, channels: U16, values: F32, whole: bool) -> None:
        """Hand over adverbs."""
        self.connection.posted += 1
        self.hub.post(self.hub.aim, self.connection, channels, values, whole, wake=False)

    async def _wait(self) -> None:
        """Wait until the engine has handled most messages and pending ones are sent.

        So a client that does not read is not read either. This polls: sockets and the engine have no event for it.
        """
        pause, end = 0.0005, time.monotonic() + self.hub.settings.stream_slow_s
        connection = self.connection
        while (connection.backlog >= MAX_BACKLOG or connection.pending) and not connection.lost:
            if connection.pending and time.monotonic() > end:
                connection.end(TOO_SLOW, f"the client read nothing for {self.hub.settings.stream_slow_s:g} s")
            await asyncio.sleep(pause)
            pause = min(2 * pause, 0.1)

    def _hand_over(self, message: Any) -> None:
        content, channel = message.get("text"), None
        parsed: Any
        try:
            if content is None:
                channels, values, whole = _parsed_adverbs(message["bytes"])
                self.aim(channels, values, whole)
                return
            channel = _channel_of(content)
            parsed = _parsed(content)
        except BadMessage as err:
            parsed = err
        self.connection.posted += 1
        self.hub.post(self.hub.handle, self.connection, channel, parsed)


def _parsed(content: str) -> Any:
    try:
        return CLIENT.validate_json(content)
    except ValidationError as err:
        first = mistakes_of(err)[0]
        at = ".".join(str(part) for part in first["loc"])[:200]
        raise BadMessage(f"{at}: {first['msg']}" if at else str(first["msg"])) from err


def _channel_of(content: str) -> int | None:
    """Channel of a text message, also of an invalid one."""
    try:
        channel = orjson.loads(content).get("channel")
    except (orjson.JSONDecodeError, AttributeError):
        return None
    return channel if type(channel) is int and 0 <= channel <= MAX_CHANNEL else None


def _parsed_adverbs(content: bytes) -> tuple[U16, F32, bool]:
    """Channels (rows,), adverbs (rows · D,) of a binary message, and whether it is one of many channels."""
    op = content[0] if content else None
    if op == OP_ADVERBS and len(content) >= 8 and len(content) % 4 == 0:
        return np.frombuffer(content, "<u2", 1, 2).copy(), np.frombuffer(content, "<f4", -1, 4).copy(), False
    if op == OP_MANY and len(content) >= 4:
        count = int.from_bytes(content[2:4], "little")
        width = (len(content) - 4) // max(count, 1) // 4 - 1
        if count and width >= 1 and len(content) == 4 + count * (4 + 4 * width):
            rows = np.frombuffer(
                content, np.dtype([("channel", "<u2"), ("zero", "<u2"), ("row", "<f4", (width,))]), count, 4
            )
            return rows["channel"].copy(), rows["row"].reshape(-1).copy(), True
    raise BadMessage(
        "a binary message is 0x10, 0, channel as u16, then the verb's adverbs as f32; or 0x11, 0, a count as u16, then "
        f"so many rows of channel as u16, 0 as u16 and adverbs as f32; it has {len(content)} bytes"
    )
