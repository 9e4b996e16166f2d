from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.verbs.blend.places import permuted, verb_at
from verbs import library
from verbs.authoring import basis as bases
from verbs.blend.corrected import Corrected
from verbs.blend.inverse import Constraint, Inverse
from verbs.domain import accuracy_points, random_points
from verbs.errors import OutOfRange, UnknownName
from verbs.goal import Goal
from verbs.quality.smoothness import curvature, slices
from verbs.verb import Adverb

ELBOW = "RightForeArm"


@pytest.fixture(scope="module")
def reach():
    return library.load("reach")


@pytest.fixture(scope="module")
def points(reach):
    return accuracy_points(reach, count=100).adverbs


def placed(verb, weights, joint, keytime):
    """Positions (B, 3) of a joint at a keytime, through poses: a way of its own."""
    from verbs.runtime.evaluate import Blend, Evaluator

    evaluator, count = Evaluator(verb), len(weights)
    blend = Blend("test", weights, np.empty((count, 0)), np.empty(count), np.zeros(count, bool))
    phase = np.full(count, verb.phases[verb.keytime_names.index(keytime)])
    return evaluator.positions(evaluator.pose_of(blend, phase=phase))[1][:, verb.skeleton.index(joint)]


def starts(method, points):
    """The paper's initial weights: exp(−e²/σ²) of the k examples of least error, σ² the mean of their e²."""
    count = method.examples.shape[1]
    errors = np.stack([method.cost(points, np.tile(row, (len(points), 1))) for row in np.eye(count)], axis=1)
    weights = np.zeros_like(errors)
    for row, error in zip(weights, errors, strict=True):
        near = np.argsort(error)[: method.k]
        row[near] = np.exp(-error[near] / error[near].mean())
    return weights / weights.sum(axis=1, keepdims=True)


def scipy_from(method, point, start):
    """What SciPy's SLSQP reaches from a start, over the examples that the start uses; costs by finite differences."""
    used = np.flatnonzero(start)
    row = np.zeros_like(start)

    def cost(shares):
        row[used] = shares
        return method.cost(point[None], row[None])[0]

    total = {"type": "eq", "fun": lambda shares: shares.sum() - 1.0}
    bounds = [(0.0, 1.0)] * len(used)
    return minimize(cost, start[used], bounds=bounds, constraints=total, method="SLSQP", options={"ftol": 1e-15}).fun


def test_weights_sum_to_one_and_lie_between_zero_and_one(reach):
    around = random_points(reach, np.random.default_rng(0), 300, gauge=(0.0, 1.2))
    weights = Inverse.of_verb(reach).weights(around)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert weights.min() >= 0.0
    assert (weights > 0).sum(axis=1).max() <= 10


def test_the_result_is_no_worse_than_the_start(reach, points):
    method = Inverse.of_verb(reach)
    before, after = method.cost(points, starts(method, points)), method.cost(points, method.weights(points))
    assert (after <= before).all()
    assert np.sqrt(after).mean() < 0.25 * np.sqrt(before).mean()


def test_the_default_cost_is_the_squared_error(reach, points):
    method, weights = Inverse.of_verb(reach), np.random.default_rng(0).dirichlet(np.ones(24), 100)
    goal = Goal.of_verb(reach)
    error = goal.compare(points, goal.measured(weights))[1]
    np.testing.assert_allclose(method.cost(points, weights), error**2, rtol=1e-9)


@pytest.mark.parametrize(("name", "k"), [("arm3", 3), ("arm3", 5), ("reach", 4), ("reach", 10)])
def test_scipy_reaches_the_same_minimum(name, k):
    verb = library.load(name)
    some = random_points(verb, np.random.default_rng(1), 25)
    method = Inverse.of_verb(verb, k=k)
    ours = method.cost(some, method.weights(some))
    theirs = np.array([scipy_from(method, *pair) for pair in zip(some, starts(method, some), strict=True)])
    same = np.abs(np.sqrt(ours) - np.sqrt(theirs)) < 1e-5
    assert same.mean() > 0.85  # another path may end in another valley, either way
    assert np.sqrt(ours).mean() < 1.05 * np.sqrt(theirs).mean() + 1e-6


