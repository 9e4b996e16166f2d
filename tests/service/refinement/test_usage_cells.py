from __future__ import annotations

import numpy as np
import pytest

from service.refinement.usage_cells import CELLS, MAX_CELLS, cells_json, sample_cells
from verbs import library
from verbs.domain import inside, random_points


def cell(*adverbs, weight=1.0):
    return {"adverbs": list(adverbs), "weight": weight}


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_cells_count_every_adverb_once(name):
    verb = library.load(name)
    adverbs = random_points(verb, np.random.default_rng(0), 3_000)
    cells = cells_json(verb, adverbs)["cells"]
    assert sum(one["weight"] for one in cells) == 3_000
    assert len(cells) <= MAX_CELLS
    weights = [one["weight"] for one in cells]
    assert weights == sorted(weights, reverse=True)


def test_points_are_sampled_from_the_counted_cells():
    verb = library.load("arm3")
    side = (verb.values.max(axis=0) - verb.values.min(axis=0)) / CELLS
    there = random_points(verb, np.random.default_rng(1), 1)
    points = sample_cells(verb, cells_json(verb, there)["cells"], np.random.default_rng(2), 100)
    assert points.shape == (100, 2)
    assert (np.abs(points - there) <= side).all()
    assert inside(verb.domain, verb.domain.chart.points(points)).all()


def test_points_follow_the_weights_and_the_seed():
    verb = library.load("arm3")
    two = random_points(verb, np.random.default_rng(3), 2)
    cells = [cell(*two[0], weight=9.0), cell(*two[1], weight=1.0)]
    points = sample_cells(verb, cells, np.random.default_rng(4), 1_000)
    nearer = np.linalg.norm(points - two[0], axis=1) < np.linalg.norm(points - two[1], axis=1)
    assert 0.85 < nearer.mean() < 0.95
    assert np.array_equal(points, sample_cells(verb, cells, np.random.default_rng(4), 1_000))


@pytest.mark.parametrize(
    "cells",
    [
        [],
        [cell(0.1)],
        [cell(1e9, 1e9)],
        [cell(float("nan"), 0.0)],
        [cell(0.4, 0.3, weight=0.0)],
        [cell(0.4, 0.3, weight=float("inf"))],
    ],
)
def test_unusable_cells_are_skipped(cells):
    assert sample_cells(library.load("arm3"), cells, np.random.default_rng(0), 5).shape == (0, 2)
