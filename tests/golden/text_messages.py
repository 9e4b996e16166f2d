"""Text messages of the stream for the wire vectors, one per op and variant, written from ``docs/wire.md``."""

from __future__ import annotations

import json
from typing import Any

Json = dict[str, Any]

SKELETON = {"names": ["Hips", "Hand"], "parents": [-1, 0], "offsets": [[0.0, 0.0, 0.0], [0.0, 0.5, 0.25]]}
ADVERBS = [
    {"name": "x", "unit": "m", "min": -0.5, "max": 0.5, "style": False, "goal": 0.1},
    {"name": "mood", "unit": "", "min": 0.0, "max": 1.0, "style": True, "goal": 0.5},
]
OPENED: Json = {
    "op": "opened",
    "channel": 3,
    "verb": "reach",
    "version": 2,
    "method": "corrected",
    "skeleton": SKELETON,
    "adverbs": ADVERBS,
    "joints": ["Hips", "Hand"],
    "encoding": "q48",
    "space": "local",
    "frame": "gltf",
    "fps": 60,
    "looping": False,
    "keytimes": [{"name": "start", "phase": 0.0}, {"name": "apex", "phase": 0.5}],
    "follow": [0.4, 0.6],
    "record_bytes": 48,
    "resumed": False,
}
SERVER: list[Json] = [
    {
        "op": "hello",
        "session": "k3J-x_9",
        "server_time_ns": 1_700_000_000_123_456_789,
        "max_channels": 4096,
        "grace_s": 30.0,
    },
    OPENED,
    OPENED | {"encoding": "f32", "record_bytes": 68, "follow": None, "resumed": True},
    {"op": "version", "channel": 3, "version": 4_294_967_295, "record_bytes": 48},
    OPENED | {"encoding": "q32", "record_bytes": 44},
    {
        "op": "events",
        "items": [
            {"channel": 3, "name": "apex", "phase": 0.5},
            {"channel": 65_535, "name": "end", "phase": 1.0},
            {"channel": 3, "name": "end", "phase": 1.0},
        ],
    },
    {"op": "events", "items": [{"channel": 0, "name": "start", "phase": 0.0}]},
    {"op": "end", "channel": 65_535},
    {"op": "pong", "t": 12.25, "server_time_ns": 1_700_000_000_123_456_789},
    {
        "op": "stats",
        "seconds": 1.0,
        "kbps": 1_996.5,
        "budget_kbps": 2_000.0,
        "records": 1_480,
        "left_out": 4_520,
        "min_fps": 7.0,
        "max_fps": 60.0,
    },
    {"op": "error", "channel": 3, "code": "unknown_adverb", "detail": "no adverb 'q'; known: x"},
    {"op": "error", "channel": None, "code": "unknown_session", "detail": "no session 'k3J-x_9'"},
    {"op": "error", "channel": None, "code": "of_tomorrow", "detail": "a code of a later server"},
    {"op": "drain", "detail": "the server is stopping", "reconnect_after_s": 1.5},
]
CLIENT: list[Json] = [
    {
        "op": "open",
        "channel": 3,
        "verb": "reach",
        "adverbs": {"x": 0.1, "y": 1.0, "z": 0.5},
        "fps": 30,
        "method": "corrected",
        "space": "global",
        "encoding": "q48",
        "frame": "unity",
        "joints": ["Hand", "Hips"],
        "phase": 0.25,
        "speed": -1.5,
        "play": False,
        "loop": True,
        "half_life": 0.05,
        "follow": False,
        "events": False,
        "priority": 2.5,
    },
    {"op": "open", "channel": 0, "verb": "reach"},
    {
        "op": "set",
        "channel": 3,
        "adverbs": {"x": -0.25},
        "speed": 0.5,
        "phase": 0.75,
        "play": True,
        "loop": False,
        "fps": 120,
        "half_life": 1.0,
        "follow": True,
        "priority": 1000.0,
    },
    {"op": "set", "channel": 3, "phase": 0.0},
    {
        "op": "switch",
        "channel": 3,
        "verb": "board",
        "adverbs": {"u": 0.1, "v": 0.2},
        "method": "rbf",
        "phase": 0.5,
        "transition_s": 0.0,
    },
    {"op": "switch", "channel": 3, "verb": "board"},
    {"op": "close", "channel": 3},
    {"op": "ping", "t": 1},
    {"op": "view", "x": 1.5, "y": 1.7, "z": -4.0, "budget_kbps": 2_000},
    {"op": "view", "budget_kbps": 64.5},
    {"op": "view", "x": 0.0, "y": 0.0, "z": 0.0},
    {"op": "view"},
    {"op": "resume", "session": "k3J-x_9", "last_seq": 4_294_967_295},
]


