"""A real server on a real socket, and a client that reads the wire as docs/wire.md states it."""

import asyncio
import json
import socket
import struct
import threading
import time
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
from websockets.asyncio.client import connect

from service import packing
from service.app import create_app
from service.run.server import Server as Uvicorn
from service.run.server import config_of
from service.settings import Settings
from service.stream import kernels
from tests.warm import Sandboxes, Workers

HEADER = struct.Struct("<BBHIQI")
HEAD = struct.Struct("<HBBI4f")
PATIENCE_S = 60.0


class Server:
    """uvicorn with the settings of `adverb serve`, in a thread of its own."""

    def __init__(self, catalog, **settings):
        self.settings = Settings(**settings)
        self.workers = Workers()
        self.app = create_app(self.settings, supervise=self.workers.supervise, sandboxes=Sandboxes())
        self.state = self.app.state.server

        async def loaded():
            self.loop = asyncio.get_running_loop()
            packing.warm()
            kernels.warm()
            self.state.set_catalog(catalog)

        self.state.run = loaded
        self.socket = socket.socket()
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.uvicorn = Uvicorn(config_of(self.app, self.settings), self.state.hub)
        self.thread = threading.Thread(target=lambda: self.uvicorn.run(sockets=[self.socket]))

    def start(self, patience_s=PATIENCE_S):
        self.thread.start()
        end = time.monotonic() + patience_s
        while not (self.uvicorn.started and self.state.ready.is_set()) and time.monotonic() < end:
            time.sleep(0.01)
        return self

    def stop(self):
        self.uvicorn.should_exit = True
        self.thread.join(PATIENCE_S)
        self.socket.close()

    def call(self, what, *arguments):
        """Call something in the server's own thread."""
        self.loop.call_soon_threadsafe(what, *arguments)

    @property
    def hub(self):
        return self.state.hub

    @property
    def url(self):
        return f"ws://127.0.0.1:{self.port}/v1/stream"


@pytest.fixture(scope="module")
def server(serve):
    with serve() as server:
        yield server


@dataclass
class Record:
    """One record, decoded by the specification."""

    channel: int
    encoding: int
    flags: int
    version: int
    phase: float
    time: float
    error: float
    duration: float
    root: np.ndarray | None
    rotations: np.ndarray | None
    weights: np.ndarray | None


@dataclass
class Message:
    sequence: int
    time_ns: int
    dropped: int
    records: list[Record]
    arrived_ns: int = 0

    def of(self, channel):
        return next((one for one in self.records if one.channel == channel), None)


@dataclass
class Client:
    """One connection. ``texts`` and ``frames`` hold what came, in order."""

    socket: object
    texts: list = field(default_factory=list)
    frames: list = field(default_factory=list)
    joints: dict = field(default_factory=dict)
    lengths: dict = field(default_factory=dict)

    async def send(self, op, **fields):
        await self.socket.send(json.dumps({"op": op, **fields}))

    async def set_adverbs(self, channel, *adverbs):
        await self.socket.send(struct.pack(f"<BBH{len(adverbs)}f", 0x10, 0, channel, *adverbs))

    async def read(self):
        """The next message: a mapping, or a Message."""
        content = await asyncio.wait_for(self.socket.recv(), PATIENCE_S)
        if isinstance(content, str):
            message = json.loads(content)
            self.texts.append(message)
            if message["op"] in ("opened", "version"):
                self.lengths[message["channel"]] = message["record_bytes"]
            if message["op"] == "opened":
                self.joints[message["channel"]] = len(message["joints"])
            return message
        frame = self.decode(content)
        frame.arrived_ns = time.time_ns()
        self.frames.append(frame)
        return frame

    async def until(self, op, **fields):
        """Read up to the next text message with these fields."""
        while True:
            message = await self.read()
            if isinstance(message, dict) and message["op"] == op and fields.items() <= message.items():
                return message

    async def poses(self, count, channel=None):
        """The next pose messages (those with a channel, where one is named)."""
        found = []
        while len(found) < count:
            message = await self.read()
            if isinstance(message, Message) and (channel is None or message.of(channel)):
                found.append(message)
        return found

    async def for_seconds(self, seconds):
        """Whatever comes in so many seconds."""
        end = asyncio.get_running_loop().time() + seconds
        while (left := end - asyncio.get_running_loop().time()) > 0:
            try:
                await asyncio.wait_for(self.read(), left)
            except TimeoutError:
                return

    async def open(self, channel, verb, **fields):
        await self.send("open", channel=channel, verb=verb, **fields)
        return await self.until("opened", channel=channel)

    def decode(self, content):
        op, wire, count, sequence, time_ns, dropped = HEADER.unpack_from(content)
        assert (op, wire) == (1, 1)
        at, records = HEADER.size, []
        for _ in range(count):
            head = HEAD.unpack_from(content, at)
            length = self.lengths[head[0]]
            records.append(
                Record(*head, *payload(head[1], content[at + HEAD.size : at + length], self.joints[head[0]]))
            )
            at += length
        assert at == len(content)
        return Message(sequence, time_ns, dropped, records)


def payload(encoding, content, joints):
    """Root, rotations, weights of a payload."""
    if encoding == 2:
        (count, zero) = struct.unpack_from("<HH", content)
        assert zero == 0
        return None, None, np.frombuffer(content, "<f4", count, 4)
    root = np.frombuffer(content, "<f4", 3)
    if encoding == 0:
        return root, np.frombuffer(content, "<f4", 4 * joints, 12).reshape(joints, 4), None
    halves = np.frombuffer(content, "<u2", 3 * joints, 12).reshape(joints, 3)
    assert not content[12 + 6 * joints :].strip(b"\0")
    return root, np.array([rotation(*row) for row in halves.tolist()]), None


def rotation(a, b, c):
    left_out = (a >> 15) + 2 * (b >> 15)
    assert c < 32_768
    three = [((v & 0x7FFF) - 16_383) / (16_383 * 2**0.5) for v in (a, b, c)]
    largest = max(0.0, 1.0 - sum(v * v for v in three)) ** 0.5
    return [*three[:left_out], largest, *three[left_out:]]


@asynccontextmanager
async def open_stream(server, **options):
    """A connection that has been greeted."""
    async with connect(server.url, subprotocols=["adverb.v1"], compression=None, max_queue=None, **options) as socket:
        client = Client(socket)
        client.hello = await client.until("hello")
        yield client


async def eventually(holds):
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end, "it never came"
        await asyncio.sleep(0.01)
