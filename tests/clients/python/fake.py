"""A small stream server that speaks the documented bytes over a real socket, with faults on request."""

from __future__ import annotations

import asyncio
import json
import math
import struct
import threading
import time
from collections.abc import Callable
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from tests.clients.python.specimen import Rec, message, record_bytes

ENCODINGS = {"f32": 0, "q48": 1, "weights": 2, "q32": 3}
NAMES, PARENTS = ["Hips", "Spine", "Hand"], [-1, 0, 1]
OFFSETS = [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.3, 0.0, 0.0]]


@dataclass
class FakeVerb:
    adverbs: dict[str, tuple[float, float]]
    names: list[str] = field(default_factory=lambda: NAMES)
    parents: list[int] = field(default_factory=lambda: PARENTS)
    offsets: list[list[float]] = field(default_factory=lambda: OFFSETS)
    duration: float = 1.0
    looping: bool = True
    examples: int = 5
    pose: Callable[[list[float], float], tuple[Any, Any, float]] | None = (
        None  # adverbs, phase → root, rotations, error
    )


VERBS = {
    "reach": FakeVerb({"x": (-1.0, 1.0), "y": (0.0, 2.0), "z": (0.0, 1.0)}),
    "board": FakeVerb({"u": (-0.5, 0.5), "v": (-0.5, 0.5)}),
    "once": FakeVerb({"x": (-1.0, 1.0)}, duration=0.1, looping=False),
}


@dataclass
class FakeChannel:
    number: int
    verb: str
    adverbs: list[float]
    encoding: int = 0
    fps: float = 60.0
    phase: float = 0.0
    speed: float = 1.0
    play: bool = True
    ended: bool = False

    def record(self, verbs: dict[str, FakeVerb]) -> Rec:
        verb = verbs[self.verb]
        if verb.pose is None:  # root x is the first adverb, the phase turns the first joint
            half = math.pi * self.phase
            turns = [(0.0, math.sin(half), 0.0, math.cos(half))] + [(0.0, 0.0, 0.0, 1.0)] * (len(verb.names) - 1)
            root, error = (self.adverbs[0], 1.0, self.phase), 0.25
        else:
            root, turns, error = verb.pose(self.adverbs, self.phase)
        share = [1.0 / verb.examples] * verb.examples
        flags = 8 if self.ended else 0
        times = {"phase": self.phase, "time": self.phase * verb.duration, "duration": verb.duration, "error": error}
        return Rec(
            self.number, self.encoding, flags, 1, root=tuple(root), rotations=list(turns), weights=share, **times
        )


@dataclass
class FakeSession:
    name: str
    channels: dict[int, FakeChannel] = field(default_factory=dict)
    sequence: int = 0
    dropped: int = 0


