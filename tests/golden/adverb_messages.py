"""Binary messages of clients for the wire vectors: adverbs of one and of many channels, written from docs/wire.md."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np

Json = dict[str, Any]


def single(number: float) -> float | None:
    """A number as float32 stores it; null for NaN."""
    return None if math.isnan(number) else float(np.float32(number))


def floats(adverbs: list[float]) -> bytes:
    return b"".join(struct.pack("<f", number) for number in adverbs)


def adverb_messages() -> list[Json]:
    """Binary messages 0x10; the adverbs are float32 numbers."""
    rows: list[tuple[int, list[float]]] = [
        (0, [0.0]),
        (513, [1.0, -2.0]),
        (65_535, [0.1, -0.0, 1e-45, 3e38]),
        (7, list(np.linspace(-1.0, 1.0, 16))),
    ]
    found = []
    for channel, adverbs in rows:
        content = struct.pack("<BBH", 0x10, 0, channel) + floats(adverbs)
        found.append({"channel": channel, "adverbs": [single(number) for number in adverbs], "hex": content.hex()})
    return found


def bulk(rows: list[tuple[int, list[float]]]) -> bytes:
    """A message 0x11: op, 0, count, then channel, 0 and adverbs of each row."""
    content = struct.pack("<B", 0x11) + struct.pack("<B", 0) + struct.pack("<H", len(rows))
    return content + b"".join(struct.pack("<H", channel) + bytes(2) + floats(adverbs) for channel, adverbs in rows)


def bulk_adverb_messages() -> list[Json]:
    """Binary messages 0x11."""
    messages: dict[str, list[tuple[int, list[float]]]] = {
        "one channel": [(513, [1.0, -2.0])],
        "one adverb": [(0, [0.0]), (65_535, [0.5]), (7, [-0.25])],
        "three adverbs": [(3, [0.1, 1.2, 0.4]), (1, [-0.1, 1.0, 1e-45]), (2, [1e9, -1e9, -0.0])],
        "a channel twice: the last row counts": [(3, [0.25, 0.5]), (3, [0.75, 1.0])],
        "sixteen adverbs": [(k, list(np.linspace(-1.0, 1.0, 16) + k)) for k in range(3)],
        "a hundred channels": [(k, [0.01 * k, 1.0, 0.5]) for k in range(100)],
    }
    return [
        {
            "name": name,
            "channels": [channel for channel, _ in rows],
            "adverbs": [[single(number) for number in adverbs] for _, adverbs in rows],
            "hex": bulk(rows).hex(),
        }
        for name, rows in messages.items()
    ]


def malformed_adverb_messages() -> list[Json]:
    """Messages 0x10 and 0x11 that the server rejects as a whole, where ``adverbs`` has the open channels' numbers D."""
    found: list[Json] = []
    good: list[tuple[int, list[float]]] = [(1, [0.1, 0.2]), (2, [0.3, 0.4])]
    full, large = bulk(good), struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]

    def add(name: str, content: bytes, reason: str, code: str = "bad_message") -> None:
        opened = {"1": 2, "2": 2, "3": 3}
        found.append({"name": name, "reason": reason, "code": code, "hex": content.hex(), "adverbs": opened})

    add("one: no adverbs", struct.pack("<BBH", 0x10, 0, 1), "a message 0x10 has at least 8 bytes")
    add("one: unknown channel", struct.pack("<BBHff", 0x10, 0, 77, 0, 0), "channel 77 is not open", "unknown_channel")
    add("empty", b"", "a binary message has an op")
    add("unknown op", b"\x12" + full[1:], "the op is unknown")
    add("header cut", full[:3], "a message 0x11 has at least 4 bytes")
    add("no rows", bulk([]), "the count is at least 1")
    add("count without rows", struct.pack("<BBH", 0x11, 0, 1), "a row has a channel and at least one adverb")
    add("rows without adverbs", struct.pack("<BBHHH", 0x11, 0, 1, 1, 0), "a row has at least one adverb")
    add("row cut", full[:-4], "the length is not 4 + count·(4 + 4·D)")
    add("bytes after the last row", full + bytes(4), "the length is not 4 + count·(4 + 4·D)")
    add("bytes after the last row, odd", full + bytes(3), "the length is not 4 + count·(4 + 4·D)")
    add(
        "count too small", full[:2] + struct.pack("<H", 1) + full[4:], "D is that of the verb: 2, not 5", "out_of_range"
    )
    add("unknown channel", bulk([*good, (77, [0.0, 0.0])]), "channel 77 is not open", "unknown_channel")
    add(
        "other number of adverbs",
        bulk([(1, [0.0] * 3), (2, [0.0] * 3)]),
        "D is that of the verb: 2, not 3",
        "bad_request",
    )
    add("verbs of different D", bulk([*good, (3, [0.0, 0.0])]), "channel 3 has 3 adverbs, not 2", "out_of_range")
    for name, number in (("NaN", math.nan), ("infinite", math.inf), ("too large", large), ("above 1e9", 1.1e9)):
        add(
            f"adverb {name}",
            bulk([*good[:1], (2, [0.0, number])]),
            "adverbs are finite, at most 1e9 in magnitude",
            "out_of_range",
        )
    return found