@pytest.mark.parametrize("constraints", [1, 2], ids=["goal", "goal and elbow"])
def test_scipy_finds_nothing_better_nearby(reach, points, constraints):
    """From our result on: a local minimum is where another optimiser stays, too."""
    elbow = Constraint("position", 0.5, 1.0, ELBOW, reach.keytime_names[1], (0.3, 1.2, 0.3))
    method = Inverse.of_verb(reach, constraints=(Constraint(), elbow)[:constraints])
    some = points[:25]
    weights = method.weights(some)
    ours = np.sqrt(method.cost(some, weights))
    theirs = np.sqrt([scipy_from(method, *pair) for pair in zip(some, weights, strict=True)])
    assert (ours <= theirs + 1e-6).all()


def test_priority_decides_between_constraints(reach, points):
    joint, keytime, target = ELBOW, reach.keytime_names[1], (0.5, 1.5, 0.4)
    gaps = []
    for priority in (0.0, 0.1, 1.0, 10.0):
        elbow = Constraint("position", priority, 1.0, joint, keytime, target)
        weights = Inverse.of_verb(reach, constraints=(Constraint(), elbow)).weights(points)
        gaps.append(np.linalg.norm(placed(reach, weights, joint, keytime) - target, axis=1).mean())
    assert gaps[0] > gaps[1] > gaps[2] > gaps[3]


def test_priority_times_scale_is_what_counts(reach, points):
    goals = [Constraint("goal", 8.0, 0.5), Constraint("goal", 0.5, 8.0)]
    elbow = Constraint("position", 1.0, 2.0, ELBOW, reach.keytime_names[1], (0.5, 1.5, 0.4))
    one, other = (Inverse.of_verb(reach, constraints=(goal, elbow)) for goal in goals)
    np.testing.assert_array_equal(one.weights(points), other.weights(points))


def test_a_distance_is_kept(reach):
    joint, keytime = reach.skeleton.names[reach.measure.effector], reach.keytime_names[1]
    middle = reach.values.mean(axis=0)
    ring = Constraint("distance", 1.0, 1.0, joint, keytime, tuple(middle), 0.15)
    weights = Inverse.of_verb(reach, constraints=(ring,)).weights(reach.values[:1])
    gap = np.linalg.norm(placed(reach, weights, joint, keytime) - middle, axis=1)
    np.testing.assert_allclose(gap, 0.15, atol=1e-6)


def test_unmeasured_adverbs_are_met_in_the_mean():
    values = np.random.default_rng(0).uniform(size=(12, 2))
    verb = verb_at(values)
    inside = random_points(verb, np.random.default_rng(1), 50, gauge=(0.0, 0.5))
    np.testing.assert_allclose(Inverse.of_verb(verb, k=12).weights(inside) @ values, inside, atol=1e-6)


def test_style_is_met_beside_the_goal():
    """An arm with a mood: blends reach the place and have the mood, each error as heavy as its range."""
    arm = library.load("arm3")
    values = np.concatenate([arm.values, np.tile([0.0, 50.0, 100.0, 30.0], 3)[:9, None]], axis=1)
    chart = bases.chart_of(values, ("m", "m", "%"))
    tired = replace(
        arm,
        adverbs=(*arm.adverbs, Adverb("mood", "%", "", True, 0.0, 100.0)),
        values=values,
        domain=bases.domain_of(chart, values),
        bases={"rbf": bases.cardinal(chart, values)},
    )
    method, weights = Inverse.of_verb(tired, k=9), np.random.default_rng(0).dirichlet(np.ones(9), 20)
    requested = random_points(tired, np.random.default_rng(1), 20, gauge=(0.0, 0.3))
    goal = Goal.of_verb(tired)
    error = goal.compare(requested, goal.measured(weights))[1]
    extent = np.linalg.norm(np.ptp(arm.values, axis=0)) / 100.0
    wanted = error**2 + (extent * (weights @ values[:, 2] - requested[:, 2])) ** 2
    np.testing.assert_allclose(method.cost(requested, weights), wanted, rtol=1e-9)
    assert np.median(method.cost(requested, method.weights(requested))) < 1e-12


def test_a_warm_start_is_never_worse(reach):
    """Neither than what it starts from, nor than the usual start's result; here it is often better."""
    method, rng = Inverse.of_verb(reach), np.random.default_rng(3)
    path = random_points(reach, rng, 60, gauge=(0.9, 1.2))
    cold = method.weights(path)
    bettered = 0
    for start in (cold[0], np.roll(cold, 1, axis=0), rng.dirichlet(np.ones(24), 60), rng.normal(size=(60, 24))):
        warm = method.weights(path, start=start)
        assert (method.cost(path, warm) <= method.cost(path, cold) + method.enough).all()
        bettered += (method.cost(path, warm) < method.cost(path, cold) - method.enough).sum()
        again = method.weights(path, start=warm)
        assert (method.cost(path, again) <= method.cost(path, warm) + method.enough).all()
    assert bettered > 20


