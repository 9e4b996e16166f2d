from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from verbs import library
from verbs.blend.cardinal import basis_weights
from verbs.blend.methods import usable
from verbs.blend.refined import CROSSOVER, Hybrid, Refined
from verbs.blend.search import Search
from verbs.domain import random_points
from verbs.refine import Rules, refine
from verbs.runtime.describe import describe
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb


@cache
def refined(name: str, count: int) -> Verb:
    verb = library.load(name)
    *_, last = refine(verb, Rules(target_error=0.0, max_pseudo=count, samples=300))
    return replace(verb, bases={**verb.bases, "refined": last.basis})


@pytest.mark.parametrize("name", ["arm3", "reach"])
@pytest.mark.parametrize("count", [3, 60])
def test_weights_are_those_of_the_basis_inside_and_around_the_domain(name, count):
    verb = refined(name, count)
    points = random_points(verb, np.random.default_rng(1), 500, gauge=(0.0, 1.25))
    method = Refined.of_verb(verb)
    assert (method.lists is None) == (len(verb.values) + count < CROSSOVER)
    assert np.allclose(method.weights(points), basis_weights(verb.bases["refined"], points), rtol=0, atol=1e-12)


def test_weights_sum_to_one_and_are_a_unit_vector_at_each_example():
    verb = refined("reach", 60)
    method = Refined.of_verb(verb)
    assert np.allclose(method.weights(verb.values), np.eye(len(verb.values)), atol=1e-12)
    points = random_points(verb, np.random.default_rng(1), 500, gauge=(0.0, 1.25))
    assert np.allclose(method.weights(points).sum(axis=1), 1.0, atol=1e-11)


def test_a_batch_is_its_rows():
    verb = refined("reach", 60)
    points = random_points(verb, np.random.default_rng(2), 20)
    method = Refined.of_verb(verb)
    rows = np.concatenate([method.weights(point[None]) for point in points])
    assert np.array_equal(method.weights(points), rows)


def test_functions_that_never_end_are_evaluated_whole():
    verb = library.load("reach")
    many = replace(verb, bases={**verb.bases, "refined": verb.bases["smooth"]})
    assert Refined.of_verb(many).lists is None


def test_hybrid_is_the_search_on_the_refined_basis():
    verb = refined("arm3", 20)
    points = random_points(verb, np.random.default_rng(3), 50)
    search = Search.of_verb(verb, basis="refined", iterations=2)
    assert np.allclose(Hybrid.of_verb(verb, iterations=2).weights(points), search.weights(points), atol=1e-12)


@pytest.mark.parametrize(("name", "plain"), [("refined", "rbf"), ("hybrid", "search")])
@pytest.mark.parametrize("verb", ["arm3", "reach"])
def test_without_pseudo_examples_the_weights_are_those_of_the_plain_method(verb, name, plain):
    evaluator = Evaluator(library.load(verb))
    points = random_points(evaluator.verb, np.random.default_rng(3), 50)
    blend = evaluator.blend(points, method=name)
    assert blend.method == name
    assert np.array_equal(blend.weights, evaluator.blend(points, method=plain).weights)


def test_a_refinement_takes_no_method_away():
    assert usable(library.load("arm3")) == usable(refined("arm3", 3))
    assert {"refined", "hybrid"} <= set(describe(library.load("arm3"))["methods"])
