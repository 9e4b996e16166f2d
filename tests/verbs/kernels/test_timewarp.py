import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from verbs.kernels import timewarp

lengths = st.lists(st.floats(0.01, 10.0), min_size=1, max_size=8)


def knots_and_values(steps, seed):
    knots = np.concatenate([[0.0], np.cumsum(np.random.default_rng(seed).uniform(0.1, 1.0, len(steps)))])
    return knots / knots[-1], np.concatenate([[0.0], np.cumsum(steps)])


@settings(max_examples=60, deadline=None)
@given(lengths, st.integers(0, 9))
def test_time_equals_scipys_pchip_and_its_derivative(steps, seed):
    knots, values = knots_and_values(steps, seed)
    tangents = np.empty(len(knots))
    timewarp.slopes(knots, values, False, tangents)
    oracle = PchipInterpolator(knots, values)
    at = np.linspace(0, 1, 37)
    ours = [timewarp.time_at(knots, values, tangents, phase) for phase in at]
    np.testing.assert_allclose(ours, oracle(at), atol=1e-12 * values[-1])
    rates = [timewarp.rate_at(knots, values, tangents, phase) for phase in at]
    np.testing.assert_allclose(rates, oracle.derivative()(at), atol=1e-9 * max(rates))


@settings(max_examples=60, deadline=None)
@given(lengths, st.integers(0, 9), st.booleans())
def test_time_is_monotone_and_phase_is_its_inverse(steps, seed, periodic):
    knots, values = knots_and_values(steps, seed)
    tangents = np.empty(len(knots))
    timewarp.slopes(knots, values, periodic, tangents)
    at = np.linspace(0, 1, 101)
    times = np.array([timewarp.time_at(knots, values, tangents, phase) for phase in at])
    assert np.all(np.diff(times) > 0)
    back = [timewarp.phase_at(knots, values, tangents, time) for time in times]
    again = [timewarp.time_at(knots, values, tangents, phase) for phase in back]
    np.testing.assert_allclose(again, times, atol=1e-12 * values[-1])


def test_periodic_slopes_agree_at_the_seam():
    knots, values = knots_and_values([0.3, 0.5, 0.2, 0.9], 3)
    tangents = np.empty(5)
    timewarp.slopes(knots, values, True, tangents)
    assert tangents[0] == tangents[-1] > 0


@pytest.mark.parametrize("spread", [1.0, 2.0, 8.0])
def test_blended_segments_are_positive_for_any_weights(spread):
    rng = np.random.default_rng(4)
    logs = np.log(rng.uniform(0.1, 3.0, (19, 4)))
    for _ in range(200):
        weights = rng.normal(size=19)
        weights *= spread / np.abs(weights).sum()
        weights[0] += 1.0 - weights.sum()
        keytimes = np.empty(5)
        timewarp.blend_keytimes(weights, logs, keytimes)
        assert np.all(np.diff(keytimes) > 0)


def test_blended_keytimes_are_exact_at_an_example():
    logs = np.log(np.random.default_rng(5).uniform(0.1, 3.0, (7, 3)))
    keytimes = np.empty(4)
    timewarp.blend_keytimes(np.eye(7)[2], logs, keytimes)
    np.testing.assert_allclose(np.diff(keytimes), np.exp(logs[2]), rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(lengths, st.integers(0, 9), st.floats(-0.5, 1.5))
def test_a_guess_changes_nothing_but_the_number_of_steps(steps, seed, guess):
    knots, values = knots_and_values(steps, seed)
    tangents = np.empty(len(knots))
    timewarp.slopes(knots, values, False, tangents)
    for time in np.linspace(0, values[-1], 31):
        found = timewarp.phase_near(knots, values, tangents, time, guess)
        assert timewarp.time_at(knots, values, tangents, found) == pytest.approx(time, abs=1e-12 * values[-1])
    for knot, value in zip(knots, values, strict=True):
        assert timewarp.phase_near(knots, values, tangents, value, guess) == knot


def test_the_phase_of_no_time_is_no_phase():
    knots, values = knots_and_values([0.3, 0.5], 0)
    tangents = np.empty(3)
    timewarp.slopes(knots, values, False, tangents)
    assert np.isnan(timewarp.phase_at(knots, values, tangents, np.nan))
