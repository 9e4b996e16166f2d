"""The decoder accepts what an encoder written from docs/wire.md produces, and rejects everything else."""

import contextlib
import math
import struct

import numpy as np
import pytest
from adverb_client import DecodeError, Layout, decode_message, encode_adverbs
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.clients.python.specimen import Rec, message, record_bytes

Q48_RAD = 1.5e-4
"""Half a step in each of three components, where all four are equal: 2·√12 / (2·16383·√2) rad."""

finite = st.floats(-1e6, 1e6, width=32)
COUNTS = {channel: 1 + channel % 7 for channel in range(12)}
LAYOUTS = {channel: Layout(channel % 3, count) for channel, count in COUNTS.items()}


@st.composite
def turns(draw):
    numbers = draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
    return tuple(number / math.hypot(*numbers) for number in numbers)


@st.composite
def records(draw):
    channel = draw(st.integers(0, 11))
    encoding, count = channel % 3, COUNTS[channel]
    head = [draw(finite) for _ in range(3)]
    return Rec(
        channel,
        encoding,
        draw(st.integers(0, 255)),
        draw(st.integers(0, 2**32 - 1)),
        *head[:2],
        draw(st.one_of(finite, st.just(math.nan))),
        head[2],
        tuple(draw(finite) for _ in range(3)),
        [draw(turns()) for _ in range(count)] if encoding < 2 else [],
        [draw(finite) for _ in range(draw(st.integers(0, 9)))] if encoding == 2 else [],
    )


tops = st.fixed_dictionaries(
    {
        "sequence": st.integers(0, 2**32 - 1),
        "time_ns": st.integers(0, 2**64 - 1),
        "dropped": st.integers(0, 2**32 - 1),
    }
)


@settings(max_examples=60)
@given(st.lists(records(), max_size=8), tops)
def test_decoding_inverts_encoding(sent, top):
    found = decode_message(message(sent, **top), LAYOUTS)
    assert {"sequence": found.sequence, "time_ns": found.time_ns, "dropped": found.dropped} == top
    got = list(found.records())
    assert len(got) == len(sent)
    for one, other in zip(got, sent, strict=True):
        assert (one.channel, one.flags, one.version) == (other.channel, other.flags, other.version)
        numbers = [one.phase, one.time_s, one.error, one.duration_s]
        np.testing.assert_array_equal(
            np.float32(numbers), np.float32([other.phase, other.time, other.error, other.duration])
        )
        if other.encoding == 2:
            assert one.root is None
            assert one.rotations is None
            np.testing.assert_array_equal(one.weights, np.float32(other.weights))
        else:
            np.testing.assert_array_equal(one.root, np.float32(other.root))
            assert one.weights is None
            assert angle(one.rotations, other.rotations) < (1e-6 if other.encoding == 0 else Q48_RAD)


def angle(found, expected) -> float:
    """The largest angle between rotations, radians; by the chord, which is exact where the angle is small."""
    a, b = np.float64(found), np.float64(np.float32(expected))
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return float((4.0 * np.arcsin(chord / 2.0)).max())


@settings(max_examples=60)
@given(turns())
def test_q48_is_within_its_tolerance_and_unit(turn):
    content = message([Rec(1, 1, rotations=[turn] * 2)])
    record = next(decode_message(content, {1: Layout(1, 2)}).records())
    assert angle(record.rotations, [turn] * 2) < Q48_RAD
    np.testing.assert_allclose(np.linalg.norm(record.rotations, axis=-1), 1.0, atol=1e-6)


@settings(max_examples=30)
@given(st.lists(records(), min_size=1, max_size=5), st.data())
def test_a_truncated_or_longer_message_is_rejected(sent, data):
    content = message(sent)
    with pytest.raises(DecodeError):
        decode_message(content[: data.draw(st.integers(0, len(content) - 1))], LAYOUTS)
    with pytest.raises(DecodeError, match="after the last"):
        decode_message(content + bytes(data.draw(st.integers(1, 40))), LAYOUTS)


