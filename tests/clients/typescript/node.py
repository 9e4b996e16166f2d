"""Node with the built package."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.clients import driver

PROJECT = Path(__file__).parents[3]
PACKAGE = PROJECT / "clients" / "typescript"
BUILT = PACKAGE / "dist" / "index.js"
NODE = shutil.which("node")
FOLDER = Path(__file__).parent


def missing() -> str:
    """Why the package cannot be run; empty if it can."""
    if NODE is None:
        return "Node is not installed"
    if not BUILT.is_file():
        return "the TypeScript client is not built: npm --prefix clients/typescript run build"
    text = subprocess.run([NODE, "--version"], capture_output=True, text=True, check=True).stdout
    major, minor = map(int, text.removeprefix("v").split(".")[:2])
    return "" if (major, minor) >= (20, 16) else "Node is older than 20.16"


def environment() -> dict[str, str]:
    return {**os.environ, "ADVERB_CLIENT": BUILT.as_uri()}


def run(script: str, *arguments: str) -> Any:
    """Output of a script, which prints JSON."""
    assert NODE is not None
    command = [NODE, str(FOLDER / script), *arguments]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Driver(driver.Driver):
    """The program ``driver.mjs``."""

    def __init__(self, server: str, verb: str = "arm3", **settings: Any) -> None:
        assert NODE is not None
        arguments = json.dumps({"server": server, "verb": verb, **settings})
        super().__init__([NODE, str(FOLDER / "driver.mjs"), arguments], environment())

    def discard(self) -> None:
        """Skip the events so far."""
        with suppress(queue.Empty):
            while True:
                self.rows.get_nowait()
