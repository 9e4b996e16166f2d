"""Record a stream for tests of clients in all languages: ``python -m tools.golden_stream``.

``tests/golden/stream.v1.bin`` has what a server sends in one session of several encodings, a switch and a new version;
``tests/golden/stream.v1.json`` has the joint positions of its records. The clock of the server is stepped from tick to
tick, so that the recording is the same in every run on a machine.

Each message of the recording has a head of 8 bytes, u32 kind (0 text, 1 binary) and u32 length, both little-endian.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import struct
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest.mock import patch

import numpy as np

from service import packing
from service.app import create_app
from service.catalog.catalog import Catalog, Entry
from service.settings import Settings
from service.stream import kernels
from verbs.conventions import F64
from verbs.io import artifact
from verbs.kernels.pose import forward
from verbs.runtime.evaluate import Blend, Evaluator

__all__ = ["EXPECTED", "STREAM", "expected", "messages_of", "record"]

ROOT = Path(__file__).parents[1]
STREAM = ROOT / "tests" / "golden" / "stream.v1.bin"
EXPECTED = ROOT / "tests" / "golden" / "stream.v1.json"
HEAD = struct.Struct("<II")
TEXT, BINARY = 0, 1

FILES = {
    ("arm3", 1): "verbs/library/arm3.verb",
    ("arm3", 2): "tests/golden/refined.v1.verb",
    ("locomotion", 1): "verbs/library/locomotion.verb",
    ("reach", 1): "verbs/library/reach.verb",
}
"""Artifacts by verb and version."""

START_S, EPOCH_S = 1000.0, 1_700_000_000
DIGITS = 7
"""Positions are rounded to 0.1 µm."""

Json = dict[str, Any]
Message = tuple[int, bytes]

REACH = {"x": -0.3, "y": 1.2, "z": 0.4}
OPENS = (
    {"channel": 1, "verb": "reach", "adverbs": REACH, "fps": 15, "encoding": "f32"},
    {"channel": 2, "verb": "reach", "adverbs": REACH, "fps": 30, "encoding": "q48", "phase": 0.3},
    {"channel": 3, "verb": "locomotion", "fps": 15, "encoding": "q32"},
    {"channel": 4, "verb": "arm3", "adverbs": {"x": 0.5, "y": 0.2}, "encoding": "weights", "method": "refined"},
    {"channel": 5, "verb": "arm3", "adverbs": {"x": 0.5, "y": 0.2}, "encoding": "f32", "loop": True, "phase": 0.6},
    {"channel": 6, "verb": "reach", "adverbs": REACH, "fps": 15, "encoding": "weights", "half_life": 0.2},
)


class Recorder:
    """A server whose clock is stepped, and the messages that it sends to one client."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.now_s = START_S
        self.messages: list[Message] = []
        self._loop, self._inbox = loop, asyncio.Queue[Json]()
        with self.clock():
            app = create_app(Settings())
        self.state = app.state.server
        self._hub = self.state.hub
        scope = {
            "type": "websocket", "path": "/v1/stream", "raw_path": b"/v1/stream", "query_string": b"", "headers": [],
            "scheme": "ws", "subprotocols": ["adverb.v1"], "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 80),
            "root_path": "", "state": {},
        }  # fmt: skip
        self._inbox.put_nowait({"type": "websocket.connect"})
        self._task = loop.create_task(app(scope, self._inbox.get, self._keep))

    @contextmanager
    def clock(self) -> Iterator[None]:
        """Replace the clocks of this process by the one of the recording."""
        with (
            patch("time.monotonic", lambda: self.now_s),
            patch("time.monotonic_ns", lambda: round(self.now_s * 1e9)),
            patch("time.time_ns", lambda: round((self.now_s + EPOCH_S) * 1e9)),
        ):
            yield

    async def _keep(self, message: MutableMapping[str, Any]) -> None:
        if message.get("text"):
            fields = json.loads(message["text"])
            if fields["op"] == "hello":
                fields["session"] = "golden"
            self.messages.append((TEXT, json.dumps(fields).encode()))
        elif message.get("bytes"):
            self.messages.append((BINARY, message["bytes"]))

    def handle(self) -> None:
        """Let the endpoint and the engine handle what waits."""

        async def turns() -> None:
            for _ in range(8):
                await asyncio.sleep(0)
                self._hub.engine.handle(1.0)
                self._hub.idle(self.now_s)

        self._loop.run_until_complete(turns())

    def send(self, **fields: Any) -> None:
        """Send a text message of the client."""
        self._inbox.put_nowait({"type": "websocket.receive", "text": json.dumps(fields)})
        self.handle()

    def aim(self, channel: int, *adverbs: float) -> None:
        """Send all adverbs of a channel."""
        content = struct.pack(f"<BBH{len(adverbs)}f", 0x10, 0, channel, *adverbs)
        self._inbox.put_nowait({"type": "websocket.receive", "bytes": content})
        self.handle()

    def tick(self, count: int) -> None:
        """Step the clock to the next ticks, and send them."""
        for _ in range(count):
            self.now_s = self._hub.ticks.due_s()
            self._hub.send(self._hub.prepare())
            self.handle()

    def leave(self) -> None:
        """Close the connection."""
        self._inbox.put_nowait({"type": "websocket.disconnect", "code": 1000})
        self.handle()
        self._loop.run_until_complete(self._task)


