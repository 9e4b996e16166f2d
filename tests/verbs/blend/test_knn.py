from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.verbs.blend.places import verb_at
from verbs import library
from verbs.blend.knn import Knn
from verbs.domain import accuracy_points
from verbs.quality.smoothness import slice_curvature, slices
from verbs.runtime.evaluate import Evaluator


@pytest.fixture(scope="module")
def reach():
    return library.load("reach")


@pytest.fixture(scope="module")
def method(reach):
    return Knn.of_verb(reach, count=2_000)


def error(verb, method, points):
    goal = Evaluator(verb).goal
    return goal.compare(points, goal.measured(method.weights(points)))[1].mean()


def test_weights_sum_to_one_and_stay_near_the_examples_mixes(reach, method):
    weights = method.weights(accuracy_points(reach, count=500).adverbs)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert weights.min() >= -1.0 / 6.0
    assert weights.max() <= 2.0


def test_at_an_example_it_alone_has_weight(reach, method):
    np.testing.assert_array_equal(method.weights(reach.values), np.eye(len(reach.examples)))


def test_pseudo_examples_stand_where_their_blends_reach(reach, method):
    """The inverse map of the method: the measured adverbs of a pseudo-example give its weights."""
    goal = Evaluator(reach).goal
    mixes = np.zeros((len(method.members), len(reach.examples)))
    np.add.at(mixes, (np.arange(len(mixes))[:, None], method.members), method.shares)
    reached = goal.measured(mixes)
    np.testing.assert_allclose(reach.domain.chart.points(reached), method.tree.data, atol=1e-9)
    np.testing.assert_allclose(goal.measured(method.weights(reached)), reached, atol=1e-9)


def test_unmeasured_pseudo_examples_stand_at_the_mean_of_values():
    values = np.random.default_rng(0).uniform(size=(15, 2))
    method = Knn.of_verb(verb_at(values), count=500)
    means = np.einsum("pm,pmd->pd", method.shares, values[method.members])
    np.testing.assert_allclose(method.tree.data, method.chart.points(means), atol=1e-12)


def test_the_paper_s_weights_of_neighbours(reach, method):
    """1/d − 1/d_k over the six nearest, normalised: by the formula, one query at a time."""
    points = accuracy_points(reach, count=20).adverbs
    for point, weights in zip(reach.domain.chart.points(points), method.weights(points), strict=True):
        distances = np.linalg.norm(method.tree.data - point, axis=1)
        near = np.argsort(distances)[:6]
        shares = 1 / distances[near] - 1 / distances[near[-1]]
        wanted = np.zeros(len(weights))
        np.add.at(wanted, method.members[near], (shares / shares.sum())[:, None] * method.shares[near])
        np.testing.assert_allclose(weights, wanted, atol=1e-9)


def test_neighbours_enter_and_leave_without_a_jump(reach, method):
    line = reach.values[0] + np.linspace(0, 1, 20_001)[:, None] * (reach.values[20] - reach.values[0])
    steps = np.abs(np.diff(method.weights(line), axis=0)).max(axis=1)
    assert steps.max() < 0.02


def test_equally_far_neighbours_count_the_same():
    method = Knn.of_verb(verb_at([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), count=0, k=4)
    np.testing.assert_allclose(method.weights(np.array([[0.5, 0.5]])), [[0.25] * 4], atol=1e-12)


def test_two_examples_are_enough():
    method = Knn.of_verb(verb_at([[0.0], [1.0]]), count=50)
    weights = method.weights(np.linspace(0, 1, 11)[:, None])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(weights[[0, -1]], np.eye(2), atol=1e-12)


def test_the_same_seed_gives_the_same_weights(reach, method):
    points = accuracy_points(reach, count=100).adverbs
    np.testing.assert_array_equal(method.weights(points), Knn.of_verb(reach, count=2_000).weights(points))
    assert np.abs(method.weights(points) - Knn.of_verb(reach, count=2_000, seed=1).weights(points)).max() > 1e-3


def test_weights_do_not_depend_on_the_batch_or_the_thread(reach, method):
    points = accuracy_points(reach, count=100).adverbs
    weights = method.weights(points)
    np.testing.assert_array_equal(weights, np.concatenate([method.weights(points[b : b + 1]) for b in range(100)]))
    np.testing.assert_array_equal(weights[::-1], method.weights(np.ascontiguousarray(points[::-1])))
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(method.weights, [points] * 8):
            np.testing.assert_array_equal(weights, again)


def test_more_pseudo_examples_reach_the_goal_better(reach):
    points = accuracy_points(reach, count=1_000).adverbs
    errors = [error(reach, Knn.of_verb(reach, count=count), points) for count in (100, 1_000, 10_000)]
    assert errors[0] > 1.2 * errors[1] > 1.2**2 * errors[2]


@pytest.mark.parametrize("name", ["punch", "jump", "locomotion"])
def test_more_pseudo_examples_help_on_mocap_of_every_measure(mocap, verb_of, name):
    verb = verb_of(name)
    points = accuracy_points(verb, count=1_000).adverbs
    few, many = (error(verb, Knn.of_verb(verb, count=count), points) for count in (200, 10_000))
    assert many < 0.9 * few


def test_control_on_mocap_neighbours_are_not_smooth(mocap, verb_of):
    """Halving the spacing would quarter the largest κ of a smooth method; kinks stay."""
    verb = verb_of("punch")
    evaluator = Evaluator(verb)
    evaluator.method = lambda name=None: (name, method)
    method = Knn.of_verb(verb)
    coarse, fine = (np.nanmax(slice_curvature(evaluator, "knn", slices(verb, n)[1])) for n in (41, 81))
    assert coarse / fine < 2.5