def exact(fields: Json) -> Json:
    """The fields with times in ns as strings: they exceed 2^53."""
    return {name: str(value) if name == "server_time_ns" else value for name, value in fields.items()}


def server_messages() -> list[Json]:
    rows = [{"text": json.dumps(fields), "fields": exact(fields)} for fields in SERVER]
    more = {"op": "end", "channel": 1, "of_tomorrow": {"a": [1]}}
    rows.append({"text": json.dumps(more), "fields": {"op": "end", "channel": 1}})  # unknown fields are ignored
    return [*rows, {"text": json.dumps({"op": "of_tomorrow", "channel": 1}), "fields": None}]  # so are unknown ops


def without(fields: Json, *names: str) -> Json:
    return {name: value for name, value in fields.items() if name not in names}


def malformed_server_messages() -> list[Json]:
    hello, events, stats = (next(row for row in SERVER if row["op"] == op) for op in ("hello", "events", "stats"))
    item = events["items"][0]
    rows: list[tuple[str, str]] = [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("7", "not an object"),
        ("null", "not an object"),
        ("[]", "no op"),
        ("{}", "no op"),
        (json.dumps(without(hello, "session")), "session is missing"),
        (json.dumps(without(OPENED, "record_bytes")), "record_bytes is missing"),
        (json.dumps(without(OPENED, "skeleton")), "skeleton is missing"),
        (json.dumps(without(events, "items")), "items is missing"),
        (json.dumps(events | {"items": 7}), "items is not an array"),
        (json.dumps(events | {"items": [item | {"channel": "three"}]}), "channel is not a number"),
        (json.dumps(events | {"items": [item, without(item, "phase")]}), "phase is missing"),
        (json.dumps(without(stats, "left_out")), "left_out is missing"),
        (json.dumps(stats | {"kbps": "many"}), "kbps is not a number"),
        (json.dumps({"op": "pong", "t": "now", "server_time_ns": 1}), "t is not a number"),
        (json.dumps({"op": "end"}), "channel is missing"),
        (json.dumps({"op": "error", "channel": None, "detail": "x"}), "code is missing"),
        (json.dumps({"op": "drain", "detail": "x"}), "reconnect_after_s is missing"),
    ]
    return [{"text": text, "reason": reason} for text, reason in rows]


def client_messages() -> list[Json]:
    return [{"text": json.dumps(fields), "fields": fields} for fields in CLIENT]


def malformed_client_messages() -> list[Json]:
    """Messages that the server answers with the error ``bad_message``."""
    channel, opening = {"op": "set", "channel": 3}, {"op": "open", "channel": 0, "verb": "reach"}
    rows: list[tuple[Json, str]] = [
        ({"op": "view", "x": 1.0, "y": 2.0}, "x, y and z are given together"),
        ({"op": "view", "z": 1.0, "budget_kbps": 100}, "x, y and z are given together"),
        ({"op": "view", "x": 1.0, "y": None, "z": 3.0}, "x, y and z are given together"),
        ({"op": "view", "budget_kbps": 0.5}, "budget_kbps is below 1"),
        ({"op": "view", "budget_kbps": 10_000_001}, "budget_kbps is above 10,000,000"),
        ({"op": "view", "budget_kbps": "100"}, "budget_kbps is not a number"),
        ({"op": "view", "x": 2e9, "y": 0.0, "z": 0.0}, "x is above 1e9"),
        ({"op": "view", "w": 1.0}, "w is no field of view"),
        (channel | {"priority": 0.0}, "priority is not positive"),
        (channel | {"priority": 1000.5}, "priority is above 1000"),
        (channel | {"events": False}, "events is no field of set"),
        (opening | {"priority": -1.0}, "priority is not positive"),
        (opening | {"events": 0}, "events is not a boolean"),
        (opening | {"encoding": "q16"}, "the encoding is unknown"),
    ]
    return [{"text": json.dumps(fields), "reason": reason} for fields, reason in rows]
