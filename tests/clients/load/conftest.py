"""A real server on a free port, for all tests of this folder."""

import subprocess
import sys
from pathlib import Path

import pytest
from adverb_load.process import serve

from tests.clients.load import LOAD

PROJECT = Path(__file__).resolve().parents[3]
START = "from service.cli import main; main()"


@pytest.fixture(scope="session")
def server():
    command = [sys.executable, "-c", START, "serve", "--port", "0"]
    with serve(command, core=None, cwd=PROJECT, environment={"ADVERB_DATA": "", "ADVERB_STREAM_GRACE_S": "2"}) as found:
        first = [sys.executable, str(LOAD / "streams.py"), "--url", found.url, "--seconds", "0.2", "--steer", "20"]
        subprocess.run(first, capture_output=True, timeout=180, check=False)  # compiles what is not compiled yet
        yield found
