"""The examples of the C# client's README, and its component for Unity."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.clients.csharp.mono import CLIENT, PROGRAMS, compile_cs, run
from tests.clients.python.served import serve

EXAMPLES = re.findall(r"```csharp\n(.*?)```", (CLIENT / "README.md").read_text("utf-8"), re.DOTALL)
PROGRAM = """
using System;
using System.Collections.Generic;
using System.Threading.Tasks;
using Adverb;

static class Examples
{
    static async Task Run() { EXAMPLE }

    static int Main() { return Run().Wait(30000) ? 0 : 1; }
}
"""
UNITY = PROGRAMS.parent / "unity"


@pytest.fixture(scope="module")
def example_address(all_verbs):
    with serve(all_verbs) as address:
        yield address


@pytest.mark.parametrize("k", range(len(EXAMPLES)))
def test_examples_of_the_readme_run(built, example_address, tmp_path, k):
    source = tmp_path / "Example.cs"
    example = EXAMPLES[k].replace("http://127.0.0.1:8000", example_address)
    source.write_text(PROGRAM.replace("EXAMPLE", example))
    program = built / f"example{k}.exe"
    compile_cs(program, [source], str(built / "Adverb.dll"))
    done = subprocess.run(["mono", str(program)], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_the_readme_starts_with_a_short_example():
    assert len(EXAMPLES) == 4
    assert len(EXAMPLES[0].splitlines()) <= 6


def test_a_unity_avatar_meets_the_goal_also_after_switches(built, example_address):
    program = built / "unity.exe"
    sources = [CLIENT / "Unity" / "AdverbFigure.cs", *sorted(UNITY.glob("*.cs"))]
    compile_cs(program, sources, str(built / "Adverb.dll"))
    found = run(program, example_address)
    assert found["reached_m"] < 0.002
    assert min(found["limbs"]) > 0.999
    assert found["away_m"] > 0.3
    assert found["reached_again_m"] < 0.05, "a goal that stands still is lost by a switch"
    assert found["locomotion"] < 0.002, "the goal's metres are used as adverbs of another kind"
