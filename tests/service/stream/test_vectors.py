"""The server's encoder and messages against the test vectors of the wire."""

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from service.packing import pack
from service.stream.messages import CLIENT, SERVER
from service.wire import HEADER, OP_POSES, WIRE, Layout, Targets
from verbs.kernels import character_state
from verbs.runtime.characters import Frames
from verbs.runtime.evaluate import Blend

FILE = Path(__file__).parents[2] / "golden" / "wire_vectors.v1.json"
VECTORS = json.loads(FILE.read_text(encoding="utf-8"))
NEW_VERSION = 4
KNOWN_FLAGS = 15
WRITTEN = [row for row in VECTORS["pose_messages"] if all(one["flags"] <= KNOWN_FLAGS for one in row["records"])]


def encode(record) -> bytes:
    """One record, written by the server."""
    pose = np.array(record.get("rotations", [[0.0, 0.0, 0.0, 1.0]]), np.float64)[None]
    weights = np.array(record.get("weights", [1.0]), np.float64)[None]
    root = np.array(record.get("root", [0.0, 0.0, 0.0]), np.float64)[None]
    error = np.array([np.nan if record["error"] is None else record["error"]])
    flags = record["flags"]
    progress = np.zeros(1, character_state.PROGRESS)
    progress["phase"], progress["time_s"], progress["duration_s"] = record["phase"], record["time"], record["duration"]
    progress["ended"] = float(bool(flags & 8))
    blend = Blend("", weights, np.zeros((1, 0)), error, np.array([bool(flags & 1)]))
    frames = Frames(blend, progress, root, pose, np.array([bool(flags & 2)]))
    layout = Layout(record["encoding"], "local", "gltf", np.arange(pose.shape[1]), weights.shape[1])
    words = np.zeros(layout.words, np.uint32)
    head = record["channel"] | (flags & NEW_VERSION) << 24
    pack(frames, pose, record["version"], Targets.of([layout], [0], [head]), words)
    return words.tobytes()


@pytest.mark.parametrize("vector", WRITTEN, ids=lambda vector: vector["name"])
def test_pose_messages_are_encoded(vector):
    header, records = vector["header"], vector["records"]
    numbers = (header["records"], header["sequence"], int(header["time_ns"]), header["dropped"])
    content = HEADER.pack(OP_POSES, WIRE, *numbers) + b"".join(encode(record) for record in records)
    assert content.hex() == vector["hex"]


def test_q48_rotations_are_encoded():
    """Within one step of each word: the vectors do not state how halves are rounded."""
    rows = VECTORS["q48"]["encode"]
    record = VECTORS["pose_messages"][0]["records"][1] | {"rotations": [row["rotation"] for row in rows]}
    words = np.frombuffer(encode(record), "<u2", 3 * len(rows), 36).reshape(-1, 3).astype(int)
    expected = np.array([row["words"] for row in rows])
    assert (words >> 15 == expected >> 15).all()
    assert np.abs((words & 0x7FFF) - (expected & 0x7FFF)).max() <= 1


def test_q32_rotations_are_encoded():
    """Within one step of each component: the vectors do not state how halves are rounded."""
    rows = VECTORS["q32"]["encode"]
    record = VECTORS["pose_messages"][0]["records"][1]
    content = encode(record | {"encoding": "q32", "rotations": [row["rotation"] for row in rows]})
    words = np.frombuffer(content, "<u4", len(rows), 36).astype(np.int64)
    expected = np.array([row["word"] for row in rows], np.int64)
    assert (words >> 30 == expected >> 30).all()
    for shift in (0, 10, 20):
        assert np.abs((words >> shift & 1023) - (expected >> shift & 1023)).max() <= 1


@pytest.mark.parametrize("vector", VECTORS["malformed_client_messages"], ids=lambda vector: vector["text"])
def test_malformed_client_messages_are_rejected(vector):
    with pytest.raises(ValidationError):
        CLIENT.validate_json(vector["text"])


@pytest.mark.parametrize("vector", VECTORS["client_messages"], ids=lambda vector: vector["text"][:40])
def test_client_messages_are_accepted(vector):
    found = CLIENT.validate_json(vector["text"]).model_dump()
    assert {name: found[name] for name in vector["fields"]} == vector["fields"]


def test_server_messages_fit_the_schemas():
    known = [row for row in VECTORS["server_messages"] if row["fields"] is not None]
    for row in known[:-1]:  # the last one has a field of a future version
        SERVER.validate_json(row["text"])
