import numpy as np
import pytest

from verbs import library
from verbs.kernels import quat
from verbs.runtime.error_bound import TURN_LIMIT_RAD, apply_polish, escalate, polish
from verbs.runtime.evaluate import Evaluator

GOAL = np.array([[-0.1, 1.2, 0.5]])


@pytest.fixture(scope="module")
def reach():
    return Evaluator(library.load("reach"))


def test_a_loose_bound_takes_the_cheapest_method(reach):
    found = escalate(reach, GOAL, 10.0)
    assert found.tried == ("rbf",)
    assert found.blend.method == "rbf"


def test_a_tight_bound_goes_on_until_it_is_met(reach):
    found = escalate(reach, GOAL, 1e-8)
    assert found.tried == ("rbf", "search", "corrected")
    assert found.blend.error[0] < 1e-8
    assert found.rotation_vectors is None


def test_the_method_asked_for_is_where_it_starts(reach):
    assert escalate(reach, GOAL, 1e-8, method="corrected").tried == ("corrected",)


def test_out_of_the_domain_the_polish_gets_nearer(reach):
    high = reach.verb.values.max(axis=0, keepdims=True) + np.array([[0.05, 0.0, 0.02]])
    plain = reach.blend(high)
    found = escalate(reach, high, 1e-6)
    assert found.tried[-1] == "polish"
    assert found.blend.error[0] < plain.error[0]


def test_polish_meets_a_goal_that_plain_weights_miss_and_stays_bounded(reach):
    blend = reach.blend(GOAL, method="rbf")
    better, turns = polish(reach, blend, GOAL)
    assert blend.error[0] > 1e-3
    assert better.error[0] < 1e-6
    assert np.linalg.norm(turns, axis=1).max() <= TURN_LIMIT_RAD + 1e-9
    np.testing.assert_array_equal(turns[0], 0.0)  # the root keeps its place, and the feet with it


def test_polish_is_whole_at_the_keytime_and_gone_at_its_neighbours(reach):
    blend = reach.blend(GOAL, method="rbf")
    better, turns = polish(reach, blend, GOAL)
    shown = reach.pose_of(blend, phase=np.array([0.0, reach.verb.phases[1], 1.0]))
    polished = apply_polish(reach, shown, turns)
    _, places = reach.positions(polished)
    np.testing.assert_allclose(places[1, reach.verb.measure.effector], better.measured[0], atol=1e-9)
    np.testing.assert_allclose(polished.rotations[[0, 2]], shown.rotations[[0, 2]], atol=1e-12)


def test_polish_adds_no_jump_over_time(reach):
    blend = reach.blend(GOAL, method="rbf")
    _, turns = polish(reach, blend, GOAL)
    shown = reach.pose_of(blend, phase=np.linspace(0, 1, 400))
    both = [
        quat.log(quat.mul(quat.conjugate(p.rotations[:-1]), p.rotations[1:]))
        for p in (shown, apply_polish(reach, shown, turns))
    ]
    steps = [np.linalg.norm(one, axis=-1).max() for one in both]
    assert steps[1] < steps[0] + 2.0 * TURN_LIMIT_RAD / 100


def test_verbs_without_a_place_are_not_polished(mocap, verb_of):
    found = escalate(Evaluator(verb_of("locomotion")), np.array([[30.0, 0.0, 0.0]]), 1e-9)
    assert "polish" not in found.tried
