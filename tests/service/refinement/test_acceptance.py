from __future__ import annotations

import json
import re

import numpy as np
import pytest

from service.refinement.usage_cells import cells_json
from service.refinement.worker.acceptance import HELD_OUT, SMOOTHNESS_LIMIT, compare, held_out, method_of
from verbs import library
from verbs.domain import accuracy_points, random_points
from verbs.quality.smoothness import smoothness
from verbs.refine import Rules, refine, with_basis
from verbs.runtime.evaluate import Evaluator


@pytest.fixture(scope="module")
def pair():
    verb, rules = library.load("arm3"), Rules(target_error=0.0, max_pseudo=8)
    *_, last = refine(verb, rules)
    return verb, with_basis(verb, last.basis, rules, last.mark)


def test_better_version_is_better_by_the_measured_figures(pair):
    now, new = pair
    points = held_out(now, 1, None)
    comparison = compare(now, new, "refined", points)
    assert comparison.better
    error = Evaluator(new).blend(points, method="refined").error
    assert (comparison.new.error_mean_m, comparison.new.error_max_m) == (error.mean(), error.max())
    assert comparison.new.smoothness == smoothness(Evaluator(new), "refined")[0]
    assert comparison.now.method == "rbf"
    assert comparison.new.smoothness <= SMOOTHNESS_LIMIT * comparison.now.smoothness
    assert re.match(
        r"at 3000 held-out points the mean error by 'refined' is [\d.]+ mm, the largest [\d.]+ mm", comparison.text
    )
    assert json.loads(json.dumps(comparison.to_json()))["better"] is True


def test_a_version_is_not_better_than_itself(pair):
    comparison = compare(pair[1], pair[1], "hybrid", held_out(pair[0], 1, None))
    assert comparison.reasons == ("its mean error is not lower", "its largest error is not lower")


def test_unrefined_version_is_measured_by_rbf(pair):
    assert (method_of(pair[0], "hybrid"), method_of(pair[1], "hybrid")) == ("rbf", "hybrid")


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_held_out_points_differ_from_search_points(name):
    verb = library.load(name)
    points = held_out(verb, 1, None)
    assert points.shape == (HELD_OUT, len(verb.adverbs))
    seen = [accuracy_points(verb).adverbs]
    seen += [random_points(verb, np.random.default_rng([1, stream]), 4_000) for stream in (0, 1)]
    for others in seen:
        assert not {row.tobytes() for row in points} & {row.tobytes() for row in others}


def test_half_of_the_held_out_points_come_from_usage():
    verb = library.load("arm3")
    there = random_points(verb, np.random.default_rng(0), 1)
    points = held_out(verb, 1, cells_json(verb, there)["cells"])
    near = np.linalg.norm(points - there, axis=1) < 0.1 * np.linalg.norm(np.ptp(verb.values, axis=0))
    assert len(points) == HELD_OUT
    assert near[HELD_OUT // 2 :].all()
    assert near[: HELD_OUT // 2].mean() < 0.1
