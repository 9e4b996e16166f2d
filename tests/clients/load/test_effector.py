"""Effector errors agree with the library; walks stay among the examples."""

import numpy as np
import pytest
from adverb_load.effector import Effector
from adverb_load.goals import Goals, base_of

from verbs.kernels import pose as kernels
from verbs.kernels import quat
from verbs.skeleton import Skeleton

NAMES, PARENTS = ["hips", "spine", "leg", "hand"], [-1, 0, 0, 1]
OFFSETS = [[0.0, 0.0, 0.0], [0.0, 0.5, 0.1], [0.1, -0.5, 0.0], [0.3, 0.0, 0.2]]
VERB = {
    "skeleton": {"names": NAMES, "parents": PARENTS, "offsets": OFFSETS},
    "measure": {"kind": "joint_position", "effector": "hand", "keytime": "touch", "adverbs": ["x", "y", "z"]},
    "keytime_names": ["start", "touch", "end"],
    "keytime_phases": [0.0, 0.4, 1.0],
}


def test_forward_kinematics_agrees_with_the_library():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 3))
    rotations = quat.exp(rng.normal(size=(5, 4, 3)))
    skeleton = Skeleton(tuple(NAMES), np.array(PARENTS), np.array(OFFSETS))
    turns, places = np.empty_like(rotations), np.empty((5, 4, 3))
    kernels.forward(root, rotations, skeleton.parents, skeleton.offsets, turns, places)
    effector = Effector.of(VERB)
    assert effector.phase == 0.4
    np.testing.assert_allclose(effector.points(root, rotations), places[:, 3], atol=1e-12)
    goals = places[:, 3] + [0.0, 0.03, 0.04]
    np.testing.assert_allclose(effector.errors(goals, root, rotations), 0.05, atol=1e-12)


@pytest.mark.parametrize("change", [{"kind": "jump"}, {"adverbs": ["u", "v"]}])
def test_verbs_of_other_measures_have_no_effector(change):
    assert Effector.of(VERB | {"measure": VERB["measure"] | change}) is None


def test_a_walk_passes_through_examples_and_stays_between_neighbours():
    examples = [{"adverbs": {"a": float(k), "b": 1.0}} for k in range(9)]
    goals = Goals.of({"adverbs": [{"name": "a"}, {"name": "b"}], "examples": examples}, np.random.default_rng(1))
    rows = goals.rows
    assert rows.shape == (1_024, 2)
    assert (rows[:, 0] >= 0).all()
    assert (rows[:, 0] <= 8).all()
    assert (rows[:, 1] == 1).all()
    assert np.abs(np.diff(rows[:, 0])).max() <= 5 / 16 + 1e-6
    assert (rows[::16, 0] % 1 == 0).all()
    assert goals.packed[3] == rows[3].tobytes()
    assert goals.adverbs(1_024 + 3) == {"a": float(rows[3, 0]), "b": 1.0}


def test_a_walk_of_one_example_is_constant():
    goals = Goals.of({"adverbs": [{"name": "a"}], "examples": [{"adverbs": {"a": 2.0}}]}, np.random.default_rng(1))
    assert (goals.rows == 2.0).all()


def test_the_rest_address_of_a_stream():
    assert base_of("ws://127.0.0.1:8000/v1/stream") == "http://127.0.0.1:8000"
    assert base_of("http://127.0.0.1:8000") == "http://127.0.0.1:8000"
