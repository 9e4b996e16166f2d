"""Points of a verb's domain: grids, slices and random samples in its chart, with words that state them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64
from verbs.kernels import chart as charts
from verbs.verb import Domain, Verb

__all__ = ["Points", "Slice", "accuracy_points", "axis_names", "inside", "random_points", "slices"]

EDGE = 1e-9
"""Slack of the hull test, so that nodes on its surface count as inside."""

GRID_EDGE = 1.001
"""Grids take in nodes up to 0.1 % outside the hull: examples on a straight edge are rounded, nodes are not."""

_NAMES = {number: name for name, number in charts.CHARTS.items()}

_BENT = {charts.CYLINDER: ("angle", "height", "radius"), charts.PLANAR: ("left", "forward")}
"""Axes of bent charts: about, along and off a vertical axis; a jump over the ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Adverbs (B, D) to measure at, and a sentence that describes them."""

    adverbs: F64
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Slice:
    """A plane of the chart's bounding box, sampled on a grid.

    Parameters
    ----------
    adverbs : (m, n, D) float64
    inside : (m, n) bool
        Which nodes lie in the hull.
    text : str
        Which plane it is.
    axes : tuple of int
        The chart axes that span it.
    """

    adverbs: F64
    inside: npt.NDArray[np.bool_]
    text: str
    axes: tuple[int, int]


def inside(domain: Domain, points: F64, *, gauge: float = 1.0) -> npt.NDArray[np.bool_]:
    """Which normalised chart points (..., D) lie in the hull scaled by ``gauge`` about its middle."""
    return np.asarray(((points - domain.middle) @ domain.facets.T).max(axis=-1) <= gauge + EDGE)


def bounds(verb: Verb) -> tuple[F64, F64]:
    """Bounding box of the examples in normalised chart coordinates."""
    points = verb.domain.chart.points(verb.values)
    return points.min(axis=0), points.max(axis=0)


def describe(verb: Verb) -> str:
    """Words for the domain: "convex hull of the 35 examples in the identity chart"."""
    return f"convex hull of the {len(verb.examples)} examples in the {_NAMES[verb.domain.chart.kind]} chart"


def random_points(verb: Verb, rng: np.random.Generator, count: int, *, gauge: tuple[float, float] = (0.0, 1.0)) -> F64:
    """Adverbs (count, D), uniform in the chart, between two scalings of the hull (0 to 1: inside).

    Points are drawn from the scaled bounding box and kept where they fit. Where the hull fills little of its box
    (many dimensions), what is missing after a bounded number of draws is made of random means of the examples.
    """
    low, high = bounds(verb)
    middle, domain = verb.domain.middle, verb.domain
    kept: list[F64] = []
    found = 0
    for _ in range(400):
        points = middle + gauge[1] * (rng.uniform(low, high, (4 * count, len(low))) - middle)
        fits = inside(domain, points, gauge=gauge[1])
        if gauge[0] > 0:
            fits &= ~inside(domain, points, gauge=gauge[0])
        kept.append(points[fits])
        found += int(fits.sum())
        if found >= count:
            break
    if found < count:
        corners = (np.array([verb.values[:, a] for a in range(len(low))]).T,)
        mixes = rng.dirichlet(np.full(len(verb.examples), 0.3), count - found)
        return np.concatenate([domain.chart.adverbs(np.concatenate(kept)), mixes @ corners[0]])[:count]
    return domain.chart.adverbs(np.concatenate(kept)[:count])


def accuracy_points(verb: Verb, *, count: int = 3_000, seed: int = 1) -> Points:
    """Where parametric error is measured: a 41-node grid up to two adverbs, random points above."""
    dims = len(verb.adverbs)
    if dims > 2:
        adverbs = random_points(verb, np.random.default_rng(seed), count)
        return Points(adverbs, f"{len(adverbs)} uniform random points (seed {seed}) in the {describe(verb)}")
    low, high = bounds(verb)
    axes = [np.linspace(low[a], high[a], 41) for a in range(dims)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dims)
    nodes = nodes[inside(verb.domain, nodes, gauge=GRID_EDGE)]
    return Points(verb.domain.chart.adverbs(nodes), f"{'×'.join(['41'] * dims)} grid over the {describe(verb)}")


def axis_names(verb: Verb) -> list[str]:
    """What the axes of the domain's chart are, in the order of the adverbs: the adverbs' names where nothing bends."""
    chart, names = verb.domain.chart, [adverb.name for adverb in verb.adverbs]
    for axis, name in zip(chart.axes, _BENT.get(chart.kind, ()), strict=False):
        names[axis] = name
    return names


def slices(verb: Verb, nodes: int = 61) -> list[Slice]:
    """Planes through the chart's bounding box on which smoothness is measured, ``nodes`` to a side.

    Two adverbs: the whole plane. Three: across the last axis at 30, 50 and 70 % and across the others at 50 %.
    More: the planes of each pair of the first four axes, the others at 50 %. One adverb: a line.
    """
    dims = len(verb.adverbs)
    if dims <= 2:
        return [plane(verb, (0, dims - 1), [0.5] * dims, nodes)]
    if dims == 3:
        cuts = [((0, 1), 2, 0.3), ((0, 1), 2, 0.5), ((0, 1), 2, 0.7), ((0, 2), 1, 0.5), ((1, 2), 0, 0.5)]
        return [plane(verb, axes, [at if a == across else 0.5 for a in range(3)], nodes) for axes, across, at in cuts]
    pairs = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    return [plane(verb, pair, [0.5] * dims, nodes) for pair in pairs]


def plane(verb: Verb, axes: tuple[int, int], fractions: list[float], nodes: int) -> Slice:
    """Grid over the plane of two chart axes, the others fixed at fractions of their range."""
    low, high = bounds(verb)
    sides = (nodes, nodes if axes[0] != axes[1] else 1)
    points = np.broadcast_to(low + np.array(fractions) * (high - low), (*sides, len(low))).copy()
    points[..., axes[0]] = np.linspace(low[axes[0]], high[axes[0]], nodes)[:, None]
    if axes[0] != axes[1]:
        points[..., axes[1]] = np.linspace(low[axes[1]], high[axes[1]], nodes)[None]
    words = axis_names(verb)
    names = [words[a] for a in axes]
    fixed = [f"{words[a]} at {fractions[a]:.0%}" for a in range(len(low)) if a not in axes]
    text = " × ".join(dict.fromkeys(names)) + (f", {', '.join(fixed)}" if fixed else "")
    return Slice(verb.domain.chart.adverbs(points), inside(verb.domain, points), text, axes)
