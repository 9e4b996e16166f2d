"""Mono with the C# client and the test programs."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.clients import driver

PROJECT = Path(__file__).parents[3]
CLIENT = PROJECT / "clients" / "csharp"
PROGRAMS = Path(__file__).parent / "programs"


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


def fields_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of ``OpenOptions`` by their names in C#."""
    return {name.title().replace("_", ""): value for name, value in options.items()}


class Driver(driver.Driver):
    """The program ``Driver.cs``. Options have the names of the wire."""

    def __init__(
        self, program: Path, server: str, verb: str = "arm3", options: Mapping[str, Any] | None = None, **settings: Any
    ) -> None:
        content = {"server": server, "verb": verb, "options": fields_of(options or {}), **settings}
        super().__init__(["mono", str(program), "stream", json.dumps(content)])

    def send(self, command: str, **fields: Any) -> None:
        super().send(command, **({"options": fields_of(fields)} if command.endswith("set") else fields))

    def stats(self) -> dict[str, Any]:
        """Counters of the stream."""
        self.send("stats")
        return self.until("stats")
