"""The five lines for each kind of user in README.md run, as they stand, against a server."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.clients.csharp import mono
from tests.clients.godot import godot
from tests.service.catalog.conftest import PATIENCE_S, Kept

PROJECT = Path(__file__).parents[1]
SECTION = (PROJECT / "README.md").read_text("utf-8").split("## Five lines for each")[1].split("\n## ")[0]
SERVER = "http://127.0.0.1:8000"
CSHARP = """
using System;
using System.Threading.Tasks;
using Adverb;

static class Program
{
    static async Task Run() { EXAMPLE }

    static int Main() { return Run().Wait(60000) ? 0 : 1; }
}
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


@pytest.fixture(scope="module")
def address(data):
    server = Kept(data=data / "data", refiners=0).start(PATIENCE_S)
    yield f"http://127.0.0.1:{server.port}"
    server.stop()


def lines_of(heading: str, language: str) -> str:
    """The block below a heading."""
    found = re.search(rf"\*\*{heading}.*?```{language}\n(.*?)```", SECTION, re.DOTALL)
    assert found, heading
    lines = found[1].strip().splitlines()
    assert len([line for line in lines if line.strip()]) <= 6
    return found[1]


def run(command: list[str], cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, timeout=400, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def shell(data, address):
    """Run a block of commands; `adverb` is that of this interpreter."""
    programs = data / "bin"
    programs.mkdir(exist_ok=True)
    start = f"#!/bin/sh\nexec {sys.executable} -c 'from service.cli import main; main()' \"$@\"\n"
    (programs / "adverb").write_text(start)
    (programs / "adverb").chmod(0o755)
    if not (data / "verbs").exists():
        (data / "verbs").symlink_to(PROJECT / "verbs")
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"

    def started(block: str) -> str:
        return run(["bash", "-euc", block.replace(SERVER, address)], data, PATH=path, PYTHONPATH=_paths())

    return started


def _paths() -> str:
    return os.pathsep.join(map(str, (PROJECT, PROJECT / "clients" / "python", PROJECT / "clients" / "load")))


def test_a_game_in_python(address, data):
    block = lines_of("A game in Python", "python").replace(SERVER, address)
    assert "fist at [" in run([sys.executable, "-c", block], data, PYTHONPATH=_paths())


@pytest.mark.skipif(bool(mono.missing()), reason=mono.missing() or "-")
def test_unity_and_other_net(address, tmp_path):
    source, program = tmp_path / "Program.cs", tmp_path / "program.exe"
    block = lines_of("Unity and other .NET", "csharp").replace(SERVER, address)
    source.write_text(CSHARP.replace("EXAMPLE", block))
    mono.compile_cs(program, [mono.CLIENT / "Adverb.cs", source], "System.Net.Http.dll")
    assert run(["mono", str(program)], tmp_path).startswith("hips at ")


@pytest.mark.skipif(bool(godot.missing()), reason=godot.missing() or "-")
def test_godot(address, tmp_path):
    project = godot.make_project(tmp_path)
    block = lines_of("Godot", "gdscript").replace(SERVER, address).replace("    ", "\t")
    body = "".join(f"\t{line}\n" for line in block.splitlines())
    (project / "first.gd").write_text(f"extends SceneTree\n\nfunc _initialize():\n{body}\tquit()\n")
    line, environment = godot.command(project, "first", [])
    assert "hips at " in run(line, project, **environment)


def test_load_testers(shell, data):
    shown = shell(lines_of("Load testers", "sh"))
    assert "noise" in shown or "worse" in shown or "better" in shown
    assert (data / "before.html").read_text("utf-8").startswith("<!doctype html>")


def test_technical_directors(shell, data):
    shown = shell(lines_of("Technical directors", "sh"))
    assert "corrected" in shown
    assert (data / "reach.glb").read_bytes().startswith(b"glTF")
    assert (data / "gallery" / "index.html").exists()


def test_operators(shell, data):
    """The last one, since a key is required after it."""
    shown = shell(lines_of("Operators", "sh"))
    assert '"ready":true' in shown.replace(" ", "")
    assert "operator" in shown
    assert (data / "adverb.tar").stat().st_size > 10_000
