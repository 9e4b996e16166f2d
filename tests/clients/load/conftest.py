"""A real server on a free port, for all tests of this folder."""

import sys
from pathlib import Path

import pytest
from adverb_load.process import serve

PROJECT = Path(__file__).resolve().parents[3]
START = "from service.cli import main; main()"


@pytest.fixture(scope="session")
def server():
    command = [sys.executable, "-c", START, "serve", "--port", "0"]
    with serve(command, core=None, cwd=PROJECT, environment={"ADVERB_DATA": "", "ADVERB_STREAM_GRACE_S": "2"}) as found:
        yield found
