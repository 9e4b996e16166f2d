"""Targets that read what clients of streams send: messages by their functions, WebSocket frames, whole sessions."""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import uvicorn
from uvicorn.server import ServerState

from service.errors import PROBLEMS, BadMessage
from service.stream import kernels
from service.stream.endpoint import MAX_CHANNEL, _channel_of, _parsed, _parsed_adverbs
from service.stream.messages import SERVER
from service.stream.transport import TRANSPORT, StreamProtocol
from tests.fuzz.requests import Server

Run = Callable[[bytes], None]

TURNS = 8
"""Turns of the event loop after which an endpoint waits for the next message."""

TURNS_BETWEEN_PARTS = 2
"""Turns after which an accepted endpoint has read what a part completes."""

MAX_PARTS = 32
"""Most parts of one input; the last one holds the rest."""


# ── messages ─────────────────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def read_text() -> Iterator[Run]:
    """The bytes are a text message; WebSocket libraries let only UTF-8 through."""

    def run(data: bytes) -> None:
        with suppress(UnicodeDecodeError):
            text = data.decode()
            channel = _channel_of(text)
            assert channel is None or 0 <= channel <= MAX_CHANNEL
            with suppress(BadMessage):
                _parsed(text)

    yield run


_MESSAGES = (
    {"op": "open", "channel": 1, "verb": "arm", "adverbs": {"x": 0.4, "y": 0.3}, "fps": 30, "encoding": "q48"},
    {"op": "open", "channel": 2, "verb": "arm", "space": "global", "frame": "unity", "joints": ["Hand"], "loop": True},
    {"op": "set", "channel": 1, "adverbs": {"x": 1e3, "y": -1.5}, "speed": -1.0, "phase": 1, "half_life": 0.1},
    {"op": "switch", "channel": 1, "verb": "reach", "transition_s": 0.3, "adverbs": None},
    {"op": "switch", "channel": 1, "verb": "arm", "phase": 0.2, "method": "exact"},
    {"op": "view", "x": 1, "y": 2, "z": 3, "budget_kbps": 64},
    {"op": "ping", "t": 1.5},
    {"op": "resume", "session": "s", "last_seq": 7},
    {"op": "close", "channel": 1},
)


def text_seeds() -> Iterator[bytes]:
    """A message of each kind, and what is none."""
    for message in _MESSAGES:
        yield json.dumps(message).encode()
    yield b'{"op": "ping", "t": 1e999}'
    yield b'{"op": "set", "channel": 99999999999999999999, "adverbs": {"\\ud800": 1}}'
    yield b"[" * 300


@contextmanager
def read_binary() -> Iterator[Run]:
    """The bytes are a binary message."""

    def run(data: bytes) -> None:
        with suppress(BadMessage):
            channels, values, _ = _parsed_adverbs(data)
            assert len(channels) >= 1
            assert len(values) % len(channels) == 0
            assert 4 * len(values) < len(data)

    yield run


def _adverbs(channel: int, *row: float) -> bytes:
    return struct.pack(f"<BBH{len(row)}f", 0x10, 0, channel, *row)


def _many(width: int, *channels: int) -> bytes:
    rows = b"".join(struct.pack(f"<HH{width}f", channel, 0, *([0.25] * width)) for channel in channels)
    return struct.pack("<BBH", 0x11, 0, len(channels)) + rows


def binary_seeds() -> Iterator[bytes]:
    """One channel, many channels, wrong lengths."""
    yield _adverbs(1, 0.4, 0.3)
    yield _many(2, 1, 2, 3)
    yield _many(1, *range(40))
    yield _many(2, 1, 2)[:-1]
    yield b"\x11\0\0\0"


# ── frames ───────────────────────────────────────────────────────────────────────────────────────────────────────────

