from __future__ import annotations

import numpy as np
import pytest

from tests.verbs.plain_characters import plain_pose
from verbs import library
from verbs.kernels import crowd_pose
from verbs.kernels.pose import NLERP


@pytest.fixture(scope="module")
def verb():
    return library.load("reach")


def some(verb, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Weights (B, N), some below 0, and phases (B,), which contain both ends."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(len(verb.examples)), count) * 1.4 - 0.4 / len(verb.examples)
    phases = rng.uniform(size=count)
    phases[: count // 3] = rng.choice([0.0, 0.25, 1.0], count // 3)
    return weights, phases


def blended(verb, weights, phases):
    curves = crowd_pose.curves_of(verb.curves, verb.rotation_mode, verb.references)
    root, rotations = np.empty((len(weights), 3)), np.empty((len(weights), len(verb.skeleton), 4))
    crowd_pose.blend_sorted(weights, phases, curves, root, rotations)
    return root, rotations


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 9, crowd_pose.TILE, 3 * crowd_pose.TILE + 5])
def test_a_crowd_stands_as_each_one_alone(verb, count):
    weights, phases = some(verb, count)
    root, rotations = blended(verb, weights, phases)
    for b in range(count):
        expected = plain_pose(verb, weights[b], phases[b])
        np.testing.assert_allclose(root[b], expected[0], atol=1e-14)
        np.testing.assert_allclose(rotations[b], expected[1], atol=1e-14)
        alone = blended(verb, weights[b : b + 1], phases[b : b + 1])
        np.testing.assert_array_equal(root[b], alone[0][0])
        np.testing.assert_array_equal(rotations[b], alone[1][0])


def test_numbers_are_sorted_by_interval_and_else_stay_in_order():
    rng = np.random.default_rng(0)
    phases = rng.uniform(-0.1, 1.1, 300)
    chosen = rng.permutation(300)[:200]
    order = np.empty(200, np.int64)
    crowd_pose.sort_by_interval(chosen, phases, 17, order)
    keys = np.clip(np.floor(phases[chosen] * 17), 0, 16)
    np.testing.assert_array_equal(order, chosen[np.argsort(keys, kind="stable")])


def test_single_precision_is_near_double(verb):
    weights, phases = some(verb, 150)
    rows, intervals, mode, references = crowd_pose.curves_of(verb.curves, verb.rotation_mode, verb.references)
    order = np.empty(150, np.int64)
    crowd_pose.sort_by_interval(np.arange(150), phases, intervals, order)
    shares, out = np.empty((150, 4 * len(verb.examples)), np.float32), np.empty((150, rows.shape[1]), np.float32)
    at = np.array([crowd_pose.share(weights[b], phases[b], intervals, np.empty(4), shares[k])
                   for k, b in enumerate(order)])  # fmt: skip
    crowd_pose.sums(shares, at, rows, out)
    crowd_pose.finish_single(out, np.empty(out.size // 4, np.float32), mode, references)
    root, rotations = blended(verb, weights[order], phases[order])
    np.testing.assert_allclose(out[:, :3], root, atol=1e-6)
    np.testing.assert_allclose(out[:, 4:].reshape(rotations.shape), rotations, atol=1e-6)


@pytest.mark.parametrize("length", [0.0, 0.1, 0.29])
def test_a_sum_without_direction_is_the_reference(length):
    references = np.array([[0.0, 0.0, 0.0, 1.0], [0.6, 0.0, 0.8, 0.0]])
    tile = np.ones((3, 12), np.float32)
    tile[1, 8:] = [length, 0.0, 0.0, 0.0]
    crowd_pose.finish_single(tile, np.empty(9, np.float32), NLERP, references)
    expected = np.full((3, 12), 0.5)
    expected[:, :4], expected[1, 8:] = 1.0, references[1]
    np.testing.assert_allclose(tile, expected, atol=1e-6)
