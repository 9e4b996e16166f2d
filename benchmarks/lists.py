"""Evaluating a basis of many centers: all of them, lists by grid cell, and a tree of bounding spheres.

``python -m benchmarks.lists [N]`` takes centers of a real refinement up to N (300; 2,000 takes minutes) and uniform
ones up to 2,000. Times are the least of interleaved rounds, in microseconds per query of 24 weights: ``rbf`` is what
the method of that name runs, ``brute`` all centers in the loops that grid and tree use, so that ratios compare lists.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from verbs import library
from verbs.blend.cardinal import basis_weights
from verbs.blend.refined import Refined
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.kernels import center_lists
from verbs.refine import Rules, refine
from verbs.verb import Basis, Verb

COUNTS = (24, 50, 100, 300, 1_000, 2_000)
"""Pseudo-examples; the 24 examples come on top."""

ROUNDS, QUERIES = 40, 500


def main(most: int = 300) -> None:
    """Print active centers and times for refined and for uniform centers."""
    verb = library.load("reach")
    queries = random_points(verb, np.random.default_rng(5), QUERIES)
    print(f"basis evaluation, built-in verb 'reach', {platform.machine()}, one thread, {ROUNDS} interleaved rounds")
    for title, bases in (("refined", _refined(verb, most)), ("uniform", _uniform(verb))):
        print(f"\n{title:>8}  active     rbf   brute    grid    tree  brute/grid  brute/tree  entries")
        for count, basis in bases:
            _print_row(count, basis, queries)


def _refined(verb: Verb, most: int) -> list[tuple[int, Basis]]:
    """Bases after the numbers of refinement steps that stand in COUNTS."""
    counts = [count for count in COUNTS if count <= most]
    rules = Rules(target_error=0.0, max_pseudo=counts[-1], patience=0)
    return [(step.pseudo, step.basis) for step in refine(verb, rules) if step.pseudo in counts]


def _uniform(verb: Verb) -> list[tuple[int, Basis]]:
    """Random centers, each with the radius that it would have got when it came; coefficients do not matter here."""
    start, rng = verb.bases["rbf"], np.random.default_rng(6)
    places = start.chart.points(random_points(verb, rng, COUNTS[-1]))
    centers, radii = start.centers, start.radii
    for place in places:
        radii = np.append(radii, np.linalg.norm(centers - place, axis=1).min())
        centers = np.concatenate([centers, place[None]])
    radial = rng.normal(size=(len(centers), len(verb.values)))
    sizes = [(count, count + len(verb.values)) for count in COUNTS]
    return [(count, replace(start, centers=centers[:n], radii=radii[:n], radial=radial[:n])) for count, n in sizes]


def _print_row(count: int, basis: Basis, queries: F64) -> None:
    points = basis.chart.points(queries)
    grid, tree = center_lists.grid(basis.centers, basis.radii), center_lists.cluster(basis.centers, basis.radii)
    middle = np.zeros(1, np.int64)  # one cell that is everywhere, and all centers in its list
    whole = center_lists.Grid(middle, np.full(1, -1e6), np.full(1, 1e-9), middle + 1, np.array([0, len(basis.centers)]),
                       np.arange(len(basis.centers)))  # fmt: skip
    every, listed = Refined(basis, whole), Refined(basis, grid)
    treed, reached = np.empty((QUERIES, basis.radial.shape[1])), np.empty(QUERIES, int)

    def by_tree() -> None:
        center_lists.cardinal_tree(points, basis.arrays, tree, treed)

    rbf, brute, by_grid, by_spheres = _least(
        [
            lambda: basis_weights(basis, queries),
            lambda: every.weights(queries),
            lambda: listed.weights(queries),
            by_tree,
        ]
    )
    center_lists.active(points, basis.arrays, reached)
    print(
        f"{count:8d}  {reached.mean():6.1f}  {rbf:6.3f}  {brute:6.3f}  {by_grid:6.3f}  {by_spheres:6.3f}"
        f"  {brute / by_grid:10.2f}  {brute / by_spheres:10.2f}  {len(grid.members):7d}"
    )


def _least(runs: list[Callable[[], object]]) -> list[float]:
    """Microseconds per query of each run: the least of rounds in which they take turns."""
    best = [np.inf] * len(runs)
    for _ in range(ROUNDS):
        for k, run in enumerate(runs):
            started = time.perf_counter()
            run()
            best[k] = min(best[k], time.perf_counter() - started)
    return [1e6 * seconds / QUERIES for seconds in best]


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
