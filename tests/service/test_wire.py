"""Binary records have the layout of docs/wire.md."""

import struct

import numpy as np
import pytest

from service import wire
from tests.service.records import records_of
from verbs.runtime.evaluate import Blend, Poses


def poses(count: int, joints: int) -> Poses:
    rng = np.random.default_rng(count)
    blend = Blend(
        "rbf", np.ones((count, 1)), np.zeros((count, 0)), rng.uniform(size=count), rng.uniform(size=count) < 0.5
    )
    numbers = rng.uniform(size=(3, count))
    return Poses(blend, *numbers, rng.uniform(size=(count, 3)), rng.uniform(size=(count, joints, 4)), None)


def test_the_head_is_24_bytes_and_records_are_multiples_of_4():
    assert wire.HEAD.itemsize == 24
    assert all(wire.record(joints).itemsize == 36 + 16 * joints for joints in (1, 4, 23, 1_000))


def test_fields_stand_where_the_specification_says():
    batch = poses(1, 2)
    content = wire.encode(batch, batch.rotations, 7, channels=513, ended=True).tobytes()
    channel, encoding, flags, version, *numbers = struct.unpack("<HBBI4f3f8f", content)
    assert (channel, encoding, version) == (513, 0, 7)
    assert flags == int(batch.blend.clamped[0]) | wire.LAST
    expected = [batch.phase[0], batch.time_s[0], batch.blend.error[0], batch.duration_s[0], *batch.root[0]]
    np.testing.assert_array_equal(numbers[:7], np.float32(expected))
    np.testing.assert_array_equal(numbers[7:], batch.rotations.astype(np.float32).ravel())


@pytest.mark.parametrize("joints", [1, 4, 23])
def test_one_record_is_the_same_in_both_ways(joints):
    batch = poses(1, joints)
    turns = batch.rotations.astype(np.float32)
    assert wire.encode_one(batch, turns, 3) == wire.encode(batch, turns, 3).tobytes()


def test_decoding_gives_back_what_was_encoded():
    batch = poses(50, 5)
    rows = wire.encode(batch, batch.rotations, 2, channels=np.arange(50))
    again = records_of(rows.tobytes(), 5)
    np.testing.assert_array_equal(again, rows)
    np.testing.assert_array_equal(again["flags"] == wire.CLAMPED, batch.blend.clamped)


def test_a_cut_record_is_refused():
    batch = poses(2, 5)
    content = wire.encode(batch, batch.rotations, 2).tobytes()
    with pytest.raises(ValueError, match="buffer size"):
        records_of(content[:-1], 5)
