"""An encoder of the server's binary messages, written from docs/wire.md alone, independent of the client."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field


@dataclass
class Rec:
    channel: int
    encoding: int = 0
    flags: int = 0
    version: int = 1
    phase: float = 0.0
    time: float = 0.0
    error: float = float("nan")
    duration: float = 1.0
    root: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotations: list[tuple[float, float, float, float]] = field(default_factory=list)
    weights: list[float] = field(default_factory=list)

    def encode(self) -> bytes:
        head = struct.pack("<H", self.channel) + struct.pack("<B", self.encoding) + struct.pack("<B", self.flags)
        head += struct.pack("<I", self.version)
        head += struct.pack("<ffff", self.phase, self.time, self.error, self.duration)
        assert len(head) == 24
        payload = (f32, q48, weights, q32)[self.encoding](self)
        return head + payload + bytes(-len(payload) % 4)


def f32(rec: Rec) -> bytes:
    return struct.pack("<fff", *rec.root) + b"".join(struct.pack("<ffff", *turn) for turn in rec.rotations)


def q48(rec: Rec) -> bytes:
    return struct.pack("<fff", *rec.root) + b"".join(smallest_three(turn) for turn in rec.rotations)


def smallest_three(turn: tuple[float, float, float, float]) -> bytes:
    out = max(range(4), key=lambda k: abs(turn[k]))
    signed = [-c for c in turn] if turn[out] < 0 else list(turn)
    words = [round(16383 * math.sqrt(2) * c) + 16383 for k, c in enumerate(signed) if k != out]
    words[0] |= (out & 1) << 15
    words[1] |= (out >> 1) << 15
    return struct.pack("<HHH", *words)


def q32(rec: Rec) -> bytes:
    return struct.pack("<fff", *rec.root) + b"".join(smallest_three_32(turn) for turn in rec.rotations)


def smallest_three_32(turn: tuple[float, float, float, float]) -> bytes:
    out = max(range(4), key=lambda k: abs(turn[k]))
    signed = [-c for c in turn] if turn[out] < 0 else list(turn)
    first, second, third = (round(511 * math.sqrt(2) * c) + 511 for k, c in enumerate(signed) if k != out)
    return struct.pack("<I", first + (second << 10) + (third << 20) + (out << 30))


def weights(rec: Rec) -> bytes:
    return struct.pack("<HH", len(rec.weights), 0) + b"".join(struct.pack("<f", weight) for weight in rec.weights)


def message(records: list[Rec], *, sequence: int = 1, time_ns: int = 10**18, dropped: int = 0) -> bytes:
    head = struct.pack("<B", 1) + struct.pack("<B", 1) + struct.pack("<H", len(records))
    head += struct.pack("<I", sequence) + struct.pack("<Q", time_ns) + struct.pack("<I", dropped)
    assert len(head) == 20
    return head + b"".join(record.encode() for record in records)


def record_bytes(encoding: int, count: int) -> int:
    """Length of a record with a number of joints or examples."""
    payload = (12 + 16 * count, 12 + 6 * count, 4 + 4 * count, 12 + 4 * count)[encoding]
    return 24 + payload + -payload % 4
