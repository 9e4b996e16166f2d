"""The crowd client: compiled parsing against the encoder of the documentation, goals and errors."""

import numpy as np
import pytest
from adverb_client.records import ENCODINGS
from adverb_load import frames
from adverb_load.crowd_frames import SOCKET, TOTALS, Counts, Totals, walk
from adverb_load.crowd_goals import STRIDE, Steering, errors_of
from adverb_load.effector import Effector
from adverb_load.goals import Goals

from tests.clients.python.specimen import Rec, message, record_bytes

IDENTITY = (0.0, 0.0, 0.0, 1.0)
OFFSET_NS, NOW_NS = 10**18, 5_000_000
LAST = 2
"""Channel of which records are copied."""


def served(payload: bytes, first: int = 0x82) -> bytes:
    """A frame of a server: no mask."""
    whole = bytearray(frames.frame(first & 0x0F, payload, bytes(4)))
    at = {126: 4, 127: 10}.get(whole[1] & 0x7F, 2)
    whole[0], whole[1] = first, whole[1] & 0x7F
    return bytes(whole[:at] + whole[at + 4 :])


def poses(sequence: int, *, dropped: int = 0, late_ns: int = 1_000, encoding: int = 0, **changed) -> bytes:
    records = [Rec(k, encoding, error=0.001 * (k + 1), rotations=[IDENTITY] * 3, **changed) for k in range(LAST + 1)]
    due_ns = NOW_NS + OFFSET_NS - late_ns
    return served(message(records, sequence=sequence, time_ns=due_ns, dropped=dropped))


def counts() -> Counts:
    totals = np.zeros(len(TOTALS), np.int64)
    totals[:2] = 0, 2 * NOW_NS
    sockets = np.zeros((2, len(SOCKET)), np.int64)
    sockets[:, 3] = OFFSET_NS
    width = record_bytes(0, 3)
    return Counts(sockets, totals, np.zeros(8, np.int64), np.zeros((4, 3), np.int64), np.zeros((8, width), np.uint8),
                  np.zeros((8, 2), np.int64))  # fmt: skip


def parse(content: bytes, found: Counts, *, encoding: int = 0) -> tuple[int, int]:
    room = np.frombuffer(content + bytes(64), np.uint8).copy()
    return walk(room, len(content), 1, NOW_NS, record_bytes(encoding, 3), encoding, LAST, 1, found)


def totals_of(found: Counts) -> Totals:
    return Totals(*found.totals.tolist())


def test_messages_are_counted():
    found = counts()
    found.sockets[1, 4] = 77
    content = poses(1, late_ns=1_000) + poses(2, late_ns=3_000, flags=1)
    assert parse(content, found) == (len(content), 0)
    totals = totals_of(found)
    assert (totals.messages, totals.delivered, totals.records) == (2, 2, 6)
    assert (totals.gaps, totals.dropped, totals.wrong, totals.clamped) == (0, 0, 0, 3)
    assert totals.bytes == 2 * (20 + 3 * record_bytes(0, 3))
    assert found.late_ns[:2].tolist() == [1_000, 3_000]
    assert np.array([totals.worst], np.uint32).view(np.float32)[0] == np.float32(0.003)
    assert totals.samples == 2
    assert found.samples[0].tobytes() == Rec(LAST, error=0.003, rotations=[IDENTITY] * 3).encode()
    assert found.sampled[:2].tolist() == [[1, 77]] * 2


@pytest.mark.parametrize(
    ("sequence", "dropped", "gaps", "lost"),
    [(2, 0, 0, 0), (4, 2, 0, 2), (4, 0, 2, 0), (4, 1, 1, 1), (2, 3, 0, 3), (1, 0, 1, 0)],
)
def test_missing_messages_are_counted(sequence, dropped, gaps, lost):
    found = counts()
    parse(poses(1) + poses(sequence, dropped=dropped), found)
    assert (totals_of(found).gaps, totals_of(found).dropped) == (gaps, lost)


