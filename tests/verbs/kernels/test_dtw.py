from __future__ import annotations

import numpy as np
import pytest

from verbs.kernels import dtw


def reference(first, second, penalty):
    """Least cost over all monotone paths, by the plain recursion."""
    gaps = np.linalg.norm(first[:, None] - second[None], axis=-1)
    cost = np.full(gaps.shape, np.inf)
    for i in range(len(first)):
        for j in range(len(second)):
            if i == j == 0:
                cost[i, j] = gaps[0, 0]
                continue
            options = []
            if i and j:
                options.append(cost[i - 1, j - 1])
            if i:
                options.append(cost[i - 1, j] + penalty)
            if j:
                options.append(cost[i, j - 1] + penalty)
            cost[i, j] = min(options) + gaps[i, j]
    return cost[-1, -1]


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 9), (9, 1), (12, 30), (31, 17)])
def test_cost_and_path_are_those_of_the_plain_recursion(rows, columns):
    rng = np.random.default_rng(rows + columns)
    first, second = rng.normal(size=(rows, 3)), rng.normal(size=(columns, 3))
    path = np.empty((rows + columns, 2), np.int64)
    cost, length = dtw.warp(first, second, max(rows, columns), 0.3, path)
    assert cost == pytest.approx(reference(first, second, 0.3))
    pairs = path[:length][::-1]
    assert pairs[0].tolist() == [0, 0]
    assert pairs[-1].tolist() == [rows - 1, columns - 1]
    steps = np.diff(pairs, axis=0)
    assert set(map(tuple, steps.tolist())) <= {(0, 1), (1, 0), (1, 1)}
    along = sum(np.linalg.norm(first[i] - second[j]) for i, j in pairs) + 0.3 * np.sum(steps.sum(axis=1) == 1)
    assert along == pytest.approx(cost)


def test_a_time_warp_is_recovered():
    s = np.linspace(0.0, 1.0, 80)
    curve = lambda t: np.stack([np.sin(6 * t), np.cos(4 * t)], axis=1)  # noqa: E731
    first, second = curve(s), curve(s**1.5)
    path = np.empty((160, 2), np.int64)
    _, length = dtw.warp(first, second, 30, 0.0, path)
    pairs = path[:length]
    assert np.abs(s[pairs[:, 0]] - s[pairs[:, 1]] ** 1.5).max() < 0.03


def test_a_band_that_is_not_connected_is_reported():
    path = np.empty((120, 2), np.int64)
    cost, length = dtw.warp(np.zeros((3, 1)), np.zeros((100, 1)), 2, 0.0, path)
    assert np.isinf(cost)
    assert length == 0