def _catalogs() -> list[Catalog]:
    """What is served: first with version 1 of `arm3`, then with version 2."""
    entries = {
        key: Entry.of_verb(artifact.load(ROOT / path), path=ROOT / path, version=key[1]) for key, path in FILES.items()
    }
    return [
        Catalog(MappingProxyType({name: entries[name, version if name == "arm3" else 1] for name, _ in FILES}), ())
        for version in (1, 2)
    ]


def record() -> list[Message]:
    """Messages of one session."""
    packing.warm()
    kernels.warm()
    first, second = _catalogs()
    loop = asyncio.new_event_loop()
    try:
        recorder = Recorder(loop)
        recorder.state.set_catalog(first)
        with recorder.clock():
            recorder.handle()
            for fields in OPENS:
                recorder.send(op="open", **{"fps": 30, **fields})
            recorder.tick(6)
            recorder.aim(1, -0.1, 1.3, 0.4)
            recorder.send(op="set", channel=6, adverbs={"y": 1.0}, speed=0.5)
            recorder.tick(5)
            recorder.send(op="switch", channel=2, verb="locomotion", transition_s=0.2)
            recorder.tick(8)
            recorder.state.set_catalog(second)
            recorder.handle()
            recorder.tick(6)
            recorder.send(op="close", channel=3)
            recorder.send(op="ping", t=1)
            recorder.tick(5)
            recorder.leave()
    finally:
        loop.close()
    return recorder.messages


def messages_of(content: bytes) -> Iterator[Message]:
    """Messages of a recording: kind and content."""
    at = 0
    while at < len(content):
        kind, length = HEAD.unpack_from(content, at)
        at += HEAD.size
        yield kind, content[at : at + length]
        at += length