_HANDSHAKE = (
    b"GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class _Transport:
    """A transport that drops what is written."""

    closing = False

    def get_extra_info(self, name: str) -> Any:
        return {"peername": ("127.0.0.1", 1), "sockname": ("127.0.0.1", 80)}.get(name)

    def write(self, data: bytes) -> None:
        del data

    def close(self) -> None:
        self.closing = True

    abort = close

    def is_closing(self) -> bool:
        return self.closing

    def set_write_buffer_limits(self, **_: int) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return 0

    def pause_reading(self) -> None:
        pass

    resume_reading = pause_reading


class _Receiver:
    """An endpoint that records what arrives, by either way."""

    def __init__(self, *, direct: bool) -> None:
        self.direct = direct
        self.received: list[Any] = []

    def aim(self, channels: Any, values: Any, whole: bool) -> None:
        assert len(channels) >= 1
        assert len(values) % len(channels) == 0
        for channel, row in zip(channels, values.reshape(len(channels), -1), strict=True):  # of one message or several
            self.received.append((int(channel), row.tobytes(), whole))

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "websocket.accept"})
        transport = scope["extensions"][TRANSPORT]
        if self.direct:
            transport.idle, transport.on_adverbs = lambda: True, self.aim
        while (message := await receive())["type"] != "websocket.disconnect":
            content = message.get("text")
            if content is not None:
                self.received.append(content)
                continue
            try:
                channels, values, whole = _parsed_adverbs(message["bytes"])
            except BadMessage as err:
                self.received.append(err.detail)
            else:
                self.aim(channels, values, whole)


@contextmanager
def read_frames() -> Iterator[Run]:
    """First byte: length of the parts in which bytes arrive; the rest are frames. Both ways receive the same."""
    kernels.warm()
    loop = asyncio.new_event_loop()
    endpoints = {direct: _Receiver(direct=direct) for direct in (True, False)}
    configs = {
        direct: uvicorn.Config(
            endpoint, ws=StreamProtocol, ws_per_message_deflate=False, ws_max_size=65_536, ws_ping_interval=None,
            lifespan="off", log_config=None,
        )
        for direct, endpoint in endpoints.items()
    }  # fmt: skip
    for config in configs.values():
        config.load()

    def received(parts: list[bytes], *, direct: bool) -> tuple[list[Any], bool]:
        endpoint, state, transport = endpoints[direct], ServerState(), _Transport()
        endpoint.received = []
        protocol = StreamProtocol(configs[direct], state, {}, loop)
        protocol.connection_made(transport)  # type: ignore[arg-type]

        async def arrive() -> None:
            protocol.data_received(_HANDSHAKE)
            for _ in range(TURNS):
                await asyncio.sleep(0)
            for part in parts:
                if transport.closing:
                    break
                protocol.data_received(part)
                for _ in range(TURNS_BETWEEN_PARTS):
                    await asyncio.sleep(0)
            protocol.connection_lost(None)
            await asyncio.wait_for(asyncio.gather(*state.tasks), 60.0)

        loop.run_until_complete(arrive())
        return endpoint.received, transport.closing

    def run(data: bytes) -> None:
        length = data[0] if data and data[0] else len(data) + 1
        starts = range(1, len(data), length)[:MAX_PARTS]
        parts = [data[at : at + length] for at in starts[:-1]] + [data[at:] for at in starts[-1:]]
        (first, _), (second, failed) = (received(parts, direct=direct) for direct in (True, False))
        common = min(len(first), len(second))
        assert first[:common] == second[:common]
        assert failed or len(first) == len(second)  # what arrived with an error of the protocol may be dropped

    yield run
    loop.close()


def _frame(content: bytes, first: int = 0x82, key: bytes = b"\1\2\3\4") -> bytes:
    size = len(content)
    head = bytes([first, 0x80 | size]) if size < 126 else struct.pack("!BBH", first, 0x80 | 126, size)
    return head + key + bytes(byte ^ key[k % 4] for k, byte in enumerate(content))


def frame_seeds() -> Iterator[bytes]:
    """Adverbs alone and between texts, in parts of several lengths; fragments, pings, wrong lengths."""
    adverbs, many, text = _frame(_adverbs(1, 0.4, 0.3)), _frame(_many(2, *range(20))), _frame(b'{"op": "x"}', 0x81)
    for length in (0, 1, 7, 40):
        yield bytes([length]) + adverbs * 3 + text + many + adverbs
        yield bytes([length]) + _frame(b"\x10\0", 0x02) + _frame(b"", 0x89) + _frame(b"\1\0" + bytes(8), 0x80) + adverbs
    yield b"\0" + adverbs + struct.pack("!BBQ", 0x82, 0xFF, 1 << 40) + b"\0\0\0\0" + adverbs
    yield b"\0" + adverbs + _frame(b"\x03\xe8", 0x88) + adverbs
    yield b"\0" + adverbs + b"\x82\x04" + adverbs + b"\xc2\x80" + adverbs