@settings(max_examples=60)
@given(st.one_of(st.binary(max_size=300), st.binary(max_size=300).map(lambda rest: b"\x01\x01\x03\x00" + rest)))
def test_noise_is_decoded_or_raises_a_decode_error(noise):
    try:
        found = decode_message(noise, LAYOUTS)
    except DecodeError:
        return
    assert 20 + sum(batch.headers.nbytes for batch in found.batches) == len(noise)


@settings(max_examples=40)
@given(st.lists(records(), min_size=1, max_size=4), st.data())
def test_a_flipped_byte_raises_no_other_error(sent, data):
    content = bytearray(message(sent))
    content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(DecodeError):
        decode_message(bytes(content), LAYOUTS)


def test_many_channels_of_one_layout_are_one_batch_of_views():
    sent = [Rec(k, rotations=[(0.0, 0.0, 0.0, 1.0)] * 3) for k in range(200)]
    content = message(sent)
    found = decode_message(content, {k: Layout(0, 3) for k in range(200)})
    assert [len(batch.headers) for batch in found.batches] == [200]
    assert found.batches[0].rotations.shape == (200, 3, 4)
    assert not found.batches[0].rotations.flags.writeable


def test_alternating_layouts_are_decoded():
    sent = [Rec(0).encode(), Rec(1, 1, rotations=[(0, 0, 0, 1)]).encode()]
    content = struct.pack("<BBHIQI", 1, 1, 2000, 1, 0, 0) + b"".join(sent) * 1000
    assert len(decode_message(content, {0: Layout(0, 0), 1: Layout(1, 1)}).batches) == 2000


def test_a_new_version_may_have_more_examples():
    content = message([Rec(2, 2, weights=[0.5, 0.25, 0.25])])
    record = next(decode_message(content, {2: Layout(2, 9)}).records())
    np.testing.assert_array_equal(record.weights, [0.5, 0.25, 0.25])


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "at least 20"),
        (b"\x02\x01" + bytes(18), "message 0x02"),
        (b"\x01\x02" + bytes(18), "wire version 2"),
        (message([Rec(77)]), "channel 77, which is not open"),
        (message([Rec(1, 0, rotations=[(0, 0, 0, 1)])]), "encoding 0 on channel 1, which has encoding 1"),
        (message([Rec(0, root=(math.nan, 0, 0), rotations=[(0, 0, 0, 1)])]), "finite"),
        (message([Rec(0, rotations=[(0, math.inf, 0, 1)])]), "finite"),
        (message([Rec(0, phase=math.nan, rotations=[(0, 0, 0, 1)])]), "finite"),
        (message([Rec(2, 2, duration=math.inf)]), "finite"),
    ],
)
def test_decode_errors_state_the_problem(content, match):
    with pytest.raises(DecodeError, match=match):
        decode_message(content, LAYOUTS)


@pytest.mark.parametrize("count", [1, 2, 3, 22])
@pytest.mark.parametrize("name", ["f32", "q48", "weights", "q32"])
def test_the_layout_of_opened_has_its_length(name, count):
    length = record_bytes({"f32": 0, "q48": 1, "weights": 2, "q32": 3}[name], count)
    layout = Layout.from_opened(name, count, length)
    assert (layout.count, layout.record_bytes) == (count, length)
    with pytest.raises(DecodeError, match="do not fit"):
        Layout.from_opened(name, count, length + 2)
    with pytest.raises(DecodeError, match="unknown encoding"):
        Layout.from_opened("f64", count, length)


def test_adverbs_are_encoded_as_specified():
    assert encode_adverbs(513, [1.0, -2.0]) == bytes([0x10, 0, 1, 2]) + struct.pack("<ff", 1.0, -2.0)
    with pytest.raises(ValueError, match="channel"):
        encode_adverbs(65_536, [1.0])
    for bad in (math.nan, math.inf, 1e300):
        with pytest.raises(ValueError, match="finite"):
            encode_adverbs(0, [bad])
