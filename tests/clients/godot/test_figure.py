"""The node `AdverbFigure` of the demo scene moves a skeleton to its goal."""

from __future__ import annotations

import json
import re
import subprocess

import numpy as np
import pytest

from tests.clients.godot.godot import PREFIX, command
from verbs import library

GOAL = [-0.3, 1.2, 0.4]
LOWERED = ["LeftForeArm", "LeftHand", "RightForeArm", "RightHand"]


@pytest.fixture
def show(project, address, all_verbs):
    """Runs the scene until the hand is on its goal, or its patience ends."""

    def run(other, hand, *, demo=False, **changed):
        skeleton = all_verbs.entries["reach"].verb.skeleton
        joints = {"names": skeleton.names, "parents": skeleton.parents.tolist(), "offsets": skeleton.offsets.tolist()}
        settings = {
            "server": address,
            "verb": "reach",
            "phase": 0.4827586206896552,
            "goal": [(1.5 if other else 1.0) * value for value in GOAL],
            "hand": hand,
            "tolerance_m": 1.0 if demo else 0.002,
            "demo": demo,
            "other": other,
            "skeleton": joints,
            "lowered": LOWERED,
            "method": "",
            "adverbs": {},
            "moves": False,
            **changed,
        }
        line, environment = command(project, "figure", settings)
        done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=120, check=False)
        assert "SCRIPT ERROR" not in done.stderr, done.stderr
        return json.loads(re.search(rf"^{PREFIX}(.*)$", done.stdout, re.MULTILINE)[1])

    return run


def test_a_skeleton_that_the_node_makes_has_the_pose(show, all_verbs):
    found = show(False, "RightHand")
    assert found["distance"] < 0.002
    verb = all_verbs.entries["reach"].verb
    positions = np.array(found["positions"])
    lengths = np.linalg.norm(positions[1:] - positions[verb.skeleton.parents[1:]], axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(verb.skeleton.offsets[1:], axis=1), atol=1e-5)
    np.testing.assert_allclose(positions[0], found["values"][:3], atol=1e-5)


def test_a_skeleton_of_another_size_and_rest_pose_has_the_directions_of_the_limbs(show, all_verbs):
    found = show(True, "rig_RIGHTHAND")
    assert found["distance"] < 0.002
    assert found["positions"][0][1] == pytest.approx(1.5 * found["values"][1], rel=0.1)


def test_the_demo_scene_runs(show, all_verbs):
    found = show(False, "RightHand", demo=True)
    joints = len(all_verbs.entries["reach"].verb.skeleton.names)
    assert found["lines"] == 2 * (joints - 1)
    assert found["goal"]["z"] == pytest.approx(0.4, abs=1e-5)


def test_a_figure_with_another_parent_goes_on(show):
    found = show(False, "RightHand", moves=True)
    assert found["distance"] < 0.002


def test_a_goal_does_not_count_for_adverbs_other_than_a_point(show):
    adverbs = {row.name: row.minimum / 2 for row in library.load("locomotion").adverbs}
    found = show(False, "RightHand", verb="locomotion", adverbs=adverbs, method="rbf", tolerance_m=100.0)
    assert found["goal"] == pytest.approx(adverbs)
    assert found["method"] == "rbf"
