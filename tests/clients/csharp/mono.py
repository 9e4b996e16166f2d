"""Mono with the C# client and the test programs."""

from __future__ import annotations

import json
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
CLIENT = PROJECT / "clients" / "csharp"
PROGRAMS = Path(__file__).parent / "programs"
PATIENCE_S = 60.0


def missing() -> str:
    """Why programs cannot be compiled and run; empty if they can."""
    absent = [name for name in ("mcs", "mono") if shutil.which(name) is None]
    return f"{' and '.join(absent)} not installed (Debian: mono-mcs mono-runtime)" if absent else ""


def compile_cs(output: Path, sources: list[Path], *references: str, library: bool = False) -> str:
    """Compile sources at the language level of the client; warnings are errors. Returns the output of the compiler."""
    options = ["-langversion:6", "-warn:4", "-warnaserror", f"-target:{'library' if library else 'exe'}"]
    if library:
        options.append(f"-doc:{output.with_suffix('.xml')}")  # public names without documentation are errors
    options += [f"-r:{reference}" for reference in references]
    command = ["mcs", *options, f"-out:{output}", *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def run(program: Path, *arguments: str) -> Any:
    """Output of a program, which prints JSON."""
    done = subprocess.run(["mono", str(program), *arguments], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


class Driver:
    """The program ``Driver.cs``: one channel of a stream."""

    def __init__(self, program: Path, server: str, verb: str = "arm3", **settings: Any) -> None:
        arguments = json.dumps({"server": server, "verb": verb, **settings})
        self.rows: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.process = subprocess.Popen(
            ["mono", str(program), "stream", arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
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
        """Send a command."""
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

    def stats(self) -> dict[str, Any]:
        """Counters of the stream."""
        self.send("stats")
        return self.until("stats")
