"""Weights of a batch against those of rows one by one: two kernels for one method."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from verbs import Evaluator, library
from verbs.authoring import basis as bases
from verbs.blend.cardinal import basis_weights
from verbs.blend.corrected import Corrected
from verbs.domain import random_points
from verbs.errors import OutOfRange
from verbs.kernels import correction, radial_basis
from verbs.kernels.columns import BATCH, TILE
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Blended, corrected_position

BUILT_IN = ["arm3", "board", "reach"]
CAPTURED = ["reach", "punch", "kick"]

one_by_one = direct(corrected_position)


def expected(evaluator, rows):
    """Results of the single-row kernel."""
    size, (count, axes) = len(rows), evaluator._shape
    out = Blended(np.empty((size, count)), np.empty((size, axes)), np.empty(size), np.empty(size))
    one_by_one(np.ascontiguousarray(rows), evaluator.method("corrected")[1].problem(), out)
    return out


def goals_of(verb, count, *, spread=1.0):
    """Adverbs in the domain, moved away from their mean by a factor."""
    rows = random_points(verb, np.random.default_rng(5), count)
    return rows.mean(axis=0) + spread * (rows - rows.mean(axis=0))


def assert_same(blend, other, tolerance=2e-12):
    np.testing.assert_allclose(blend.weights, other.weights, rtol=0, atol=tolerance)
    np.testing.assert_allclose(blend.measured, other.measured, rtol=0, atol=tolerance)
    np.testing.assert_allclose(blend.error, other.error, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(blend.clamped, other.moved > 0)


def assert_batches_agree(verb):
    evaluator = Evaluator(verb)
    for spread in (1.0, 2.0, 4.0):
        rows = goals_of(verb, 700, spread=spread)
        blend = evaluator.blend(rows, method="corrected")
        assert_same(blend, expected(evaluator, rows))
        assert blend.clamped.any() == (spread > 1.0)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_batch_gives_the_weights_of_its_rows(name):
    assert_batches_agree(library.load(name))


@pytest.mark.parametrize("name", CAPTURED)
def test_a_batch_of_captured_verbs_gives_the_weights_of_its_rows(mocap, verb_of, name):
    assert_batches_agree(verb_of(name))


def with_lift(verb):
    """A verb with a style adverb, ``lift``, whose blend corrections must keep."""
    lift = np.random.default_rng(3).uniform(size=(len(verb.examples), 1))
    values, chart = np.concatenate([verb.values, lift], axis=1), verb.domain.chart
    chart = replace(chart, shift=np.append(chart.shift, 0.5), scale=np.append(chart.scale, 1.0))
    return replace(
        verb,
        adverbs=(*verb.adverbs, replace(verb.adverbs[0], name="lift", minimum=0.0, maximum=1.0)),
        values=values,
        domain=bases.domain_of(chart, values),
        bases={"rbf": bases.cardinal(chart, values), "smooth": bases.smooth(chart, values)},
    )


def test_style_adverbs_are_kept_in_batches():
    verb = with_lift(library.load("reach"))
    assert_batches_agree(verb)
    rows = goals_of(verb, 200)
    start = basis_weights(verb.bases["smooth"], rows)
    blend = Evaluator(verb).blend(rows)
    np.testing.assert_allclose(blend.weights @ verb.values[:, 3], start @ verb.values[:, 3], atol=1e-12)
    assert np.abs(blend.weights - start).max() > 1e-3
    assert blend.error.max() < 1e-6


@pytest.mark.parametrize("function", radial_basis.RADIAL_BASES)
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_batches_of_every_basis(function, degree):
    """Any radial function and polynomial, in a chart other than the domain's."""
    verb = library.load("reach")
    chart = replace(verb.domain.chart, scale=verb.domain.chart.scale * [1.0, 1.5, 0.5])
    number = radial_basis.RADIAL_BASES[function]
    verb = replace(
        verb, bases={**verb.bases, "smooth": bases.cardinal(chart, verb.values, function=number, degree=degree)}
    )
    rows, evaluator = goals_of(verb, 50), Evaluator(verb)
    assert_same(evaluator.blend(rows), expected(evaluator, rows), 1e-9)
    basis = verb.bases["smooth"]
    single = np.concatenate([basis_weights(basis, row[None]) for row in rows])
    np.testing.assert_allclose(basis_weights(basis, rows), single, rtol=0, atol=1e-10)