class FakeServer:
    """One server process; forget() simulates a restarted one."""

    def __init__(self, verbs: dict[str, FakeVerb] | None = None) -> None:
        self.verbs = verbs or VERBS
        self.sessions: dict[str, FakeSession] = {}
        self.sockets: set[ServerConnection] = set()
        self.messages: list[Any] = []  # all messages of clients
        self.mute: set[str] = set()  # ops without an answer
        self.close_code: int | None = None  # a close code instead of hello
        self.refused = 0  # connections that were closed with it
        self.protocols = ["adverb.v1"]
        self.port, self.not_ready, self._count, self.skew_ns = 0, 0, 0, 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def received(self, op: str) -> list[dict[str, Any]]:
        return [row for row in self.messages if isinstance(row, dict) and row["op"] == op]

    def now_ns(self) -> int:
        return time.time_ns() + self.skew_ns

    async def handle(self, socket: ServerConnection) -> None:
        if self.close_code is not None:
            self.refused += 1
            await socket.close(self.close_code)
            return
        self._count += 1
        session = FakeSession(f"s{self._count}")
        self.sessions[session.name] = session
        self.sockets.add(socket)
        hello = {"server_time_ns": self.now_ns(), "max_channels": 100, "grace_s": 30.0}
        await socket.send(json.dumps({"op": "hello", "session": session.name, **hello}))
        holder = [session]
        ticker = asyncio.create_task(self.tick(socket, holder))
        try:
            async for content in socket:
                await self.handle_message(socket, holder, content)
        except ConnectionClosed:
            pass
        finally:
            ticker.cancel()
            self.sockets.discard(socket)

    async def tick(self, socket: ServerConnection, holder: list[FakeSession]) -> None:
        due_s, step_s = time.monotonic(), 1.0 / 60.0
        try:
            while True:
                due_s += step_s
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                session = holder[0]
                for channel in session.channels.values():
                    await self.move(socket, channel, step_s)
                if session.channels:
                    session.sequence += 1
                    records = [channel.record(self.verbs) for channel in session.channels.values()]
                    stamp = {"sequence": session.sequence, "time_ns": self.now_ns(), "dropped": session.dropped}
                    await socket.send(message(records, **stamp))
        except ConnectionClosed:
            return

    async def move(self, socket: ServerConnection, channel: FakeChannel, step_s: float) -> None:
        verb = self.verbs[channel.verb]
        if not channel.play or channel.ended:
            return
        before, channel.phase = channel.phase, channel.phase + channel.speed * step_s / verb.duration
        if before < 0.5 <= channel.phase:
            item = {"channel": channel.number, "name": "half", "phase": 0.5}
            await socket.send(json.dumps({"op": "events", "items": [item]}))
        if channel.phase >= 1.0 and not verb.looping:
            channel.phase, channel.ended = 1.0, True
            await socket.send(json.dumps({"op": "end", "channel": channel.number}))
        channel.phase = channel.phase if channel.ended else channel.phase % 1.0

    async def handle_message(self, socket: ServerConnection, holder: list[FakeSession], content: str | bytes) -> None:
        session = holder[0]
        if isinstance(content, bytes):
            op, _, number = struct.unpack_from("<BBH", content)
            if op == 0x11:
                return await self.handle_bulk(socket, session, content, number)
            numbers = list(struct.unpack_from(f"<{(len(content) - 4) // 4}f", content, 4))
            self.messages.append((op, number, numbers))
            if number not in session.channels:
                await self.send_error(socket, number, "unknown_channel")
            elif len(numbers) != len(session.channels[number].adverbs):
                await self.send_error(socket, number, "bad_message")
            else:
                session.channels[number].adverbs = numbers
            return None
        fields = json.loads(content)
        self.messages.append(fields)
        if fields["op"] not in self.mute:
            await getattr(self, f"on_{fields['op']}")(socket, holder, fields)
        return None

    async def handle_bulk(self, socket, session: FakeSession, content: bytes, count: int) -> None:
        size = (len(content) - 4) // count
        rows = [struct.unpack_from(f"<HH{size // 4 - 1}f", content, 4 + k * size) for k in range(count)]
        self.messages.append((0x11, len(content), [(channel, list(adverbs)) for channel, _, *adverbs in rows]))
        assert len(content) == 4 + count * size
        if any(len(session.channels[channel].adverbs) != len(adverbs) for channel, _, *adverbs in rows):
            return await self.send_error(socket, None, "out_of_range")
        for channel, _, *adverbs in rows:
            session.channels[channel].adverbs = adverbs
        return None

    async def on_view(self, socket, holder, fields) -> None:
        if "budget_kbps" in fields:
            numbers = {"seconds": 1.0, "kbps": 0.5 * fields["budget_kbps"], "records": 60, "left_out": 40}
            rates = {"budget_kbps": fields["budget_kbps"], "min_fps": 6.0, "max_fps": 60.0}
            await socket.send(json.dumps({"op": "stats", **numbers, **rates}))

    async def send_error(self, socket: ServerConnection, channel: int | None, code: str) -> None:
        await socket.send(json.dumps({"op": "error", "channel": channel, "code": code, "detail": f"it is {code}"}))

    async def on_ping(self, socket, holder, fields) -> None:
        await socket.send(json.dumps({"op": "pong", "t": fields["t"], "server_time_ns": self.now_ns()}))

    async def on_open(self, socket, holder, fields) -> None:
        number, session = fields["channel"], holder[0]
        if self.not_ready:
            self.not_ready -= 1
            return await self.send_error(socket, number, "not_ready")
        if fields["verb"] not in self.verbs:
            return await self.send_error(socket, number, "unknown_verb")
        if number in session.channels:
            return await self.send_error(socket, number, "channel_in_use")
        channel = FakeChannel(number, fields["verb"], self.middle(fields), ENCODINGS[fields.get("encoding", "f32")])
        for name in ("phase", "speed", "play", "fps"):
            setattr(channel, name, fields.get(name, getattr(channel, name)))
        session.channels[number] = channel
        return await self.opened(socket, channel, resumed=False)

    def middle(self, fields) -> list[float]:
        given, ranges = fields.get("adverbs", {}), self.verbs[fields["verb"]].adverbs
        return [given.get(name, 0.5 * (low + high)) for name, (low, high) in ranges.items()]

    async def opened(self, socket, channel: FakeChannel, *, resumed: bool) -> None:
        verb = self.verbs[channel.verb]
        count = verb.examples if channel.encoding == 2 else len(verb.names)
        adverbs = [
            {"name": name, "unit": "m", "min": low, "max": high, "style": False}
            for name, (low, high) in verb.adverbs.items()
        ]
        fields = {
            "op": "opened",
            "channel": channel.number,
            "verb": channel.verb,
            "version": 1,
            "method": "corrected",
            "skeleton": {"names": verb.names, "parents": verb.parents, "offsets": verb.offsets},
            "adverbs": adverbs,
            "joints": verb.names,
            "encoding": list(ENCODINGS)[channel.encoding],
            "space": "local",
            "frame": "gltf",
            "fps": channel.fps,
            "looping": verb.looping,
            "keytimes": [{"name": "half", "phase": 0.5}],
            "follow": [0.4, 0.6],
            "record_bytes": record_bytes(channel.encoding, count),
            "resumed": resumed,
        }
        await socket.send(json.dumps(fields))

    async def on_set(self, socket, holder, fields) -> None:
        channel = holder[0].channels.get(fields["channel"])
        if channel is None:
            return await self.send_error(socket, fields["channel"], "unknown_channel")
        names = list(self.verbs[channel.verb].adverbs)
        for name, value in fields.get("adverbs", {}).items():
            channel.adverbs[names.index(name)] = value
        for name in ("phase", "speed", "play", "fps"):
            setattr(channel, name, fields.get(name, getattr(channel, name)))
        channel.ended = channel.ended and "phase" not in fields
        return None

    async def on_switch(self, socket, holder, fields) -> None:
        channel = holder[0].channels[fields["channel"]]
        if fields["verb"] not in self.verbs:
            return await self.send_error(socket, fields["channel"], "unknown_verb")
        channel.verb, channel.adverbs, channel.phase = fields["verb"], self.middle(fields), 0.0
        return await self.opened(socket, channel, resumed=False)

    async def on_close(self, socket, holder, fields) -> None:
        holder[0].channels.pop(fields["channel"], None)

    async def on_resume(self, socket, holder, fields) -> None:
        session = self.sessions.get(fields["session"])
        if session is None:
            return await self.send_error(socket, None, "unknown_session")
        session.dropped += session.sequence - fields["last_seq"]
        for channel in session.channels.values():
            await self.opened(socket, channel, resumed=True)
        holder[0] = session
        return None

    async def drop(self, code: int = 1011) -> None:
        """Lose all connections; sessions stay."""
        await asyncio.gather(*(socket.close(code) for socket in list(self.sockets)))

    def forget(self) -> None:
        """Simulate a restart, with another clock."""
        self.sessions.clear()
        self.skew_ns += 3_600 * 10**9

    async def drain(self, after_s: float) -> None:
        fields = json.dumps({"op": "drain", "detail": "stopping", "reconnect_after_s": after_s})
        for socket in list(self.sockets):
            await socket.send(fields)
        await self.drop(1012)


@asynccontextmanager
async def running(verbs: dict[str, FakeVerb] | None = None, port: int = 0):
    """A fake server in this event loop."""
    fake = FakeServer(verbs)
    pick = lambda _, offered: next((name for name in offered if name in fake.protocols), None)  # noqa: E731
    async with serve(fake.handle, "127.0.0.1", port, select_subprotocol=pick, compression=None) as server:
        fake.port = server.sockets[0].getsockname()[1]
        yield fake


@contextmanager
def running_aside(verbs: dict[str, FakeVerb] | None = None):
    """A fake server in a thread, for clients without an event loop; yields it with its loop."""
    started, box = threading.Event(), {}

    async def main() -> None:
        async with running(verbs) as fake:
            box.update(fake=fake, loop=asyncio.get_running_loop(), stop=asyncio.Event())
            started.set()
            await box["stop"].wait()

    thread = threading.Thread(target=asyncio.run, args=(main(),), daemon=True)
    thread.start()
    assert started.wait(60.0)
    try:
        yield box["fake"], box["loop"]
    finally:
        box["loop"].call_soon_threadsafe(box["stop"].set)
        thread.join(60.0)
