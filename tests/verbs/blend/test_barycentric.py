from concurrent.futures import ThreadPoolExecutor
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from tests.verbs.blend.places import grid, permuted, verb_at
from verbs import library
from verbs.blend.barycentric import Barycentric
from verbs.domain import accuracy_points, random_points
from verbs.errors import IllPosedVerb, UnknownName
from verbs.runtime.evaluate import Evaluator

RANDOM = {dims: np.random.default_rng(dims).uniform(-1, 1, (12 + 4 * dims, dims)) for dims in (1, 2, 3, 4, 6)}
PLACES = {**{f"random {d}": values for d, values in RANDOM.items()}, **{f"grid {d}": grid(3, d) for d in (1, 2, 3, 4)}}


@pytest.fixture(params=list(PLACES))
def verb(request):
    return verb_at(PLACES[request.param])


def anywhere(verb, count=300, *, seed=0):
    """Places in and around the hull."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    return np.random.default_rng(seed).uniform(low - 0.5, high + 0.5, (count, len(low)))


def nearest_in_hull(points, place):
    """Point of the hull of ``points`` (N, D) nearest to a place, by SciPy's non-negative least squares."""
    heavy = 1e5 * np.ones((1, len(points)))
    shares, _ = nnls(np.concatenate([points.T - place[:, None], heavy]), np.append(np.zeros(len(place)), 1e5))
    return shares @ points / shares.sum()


def test_weights_sum_to_one_and_lie_between_zero_and_one(verb):
    weights = Barycentric.of_verb(verb).weights(anywhere(verb))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert weights.min() >= 0.0
    assert (weights > 0).sum(axis=1).max() <= len(verb.adverbs) + 1


def test_at_an_example_it_alone_has_weight(verb):
    np.testing.assert_allclose(Barycentric.of_verb(verb).weights(verb.values), np.eye(len(verb.examples)), atol=1e-8)


def test_a_linear_function_is_reproduced_in_the_hull(verb):
    inside = random_points(verb, np.random.default_rng(0), 200)
    np.testing.assert_allclose(Barycentric.of_verb(verb).weights(inside) @ verb.values, inside, atol=1e-8)


def test_outside_the_hull_the_nearest_point_of_it_counts(verb):
    places, method = anywhere(verb, 60), Barycentric.of_verb(verb)
    reached = method.weights(places) @ verb.values
    chart = verb.domain.chart
    points, requested = chart.points(verb.values), chart.points(places)
    wanted = np.array([nearest_in_hull(points, place) for place in requested])
    np.testing.assert_allclose(chart.points(reached), wanted, atol=1e-6)


def test_neighbouring_places_have_neighbouring_weights(verb):
    """Across facets, edges and the hull's surface: no jump along random lines that cross them all."""
    method = Barycentric.of_verb(verb)
    ends = anywhere(verb, 10, seed=2).reshape(2, 5, -1)
    line = ends[0] + np.linspace(0, 1, 1_001)[:, None, None] * (ends[1] - ends[0])
    weights = method.weights(np.ascontiguousarray(line.reshape(-1, line.shape[-1]))).reshape(*line.shape[:2], -1)
    steps = np.abs(np.diff(weights, axis=0)).max(axis=(0, 2))
    length = np.linalg.norm((ends[1] - ends[0]) * verb.domain.chart.scale, axis=-1) / 1_000
    assert (steps <= 1.01 * length / method.heights.min() + 1e-9).all()


@pytest.mark.parametrize("dims", [2, 3, 4])
def test_simplices_of_a_grid_meet_facet_to_facet_and_fill_it(dims):
    method = Barycentric.of_verb(verb_at(grid(3, dims)))
    facets = [tuple(sorted(face)) for row in method.members.tolist() for face in combinations(row, dims)]
    points = grid(3, dims)
    for face in set(facets):
        on_surface = any(np.ptp(points[list(face), a]) == 0 and points[face[0], a] in (0, 1) for a in range(dims))
        assert facets.count(face) == (1 if on_surface else 2)
    volumes = np.abs(np.linalg.det(points[method.members[:, 1:]] - points[method.members[:, :1]]))
    assert volumes.sum() == pytest.approx(np.prod(np.arange(1, dims + 1)), rel=1e-12)


def test_weights_are_the_same_from_both_sides_of_a_facet():
    method, rng = Barycentric.of_verb(verb_at(grid(3, 3))), np.random.default_rng(3)
    verb = verb_at(grid(3, 3))
    faces = [face for row in method.members.tolist() for face in combinations(row, 3)]
    corners = verb.values[np.array(faces)]
    middle = np.einsum("fc,fcd->fd", rng.dirichlet(np.ones(3), len(faces)), corners)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= 1e-9 / np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(method.weights(middle + normal), method.weights(middle - normal), atol=1e-7)


def test_weights_do_not_depend_on_the_order_of_examples(verb):
    order, places = np.random.default_rng(5).permutation(len(verb.examples)), anywhere(verb)
    weights = Barycentric.of_verb(permuted(verb, order)).weights(places)
    np.testing.assert_allclose(weights, Barycentric.of_verb(verb).weights(places)[:, order], atol=1e-6)


