"""Smoothness of blending weights: the curvature κ of the weights over grids of adverbs.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 4.1:
κ = |Σ_ab (w_xy − w_{x+a,y+b})| / 8 over the eight neighbours of a node. It scales with the square of the grid's
spacing, so values compare only on the same grid.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.domain import Slice, bounds, inside, slices
from verbs.runtime.evaluate import Evaluator

__all__ = ["curvature", "slice_curvature", "smoothness", "zoom_ratios"]


def curvature(weights: F64, inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> F64:
    """κ (m, n) of weights (m, n, N); NaN at nodes of which not all neighbours lie inside.

    A line (n = 1) has two neighbours to a node instead of eight.
    """
    out = np.full(inside.shape, np.nan)
    if inside.shape[1] == 1:
        bend = weights[1:-1] - 0.5 * (weights[2:] + weights[:-2])
        fits = inside[1:-1] & inside[2:] & inside[:-2]
        out[1:-1][fits] = np.linalg.norm(bend, axis=-1)[fits]
        return out
    total, fits = np.zeros(weights[1:-1, 1:-1].shape), inside[1:-1, 1:-1].copy()
    rows, columns = inside.shape
    for a in (0, 1, 2):
        for b in (0, 1, 2):
            total += weights[a : rows - 2 + a, b : columns - 2 + b]
            fits &= inside[a : rows - 2 + a, b : columns - 2 + b]
    # nine nodes were summed, the middle one too: 8·w − Σ of eight = 9·w − Σ of nine
    bend = np.linalg.norm(9.0 * weights[1:-1, 1:-1] - total, axis=-1) / 8.0
    out[1:-1, 1:-1][fits] = bend[fits]
    return out


def smoothness(evaluator: Evaluator, method: str, *, nodes: int = 61) -> tuple[float, float, str]:
    """Mean and maximum of κ over the verb's slices, and a description of the grid."""
    planes = slices(evaluator.verb, nodes)
    values = np.concatenate([slice_curvature(evaluator, method, one).ravel() for one in planes])
    values = values[np.isfinite(values)]
    text = f"{len(planes)} slices of {nodes}×{nodes} nodes: " + "; ".join(one.text for one in planes)
    if not len(values):
        return float("nan"), float("nan"), text
    return float(values.mean()), float(values.max()), text


def slice_curvature(evaluator: Evaluator, method: str, one: Slice) -> F64:
    """κ (m, n) over one slice."""
    flat = one.adverbs.reshape(-1, one.adverbs.shape[-1])
    weights = evaluator.blend(flat, method=method).weights
    return curvature(weights.reshape(*one.inside.shape, -1), one.inside)


def zoom_ratios(evaluator: Evaluator, method: str, *, nodes: int = 61, halvings: int = 5) -> list[float]:
    """Ratios of successive maxima of κ as the grid is halved around the largest.

    The node of largest κ over all slices is found; then the spacing is halved ``halvings`` times on a 13×13 grid about
    the latest maximum. Twice differentiable weights tend to 4, kinks to 2, jumps to 1.
    """
    verb, best = evaluator.verb, (-1.0, np.zeros(0), np.zeros((2, 0)))
    low, high = bounds(verb)
    for one in slices(verb, nodes):
        values = slice_curvature(evaluator, method, one)
        if np.isfinite(values).any() and np.nanmax(values) > best[0]:
            node = np.unravel_index(np.nanargmax(values), values.shape)
            sides = np.zeros((2, len(low)))
            for side, axis in enumerate(one.axes):
                sides[side, axis] = (high[axis] - low[axis]) / (nodes - 1)
            point = verb.domain.chart.points(one.adverbs[node][None])[0]
            best = (float(np.nanmax(values)), point, sides)
    top, centre, sides = best
    ratios = []
    for _ in range(halvings):
        sides = 0.5 * sides
        steps = np.arange(-6, 7)
        grid = centre + steps[:, None, None] * sides[0] + steps[None, :, None] * sides[1]
        weights = evaluator.blend(verb.domain.chart.adverbs(grid).reshape(-1, len(low)), method=method).weights
        values = curvature(weights.reshape(13, 13, -1), inside(verb.domain, grid))
        node = np.unravel_index(np.nanargmax(values), values.shape)
        ratios.append(top / float(values[node]))
        top, centre = float(values[node]), grid[node]
    return ratios
