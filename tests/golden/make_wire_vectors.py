"""Generate ``wire_vectors.v1.json``: test vectors of the stream's wire format, for clients in every language.

The bytes come from the encoder of ``tests/clients/python/specimen.py``, which is written from ``docs/wire.md`` alone
and shares nothing with the code under test. The output is deterministic: python -m tests.golden.make_wire_vectors
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.clients.python.specimen import Rec, message, record_bytes, smallest_three, smallest_three_32
from tests.golden.adverb_messages import adverb_messages, bulk_adverb_messages, malformed_adverb_messages, single
from tests.golden.text_messages import (
    client_messages,
    malformed_client_messages,
    malformed_server_messages,
    server_messages,
)

PATH = Path(__file__).with_name("wire_vectors.v1.json")
ENCODINGS = ("f32", "q48", "weights", "q32")
S = math.sqrt(0.5)
IDENTITY = (0.0, 0.0, 0.0, 1.0)
Json = dict[str, Any]


def random_rotations(count: int, seed: int) -> list[tuple[float, ...]]:
    drawn = np.random.default_rng(seed).normal(size=(count, 4))
    return [tuple(row) for row in (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).tolist()]


def count_of(rec: Rec) -> int:
    return len(rec.weights) if rec.encoding == 2 else len(rec.rotations)


def layout(rec: Rec) -> Json:
    joints = 0 if rec.encoding == 2 else len(rec.rotations)
    return {
        "encoding": ENCODINGS[rec.encoding],
        "joints": joints,
        "record_bytes": record_bytes(rec.encoding, count_of(rec)),
    }


def described(rec: Rec, offset: int) -> Json:
    """What a reader must find in a record. Numbers are exact, except rotations of q48 and q32."""
    found: Json = {
        "offset": offset,
        "channel": rec.channel,
        "encoding": ENCODINGS[rec.encoding],
        "flags": rec.flags,
        "version": rec.version,
        "phase": single(rec.phase),
        "time": single(rec.time),
        "error": single(rec.error),
        "duration": single(rec.duration),
    }
    if rec.encoding == 2:
        return found | {"weights": [single(weight) for weight in rec.weights]}
    exact = rec.encoding == 0
    rotations = [[single(part) if exact else part for part in rotation] for rotation in rec.rotations]
    return found | {"root": [single(part) for part in rec.root], "rotations": rotations}


def pose_message(name: str, records: list[Rec], *, sequence: int = 1, time_ns: int = 10**18, dropped: int = 0) -> Json:
    offsets = np.cumsum([20, *(len(rec.encode()) for rec in records)]).tolist()
    return {
        "name": name,
        "hex": message(records, sequence=sequence, time_ns=time_ns, dropped=dropped).hex(),
        "layouts": {str(rec.channel): layout(rec) for rec in records},
        "header": {"records": len(records), "sequence": sequence, "time_ns": str(time_ns), "dropped": dropped},
        "records": [described(rec, offset) for rec, offset in zip(records, offsets, strict=False)],
    }


# --- pose messages ---

POSE = [IDENTITY, (S, 0.0, 0.0, S), (0.5, -0.5, 0.5, -0.5)]
HEAD: Json = {"version": 7, "phase": 0.5, "time": 1.25, "error": 0.125, "duration": 2.5, "root": (0.25, 1.0, -0.5)}
MIXED = [
    Rec(1, 0, 0, **HEAD, rotations=POSE[:2]),
    Rec(2, 1, 3, **HEAD, rotations=POSE),
    Rec(3, 2, 12, **(HEAD | {"error": math.nan}), weights=[0.75, 0.5, -0.25]),
]


def pose_messages() -> list[Json]:
    largest = 2**32 - 1
    crowd = [Rec(k, 0, **HEAD, rotations=random_rotations(4, k)) for k in range(6)]
    alternating = [
        Rec(
            10 + k, k % 3, **HEAD, rotations=random_rotations(1 + k % 4, 20 + k), weights=[0.5, 0.25, 0.25][: 1 + k % 3]
        )
        for k in range(9)
    ]
    return [
        pose_message("the message of docs/wire.md", MIXED, sequence=42, time_ns=1_700_000_000_123_456_789, dropped=5),
        pose_message("no records", []),
        pose_message("largest header", MIXED[:1], sequence=largest, time_ns=2**64 - 1, dropped=largest),
        pose_message("sequence after the largest", MIXED[:1], sequence=0, time_ns=4_102_444_800_123_456_789),
        pose_message("error is not measured", [Rec(0, 0, rotations=[IDENTITY], error=math.nan)]),
        pose_message(
            "largest channel, version and numbers",
            [Rec(65_535, 0, 0, largest, 1.0, 3e38, 3e38, 3e38, (-3e38, 1e-45, 3e38), [IDENTITY])],
        ),
        *(
            pose_message(f"flag {name}", [Rec(4, 0, bit, **HEAD, rotations=[IDENTITY])])
            for name, bit in (("clamped", 1), ("in transition", 2), ("new version", 4), ("last", 8))
        ),
        pose_message("unknown flags are ignored", [Rec(4, 0, 0xF1, **HEAD, rotations=[IDENTITY])]),
        *(
            pose_message(
                f"q48 of {count} joints" + (", padded" if count % 2 else ""),
                [Rec(5, 1, **HEAD, rotations=random_rotations(count, count))],
            )
            for count in (1, 2, 3, 22)
        ),
        *(
            pose_message(
                f"{count} weights",
                [Rec(6, 2, **HEAD, weights=np.random.default_rng(count).normal(size=count).tolist())],
            )
            for count in (1, 2, 25)
        ),
        *(
            pose_message(f"q32 of {count} joints", [Rec(7, 3, **HEAD, rotations=random_rotations(count, 100 + count))])
            for count in (1, 2, 3, 22)
        ),
        pose_message(
            "q32 among other layouts",
            [
                Rec(11 + k, encoding, 2 * k, **HEAD, rotations=random_rotations(3, 200 + k), weights=[1.5, -0.5])
                for k, encoding in enumerate((3, 1, 3, 0, 3, 2, 3))
            ],
        ),
        pose_message("channels of one layout", crowd),
        pose_message("channels of alternating layouts", alternating),
    ]


def malformed_pose_messages() -> list[Json]:
    """Each is a valid message with one change. A reader must reject it, or may where ``rejection`` is optional."""
    layouts = {str(rec.channel): layout(rec) for rec in MIXED}
    full, weights = message(MIXED[:1]), message(MIXED[2:])
    packed = Rec(4, 3, **HEAD, rotations=POSE)
    q32_layout = {str(packed.channel): layout(packed)}
    found: list[Json] = []

    def add(name: str, content: bytes, reason: str, *, required: bool = True, **changed: Json) -> None:
        rejection = "required" if required else "optional"
        row = {
            "name": name,
            "reason": reason,
            "rejection": rejection,
            "hex": content.hex(),
            "layouts": layouts | changed,
        }
        found.append(row)

    def patched(at: int, pattern: str, value: float, content: bytes = full) -> bytes:
        return content[:at] + struct.pack(pattern, value) + content[at + struct.calcsize(pattern) :]

    add("empty", b"", "shorter than the message header of 20 bytes")
    add("header cut", full[:19], "shorter than the message header of 20 bytes")
    add("other op", patched(0, "<B", 2), "op is not 0x01")
    add("other wire version", patched(1, "<B", 2), "wire version is not 1")
    add("record missing", patched(2, "<H", 2), "fewer records than the header states")
    add("record header cut", full[: 20 + 23], "a record header has 24 bytes")
    add("payload cut", full[:-1], "a record is shorter than record_bytes")
    add("weights cut", weights[:-4], "a record is shorter than record_bytes")
    add("unknown channel", patched(20, "<H", 77), "the channel is not open")
    add("other encoding", patched(22, "<B", 1), "the encoding is not that of the channel")
    add("unknown encoding", patched(22, "<B", 7), "the encoding is unknown")
    for name, at in (("phase", 28), ("time", 32), ("duration", 40)):
        add(f"{name} NaN", patched(at, "<f", math.nan), "numbers of a record header other than error are finite")
        add(f"{name} infinite", patched(at, "<f", math.inf), "numbers of a record header other than error are finite")
    add("bytes after the last record", full + bytes(4), "the message is longer than its records", required=False)
    add("q32 payload cut", message([packed])[:-4], "a record is shorter than record_bytes", **q32_layout)
    other = patched(22, "<B", 1, message([packed]))
    add("q48 on a channel of q32", other, "the encoding is not that of the channel", **q32_layout)
    add("root NaN", patched(44, "<f", math.nan), "positions are finite", required=False)
    add("rotation infinite", patched(60, "<f", math.inf), "rotations are finite", required=False)
    add("weight NaN", patched(48, "<f", math.nan, weights), "weights are finite", required=False)
    add("count of weights too large", patched(44, "<H", 9, weights), "count exceeds the record", required=False)
    return found


def layouts() -> list[Json]:
    """Lengths of records in ``opened`` and ``version``, valid and invalid."""
    found = []
    for number, encoding in enumerate(ENCODINGS):
        for count in (1, 2, 3, 22, 23):
            size = record_bytes(number, count)
            for extra, rejection in ((0, None), (-4, "required"), (2, "required"), (4, "optional")):
                free = encoding == "weights" and extra in (-4, 4)  # any number of examples is valid
                joints = 1 if encoding == "weights" else count
                row = {"encoding": encoding, "joints": joints, "record_bytes": size + extra}
                found.append(row | {"rejection": None if free else rejection})
    return found


# --- q48 ---


def quaternions() -> list[list[float]]:
    """Edge cases: each component largest, ties, negatives, nearly equal components, tiny components."""
    rows: list[tuple[float, ...]] = []
    for k in range(4):
        for sign in (1.0, -1.0):
            rows.append(tuple(sign if j == k else 0.0 for j in range(4)))
            tilted = np.array([sign * 2.0 if j == k else 0.3 * (j + 1) for j in range(4)])
            rows.append(tuple((tilted / np.linalg.norm(tilted)).tolist()))
    rows += [(S, S, 0.0, 0.0), (S, -S, 0.0, 0.0), (-S, 0.0, 0.0, S), (0.0, 0.0, -S, -S)]  # ties of two
    rows += [(0.5, 0.5, 0.5, 0.5), (-0.5, -0.5, -0.5, -0.5), (0.5, -0.5, 0.5, -0.5), (-0.5, 0.5, 0.5, 0.5)]  # of four
    for step in (1e-9, 1e-6, 1e-4):
        for k in range(4):
            near = np.full(4, 0.5)
            near[k] += step
            rows.append(tuple((near / np.linalg.norm(near)).tolist()))
    rows += [(step, 0.0, -step, math.sqrt(1.0 - 2.0 * step * step)) for step in (1e-8, 2.15e-5, 2.16e-5, 1e-3)]
    return [list(row) for row in rows + random_rotations(40, 48)]


def q48() -> Json:
    """Quaternions with their words, and words with their quaternions, by exact formulas in float64."""
    encode = [
        {"rotation": row, "words": list(struct.unpack("<3H", smallest_three(tuple(row))))} for row in quaternions()
    ]
    corners = [[a, b, c] for a in (0, 16_383, 32_766) for b in (16_383,) for c in (16_383, 20_000)]
    words = [row["words"] for row in encode[:16]] + corners
    words += [
        [w[0] | (k & 1) << 15, w[1] | (k >> 1) << 15, w[2]] for k in range(4) for w in ([12_000, 20_000, 16_383],)
    ]
    words += [[16_383, 16_383, 16_383 | 1 << 15]]  # bit 15 of the third word is ignored
    return {
        "tolerance_rad": 0.00015,
        "encode": encode,
        "decode": [{"words": w, "rotation": unpacked(w)} for w in words],
    }


def q32() -> Json:
    """As :func:`q48`, with one 32-bit word per rotation."""
    encode = [{"rotation": row, "word": struct.unpack("<I", smallest_three_32(tuple(row)))[0]} for row in quaternions()]
    words = [row["word"] for row in encode[:16]]
    corners = [(a, b, c) for a in (0, 511, 1_022) for b in (511,) for c in (511, 700)]
    parts = [*corners, *[(400, 620, 511)] * 4]
    omitted = [0] * len(corners) + [0, 1, 2, 3]
    words += [a | b << 10 | c << 20 | k << 30 for (a, b, c), k in zip(parts, omitted, strict=True)]
    return {
        "tolerance_rad": 0.005,
        "encode": encode,
        "decode": [{"word": w, "rotation": unpacked_32(w)} for w in words],
    }


def unpacked_32(word: int) -> list[float]:
    stored = [((word >> shift & 0x3FF) - 511) / (511 * math.sqrt(2.0)) for shift in (0, 10, 20)]
    return completed(stored, word >> 30)


def unpacked(words: list[int]) -> list[float]:
    omitted = (words[0] >> 15) + 2 * (words[1] >> 15)
    stored = [((word & 0x7FFF) - 16_383) / (16_383 * math.sqrt(2.0)) for word in words]
    return completed(stored, omitted)


def completed(stored: list[float], omitted: int) -> list[float]:
    """Four components of three and the index of the omitted one."""
    return [*stored[:omitted], math.sqrt(max(0.0, 1.0 - sum(part * part for part in stored))), *stored[omitted:]]


# --- clocks ---


def clocks() -> list[Json]:
    """Pings; the offset is that of the shortest round trip: server time minus the middle of sending and arrival."""
    start_ns = 1_700_000_000 * 10**9

    def clock(name: str, rows: list[tuple[float, float, float]]) -> Json:
        pings = [
            {
                "sent_s": sent,
                "arrived_s": round(sent + out + back, 9),
                "server_time_ns": str(start_ns + round((sent + out) * 1e9)),
            }
            for sent, out, back in rows
        ]
        counted = [row for row in rows if row[1] + row[2] >= 0.0 and row[0] >= rows[-1][0] - 59.0]
        sent, out, back = min(counted, key=lambda row: row[1] + row[2])
        server_s = 1_700_000_000 + sent + out
        offset = server_s - (sent + 0.5 * (out + back))
        return {"name": name, "pings": pings, "offset_s": offset, "round_trip_s": out + back}

    return [
        clock("one ping, symmetric", [(10.0, 0.004, 0.004)]),
        clock("one ping, asymmetric: the offset is off by half the difference", [(10.0, 0.001, 0.009)]),
        clock("the shortest round trip counts", [(1.0, 0.05, 0.01), (2.0, 0.003, 0.002), (3.0, 0.02, 0.04)]),
        clock("a ping that arrives before it was sent is ignored", [(5.0, 0.004, 0.004), (6.0, 0.0, -0.5)]),
        clock("pings older than 60 s are discarded", [(0.0, 0.001, 0.001), (30.0, 0.004, 0.004), (90.0, 0.01, 0.02)]),
    ]


def jitter() -> list[Json]:
    """Arrivals and due times; delay = interval + 98 % quantile of transits - smallest transit.

    Cases avoid what clients may choose themselves: the length of the window, ranks between two values, upper bounds.
    """
    found = []
    for name, interval_s, late_every, late_s in (
        ("on time", 1 / 64, 0, 0.0),
        ("every tenth message late", 1 / 64, 10, 0.04),
        ("30 fps, every second late", 1 / 32, 2, 0.0625),
        ("one of 200 late: below the quantile", 1 / 64, 200, 0.2),
    ):
        due = [1000.0 + k * interval_s for k in range(200)]
        late = [late_s if late_every and k % late_every == late_every - 1 else 0.0 for k in range(200)]
        arrivals = [[round(t - 990.0 + 0.03 + extra, 9), t] for t, extra in zip(due, late, strict=True)]
        lateness = sorted(late)[math.floor(0.98 * 199)]
        found.append(
            {
                "name": name,
                "interval_s": interval_s,
                "arrived_due_s": arrivals,
                "min_transit_s": -989.97,
                "lateness_s": lateness,
                "delay_s": interval_s + lateness,
            }
        )
    return found


PARTS: dict[str, Callable[[], Any]] = {
    "pose_messages": pose_messages,
    "malformed_pose_messages": malformed_pose_messages,
    "layouts": layouts,
    "q48": q48,
    "q32": q32,
    "adverb_messages": adverb_messages,
    "bulk_adverb_messages": bulk_adverb_messages,
    "malformed_adverb_messages": malformed_adverb_messages,
    "server_messages": server_messages,
    "malformed_server_messages": malformed_server_messages,
    "client_messages": client_messages,
    "malformed_client_messages": malformed_client_messages,
    "clocks": clocks,
    "jitter": jitter,
}


def vectors() -> str:
    """The content of the file: one vector per line."""
    head = {"wire": 1, "specification": "docs/wire.md", "tolerances": {"seconds": 2e-6}}
    lines = [f" {json.dumps(name)}: {json.dumps(value)}" for name, value in head.items()]
    for name, make in PARTS.items():
        part = make()
        rows = part.items() if isinstance(part, dict) else [(None, row) for row in part]
        inner = []
        for key, row in rows:
            text = (
                json.dumps(row)
                if not (key and isinstance(row, list))
                else "[\n" + ",\n".join(f"   {json.dumps(one)}" for one in row) + "\n  ]"
            )
            inner.append(f"  {json.dumps(key)}: {text}" if key else f"  {text}")
        opening, closing = ("{", "}") if isinstance(part, dict) else ("[", "]")
        lines.append(f" {json.dumps(name)}: {opening}\n" + ",\n".join(inner) + f"\n {closing}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    PATH.write_text(vectors(), encoding="utf-8")
