"""Node with the built package, and a proxy between it and a server."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[3]
PACKAGE = PROJECT / "clients" / "typescript"
BUILT = PACKAGE / "dist" / "index.js"
NODE = shutil.which("node")
FOLDER = Path(__file__).parent
PATIENCE_S = 60.0


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


class Driver:
    """The program ``driver.mjs``."""

    def __init__(self, server: str, verb: str = "arm3", **settings: Any) -> None:
        assert NODE is not None
        arguments = json.dumps({"server": server, "verb": verb, **settings})
        self.rows: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.process = subprocess.Popen(
            [NODE, str(FOLDER / "driver.mjs"), arguments],
            env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Driver:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(BrokenPipeError):
                pipe.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.rows.put(json.loads(line))
        self.rows.put(None)

    def send(self, command: str, **fields: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"command": command, **fields}) + "\n")
        self.process.stdin.flush()

    def until(self, event: str, holds: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """The next event of a name for which a condition holds; others before it are skipped."""
        end, last = time.monotonic() + PATIENCE_S, None
        while (left := end - time.monotonic()) > 0:
            try:
                row = self.rows.get(timeout=left)
            except queue.Empty:
                break
            assert row is not None, f"the program ended before '{event}'; its last event was {last}"
            if row["event"] == event and holds(row):
                return row
            last = row
        raise AssertionError(f"no '{event}' in time; the last event was {last}")

    def discard(self) -> None:
        """Skip the events so far."""
        with suppress(queue.Empty):
            while True:
                self.rows.get_nowait()
