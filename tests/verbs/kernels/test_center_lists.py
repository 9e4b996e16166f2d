from __future__ import annotations

import numpy as np
import pytest

from verbs.kernels import center_lists, radial_basis
from verbs.kernels.chart import ChartArrays
from verbs.kernels.radial_basis import BasisArrays, cardinal


def basis_of(centers, radii, radial, poly, function: int = radial_basis.BSPLINE) -> BasisArrays:
    """A basis in the identity chart."""
    dims = centers.shape[1]
    plain = ChartArrays(0, np.zeros(3, np.int64), np.zeros(4), np.zeros(dims), np.ones(dims))
    return BasisArrays(plain, function, 1, centers, radii, radial, poly)


def scattered(dims: int, count: int, seed: int = 0, *, clustered: bool = False):
    """Centers with the radius that each got when it came, coefficients, and queries in and around them."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-0.5, 0.5, (count, dims)) ** (3 if clustered else 1)
    radii = np.array([np.delete(np.linalg.norm(centers[: max(k, 2)] - c, axis=1), k if k < 2 else []).min()
                      for k, c in enumerate(centers)])  # fmt: skip
    queries = np.concatenate([rng.uniform(-0.9, 0.9, (400, dims)), centers[:50]])
    return centers, radii, rng.normal(size=(count, 7)), rng.normal(size=(dims + 1, 7)), queries


def brute(basis: BasisArrays, queries):
    out = np.empty((len(queries), basis.radial.shape[1]))
    cardinal(queries, basis, out)
    return out


CASES = [(1, 60), (2, 2), (2, 300), (3, 24), (3, 500), (5, 200)]


@pytest.mark.parametrize("function", [radial_basis.BSPLINE, radial_basis.WENDLAND])
@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize(("dims", "count"), CASES)
def test_grid_gives_what_all_centers_give(dims, count, clustered, function):
    centers, radii, radial, poly, queries = scattered(dims, count, clustered=clustered)
    basis = basis_of(centers, radii, radial, poly, function)
    out = np.empty((len(queries), 7))
    grid = center_lists.grid(centers, radii)
    center_lists.cardinal(queries, basis, grid, out)
    assert np.allclose(out, brute(basis, queries), rtol=0, atol=1e-12)


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize(("dims", "count"), CASES)
def test_tree_gives_what_all_centers_give(dims, count, clustered):
    centers, radii, radial, poly, queries = scattered(dims, count, clustered=clustered)
    basis = basis_of(centers, radii, radial, poly)
    out, tree = np.empty((len(queries), 7)), center_lists.cluster(centers, radii)
    center_lists.cardinal_tree(queries, basis, tree, out)
    assert np.allclose(out, brute(basis, queries), rtol=0, atol=1e-12)


def test_queries_on_faces_and_corners_of_cells_miss_no_center():
    centers, radii, radial, poly, _ = scattered(2, 200, seed=4)
    grid = center_lists.grid(centers, radii)
    faces = [grid.low[a] + np.arange(grid.shape[a] + 1) / grid.inverse[a] for a in range(2)]
    queries = np.stack(np.meshgrid(*faces), axis=-1).reshape(-1, 2)
    queries = np.concatenate([np.nextafter(queries, -9.0), queries, np.nextafter(queries, 9.0)])
    out, basis = np.empty((len(queries), 7)), basis_of(centers, radii, radial, poly)
    center_lists.cardinal(queries, basis, grid, out)
    assert np.allclose(out, brute(basis, queries), rtol=0, atol=1e-12)


def test_lists_rise_and_are_short():
    centers, radii, *_ = scattered(3, 1_000)
    grid = center_lists.grid(centers, radii)
    assert grid.starts[-1] == len(grid.members)
    lengths = np.diff(grid.starts)
    assert lengths.mean() < 120  # of 1,000
    for cell in np.flatnonzero(lengths)[::500]:
        assert np.all(np.diff(grid.members[grid.starts[cell] : grid.starts[cell + 1]]) > 0)


def test_tree_holds_each_center_once_and_its_support():
    centers, radii, *_ = scattered(3, 333)
    tree = center_lists.cluster(centers, radii)
    assert np.array_equal(np.sort(tree.order), np.arange(333))
    for middle, reach, (begin, end) in zip(tree.middles, tree.reaches, tree.spans, strict=True):
        below = tree.order[begin:end]
        assert np.all(np.linalg.norm(centers[below] - middle, axis=1) + 2.0 * radii[below] <= reach + 1e-12)
    leaves = tree.children[:, 0] < 0
    assert (tree.spans[leaves] @ [-1, 1]).sum() == 333
    assert (tree.spans[leaves] @ [-1, 1]).max() <= center_lists.LEAF


def test_constant_axis_and_equal_centers_make_a_grid():
    centers = np.array([[0.0, 0.3], [0.5, 0.3], [1.0, 0.3], [1.0, 0.3]])
    grid = center_lists.grid(centers, np.full(4, 0.5))
    out = np.empty((3, 2))
    queries = np.array([[0.1, 0.3], [0.9, 0.3], [0.5, 9.0]])
    radial, poly = np.ones((4, 2)), np.zeros((3, 2))
    basis = basis_of(centers, np.full(4, 0.5), radial, poly)
    center_lists.cardinal(queries, basis, grid, out)
    assert np.allclose(out, brute(basis, queries), rtol=0, atol=1e-12)


def test_active_centers_are_those_that_count():
    centers, radii, radial, poly, queries = scattered(2, 40)
    out = np.empty(len(queries), np.int64)
    center_lists.active(queries, basis_of(centers, radii, radial, poly), out)
    values = radial_basis.radial_matrix(radial_basis.BSPLINE, queries, centers, radii)
    assert np.array_equal(out, (values != 0).sum(axis=1))


def test_radial_matrix_is_the_function_of_the_scaled_distance():
    centers, radii, *_ = scattered(3, 20)
    out = radial_basis.radial_matrix(radial_basis.BSPLINE, centers, centers, radii)
    assert np.allclose(np.diag(out), 2.0 / 3.0)
    distance = np.linalg.norm(centers[3] - centers[5])
    assert out[3, 5] == pytest.approx(radial_basis.phi(radial_basis.BSPLINE, distance / radii[5]))
