"""Godot 3 without a window, with the addon and the test programs."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
from pathlib import Path
from typing import Any

from tests.clients import driver
from tools import godot3

PROJECT = Path(__file__).parents[3]
PROGRAMS = Path(__file__).parent / "programs"
GODOT = shutil.which("godot3-server")
PREFIX = "JSON "


def missing() -> str:
    """Why programs cannot be run; empty if they can."""
    return "" if GODOT else "godot3-server is not installed (Debian: godot3-server)"


def make_project(folder: Path) -> Path:
    """A project with the addon for Godot 3 and the test programs."""
    godot3.write(folder)
    for path in PROGRAMS.glob("*.gd"):
        shutil.copy(path, folder)
    return folder


def command(project: Path, program: str, content: Any) -> tuple[list[str], dict[str, str]]:
    """Command line and environment of a program."""
    assert GODOT is not None
    environment = {**os.environ, "HOME": str(project), "ADVERB_PROGRAM": json.dumps(content), "LC_ALL": "C.UTF-8"}
    return [GODOT, "--path", str(project), "-s", f"{program}.gd"], environment


def run(project: Path, program: str, function: str, *arguments: Any) -> Any:
    """What a function of a program returns."""
    line, environment = command(project, program, [function, arguments])
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=120, check=False)
    errors = [row for row in done.stderr.splitlines() if row.startswith("SCRIPT ERROR")]
    assert done.returncode == 0, done.stdout + done.stderr
    assert not errors, done.stderr
    rows = [row for row in done.stdout.splitlines() if row.startswith(PREFIX)]
    return json.loads(rows[-1].removeprefix(PREFIX))


class Driver(driver.Driver):
    """A program that exchanges lines of JSON on a socket; the output of Godot is buffered."""

    def __init__(self, project: Path, server: str, verb: str = "arm3", **settings: Any) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(driver.PATIENCE_S)
        self._connection: socket.socket | None = None
        content = {
            "server": server,
            "verb": verb,
            "key": "",
            "options": {},
            "timeout": 10.0,
            "silence": 10.0,
            "patience": 10.0,
            "stays": False,
        }
        content |= {"port": self._listener.getsockname()[1], **settings}
        super().__init__(*command(project, content.pop("program", "driver"), content))

    def __exit__(self, *details: object) -> None:
        super().__exit__(*details)
        self._listener.close()
        if self._connection is not None:
            self._connection.close()

    def _read(self) -> None:
        self._connection, _ = self._listener.accept()
        with self._connection.makefile("r", encoding="utf-8") as lines:
            for line in lines:
                self.rows.put(json.loads(line))
        self.rows.put(None)

    def send(self, command: str, **fields: Any) -> None:
        """Send a command."""
        assert self._connection is not None
        self._connection.sendall((json.dumps({"command": command, **fields}) + "\n").encode())

    def stats(self) -> dict[str, Any]:
        """Counters of the stream."""
        self.send("stats")
        return self.until("counters")
