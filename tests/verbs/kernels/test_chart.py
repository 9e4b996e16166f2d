import numpy as np
import pytest

from verbs.authoring.basis import chart_of, domain_of
from verbs.kernels import chart

AXES = np.array([0, 1, 2])


def there_and_back(kind, adverbs, bend=(0.0, 0.0, 0.0, 1.0)):
    dims = len(adverbs)
    arrays = chart.ChartArrays(kind, AXES, np.array(bend), np.full(dims, 0.3), np.linspace(0.5, 2.0, dims))
    points, back = np.empty((1, dims)), np.empty((1, dims))
    chart.normalise(adverbs[None], arrays, points)
    chart.denormalise(points, arrays, back)
    return points[0], back[0]


@pytest.mark.parametrize("kind", [chart.IDENTITY, chart.CYLINDER])
def test_a_position_comes_back_from_its_chart(kind):
    rng = np.random.default_rng(0)
    for row in rng.normal(size=(200, 4)):
        _, back = there_and_back(kind, row, bend=(0.1, -0.2, 0.7, 0.6))
        np.testing.assert_allclose(back, row, atol=1e-12)


def test_a_direction_lives_on_its_circle():
    ahead, _ = there_and_back(chart.PLANAR, np.array([2.0, 0.3, 0.5]))
    turned, back = there_and_back(chart.PLANAR, np.array([2.0, 0.3 + 2 * np.pi, 0.5]))
    np.testing.assert_allclose(ahead, turned, atol=1e-12)
    np.testing.assert_allclose(back, [2.0, 0.3, 0.5], atol=1e-12)


def test_at_distance_zero_the_direction_does_not_matter():
    one, back = there_and_back(chart.PLANAR, np.array([0.0, 1.3, 0.5]))
    other, _ = there_and_back(chart.PLANAR, np.array([0.0, -2.0, 0.5]))
    np.testing.assert_allclose(one, other, atol=1e-15)
    assert np.isfinite(back).all()


@pytest.fixture(scope="module")
def domain():
    values = np.random.default_rng(1).uniform(-1, 1, (30, 3))
    return domain_of(chart_of(values, ("m",) * 3), values), values


def test_the_clamp_leaves_the_hull_alone(domain):
    hull, values = domain
    mixes = np.random.default_rng(2).dirichlet(np.full(30, 0.2), 500) @ hull.chart.points(values)
    for point in (*mixes, *hull.chart.points(values)):
        moved = point.copy()
        assert not chart.clamp_point(moved, hull.facets, hull.middle, hull.sharpness)
        np.testing.assert_array_equal(moved, point)


def test_the_clamp_bounds_and_does_not_jump(domain):
    hull, _ = domain
    for direction in np.random.default_rng(3).normal(size=(20, 3)):
        before = None
        for far in np.linspace(0.5, 40.0, 400):
            point = hull.middle + far * direction / np.linalg.norm(direction)
            chart.clamp_point(point, hull.facets, hull.middle, hull.sharpness)
            assert chart.gauge(point, hull.facets, hull.middle, hull.sharpness) <= chart.LAST_GAUGE + 1e-9
            if before is not None:
                assert np.linalg.norm(point - before) < 40.0 / 400 + 1e-9
            before = point
