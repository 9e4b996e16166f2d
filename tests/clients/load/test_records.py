"""The load's decoder takes what docs/wire.md describes, and nothing else."""

import struct

import numpy as np
import pytest
from adverb_load.records import HEAD, HEADER, DecodeError, Layout, decode, layout_of

S = np.sqrt(0.5)
FULL = struct.pack("<3f", 1, 2, 3) + struct.pack("<8f", 0, 0, 0, 1, S, 0, 0, S)


def head(channel=0, encoding=0, phase=0.5, error=0.25, duration=2.0):
    return HEAD.pack(channel, encoding, 1, 7, phase, 0.5, error, duration)


def message(*records):
    return HEADER.pack(1, 1, len(records), 1, 10, 0) + b"".join(records)


def q48(*joints):
    """Joints as (index left out, three numbers)."""
    words = []
    for left_out, three in joints:
        a, b, c = (round(16_383 * np.sqrt(2) * one) + 16_383 for one in three)
        words += [a | (left_out & 1) << 15, b | (left_out >> 1) << 15, c]
    body = struct.pack(f"<3f{len(words)}H", 1, 2, 3, *words)
    return body + bytes(-len(body) % 4)


LAYOUTS = {0: Layout(0, 2, 68), 5: Layout(1, 3, 56), 9: Layout(2, 2, 36)}


def test_records_of_all_encodings_stand_in_one_message():
    content = message(
        head() + FULL,
        head(5, 1) + q48((3, (0, 0, 0)), (0, (S, 0, 0)), (2, (0.5, 0.5, -0.5))),
        head(9, 2, error=np.nan) + struct.pack("<HH2f", 2, 0, 1.5, -0.5),
    )
    full, three, weights = decode(content, LAYOUTS)
    np.testing.assert_allclose(full.rotations, [[0, 0, 0, 1], [S, 0, 0, S]], atol=1e-7)
    assert (full.channel, full.flags, full.version, full.error) == (0, 1, 7, 0.25)
    np.testing.assert_allclose(three.rotations, [[0, 0, 0, 1], [S, S, 0, 0], [0.5, 0.5, 0.5, -0.5]], atol=1e-4)
    assert three.root.tolist() == [1, 2, 3]
    assert weights.weights.tolist() == [1.5, -0.5]
    assert weights.rotations is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (message(head(1) + FULL), "never opened"),
        (message(head(0, 1) + FULL), "encoding 1"),
        (message(head() + FULL)[:-4], "where 68 should be"),
        (message(head() + FULL) + bytes(4), "4 bytes behind"),
        (message(head() + FULL)[:30], "head"),
        (message(head(phase=1.5) + FULL), "phase 1.5"),
        (message(head(duration=0.0) + FULL), "duration 0.0"),
        (message(head(error=-1.0) + FULL), "error -1.0"),
        (message(head() + FULL[:-4] + struct.pack("<f", 0.9)), "length"),
        (message(head() + struct.pack("<f", np.nan) + FULL[4:]), "root"),
        (message(head(5, 1) + q48(*[(3, (0.5, 0.6, 0.6))] * 3)), "largest component"),
        (message(head(9, 2) + struct.pack("<HH2f", 2, 0, 1.5, 0.5)), "sum"),
        (message(head(9, 2) + struct.pack("<HH2f", 3, 0, 1.0, 0.0)), "3 weights"),
        (b"\x02" + message(head() + FULL)[1:], "message 0x02"),
    ],
)
def test_what_does_not_fit_is_refused(content, said):
    with pytest.raises(DecodeError, match=said):
        decode(content, LAYOUTS)


@pytest.mark.parametrize(("encoding", "size"), [("f32", 404), ("q48", 176)])
def test_opened_must_promise_the_right_length(encoding, size):
    opened = {"encoding": encoding, "joints": ["j"] * 23, "record_bytes": size}
    assert layout_of(opened).record_bytes == size
    with pytest.raises(DecodeError, match="23 joints"):
        layout_of(opened | {"record_bytes": size + 4})