@pytest.mark.parametrize("size", [1, 2, BATCH - 1, BATCH, 31, 32, 33, 128, TILE, TILE + 1, 1000])
def test_results_do_not_depend_on_the_size_of_a_batch(size):
    verb = library.load("reach")
    evaluator, rows = Evaluator(verb), goals_of(verb, 1000, spread=1.3)
    whole, part = evaluator.blend(rows), evaluator.blend(rows[:size])
    np.testing.assert_allclose(part.weights, whole.weights[:size], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(part.clamped, whole.clamped[:size])


def test_results_do_not_depend_on_the_neighbours():
    verb = library.load("reach")
    evaluator, rows = Evaluator(verb), goals_of(verb, 600, spread=1.5)
    order = np.random.default_rng(0).permutation(len(rows))
    there, here = evaluator.blend(rows), evaluator.blend(rows[order])
    np.testing.assert_allclose(here.weights, there.weights[order], rtol=0, atol=1e-12)
    far = np.tile(goals_of(verb, 1, spread=4.0), (50, 1)) + 3.0
    among = evaluator.blend(np.concatenate([rows[:50], far]))
    np.testing.assert_allclose(among.weights[:50], there.weights[:50], rtol=0, atol=1e-12)


def test_cancelled_rotations_fall_back_to_the_reference_in_batches():
    """Weights that extrapolate far, so that sums of quaternions become short."""
    verb = library.load("reach")
    goal, rng = Evaluator(verb).goal, np.random.default_rng(1)
    rows = goal.chain.rows.reshape(-1, 4, len(verb.examples))
    weights = rng.normal(size=(400, len(verb.examples)))
    weights /= np.maximum(np.abs(np.einsum("lci,bi->blc", rows, weights)).max(axis=(1, 2)), 1e-9)[:, None]
    weights *= rng.uniform(0.05, 0.6, size=(400, 1))
    lengths = np.linalg.norm(np.einsum("lci,bi->blc", rows, weights), axis=2)
    assert (lengths < 0.3).any()
    assert (lengths > 0.3).any()
    single = np.concatenate([goal.measured(row[None]) for row in weights])
    np.testing.assert_allclose(goal.measured(weights), single, rtol=0, atol=1e-12)
    method = Corrected.of_verb(verb)
    goals, batch, alone = goal.points(goals_of(verb, 400)), weights[:40].copy(), weights[:40].copy()
    method.correct(batch, goals[:40])
    for k in range(40):
        method.correct(alone[k : k + 1], goals[k : k + 1])
    np.testing.assert_allclose(batch, alone, rtol=0, atol=1e-9)


@pytest.mark.parametrize("effector", [0, 1, 5])
def test_chains_of_any_length_in_batches(effector):
    """Without joints a chain is the root alone; goals of the hand are then out of reach."""
    verb = library.load("reach")
    evaluator = Evaluator(replace(verb, measure=replace(verb.measure, effector=effector)))
    assert len(evaluator.goal.chain.references) == len(verb.skeleton.chain(effector)) - 1
    rows = goals_of(verb, 40)
    blend, alone = evaluator.blend(rows), expected(evaluator, rows)
    np.testing.assert_allclose(blend.measured, alone.measured, rtol=0, atol=1e-9)
    np.testing.assert_allclose(blend.weights, alone.weights, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("size", [3, 300])
def test_chart_points_give_the_blend_of_their_adverbs(name, size):
    verb = library.load(name)
    evaluator, chart = Evaluator(verb), verb.domain.chart
    points = chart.points(goals_of(verb, size, spread=1.5))
    for method in ("corrected", "rbf"):
        there, here = (
            evaluator.blend(chart.adverbs(points), method=method),
            evaluator.blend_points(points, method=method),
        )
        np.testing.assert_allclose(here.weights, there.weights, rtol=0, atol=1e-12)
        np.testing.assert_allclose(here.error, there.error, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(here.clamped, there.clamped)


def test_chart_points_beyond_a_turn_are_those_of_their_adverbs(mocap, verb_of):
    verb = verb_of("kick")
    evaluator, chart = Evaluator(verb), verb.domain.chart
    points = chart.points(goals_of(verb, 64))
    points[::2, chart.axes[0]] += 2.0 * np.pi * chart.bend[3] * chart.scale[chart.axes[0]]
    points[1::4, chart.axes[2]] -= 6.0
    there, here = evaluator.blend(chart.adverbs(points)), evaluator.blend_points(points)
    np.testing.assert_allclose(here.weights, there.weights, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(here.clamped, there.clamped)


def test_chart_points_must_be_finite():
    evaluator = Evaluator(library.load("reach"))
    with pytest.raises(OutOfRange, match="finite"):
        evaluator.blend_points(np.full((20, 3), np.nan))


def test_threads_compute_batches_at_the_same_time():
    """No scratch array is shared: results of concurrent calls are those of calls one after the other."""
    verb = library.load("reach")
    evaluator = Evaluator(verb)
    batches = [goals_of(verb, 500, spread=1.0 + 0.1 * k) for k in range(8)]
    alone = [evaluator.blend(rows).weights for rows in batches]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            for weights, other in zip(
                pool.map(lambda rows: evaluator.blend(rows).weights, batches), alone, strict=True
            ):
                np.testing.assert_array_equal(weights, other)


def corrected_by_steps(method, weights, goals):
    """Weights of jumps after damped, saturated steps, as for other measures."""
    fixed, scale, saturation, damping, stop, steps = method.correction
    for row, goal in zip(weights, goals, strict=True):
        for _ in range(steps):
            jacobian = correction.jump_rates(method.goal.roots)
            point = jacobian @ row
            if correction.step(row, goal, point, jacobian, fixed, scale, (saturation, damping, stop)) < stop:
                break


@pytest.mark.parametrize("spread", [1.0, 4.0])
def test_jumps_are_corrected_as_by_steps(mocap, verb_of, spread):
    verb = verb_of("jump")
    evaluator, method = Evaluator(verb), Corrected.of_verb(verb)
    rows, clamped = evaluator.clamp(goals_of(verb, 300, spread=spread))
    assert clamped.any() == (spread > 1.0)
    weights, goals = basis_weights(method.basis, rows), method.goal.points(rows)
    corrected_by_steps(method, weights, goals)
    np.testing.assert_allclose(method.weights(rows), weights, rtol=0, atol=1e-12)
    np.testing.assert_allclose(method.goal.measured(method.weights(rows)), goals, rtol=0, atol=1e-13)


def test_a_linear_correction_leaves_flat_directions_alone():
    """Examples that all rise equally high: no weights change the rise."""
    rates = np.array([[0.0, 1.0, 2.0, 1.0], [0.0, 0.0, 1.0, 2.0], [0.3, 0.3, 0.3, 0.3]])
    limits = correction.Correction(np.full((1, 4), 0.5), np.ones(3), 0.2, 1e-6, 1e-10, 8)
    _, gains = correction.linear_correction(rates, limits)
    np.testing.assert_allclose(rates @ gains.T, np.diag([1.0, 1.0, 0.0]), atol=1e-9)
    np.testing.assert_allclose(gains.sum(axis=1), 0.0, atol=1e-12)
    assert np.abs(gains).max() < 2.0