# ── sessions ─────────────────────────────────────────────────────────────────────────────────────────────────────────


class _Client:
    """One connection to the endpoint, in ASGI."""

    def __init__(self, server: Server) -> None:
        self.server, self.inbox, self.sent = server, asyncio.Queue[Any](), list[Any]()
        scope = {
            **{"type": "websocket", "path": "/v1/stream", "raw_path": b"/v1/stream", "query_string": b"", "state": {}},
            **{"headers": [(b"host", b"localhost")], "scheme": "ws", "subprotocols": ["adverb.v1"], "root_path": ""},
            **{"client": ("127.0.0.1", 1), "server": ("localhost", 80)},
        }
        self.inbox.put_nowait({"type": "websocket.connect"})
        self.task = server.loop.create_task(server.app(scope, self.inbox.get, self._send))
        self._turn()

    async def _send(self, message: Any) -> None:
        self.sent.append(message)

    def _turn(self) -> None:
        async def turns() -> None:
            for _ in range(TURNS):
                await asyncio.sleep(0)
                self.server.app.state.server.hub.engine.handle(1.0)

        self.server.loop.run_until_complete(turns())

    def give(self, **message: Any) -> None:
        """Let a message arrive; the replies have documented fields and codes."""
        self.sent.clear()
        self.inbox.put_nowait(message)
        self._turn()
        for text in (sent["text"] for sent in self.sent if sent.get("text")):
            SERVER.validate_json(text)
            content = json.loads(text)
            assert content["op"] != "error" or content["code"] in PROBLEMS
            assert content.get("code") != "internal_error"


def _tick(server: Server, seconds: float) -> None:
    """Let time pass, and send the tick that is due."""
    hub = server.app.state.server.hub
    hub.ticks.origin_s -= seconds
    hub.idle(time.monotonic())
    start_s = hub.start_s()
    if start_s is not None and start_s <= time.monotonic():
        hub.send(hub.prepare())


@contextmanager
def serve_session() -> Iterator[Run]:
    """Rows of kind (text, binary, time), length (u16) and content, by one client, which then leaves for good."""
    with Server(stream_channels=3) as server:
        kernels.warm()
        hub = server.app.state.server.hub

        def run(data: bytes) -> None:
            client, at, count = _Client(server), 0, 0
            while at + 3 <= len(data) and count < 32:
                kind, content = data[at] % 3, data[at + 3 : at + 3 + int.from_bytes(data[at + 1 : at + 3], "little")]
                at, count = at + 3 + len(content), count + 1
                if kind == 0:
                    client.give(type="websocket.receive", text=content.decode("utf-8", "replace"))
                elif kind == 1:
                    client.give(type="websocket.receive", bytes=content)
                else:
                    _tick(server, 0.01 * (content[0] if content else 1))
                assert not client.task.done()
                assert hub.characters <= 3
            client.give(type="websocket.disconnect", code=1000)
            assert client.task.done()
            assert not hub.sessions
            assert hub.characters == 0

        for data in session_seeds():  # compiles kernels
            run(data)
        yield run


def session_seeds() -> Iterator[bytes]:
    """A character that is opened, aimed, switched and closed, with ticks between."""

    def rows(*contents: tuple[int, bytes]) -> bytes:
        return b"".join(struct.pack("<BH", kind, len(content)) + content for kind, content in contents)

    texts = [(0, json.dumps(message).encode()) for message in _MESSAGES]
    time_passes = (2, b"\x05")
    yield rows(*texts)
    yield rows(*(part for text in texts for part in (text, time_passes)))
    yield rows(
        texts[0], time_passes, (1, _adverbs(1, 0.4, 0.3)), time_passes, (1, _many(2, 1, 2)), time_passes, texts[-1]
    )
    yield rows(texts[1], time_passes, texts[5], (2, b"\xff"), texts[3], time_passes)
