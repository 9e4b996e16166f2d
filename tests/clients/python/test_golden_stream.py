"""The Python client replays the recorded stream; the library evaluates its weights."""

from __future__ import annotations

import json

import numpy as np
import pytest
from adverb_client import Layout, decode_message
from adverb_client.skeleton import Skeleton

from tests.clients.recording import check
from tools import golden_stream
from verbs.io import artifact
from verbs.runtime.evaluate import Blend, Evaluator

EXPECTED = json.loads(golden_stream.EXPECTED.read_text("utf-8"))


@pytest.fixture(scope="module")
def evaluators():
    found = {}
    for row in EXPECTED["artifacts"]:
        found[row["verb"], row["version"]] = Evaluator(artifact.load(golden_stream.ROOT / row["file"]))
    return found


def evaluated(evaluator, record):
    """Joint positions of a record of weights."""
    unknown = np.full(1, np.nan)
    blend = Blend("weights", record.weights[None].astype(np.float64), np.zeros((1, 0)), unknown, np.zeros(1, np.bool_))
    return evaluator.positions(evaluator.pose_of(blend, phase=record.phase, plant=False))[1][0]


def test_the_recorded_stream_is_replayed(evaluators):
    opened, layouts, found = {}, {}, []
    for kind, content in golden_stream.messages_of(golden_stream.STREAM.read_bytes()):
        if kind == golden_stream.BINARY:
            message = decode_message(content, layouts)
            rows = []
            for record in message.records():
                channel = opened[record.channel]
                if record.root is None:
                    positions = evaluated(evaluators[channel["verb"], record.version], record)
                else:
                    skeleton = channel["skeleton"]
                    positions = Skeleton(
                        tuple(skeleton["names"]), np.array(skeleton["parents"]), np.array(skeleton["offsets"]),
                        np.zeros(0, np.int64), np.zeros((0, 3)),
                    ).positions(record.root, record.rotations)  # fmt: skip
                rows.append({"channel": record.channel, "version": record.version, "positions": positions.ravel()})
            found.append({"sequence": message.sequence, "records": rows})
            continue
        fields = json.loads(content)
        if fields["op"] == "opened":
            opened[fields["channel"]] = fields
            layouts[fields["channel"]] = Layout.from_opened(
                fields["encoding"], len(fields["joints"]), fields["record_bytes"]
            )
    check(found, EXPECTED)
