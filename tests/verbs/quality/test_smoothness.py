import numpy as np
import pytest

from verbs import library
from verbs.domain import accuracy_points, inside, random_points, slices
from verbs.quality.report import quality_of
from verbs.quality.smoothness import curvature, smoothness
from verbs.runtime.evaluate import Evaluator


def kappa_by_the_paper(weights, inside):
    """Seed 2 §4.1, letter by letter."""
    out = np.full(inside.shape, np.nan)
    for x in range(1, inside.shape[0] - 1):
        for y in range(1, inside.shape[1] - 1):
            if inside[x - 1 : x + 2, y - 1 : y + 2].all():
                around = [weights[x, y] - weights[x + a, y + b] for a in (-1, 0, 1) for b in (-1, 0, 1)]
                out[x, y] = np.linalg.norm(np.sum(around, axis=0)) / 8
    return out


def test_curvature_is_the_papers():
    rng = np.random.default_rng(0)
    weights, mask = rng.normal(size=(9, 7, 5)), rng.uniform(size=(9, 7)) < 0.95
    np.testing.assert_allclose(curvature(weights, mask), kappa_by_the_paper(weights, mask), atol=1e-14)


def test_curvature_of_a_plane_is_zero():
    x, y = np.meshgrid(np.arange(8.0), np.arange(9.0), indexing="ij")
    flat = np.stack([2 * x - y, x + 3 * y + 1], axis=-1)
    np.testing.assert_allclose(curvature(flat, np.ones((8, 9), bool))[1:-1, 1:-1], 0.0, atol=1e-12)


def test_the_arm_has_the_raw_error_of_its_table():
    """A9 of the published tables: 4.37 % mean, 12.25 % max over a 41-node grid."""
    figures = quality_of(library.load("arm3"), "rbf", nodes=21)
    assert figures.samples == 41 * 41
    assert figures.error_mean_pct == pytest.approx(4.37, rel=0.01)
    assert figures.error_max_pct == pytest.approx(12.25, rel=0.01)


def test_smoothness_of_a_smooth_method_falls_with_the_square_of_the_spacing():
    evaluator = Evaluator(library.load("arm3"))
    coarse, fine = (smoothness(evaluator, "rbf", nodes=nodes)[0] for nodes in (61, 121))
    assert coarse / fine == pytest.approx(4.0, abs=0.15)


def test_random_points_lie_in_the_hull_and_outside_it_on_request(mocap, verb_of):
    domain = verb_of("punch").domain
    rng = np.random.default_rng(1)
    within = domain.chart.points(random_points(verb_of("punch"), rng, 500))
    assert inside(domain, within).all()
    around = domain.chart.points(random_points(verb_of("punch"), rng, 500, gauge=(1.0, 1.1)))
    assert not inside(domain, around).any()
    assert inside(domain, around, gauge=1.1).all()


def test_samples_are_the_same_every_time(mocap, verb_of):
    one, other = (accuracy_points(verb_of("kick")) for _ in range(2))
    np.testing.assert_array_equal(one.adverbs, other.adverbs)
    assert one.text == "3000 uniform random points (seed 1) in the " + one.text.split(" in the ", 1)[1]


def test_slices_of_three_adverbs_are_five_planes(mocap, verb_of):
    planes = slices(verb_of("reach"), 11)
    assert [one.inside.shape for one in planes] == [(11, 11)] * 5
    assert planes[0].text == "angle × height, radius at 30%"
