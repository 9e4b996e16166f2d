from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from verbs.kernels import quat

ORDERS = ["".join(axes) for axes in itertools.permutations("XYZ")]
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
SHAPES = [(), (5,), (4, 3), (2, 3, 4)]


def some(*shape: int, seed: int = 0) -> np.ndarray:
    return quat.normalize(np.random.default_rng(seed).normal(size=(*shape, 4)))


def angle_between(left: np.ndarray, right: np.ndarray) -> float:
    """Largest angle between two batches of rotations, radians, blind to sign."""
    return float(np.linalg.norm(quat.log(quat.mul(quat.conjugate(left), right)), axis=-1).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_products_are_closed_over_every_batch_shape(shape):
    product = quat.mul(some(*shape), some(*shape, seed=1))
    assert product.shape == (*shape, 4)
    assert product.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(product, axis=-1), 1.0, atol=1e-14)


def test_the_identity_changes_nothing_from_either_side():
    a = some(50)
    np.testing.assert_array_equal(quat.mul(a, IDENTITY), a)
    np.testing.assert_array_equal(quat.mul(IDENTITY, a), a)


def test_the_conjugate_is_the_inverse_from_either_side():
    a = some(50)
    np.testing.assert_allclose(quat.mul(a, quat.conjugate(a)), np.tile(IDENTITY, (50, 1)), atol=1e-15)
    np.testing.assert_allclose(quat.mul(quat.conjugate(a), a), np.tile(IDENTITY, (50, 1)), atol=1e-15)


def test_products_are_associative():
    a, b, c = some(50), some(50, seed=1), some(50, seed=2)
    np.testing.assert_allclose(quat.mul(quat.mul(a, b), c), quat.mul(a, quat.mul(b, c)), atol=1e-15)


def test_the_right_factor_turns_first():
    a, b, v = some(20), some(20, seed=1), np.random.default_rng(2).normal(size=(20, 3))
    np.testing.assert_allclose(quat.rotate(quat.mul(a, b), v), quat.rotate(a, quat.rotate(b, v)), atol=1e-14)


def test_batch_axes_broadcast():
    a, b = some(4, 1), some(3, seed=1)
    assert quat.mul(a, b).shape == (4, 3, 4)
    np.testing.assert_array_equal(quat.mul(a, b)[2, 1], quat.mul(a[2, 0], b[1]))
    assert quat.rotate(some(4, 1), np.ones(3)).shape == (4, 1, 3)


def test_single_precision_is_raised_to_double():
    single = some(3).astype(np.float32)
    for result in (
        quat.mul(single, single),
        quat.conjugate(single),
        quat.log(single),
        quat.to_matrix(single),
    ):
        assert result.dtype == np.float64


def test_products_agree_with_scipy():
    a, b = some(200), some(200, seed=1)
    expected = (Rotation.from_quat(a) * Rotation.from_quat(b)).as_quat()
    np.testing.assert_allclose(quat.align(quat.mul(a, b), expected), expected, atol=1e-14)


def test_rotated_vectors_agree_with_scipy():
    a, v = some(200), np.random.default_rng(1).normal(size=(200, 3))
    np.testing.assert_allclose(quat.rotate(a, v), Rotation.from_quat(a).apply(v), atol=1e-14)


def test_matrices_agree_with_scipy():
    np.testing.assert_allclose(quat.to_matrix(some(4, 5))[1, 2], Rotation.from_quat(some(4, 5)[1, 2]).as_matrix())


def test_normalizing_gives_length_one_and_zero_becomes_the_identity():
    scaled = some(3, 5) * np.random.default_rng(0).uniform(1e-6, 1e6, (3, 5, 1))
    np.testing.assert_allclose(quat.normalize(scaled), some(3, 5), atol=1e-15)
    np.testing.assert_array_equal(quat.normalize(np.zeros((2, 4))), [IDENTITY, IDENTITY])


def test_exp_agrees_with_scipy_down_to_angle_zero():
    directions = np.random.default_rng(0).normal(size=(100, 3))
    vectors = directions * np.geomspace(1e-15, 3, 100)[:, None]
    np.testing.assert_allclose(quat.exp(vectors), Rotation.from_rotvec(vectors).as_quat(), atol=1e-15)
    np.testing.assert_array_equal(quat.exp(np.zeros(3)), IDENTITY)


def test_log_agrees_with_scipy():
    np.testing.assert_allclose(quat.log(some(300)), Rotation.from_quat(some(300)).as_rotvec(), atol=1e-14)