class Reader:
    """Joint positions of the records of a recording, decoded as docs/wire.md states it."""

    def __init__(self) -> None:
        self._opened: dict[int, Json] = {}
        self._evaluators = {key: Evaluator(artifact.load(ROOT / path)) for key, path in FILES.items()}

    def text(self, content: bytes) -> None:
        """Keep what `opened` states."""
        fields = json.loads(content)
        if fields["op"] == "opened":
            self._opened[fields["channel"]] = fields

    def poses(self, content: bytes) -> Json:
        """Records of a pose message."""
        _, _, count, sequence, _, _ = struct.unpack_from("<BBHIQI", content)
        at, records = 20, []
        for _ in range(count):
            channel, encoding, flags, version, phase, *_ = struct.unpack_from("<HBBI4f", content, at)
            opened = self._opened[channel]
            positions, length = self._positions(opened, version, phase, encoding, content[at + 24 :])
            records.append({
                "channel": channel, "encoding": opened["encoding"], "verb": opened["verb"], "version": version,
                "flags": flags, "phase": phase, "positions": np.round(positions, DIGITS).ravel().tolist(),
            })  # fmt: skip
            at += 24 + -(-length // 4) * 4
        assert at == len(content)
        return {"sequence": sequence, "records": records}

    def _positions(self, opened: Json, version: int, phase: float, encoding: int, data: bytes) -> tuple[F64, int]:
        """Joint positions (J, 3), m, and the length of the payload."""
        joints = len(opened["joints"])
        if encoding == 2:
            count = int.from_bytes(data[:2], "little")
            weights = np.frombuffer(data, "<f4", count, 4).astype(np.float64)
            return _evaluated(self._evaluators[opened["verb"], version], weights, phase), 4 + 4 * count
        root = np.frombuffer(data, "<f4", 3).astype(np.float64)
        if encoding == 0:
            rotations = np.frombuffer(data, "<f4", 4 * joints, 12).astype(np.float64).reshape(joints, 4)
            length = 12 + 16 * joints
        elif encoding == 1:
            words = np.frombuffer(data, "<u2", 3 * joints, 12).reshape(joints, 3).astype(np.int64)
            omitted = (words[:, 0] >> 15) + 2 * (words[:, 1] >> 15)
            rotations = _smallest_three(((words & 0x7FFF) - 16383) / (16383 * np.sqrt(2.0)), omitted)
            length = 12 + 6 * joints
        else:
            packed = np.frombuffer(data, "<u4", joints, 12).astype(np.int64)
            parts = np.stack([packed & 0x3FF, packed >> 10 & 0x3FF, packed >> 20 & 0x3FF], axis=1)
            rotations = _smallest_three((parts - 511) / (511 * np.sqrt(2.0)), packed >> 30)
            length = 12 + 4 * joints
        return _forward(opened["skeleton"], root, rotations), length


def _smallest_three(parts: F64, omitted: Any) -> F64:
    """Rotations (J, 4) of three components (J, 3) and the index of the fourth (J)."""
    rotations = np.empty((len(parts), 4))
    for joint, (three, index) in enumerate(zip(parts, omitted, strict=True)):
        rotations[joint] = np.insert(three, index, np.sqrt(1.0 - three @ three))
    return rotations


def _forward(skeleton: Json, root: F64, rotations: F64) -> F64:
    parents, offsets = np.array(skeleton["parents"], np.int64), np.array(skeleton["offsets"], np.float64)
    global_rotations, positions = np.empty((1, *rotations.shape)), np.empty((1, len(parents), 3))
    forward(root[None], rotations[None], parents, offsets, global_rotations, positions)
    found: F64 = positions[0]
    return found


def _evaluated(evaluator: Evaluator, weights: F64, phase: float) -> F64:
    none = np.zeros((1, 0))
    blend = Blend("weights", weights[None], none, np.full(1, np.nan), np.zeros(1, np.bool_))
    poses = evaluator.pose_of(blend, phase=phase, plant=False)
    found: F64 = evaluator.positions(poses)[1][0]
    return found


def expected(messages: list[Message]) -> Json:
    """Joint positions of a recording."""
    reader, poses = Reader(), []
    for kind, content in messages:
        if kind == TEXT:
            reader.text(content)
        else:
            poses.append(reader.poses(content))
    files = [
        {
            "verb": verb,
            "version": version,
            "file": path,
            "sha256": hashlib.sha256((ROOT / path).read_bytes()).hexdigest(),
        }
        for (verb, version), path in FILES.items()
    ]
    return {"format": 1, "stream": STREAM.name, "tolerance_m": 1e-5, "artifacts": files, "messages": poses}


def _text(content: Json) -> str:
    """JSON with one line for each message."""
    head = json.dumps({key: value for key, value in content.items() if key != "messages"})[1:-1]
    rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in content["messages"])
    return f'{{{head}, "messages": [\n{rows}\n]}}\n'


def main() -> None:
    """Write both files."""
    messages = record()
    STREAM.write_bytes(b"".join(HEAD.pack(kind, len(content)) + content for kind, content in messages))
    EXPECTED.write_text(_text(expected(messages)), encoding="utf-8")


if __name__ == "__main__":
    main()