def test_weights_do_not_depend_on_the_batch_or_the_thread(verb):
    method, places = Barycentric.of_verb(verb), anywhere(verb, 100)
    weights = method.weights(places)
    single = np.concatenate([method.weights(places[b : b + 1]) for b in range(100)])
    np.testing.assert_array_equal(weights, single)
    np.testing.assert_array_equal(weights[::-1], method.weights(np.ascontiguousarray(places[::-1])))
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(method.weights, [places] * 8):
            np.testing.assert_array_equal(weights, again)


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 2.0]])


def test_authored_simplices_are_used_where_there_are_any():
    one, other = verb_at(SQUARE, simplices=[(0, 1, 2), (1, 2, 3), (2, 3, 4)]), verb_at(SQUARE, simplices=[(0, 1, 3)])
    assert Barycentric.of_verb(one).members.tolist() == [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    assert Barycentric.of_verb(other).members.tolist() == [[0, 1, 3]]
    assert len(Barycentric.of_verb(other, simplices="delaunay").members) == 3


def test_a_gap_between_authored_simplices_takes_the_nearest_point():
    verb = verb_at(SQUARE, simplices=[(0, 1, 3), (2, 3, 4)])
    weights = Barycentric.of_verb(verb).weights(np.array([[0.2, 0.4], [0.2, 0.9], [-1.0, 0.0]]))
    np.testing.assert_allclose(weights, [[0.7, 0, 0, 0.3, 0], [0, 0, 0.8, 0.2, 0], [1, 0, 0, 0, 0]], atol=1e-12)


def test_overlapping_simplices_blend_without_a_jump():
    verb = verb_at(SQUARE, simplices=[(0, 1, 2), (0, 1, 3), (1, 2, 3)])
    x = np.linspace(0.0, 1.0, 20_001)
    weights = Barycentric.of_verb(verb).weights(np.stack([x, np.full_like(x, 0.4)], axis=1))
    np.testing.assert_allclose(weights @ verb.values, np.stack([x, np.full_like(x, 0.4)], axis=1), atol=1e-9)
    assert np.abs(np.diff(weights, axis=0)).max() < 5e-4


def test_flat_simplices_are_skipped():
    flat = np.concatenate([SQUARE, [[2.0, 0.0]]])
    assert Barycentric.of_verb(verb_at(flat, simplices=[(0, 1, 5), (0, 1, 2)])).members.tolist() == [[0, 1, 2]]
    with pytest.raises(IllPosedVerb, match="every simplex of its examples is flat"):
        Barycentric.of_verb(verb_at(flat, simplices=[(0, 1, 5)]))


def test_errors_say_what_is_wrong():
    with pytest.raises(UnknownName, match="known: auto, authored, delaunay"):
        Barycentric.of_verb(verb_at(SQUARE), simplices="all")
    with pytest.raises(IllPosedVerb, match="has no authored simplices; add"):
        Barycentric.of_verb(verb_at(SQUARE), simplices="authored")
    with pytest.raises(IllPosedVerb, match="is not 3 different examples"):
        Barycentric.of_verb(verb_at(SQUARE, simplices=[(0, 1, 9)]))
    with pytest.raises(IllPosedVerb, match="9 dimensions have too many simplices"):
        Barycentric.of_verb(verb_at(np.random.default_rng(0).uniform(size=(20, 9))))


@pytest.mark.parametrize("name", ["arm3", "reach"])
def test_builtin_verbs_are_covered(name):
    verb = library.load(name)
    method = Barycentric.of_verb(verb)
    hull = ConvexHull(verb.domain.chart.points(verb.values)).volume
    volumes = np.abs(np.linalg.det(method.corners[:, 1:] - method.corners[:, :1])) / (2 if name == "arm3" else 6)
    assert volumes.sum() == pytest.approx(hull, rel=1e-6)


def test_control_on_mocap_linear_weights_miss_the_goal(mocap, verb_of):
    """The paper's finding: smooth enough to look at, and far off."""
    verb = verb_of("punch")
    evaluator, points = Evaluator(verb), accuracy_points(verb).adverbs
    weights = Barycentric.of_verb(verb).weights(points)
    assert 0.08 < evaluator.goal.compare(points, evaluator.goal.measured(weights))[1].mean() < 0.16


def test_control_on_mocap_authored_tetrahedra_leave_gaps(mocap, verb_of):
    verb = verb_of("locomotion")
    points = accuracy_points(verb).adverbs
    authored, automatic = Barycentric.of_verb(verb), Barycentric.of_verb(verb, simplices="delaunay")
    assert len(authored.members) == 52
    gaps, none = (
        np.linalg.norm((method.weights(points) @ verb.values - points) * verb.domain.chart.scale, axis=1) > 1e-6
        for method in (authored, automatic)
    )
    assert 0.2 < gaps.mean() < 0.3
    assert not none.any()
