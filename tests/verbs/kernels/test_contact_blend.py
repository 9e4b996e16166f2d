import numpy as np
import pytest

from verbs.kernels import contacts

RNG = np.random.default_rng(4)
KEYS, EXAMPLES, POINTS = 12, 5, 3
VALUES = RNG.uniform(0, 1, (KEYS + 1, EXAMPLES, POINTS)).astype(np.float32)


def contact(weights, phases, *, looping=False):
    out = np.full((len(weights), POINTS), np.nan)
    contacts.contact(np.array(weights, float), np.array(phases, float), VALUES, looping, out)
    return out


@pytest.mark.parametrize("example", range(EXAMPLES))
def test_an_example_alone_has_its_own_contact_at_every_key(example):
    weights = np.tile(np.eye(EXAMPLES)[example], (KEYS + 1, 1))
    np.testing.assert_allclose(contact(weights, np.arange(KEYS + 1) / KEYS), VALUES[:, example], atol=1e-12)


def test_contact_is_the_clipped_sum_of_the_examples_linear_between_keys():
    weights, phases = RNG.normal(0, 2, (200, EXAMPLES)), RNG.uniform(0, 1, 200)
    keys = np.arange(KEYS + 1) / KEYS
    rows = np.array([[[np.interp(at, keys, VALUES[:, i, p]) for p in range(POINTS)] for i in range(EXAMPLES)]
                     for at in phases])  # fmt: skip
    expected = np.clip(np.einsum("bi,bip->bp", weights, rows), 0, 1)
    found = contact(weights, phases)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert (found == 0).any()
    assert (found == 1).any()


def test_large_negative_weights_stay_within_bounds():
    found = contact([[-1e6, 1e6, 1.0, 0.0, 0.0], [1e9, -1e9, 0.0, 0.0, 1.0]], [0.3, 0.7])
    assert np.isfinite(found).all()
    assert ((found >= 0) & (found <= 1)).all()


def test_a_loop_repeats_and_a_motion_ends():
    weights = np.tile(RNG.dirichlet(np.ones(EXAMPLES)), (4, 1))
    first = contact(weights, [0.1, 0.4, 0.7, 0.95], looping=True)
    np.testing.assert_allclose(contact(weights, [7.1, 3.4, -0.3, 1.95], looping=True), first, atol=1e-9)
    ends = contact(weights, [0.0, -2.0, 1.0, 5.0])
    np.testing.assert_array_equal(ends[[0, 2]], ends[[1, 3]])


def test_a_batch_gives_the_bits_of_single_calls():
    weights, phases = RNG.normal(0, 1, (30, EXAMPLES)), RNG.uniform(0, 1, 30)
    single = np.concatenate([contact(weights[b : b + 1], phases[b : b + 1]) for b in range(30)])
    np.testing.assert_array_equal(contact(weights, phases), single)


def test_heights_blend_with_the_weights():
    weights, rows = RNG.normal(0, 1, (20, EXAMPLES)), RNG.normal(0, 1, (EXAMPLES, POINTS))
    out = np.empty((20, POINTS))
    contacts.heights(weights, rows, out)
    np.testing.assert_allclose(out, weights @ rows, atol=1e-12)
