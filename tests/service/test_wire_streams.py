"""Records byte by byte: against the golden file, its dump in docs/wire.md, and numbers packed by hand."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from service.packing import pack
from service.wire import ENCODINGS, FRAMES, HEADER, Layout, Targets, offsets_in
from tests.service.stream.conftest import Client, rotation
from verbs.kernels import character_state, quat
from verbs.runtime.characters import Frames
from verbs.runtime.evaluate import Blend
from verbs.skeleton import Skeleton

GOLDEN = Path(__file__).parents[1] / "golden" / "pose_message.v1.bin"
DOCUMENT = Path(__file__).parents[2] / "docs" / "wire.md"

TURN = np.sqrt(0.5)
POSE = np.array([[0.0, 0.0, 0.0, 1.0], [TURN, 0.0, 0.0, TURN], [0.5, -0.5, 0.5, -0.5]])


def frames_of(count, rotations, weights=None):
    blend = Blend(
        "",
        np.tile([0.75, 0.5, -0.25] if weights is None else weights, (count, 1)),
        np.zeros((count, 0)),
        np.full(count, 0.125),
        np.zeros(count, np.bool_),
    )
    progress = np.zeros(count, character_state.PROGRESS)
    progress["phase"], progress["time_s"], progress["duration_s"] = 0.5, 1.25, 2.5
    return Frames(blend, progress, np.tile([0.25, 1.0, -0.5], (count, 1)), rotations, np.zeros(count, np.bool_))


def golden_message() -> bytes:
    """Three records of one pose: f32 of two joints, q48 of three, and weights."""
    frames = frames_of(3, np.tile(POSE, (3, 1, 1)))
    frames.blend.clamped[1], frames.in_transition[1], frames.progress["ended"][2] = True, True, 1.0
    frames.blend.error[2] = np.nan
    layouts = [
        Layout("f32", "local", "gltf", np.array([0, 1]), 3),
        Layout("q48", "local", "gltf", np.array([0, 1, 2]), 3),
        Layout("weights", "local", "gltf", np.array([0, 1, 2]), 3),
    ]
    at = np.cumsum([5, *(layout.words for layout in layouts)])
    words = np.zeros(at[-1], np.uint32)
    pack(frames, frames.rotations, 7, Targets.of(layouts, at[:-1], [1, 2, 3 | 4 << 24]), words)
    content = bytearray(words.tobytes())
    HEADER.pack_into(content, 0, 1, 1, 3, 42, 1_700_000_000_123_456_789, 5)
    return bytes(content)


def test_the_golden_message_is_what_is_packed():
    """Written by version 1 of the wire; never regenerated."""
    assert golden_message() == GOLDEN.read_bytes()


def test_a_stranger_reads_the_golden_message():
    client = Client(None, joints={1: 2, 2: 3, 3: 3}, lengths={1: 68, 2: 56, 3: 40})
    message = client.decode(GOLDEN.read_bytes())
    one, two, three = message.records
    assert (message.sequence, message.time_ns, message.dropped) == (42, 1_700_000_000_123_456_789, 5)
    assert [record.flags for record in message.records] == [0, 1 | 2, 4 | 8]
    assert {record.version for record in message.records} == {7}
    assert (one.phase, one.time, one.error, one.duration) == (0.5, 1.25, 0.125, 2.5)
    assert np.isnan(three.error)
    np.testing.assert_array_equal(one.root, [0.25, 1.0, -0.5])
    np.testing.assert_allclose(one.rotations, POSE[:2], atol=1e-7)
    np.testing.assert_array_equal(three.weights, np.array([0.75, 0.5, -0.25], np.float32))
    same = np.abs((two.rotations * POSE).sum(axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=1e-8)


def test_the_dump_in_the_document_is_the_golden_message():
    text = DOCUMENT.read_text(encoding="utf-8")
    dump = text.split("### One real message")[1].split("```")[1]
    lines = [re.match(r"^\s*(\d+)  ((?:[0-9a-f]{2} ?)+)", line) for line in dump.splitlines()]
    found = b""
    for line in filter(None, lines):
        assert int(line[1]) == len(found)
        found += bytes.fromhex(line[2])
    assert found == GOLDEN.read_bytes()


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("encoding", ["f32", "q48"])
def test_every_rotation_survives(encoding, frame):
    rng = np.random.default_rng(1)
    random = rng.normal(size=(400, 1, 4))
    random[:8, 0] = [[0, 0, 0, 1], [0, 0, 0, -1], [1, 0, 0, 0], [0, -1, 0, 0], [0.5] * 4, [-0.5] * 4,
                     [TURN, -TURN, 0, 0], [0, 0, TURN, -TURN]]  # fmt: skip
    rotations = quat.normalize(random)
    layout = Layout(encoding, "local", frame, np.zeros(1, np.int64), 3)
    at = np.arange(400) * layout.words
    words = np.zeros(400 * layout.words, np.uint32)
    pack(frames_of(400, rotations), rotations, 1, Targets.of([layout] * 400, at, [0] * 400), words)
    rows = words.reshape(400, layout.words)[:, 9:]
    if encoding == "f32":
        found = rows.view(np.float32).astype(np.float64)
    else:
        assert not rows.view(np.uint16)[:, 3].any()
        found = np.array([rotation(*row[:3].tolist()) for row in rows.view(np.uint16)])
    matrix = offsets_in(_points(np.eye(3)), frame).T / (100.0 if frame == "unreal" else 1.0)
    expected = matrix @ quat.to_matrix(rotations[:, 0]) @ matrix.T
    np.testing.assert_allclose(quat.to_matrix(found), expected, atol=1e-6 if encoding == "f32" else 2e-4)
    same = _turned(matrix, rotations[:, 0])
    gaps = np.linalg.norm(quat.align(quat.normalize(found), same) - same, axis=-1)
    assert 2 * gaps.max() < (1e-6 if encoding == "f32" else 1.5e-4)


def _points(offsets):
    """A skeleton with these offsets."""
    return Skeleton(("a", "b", "c"), np.array([-1, 0, 0]), offsets)


def _turned(matrix, rotations):
    """Quaternions of the same turns in other axes: a rotation's axis is a pseudo-vector."""
    axis = np.linalg.det(matrix) * rotations[:, :3] @ matrix.T
    return np.concatenate([axis, rotations[:, 3:]], axis=-1)


def test_lengths_are_those_of_the_document():
    for joints in (1, 2, 22, 23):
        chosen = np.arange(joints)
        sizes = {name: 4 * Layout(name, "local", "gltf", chosen, 9).words for name in ENCODINGS}
        assert sizes == {
            "f32": 36 + 16 * joints,
            "q48": 36 + (6 * joints + 3) // 4 * 4,
            "weights": 28 + 36,
            "q32": 36 + 4 * joints,
        }


def test_a_record_without_a_place_is_not_written():
    layout = Layout("f32", "local", "gltf", np.array([0]), 3)
    words = np.zeros(layout.words, np.uint32)
    twice = np.tile(POSE, (2, 1, 1))
    pack(frames_of(2, twice), twice, 1, Targets.of([layout] * 2, [-1, -1], [1, 2]), words)
    assert not words.any()


def test_the_description_beside_the_golden_message_is_true():
    """What clients in other languages test their decoders with."""
    facts = json.loads(GOLDEN.with_suffix(".json").read_text())
    content = GOLDEN.read_bytes()
    assert facts["bytes"] == len(content)
    assert [struct.unpack_from("<H", content, record["at"])[0] for record in facts["records"]] == [1, 2, 3]
