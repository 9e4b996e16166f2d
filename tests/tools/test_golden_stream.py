"""The recorded stream is what a server sends now, and has what clients need to be tested with."""

import json

import numpy as np
import pytest

from tools import golden_stream

STORED = json.loads(golden_stream.EXPECTED.read_text("utf-8"))
RECORDS = [record for message in STORED["messages"] for record in message["records"]]
HINT = "run `python -m tools.golden_stream`"


@pytest.fixture(scope="module")
def recorded():
    return golden_stream.record()


def test_the_recording_is_current(recorded):
    stored = list(golden_stream.messages_of(golden_stream.STREAM.read_bytes()))
    texts, others = (
        [json.loads(text) for kind, text in each if kind == golden_stream.TEXT] for each in (stored, recorded)
    )
    assert texts == others, HINT
    assert [(kind, len(content)) for kind, content in stored] == [(kind, len(content)) for kind, content in recorded], (
        HINT
    )


def test_the_positions_are_current(recorded):
    fresh = golden_stream.expected(recorded)
    assert fresh["artifacts"] == STORED["artifacts"], HINT
    for old, new in zip(STORED["messages"], fresh["messages"], strict=True):
        assert old["sequence"] == new["sequence"]
        for row, other in zip(old["records"], new["records"], strict=True):
            assert {**row, "positions": 0, "phase": 0} == {**other, "positions": 0, "phase": 0}
            np.testing.assert_allclose(row["positions"], other["positions"], atol=1e-5, err_msg=HINT)


def test_it_has_all_encodings_a_switch_and_a_new_version():
    assert {record["encoding"] for record in RECORDS} == {"f32", "q48", "q32", "weights"}
    assert {record["verb"] for record in RECORDS if record["channel"] == 2} == {"reach", "locomotion"}
    assert {record["version"] for record in RECORDS if record["channel"] == 4} == {1, 2}
    assert any(record["flags"] & 2 for record in RECORDS), "no transition"
    assert any(record["flags"] & 4 for record in RECORDS), "no record is the first of a new version"
    assert golden_stream.STREAM.stat().st_size + golden_stream.EXPECTED.stat().st_size < 300_000


def test_its_poses_move():
    for channel in range(1, 7):
        rows = [record["positions"] for record in RECORDS if record["channel"] == channel and record["version"] == 1]
        first, last = np.array(rows[0]), np.array(rows[-1])
        assert np.abs(first - last).max() > 0.01
