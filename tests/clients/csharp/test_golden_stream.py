"""The C# client replays the recorded stream."""

import json

from tests.clients.csharp.mono import run
from tests.clients.recording import ARGUMENTS, check
from tools import golden_stream


def test_the_recorded_stream_is_replayed(program):
    check(run(program, "replay", *ARGUMENTS), json.loads(golden_stream.EXPECTED.read_text("utf-8")))
