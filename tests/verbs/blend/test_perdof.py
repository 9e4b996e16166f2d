import numpy as np
import pytest

from tests.verbs.blend.places import permuted
from verbs import library
from verbs.blend.cardinal import Rbf
from verbs.blend.perdof import PerDof, cost
from verbs.domain import accuracy_points


def blended(verb, points):
    """Curves (B, K + 3, C) of the cardinal basis."""
    return np.einsum("bn,knc->bkc", Rbf.of_verb(verb).weights(points), verb.curves.astype(np.float64))


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_curves_equal_those_of_the_cardinal_basis(name):
    verb = library.load(name)
    points = accuracy_points(verb, count=20).adverbs[::20]
    np.testing.assert_allclose(PerDof.of_verb(verb).coefficients(points), blended(verb, points), atol=1e-9)


@pytest.mark.parametrize("name", ["punch", "jump", "locomotion"])
def test_curves_equal_those_of_the_cardinal_basis_on_mocap(mocap, verb_of, name):
    verb = verb_of(name)
    points = accuracy_points(verb, count=8).adverbs
    np.testing.assert_allclose(PerDof.of_verb(verb).coefficients(points), blended(verb, points), atol=1e-9)


def test_weights_equal_those_of_the_cardinal_basis():
    verb = library.load("reach")
    points = accuracy_points(verb, count=300).adverbs
    weights = PerDof.of_verb(verb).weights(points)
    np.testing.assert_allclose(weights, Rbf.of_verb(verb).weights(points), atol=1e-9)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)


def test_at_an_example_the_curves_are_its_own():
    verb = library.load("arm3")
    curves = PerDof.of_verb(verb).coefficients(verb.values)
    np.testing.assert_allclose(curves, verb.curves.transpose(1, 0, 2), atol=1e-9)


def test_weights_do_not_depend_on_the_order_of_examples():
    verb = library.load("arm3")
    order, points = np.random.default_rng(0).permutation(9), accuracy_points(verb).adverbs[::40]
    weights = PerDof.of_verb(permuted(verb, order)).weights(points)
    np.testing.assert_allclose(weights, PerDof.of_verb(verb).weights(points)[:, order], atol=1e-9)


def test_weights_do_not_depend_on_the_batch():
    verb = library.load("arm3")
    method, points = PerDof.of_verb(verb), accuracy_points(verb).adverbs[::40]
    single = np.concatenate([method.weights(points[b : b + 1]) for b in range(len(points))])
    np.testing.assert_array_equal(method.weights(points), single)


def test_solving_for_every_coefficient_costs_more_than_for_every_example():
    verb = library.load("reach")
    figures = cost(verb, runs=2)
    assert figures.coefficients == verb.curves.shape[0] * verb.curves.shape[2]
    assert figures.solve_s > 3 * figures.cardinal_solve_s
    assert figures.pose_us < figures.query_us