def test_frames_may_arrive_in_any_pieces():
    content = poses(1) + served(b'{"op":"pong","t":0}', 0x81) + poses(2) + served(b"ping", 0x89)
    for cut in range(1, len(content)):
        found = counts()
        used, texts = parse(content[:cut], found)
        assert used <= cut
        assert parse(content[used:], found)[0] == len(content) - used
        assert (totals_of(found).messages, totals_of(found).gaps) == (2, 0)
        assert texts <= 2


def test_texts_are_located_and_events_are_counted():
    text, long = b'{"op":"pong","t":0}', b'{"op":"opened"' + bytes(70_000)
    content = served(text, 0x81) + served(b'{"op":"events","items":[]}', 0x81) + served(long, 0x81)
    found = counts()
    assert parse(content, found) == (len(content), 2)
    assert totals_of(found).events == 1
    for (first, start, size), expected in zip(found.texts[:2].tolist(), (text, long), strict=True):
        assert (first, content[start : start + size]) == (0x81, expected)


@pytest.mark.parametrize("content", [poses(1, encoding=3), served(b"\2" * 40), served(message([])[:-1] + bytes(9))])
def test_malformed_messages_are_counted(content):
    found = counts()
    parse(content, found)
    assert totals_of(found).wrong == 1


def test_a_message_of_unknown_length_is_not_missing():
    found = counts()
    room = np.frombuffer(poses(1) + poses(2), np.uint8)
    walk(room, len(room) // 2, 1, NOW_NS, 0, 0, LAST, 1, found)  # its records' length has not been read yet
    parse(poses(2), found)
    assert (totals_of(found).messages, totals_of(found).wrong, totals_of(found).gaps) == (1, 1, 0)


def test_messages_outside_the_window_are_not_measured():
    found = counts()
    parse(poses(1, late_ns=2 * NOW_NS) + poses(2, late_ns=-2 * NOW_NS), found)
    totals = totals_of(found)
    assert (totals.messages, totals.delivered, totals.records, totals.samples) == (2, 0, 0, 0)


def goals() -> Goals:
    rows = np.random.default_rng(3).uniform(0.1, 0.9, (50, 3)).astype(np.float32)
    return Goals(["x", "y", "z"], rows, [row.tobytes() for row in rows])


@pytest.mark.parametrize("bulk", [True, False])
def test_a_frame_steers_all_channels(bulk):
    steering = Steering.of(goals(), 4, bulk=bulk)
    content = bytearray(steering.frames[7])
    assert len(content) == (2 + 4 + 4 + 4 * 16 if bulk else 4 * (2 + 4 + 16))
    rows = np.frombuffer(bytes(content[10:] if bulk else content), np.uint8)
    width = 16 if bulk else 22
    found = rows.reshape(4, width)[:, -12:].copy().view("<f4")
    for channel in range(4):
        assert found[channel].tolist() == steering.goal(channel, 7).tolist()


@pytest.mark.parametrize(("encoding", "within"), [("f32", 1e-6), ("q48", 2e-4), ("q32", 6e-3)])
@pytest.mark.parametrize("moving", [True, False])
def test_errors_are_those_of_the_goals(encoding, within, moving):
    effector = Effector(2, [0], np.array([[0.0, 0.5, 0.0]]), 0.5)
    walked, channel, steps = goals(), 3, np.array([9, 40])
    records = []
    for step in (steps - 2 if moving else steps).tolist():
        goal = walked.rows[(step + STRIDE * channel) % 50].astype(float)
        root = tuple((goal - [0.0, 0.5, 0.0]).tolist())
        records.append(Rec(channel, ENCODINGS[encoding], root=root, rotations=[IDENTITY, IDENTITY]).encode())
    content = np.frombuffer(b"".join(records), np.uint8).reshape(2, -1)
    errors = errors_of(content, steps, channel, walked, effector, encoding, moving=moving)
    assert errors.max() < within
    apart = errors_of(content, steps + 1, channel, walked, effector, encoding, moving=False)
    assert apart.min() > within
