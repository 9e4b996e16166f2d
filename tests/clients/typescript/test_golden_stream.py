"""The TypeScript client replays the recorded stream."""

import json

from tests.clients.recording import ARGUMENTS, check
from tests.clients.typescript.node import run
from tools import golden_stream


def test_the_recorded_stream_is_replayed():
    check(run("replay.mjs", *ARGUMENTS), json.loads(golden_stream.EXPECTED.read_text("utf-8")))