def test_a_warm_start_on_the_goal_stays_where_it_is(reach, points):
    method = Inverse.of_verb(reach)
    weights = method.weights(points)
    met = method.cost(points, weights) < 1e-16
    assert met.any()
    again = method.weights(points[met], start=weights[met])
    np.testing.assert_allclose(again, weights[met], atol=1e-7)


def test_weights_do_not_depend_on_the_order_of_examples(reach, points):
    order = np.random.default_rng(0).permutation(len(reach.examples))
    weights = Inverse.of_verb(permuted(reach, order)).weights(points)
    np.testing.assert_allclose(weights, Inverse.of_verb(reach).weights(points)[:, order], atol=1e-5)


def test_weights_do_not_depend_on_the_batch_or_the_thread(reach, points):
    method = Inverse.of_verb(reach)
    weights = method.weights(points)
    np.testing.assert_array_equal(weights, np.concatenate([method.weights(points[b : b + 1]) for b in range(100)]))
    np.testing.assert_array_equal(weights[::-1], method.weights(np.ascontiguousarray(points[::-1])))
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(method.weights, [points] * 8):
            np.testing.assert_array_equal(weights, again)


def test_errors_say_what_is_wrong(reach, points):
    with pytest.raises(UnknownName, match="unknown kind of constraint 'aim'; known: goal, position, distance"):
        Inverse.of_verb(reach, constraints=(Constraint("aim"),))
    with pytest.raises(UnknownName, match="unknown joint 'Tail'"):
        Inverse.of_verb(reach, constraints=(Constraint("position", joint="Tail", keytime=reach.keytime_names[0]),))
    with pytest.raises(UnknownName, match="unknown keytime 'never'"):
        Inverse.of_verb(reach, constraints=(Constraint("position", joint=reach.skeleton.names[0], keytime="never"),))
    with pytest.raises(OutOfRange, match="priority, scale and distance not negative"):
        Inverse.of_verb(reach, constraints=(Constraint(priority=-1.0),))
    with pytest.raises(OutOfRange, match="at most one is the goal"):
        Inverse.of_verb(reach, constraints=())
    method = Inverse.of_verb(reach)
    with pytest.raises(OutOfRange, match=r"have the shape \(24,\) or \(100, 24\), not \(3,\)"):
        method.weights(points, start=np.ones(3))
    with pytest.raises(OutOfRange, match="no positive weight"):
        method.weights(points, start=np.zeros(24))


@pytest.mark.parametrize("name", ["punch", "jump", "locomotion"])
def test_mocap_goals_of_every_measure_are_met_where_bounds_allow(mocap, verb_of, name):
    """The paper's finding: the most accurate of its four, and stuck in other places."""
    verb = verb_of(name)
    some = accuracy_points(verb, count=200).adverbs
    method = Inverse.of_verb(verb)
    error = np.sqrt(method.cost(some, method.weights(some)))
    assert (error < 1e-6).mean() > 0.1
    assert error.max() > 1e-3


def test_another_joint_of_a_walk_can_be_asked_for(mocap, verb_of):
    verb = verb_of("locomotion")
    foot = Constraint("position", 1.0, 1.0, "LeftFoot", verb.keytime_names[0], (0.1, 0.2, 0.1))
    both = Inverse.of_verb(verb, constraints=(Constraint(), foot))
    some = accuracy_points(verb, count=20).adverbs
    assert (both.cost(some, both.weights(some)) <= both.cost(some, Inverse.of_verb(verb).weights(some)) + 1e-12).all()


def test_control_on_mocap_inverse_blending_jumps(mocap, verb_of):
    """κ of the same slice, at least eight times that of the corrected blend."""
    verb = verb_of("punch")
    one = slices(verb, 41)[1]
    flat = np.ascontiguousarray(one.adverbs.reshape(-1, 3))
    inverse, corrected = (
        np.nanmean(curvature(method.of_verb(verb).weights(flat).reshape(*one.inside.shape, -1), one.inside))
        for method in (Inverse, Corrected)
    )
    assert inverse > 8 * corrected
