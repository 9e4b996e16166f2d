"""Reads and writes past ASGI: frames follow RFC 6455, messages keep their order, and a socket has one writer."""

import asyncio
import itertools
import json
import os
import random
import socket
import struct
import threading
import time
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue

import anyio
import pytest
import uvicorn
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.stream.connection import BINARY, DirectConnection, frame_head
from service.stream.transport import TRANSPORT, StreamProtocol
from tests.service.stream.conftest import PATIENCE_S, eventually, open_stream

pytestmark = pytest.mark.anyio

LENGTHS = [0, 1, 125, 126, 65_535, 65_536, 3_000_000]
REACH = {"x": -0.3, "y": 1.2, "z": 0.45}


def content(length):
    return (bytes(range(251)) * (length // 251 + 1))[:length]


class Posting:
    """An app that sends a message of each length from another thread, as the engine does."""

    def __init__(self):
        self.closed, self.over = threading.Event(), threading.Event()

    async def __call__(self, scope, receive, send):
        if scope["type"] != "websocket":
            return
        await receive()
        await send({"type": "websocket.accept"})
        transport = scope["extensions"][TRANSPORT]
        loop = asyncio.get_running_loop()
        connection = DirectConnection(loop, lambda: None, transport.duplicate(), transport.close_transport)
        orders = SimpleQueue()
        await transport.hand_over(_Ordered(connection, orders))
        thread = threading.Thread(target=self.post, args=(connection, orders))
        thread.start()
        while (await receive())["type"] != "websocket.disconnect":
            pass
        await anyio.to_thread.run_sync(thread.join)
        self.over.set()

    def post(self, connection, orders):
        for length in LENGTHS:
            connection.write(frame_head(BINARY, length) + content(length))
        end = time.monotonic() + PATIENCE_S
        while not connection.lost and time.monotonic() < end:
            connection.flush()
            with suppress(Empty):
                orders.get(timeout=0.002)()


class _Ordered:
    """Hands what the library writes to the thread that writes the socket."""

    def __init__(self, connection, orders):
        self.write = lambda data: orders.put(partial(connection.write, data))
        self.close = lambda: orders.put(connection.close)


@pytest.fixture
def posting():
    app = Posting()
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        config = uvicorn.Config(app, ws=StreamProtocol, ws_per_message_deflate=False, lifespan="off", log_level="error")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=lambda: server.run(sockets=[listener]))
        thread.start()
        end = time.monotonic() + PATIENCE_S
        while not server.started and time.monotonic() < end:
            time.sleep(0.01)
        app.url = f"ws://127.0.0.1:{listener.getsockname()[1]}/"
        yield app
        server.should_exit = True
        thread.join(PATIENCE_S)


async def test_messages_of_every_length_arrive_whole_and_in_order(posting):
    """The longest one fits no buffer: it is sent in parts, and nothing comes between them."""
    async with connect(posting.url, max_size=None, compression=None) as client:
        for length in LENGTHS:
            assert await asyncio.wait_for(client.recv(), PATIENCE_S) == content(length)
    assert posting.over.wait(PATIENCE_S)


async def test_the_number_of_a_lost_socket_is_not_used_again_while_it_may_be_written(server):
    async with open_stream(server) as client:
        await client.open(1, "arm3")
        await client.poses(1)
        connection = server.hub.sessions[client.hello["session"]].connection
        assert os.fstat(connection.descriptor)
    await eventually(lambda: connection.lost)
    with pytest.raises(OSError, match="Bad file descriptor"):
        connection._socket.getsockname()


async def test_adverbs_that_follow_an_open_are_those_of_the_character_it_opened(server):
    async with open_stream(server) as client:
        await client.send("open", channel=2, verb="reach", adverbs=REACH, fps=1)
        await client.set_adverbs(2, -0.2, 1.1, 0.4)
        await client.send("close", channel=2)
        await client.send("open", channel=2, verb="arm3", fps=1)
        await client.set_adverbs(2, 0.5, 0.1)
        await client.send("ping", t=1)
        await client.until("pong")
        assert [text["op"] for text in client.texts if text["op"] == "error"] == []
        channel = server.hub.sessions[client.hello["session"]].channels[2]
        assert channel.group.characters.goals[channel.slot].tolist() == pytest.approx([0.5, 0.1])


async def test_every_message_of_a_flood_of_adverbs_is_handled(server):
    async with open_stream(server) as client:
        await client.open(0, "arm3", fps=1)
        channel = server.hub.sessions[client.hello["session"]].channels[0]
        for k in range(640):
            await client.set_adverbs(0, 0.3 + 0.0001 * k, 0.2)
        last = pytest.approx([0.3 + 0.0001 * 639, 0.2])
        await eventually(lambda: channel.group.characters.goals[channel.slot].tolist() == last)


async def test_wrong_binary_messages_are_reported_in_order(server):
    async with open_stream(server) as client:
        await client.set_adverbs(7, 1.0)
        await client.socket.send(b"\x10")
        await client.socket.send(b"")
        await client.send("ping", t=1)
        await client.until("pong")
        codes = [text["code"] for text in client.texts if text["op"] == "error"]
        assert codes == ["unknown_channel", "bad_message", "bad_message"]


@pytest.mark.parametrize("pieces", [b"\xff", [b'{"op": "ping", "t"', b": 1\xc3", b"}"]], ids=["whole", "in pieces"])
async def test_text_that_is_not_utf8_ends_its_connection_and_no_other(server, pieces, caplog):
    async with open_stream(server) as other, open_stream(server) as client:
        await client.socket.send(pieces, text=True)
        with pytest.raises(ConnectionClosed) as closed:
            await client.until("never")
        assert closed.value.rcvd.code == 1007
        await other.send("ping", t=1)
        await other.until("pong")
    assert not [record for record in caplog.records if record.exc_info]


async def test_text_that_is_not_utf8_before_a_close_in_one_read_is_no_error_of_the_server(server, caplog):
    async with open_stream(server) as other, open_stream(server) as client:
        rng = random.Random(1)
        client.socket.transport.write(frame(b"\xff", 0x81, rng) + frame(b"\x03\xe8", 0x88, rng))
        with pytest.raises(ConnectionClosed):
            await client.until("never")
        await other.send("ping", t=1)
        await other.until("pong")
    assert not [record for record in caplog.records if record.exc_info]


# ── any cut of the received bytes ─────────────────────────────────────────────────────────────────────────────────


def frame(payload, first, rng):
    """A client's frame."""
    key = rng.randbytes(4)
    head = frame_head(first, len(payload))
    return bytes((head[0], head[1] | 0x80)) + head[2:] + key + bytes(b ^ key[k % 4] for k, b in enumerate(payload))


def adverbs(channel, *row):
    return struct.pack(f"<BBH{len(row)}f", 0x10, 0, channel, *row)


def many(*rows):
    return struct.pack("<BBH", 0x11, 0, len(rows)) + b"".join(
        struct.pack(f"<HH{len(row)}f", channel, 0, *row) for channel, *row in rows
    )


def messages(rng):
    """Frames of all kinds, and what an application receives of them in order."""
    sent, received = [], []
    for k in range(60):
        kind = rng.randrange(7)
        if kind in (0, 1, 2):
            row = [rng.random() for _ in range(rng.choice((1, 3)))]
            sent.append(frame(adverbs(k, *row), 0x82, rng))
            received.append(adverbs(k, *row))
        elif kind == 3:
            content = many(*((c, rng.random(), rng.random()) for c in range(rng.randrange(1, 40))))
            sent.append(frame(content, 0x82, rng))
            received.append(content)
        elif kind == 4:
            content = json.dumps({"k": k, "pad": "x" * rng.choice((0, 100, 200))})
            sent.append(frame(content.encode(), 0x81, rng))
            received.append(content)
        elif kind == 5:  # adverbs in fragments, with a ping between them
            content = adverbs(k, 0.5, 0.25)
            parts = frame(content[:5], 0x02, rng), frame(b"?", 0x89, rng), frame(content[5:], 0x80, rng)
            sent.append(b"".join(parts))
            received.append(content)
        else:
            content = rng.randbytes(rng.randrange(0, 30))
            sent.append(frame(content, 0x82, rng))
            received.append(content)
    return b"".join(sent), received


class Listening(StreamProtocol):
    """A protocol whose decoded adverbs and queued messages are collected in order."""

    def collect(self):
        self.got = []
        self.on_adverbs, self.idle = self.take, lambda: True

    def take(self, channels, values, whole):
        rows = values.reshape(len(channels), -1).tolist()
        if whole:
            self.got.append(many(*((channel, *row) for channel, row in zip(channels.tolist(), rows, strict=True))))
        else:
            self.got += [adverbs(channel, *row) for channel, row in zip(channels.tolist(), rows, strict=True)]

    def drain(self):
        """What an application would receive now."""
        while not self.queue.empty():
            message = self.queue.get_nowait()
            self.got.append(message["text"] if message.get("text") is not None else bytes(message["bytes"]))


class Silent(asyncio.Transport):
    """A transport that sends nothing."""

    def __init__(self):
        super().__init__()
        self.written = b""

    def get_extra_info(self, name, default=None):
        return default

    def set_write_buffer_limits(self, high=None, low=None):
        pass

    def write(self, data):
        self.written += data

    def is_closing(self):
        return False

    def pause_reading(self):
        pass

    def resume_reading(self):
        pass

    def close(self):
        pass


async def _nothing(scope, receive, send):
    await asyncio.Event().wait()


REQUEST = (
    b"GET / HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


@pytest.mark.parametrize("seed", range(12))
async def test_messages_come_whole_and_in_order_however_reads_cut_them(seed):
    rng = random.Random(seed)
    config = uvicorn.Config(_nothing, ws=StreamProtocol, ws_per_message_deflate=False, lifespan="off")
    config.load()
    protocol = Listening(config, uvicorn.server.ServerState(), {}, asyncio.get_running_loop())
    protocol.connection_made(Silent())
    protocol.data_received(REQUEST)
    protocol.handshake_complete = True
    await asyncio.sleep(0)
    protocol.queue.get_nowait()
    protocol.conn.send_response(protocol.response)
    protocol.conn.data_to_send()
    protocol.collect()
    data, expected = messages(rng)
    most = rng.choice((1, 7, 60, 1000, len(data)))
    cuts = sorted({0, len(data), *(rng.randrange(len(data)) for _ in range(len(data) // most))})
    for start, stop in itertools.pairwise(cuts):
        protocol.data_received(data[start:stop])
        if rng.random() < 0.5:
            protocol.drain()
    protocol.drain()
    assert protocol.got == expected
    for task in protocol.tasks:
        task.cancel()


async def test_what_the_library_writes_goes_through_the_writer(server):
    """Pings of clients are answered between pose messages, which stay whole."""
    async with open_stream(server, max_size=None) as client:
        for number in range(40):
            await client.open(number, "arm3", fps=120)
        pongs = [await client.socket.ping(str(k)) for k in range(50)]
        await client.poses(20)
        for pong in pongs:
            await asyncio.wait_for(pong, PATIENCE_S)


def test_a_writer_is_closed_once():
    left, right = socket.socketpair()
    with right:
        left.setblocking(False)
        loop, closed = asyncio.new_event_loop(), []
        connection = DirectConnection(loop, lambda: None, left, partial(closed.append, 1))
        connection.write(b"abc")
        connection.close()
        connection.close()
        connection.write(b"late")
        assert right.recv(16) == b"abc"
        assert right.recv(16) == b""
        loop.run_until_complete(asyncio.sleep(0.01))
        loop.close()
    assert closed == [1]
    assert connection.lost
