"""The Godot addon replays the recorded stream."""

import json

from tests.clients.godot.godot import run
from tests.clients.recording import ARGUMENTS, check
from tools import golden_stream


def test_the_recorded_stream_is_replayed(project):
    expected = json.loads(golden_stream.EXPECTED.read_text("utf-8"))
    found = run(project, "replay", "replay", *ARGUMENTS)
    check(found["messages"], expected)
    assert found["stats"]["messages"] == len(expected["messages"])
    assert found["stats"]["decode_errors"] == 0
    kinds = {event["kind"] for event in found["events"]}
    assert {"opened", "version", "keytime"} <= kinds
