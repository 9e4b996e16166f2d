"""The examples of the Godot addon's README."""

from __future__ import annotations

import json
import re
import subprocess
from textwrap import indent

import numpy as np
import pytest

from tests.clients.godot.godot import PREFIX, command
from tests.clients.python.served import serve
from tools import godot3

NODE = """extends Node
var events = 0
func _on_reported(_event):
    events += 1
func run():
"""
EVALUATION = """extends Node
const Evaluator = preload("res://addons/adverb/evaluator.gd")
func run(http):
"""


@pytest.fixture(scope="module")
def example_address(all_verbs):
    with serve(all_verbs) as address:
        yield address


def test_the_examples_of_the_readme_run(project, example_address, all_verbs):
    text = (godot3.CLIENT / "README.md").read_text("utf-8").replace("http://127.0.0.1:8000", example_address)
    node, script, evaluation = re.findall(r"```gdscript\n(.*?)```", text, re.DOTALL)
    node = node.replace('.connect("reported", _on_reported)', '.connect("reported", self, "_on_reported")')
    sources = [
        NODE + indent(node, "    "),
        "extends Node\n" + script,
        EVALUATION + indent(evaluation, "    ") + "    return pose\n",
    ]
    paths = []
    for k, source in enumerate(sources):
        (project / f"example{k}.gd").write_text(godot3.translate(source), encoding="utf-8")
        paths.append(f"res://example{k}.gd")
    line, environment = command(project, "examples", {"server": example_address, "paths": paths})
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert "SCRIPT ERROR" not in done.stderr, done.stderr
    found = json.loads(re.search(rf"^{PREFIX}(.*)$", done.stdout, re.MULTILINE)[1])
    assert found["opened"] == ["reach", "punch"]
    assert found["events"] > 0
    assert found["displayed"] > 5
    assert re.search(r"^\[-?\d", done.stdout, re.MULTILINE), "the second example prints positions"
    evaluator = all_verbs.entries["reach"].evaluator
    blend = evaluator.blend(np.array([[-0.3, 1.2, 0.4]]), method="refined")
    pose = evaluator.pose_of(blend, phase=0.5, plant=False)
    np.testing.assert_allclose(found["values"], [*pose.root[0], *pose.rotations[0].ravel()], atol=1e-5)
