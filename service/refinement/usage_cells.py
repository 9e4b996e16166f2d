"""Grid cells of a verb's adverbs: counts of requests per cell, and points sampled from the cells.

A server stores ``{"cells": [{"adverbs": [D numbers], "weight": w}, …], "at_s": t}``: the centre of each cell, whose
sides are 1/32 of each adverb's range, and the number of requests inside it. The weight of a request halves every
:data:`HALF_LIFE_S`. Cells of several servers add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.domain import inside
from verbs.verb import Verb

__all__ = ["CELLS", "HALF_LIFE_S", "MAX_CELLS", "cells_json", "count_cells", "merge_cells", "sample_cells", "to_json"]

CELLS = 32
"""Cells per range of an adverb."""

MAX_ROUNDS = 20
"""Rounds of rejection sampling; points that are still missing then are filled with copies of those found."""

MAX_CELLS = 4096
"""Largest number of cells of a verb that a server stores: those with the largest weights."""

MAX_NUMBERS = 40_000
"""Largest number of floats in all these cells: the store takes 1 MB of JSON."""

HALF_LIFE_S = 24 * 3600.0


def count_cells(
    verb: Verb, adverbs: F64, before: tuple[F64, F64] | None = None, *, decay: float = 1.0
) -> tuple[F64, F64]:
    """Count adverbs (B, D), clamped to the domain, per cell.

    Parameters
    ----------
    verb : Verb
    adverbs : (B, D) float64
    before : tuple of arrays, optional
        Earlier result of this function; the new counts are added to it.
    decay : float
        Factor on the earlier counts.

    Returns
    -------
    indices : (n, D) float64
        Cells by decreasing weight; at most :data:`MAX_CELLS`.
    weights : (n,) float64
    """
    low, side = _grid(verb)
    indices, weights = np.clip(np.floor((adverbs - low) / side), 0, CELLS - 1), np.ones(len(adverbs))
    if before is not None:
        indices, weights = np.concatenate([before[0], indices]), np.concatenate([decay * before[1], weights])
    found, which = np.unique(indices, axis=0, return_inverse=True)
    sums: F64 = np.bincount(which.ravel(), weights, minlength=len(found)).astype(np.float64, copy=False)
    order = np.argsort(-sums, kind="stable")[: min(MAX_CELLS, MAX_NUMBERS // (adverbs.shape[1] + 1))]
    return found[order], sums[order]


def to_json(verb: Verb, indices: F64, weights: F64) -> dict[str, Any]:
    """Cells as JSON values, for the store."""
    low, side = _grid(verb)
    rows = zip((low + (indices + 0.5) * side).tolist(), weights.tolist(), strict=True)
    return {"cells": [{"adverbs": center, "weight": weight} for center, weight in rows]}


def cells_json(verb: Verb, adverbs: F64) -> dict[str, Any]:
    """Cells of adverbs (B, D) as JSON values."""
    return to_json(verb, *count_cells(verb, adverbs))


def merge_cells(rows: Iterable[Mapping[str, Any]], now_s: float) -> list[dict[str, Any]]:
    """Cells of all servers, with weights that decay since each server stored them."""
    return [
        {**cell, "weight": cell["weight"] * 0.5 ** (max(now_s - row.get("at_s", now_s), 0.0) / HALF_LIFE_S)}
        for row in rows
        for cell in row.get("cells", ())
    ]


def sample_cells(verb: Verb, cells: Sequence[Mapping[str, Any]], rng: np.random.Generator, count: int) -> F64:
    """Sample adverbs (count, D) of the domain: cells by their weights, and uniformly within a cell.

    Skips cells with another number of adverbs, without a positive weight or wholly outside the domain; returns (0, D)
    if no cell is left.
    """
    dims, (_, side) = len(verb.adverbs), _grid(verb)
    rows = [[*cell["adverbs"], cell["weight"]] for cell in cells if len(cell["adverbs"]) == dims]
    table = np.array(rows, np.float64).reshape(-1, dims + 1)
    table = table[np.isfinite(table).all(axis=1) & (table[:, -1] > 0.0)]
    none = np.empty((0, dims))
    if not len(table):
        return none
    centers, weights = table[:, :-1], table[:, -1]
    kept: list[F64] = []
    for _ in range(MAX_ROUNDS):
        picked = centers[rng.choice(len(table), size=count, p=weights / weights.sum())]
        points = picked + side * rng.uniform(-0.5, 0.5, picked.shape)
        kept.append(points[inside(verb.domain, verb.domain.chart.points(points))])
        if sum(map(len, kept)) >= count:
            break
    found = np.concatenate(kept)
    return np.resize(found, (count, dims)) if len(found) else none


def _grid(verb: Verb) -> tuple[F64, F64]:
    """Smallest adverbs (D,) of the examples, and sides (D,) of a cell."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    return low, np.maximum((high - low) / CELLS, 1e-12)
