from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.verbs.blend.places import verb_at
from verbs import library
from verbs.authoring import basis as bases
from verbs.blend.cardinal import basis_weights
from verbs.blend.search import Search
from verbs.domain import accuracy_points
from verbs.errors import OutOfRange
from verbs.goal import Goal, diagonal
from verbs.verb import Adverb


def errors(verb, points, iterations, *, basis="rbf"):
    goal, method = Goal.of_verb(verb), Search.of_verb(verb, basis=basis, iterations=iterations)
    return goal.compare(points, goal.measured(method.weights(points)))[1]


def grid(verb):
    """The 41×41 nodes over the bounding box of the arm's examples, as the table's."""
    axes = np.linspace(verb.values.min(axis=0), verb.values.max(axis=0), 41).T
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("iterations", "mean", "largest"), [(0, 4.37, 12.25), (1, 1.065, 6.70), (3, 0.128, 2.93)])
def test_the_arm_has_the_errors_of_its_table(iterations, mean, largest):
    """A9: percent of the examples' bounding box (1.08171) after so many line searches."""
    arm = library.load("arm3")
    assert diagonal(arm) == pytest.approx(1.08171, rel=1e-4)
    share = 100 * errors(arm, grid(arm), iterations) / diagonal(arm)
    assert share.mean() == pytest.approx(mean, rel=0.01)
    assert share.max() == pytest.approx(largest, rel=0.01)


def test_no_place_gets_worse():
    arm = library.load("arm3")
    steps = [errors(arm, grid(arm), iterations) for iterations in range(4)]
    assert all((after <= before + 1e-12).all() for before, after in pairwise(steps))


def test_examples_stay_exact():
    arm = library.load("arm3")
    np.testing.assert_allclose(Search.of_verb(arm).weights(arm.values), np.eye(9), atol=1e-9)


def test_weights_are_those_of_the_basis_at_the_places_found():
    arm = library.load("arm3")
    method = Search.of_verb(arm, basis="smooth", iterations=2)
    sources = method.sources(grid(arm))
    np.testing.assert_array_equal(method.weights(grid(arm)), basis_weights(arm.bases["smooth"], sources))
    np.testing.assert_allclose(method.weights(grid(arm)).sum(axis=1), 1.0, atol=1e-9)


def test_places_lie_along_the_error():
    arm = library.load("arm3")
    points, method = grid(arm), Search.of_verb(arm)
    measured, _ = method.goal.compare(points, method.goal.measured(basis_weights(method.basis, points)))
    moved, error = method.sources(points) - points, points - measured
    lengths = (moved * error).sum(axis=1) / np.maximum((error**2).sum(axis=1), 1e-30)
    np.testing.assert_allclose(moved, lengths[:, None] * error, atol=1e-12)
    assert lengths.min() >= 0.0
    assert lengths.max() <= 2.5 + 1e-12


def test_style_adverbs_stay_as_they_were_asked_for():
    arm = library.load("arm3")
    moods = np.random.default_rng(0).uniform(size=(9, 1))
    values = np.concatenate([arm.values, moods], axis=1)
    chart = bases.chart_of(values, ("m", "m", ""))
    adverbs = (*arm.adverbs, Adverb("mood", "", "", True, 0.0, 1.0))
    tired = replace(
        arm,
        adverbs=adverbs,
        values=values,
        domain=bases.domain_of(chart, values),
        bases={"rbf": bases.cardinal(chart, values)},
    )
    points = np.concatenate([grid(arm), np.full((41 * 41, 1), 0.4)], axis=1)
    sources = Search.of_verb(tired).sources(points)
    np.testing.assert_array_equal(sources[:, 2], points[:, 2])
    assert np.abs(sources[:, :2] - points[:, :2]).max() > 0.01


def test_a_verb_that_nobody_can_measure_is_left_alone():
    verb = verb_at(np.random.default_rng(0).uniform(size=(9, 2)))
    points = np.random.default_rng(1).uniform(size=(5, 2))
    np.testing.assert_array_equal(Search.of_verb(verb).sources(points), points)


def test_weights_do_not_depend_on_the_batch_or_the_thread():
    reach = library.load("reach")
    method, points = Search.of_verb(reach, iterations=2), accuracy_points(reach, count=60).adverbs
    weights = method.weights(points)
    single = np.concatenate([method.weights(points[b : b + 1]) for b in range(60)])
    np.testing.assert_allclose(weights, single, rtol=0, atol=1e-12)
    np.testing.assert_allclose(weights[::-1], method.weights(np.ascontiguousarray(points[::-1])), rtol=0, atol=1e-12)
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(method.weights, [points] * 4):
            np.testing.assert_array_equal(weights, again)


def test_negative_iterations_are_refused():
    with pytest.raises(OutOfRange, match="-1 iterations; give 0 or more"):
        Search.of_verb(library.load("arm3"), iterations=-1)


@pytest.mark.parametrize(("name", "share"), [("punch", 0.8), ("kick", 0.6), ("locomotion", 0.2)])
def test_a_search_helps_on_mocap(mocap, verb_of, name, share):
    verb = verb_of(name)
    points = accuracy_points(verb, count=300).adverbs
    assert errors(verb, points, 1).mean() < share * errors(verb, points, 0).mean()


def test_a_jump_is_searched_around_its_circle(mocap, verb_of):
    """A constructed basis that turns every direction by 0.1 rad is set right by one search."""
    verb = verb_of("jump")
    shifted = verb.values + np.array([0.0, 0.1, 0.0])
    turned = replace(verb, bases={**verb.bases, "turned": bases.cardinal(verb.bases["rbf"].chart, shifted)})
    points = accuracy_points(verb, count=200).adverbs
    before, after = (errors(turned, points, iterations, basis="turned") for iterations in (0, 2))
    assert after.mean() < 0.1 * before.mean()