def test_log_undoes_exp_up_to_half_a_turn():
    directions = quat.normalize(np.random.default_rng(0).normal(size=(100, 4)))[:, :3]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    vectors = directions * np.append(np.geomspace(1e-12, 1, 50), np.linspace(1, np.pi - 1e-6, 50))[:, None]
    np.testing.assert_allclose(quat.log(quat.exp(vectors)), vectors, rtol=1e-9, atol=1e-20)


def test_exp_undoes_log_up_to_sign():
    assert angle_between(quat.exp(quat.log(some(300))), some(300)) < 1e-14


def test_log_is_blind_to_sign():
    np.testing.assert_array_equal(quat.log(some(50)), quat.log(-some(50)))


def test_aligned_quaternions_share_the_hemisphere_and_the_rotation():
    a, reference = some(100), some(100, seed=1)
    aligned = quat.align(a, reference)
    assert np.all(np.sum(aligned * reference, axis=-1) >= 0)
    np.testing.assert_array_equal(np.abs(aligned), np.abs(a))


def test_unrolling_removes_every_sign_flip_and_keeps_the_first_frame():
    times = np.linspace(0, 20, 400)[:, None, None]
    smooth = quat.exp(times * np.random.default_rng(0).normal(size=(3, 3)))
    smooth = quat.mul(some(3), smooth)
    flipped = smooth * np.random.default_rng(1).choice([-1.0, 1.0], size=(400, 3, 1))
    flipped[0] = smooth[0]
    np.testing.assert_array_equal(quat.unroll(flipped), smooth)


@pytest.mark.parametrize("shape", [(1,), (1, 3), (2, 3, 2)])
def test_unrolling_keeps_the_shape_of_short_sequences(shape):
    assert quat.unroll(some(*shape)).shape == (*shape, 4)


def test_the_principal_rotation_is_blind_to_signs():
    near = quat.mul(some(1, 6), quat.exp(0.3 * np.random.default_rng(0).normal(size=(9, 6, 3))))
    flipped = near * np.random.default_rng(1).choice([-1.0, 1.0], size=(9, 6, 1))
    np.testing.assert_allclose(quat.principal(flipped), quat.principal(near), atol=1e-14)


def test_the_principal_rotation_agrees_with_scipys_mean():
    near = quat.mul(some(1), quat.exp(0.3 * np.random.default_rng(0).normal(size=(9, 3))))
    assert angle_between(quat.principal(near), Rotation.from_quat(near).mean().as_quat()) < 1e-14


def test_the_principal_rotation_of_one_is_itself_and_of_two_lies_halfway():
    assert angle_between(quat.principal(some(1, 5)), some(5)) < 1e-14
    pair = np.stack([some(), quat.mul(some(), quat.exp(np.array([0.0, 1.0, 0.0])))])
    assert angle_between(quat.principal(pair), quat.mul(some(), quat.exp(np.array([0.0, 0.5, 0.0])))) < 1e-14


@pytest.mark.parametrize("order", [*ORDERS, "X", "Y", "Z", "ZX", "XY", "YZ"])
def test_euler_angles_turn_in_the_order_of_their_channels_as_scipys_intrinsic_ones(order):
    angles = np.random.default_rng(0).uniform(-4, 4, (5, 40, len(order)))
    expected = Rotation.from_euler(order, angles.reshape(-1, len(order)))
    result = quat.from_euler(order, angles)
    assert result.shape == (5, 40, 4)
    assert angle_between(result.reshape(-1, 4), expected.as_quat()) < 1e-14


@pytest.mark.parametrize("scale", [1e-3, 1.0, 50.0])
def test_an_arc_is_the_smallest_rotation_between_directions(scale):
    vectors = np.random.default_rng(2).normal(size=(40, 2, 3))
    for start, end in vectors:
        found = quat.arc(scale * start, end)
        np.testing.assert_allclose(
            quat.rotate(found, start) / np.linalg.norm(start), end / np.linalg.norm(end), atol=1e-12
        )
        assert abs(found[:3] @ start) < 1e-12
        assert found[3] >= 0.0


def test_an_arc_between_opposite_directions_is_half_a_turn_about_z():
    np.testing.assert_allclose(np.abs(quat.arc([0, -2, 0], [0, 3, 0])), [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(np.abs(quat.arc([0, 0, 1], [0, 0, -1])), [0, 1, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(quat.arc([0, 0, 0], [0, 0, -1]), IDENTITY)
