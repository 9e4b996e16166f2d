"""Where a verb is asked for: adverbs counted in cells, and points drawn from the cells.

What a server tells the store is ``{"cells": [{"adverbs": [D numbers], "weight": w}, …], "at_s": t}``: the middle of a
box, with a 1/32 of each adverb's range to a side, and how often adverbs in it were asked for. What was asked for
:data:`HALF_LIFE_S` ago counts half. Cells of several servers add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.domain import inside
from verbs.verb import Verb

__all__ = ["CELLS", "HALF_LIFE_S", "MAX_CELLS", "cells_of", "counted", "drawn", "together", "told"]

CELLS = 32
"""Cells to the range of an adverb."""

DRAWS = 20
"""Rounds of drawing, before what is missing is filled up with the points that there are."""

MAX_CELLS = 4096
"""Cells that a server tells of a verb: the most asked-for."""

MAX_NUMBERS = 40_000
"""Numbers of all these cells: the store keeps 1 MB of JSON."""

HALF_LIFE_S = 24 * 3600.0


def counted(verb: Verb, adverbs: F64, before: tuple[F64, F64] | None = None, *, faded: float = 1.0) -> tuple[F64, F64]:
    """Count adverbs (B, D), as they were after clamping to the domain.

    Parameters
    ----------
    verb : Verb
    adverbs : (B, D) float64
    before : tuple of arrays, optional
        What this function gave before; the new counts are added to it.
    faded : float
        What the earlier counts are multiplied by.

    Returns
    -------
    indices : (n, D) float64
        Cells, the most asked-for first; at most :data:`MAX_CELLS`.
    weights : (n,) float64
    """
    low, side = _grid(verb)
    indices, weights = np.clip(np.floor((adverbs - low) / side), 0, CELLS - 1), np.ones(len(adverbs))
    if before is not None:
        indices, weights = np.concatenate([before[0], indices]), np.concatenate([faded * before[1], weights])
    found, which = np.unique(indices, axis=0, return_inverse=True)
    sums: F64 = np.bincount(which.ravel(), weights, minlength=len(found)).astype(np.float64, copy=False)
    order = np.argsort(-sums, kind="stable")[: min(MAX_CELLS, MAX_NUMBERS // (adverbs.shape[1] + 1))]
    return found[order], sums[order]


def told(verb: Verb, indices: F64, weights: F64) -> dict[str, Any]:
    """What was counted, as a server hands it to the store."""
    low, side = _grid(verb)
    rows = zip((low + (indices + 0.5) * side).tolist(), weights.tolist(), strict=True)
    return {"cells": [{"adverbs": middle, "weight": weight} for middle, weight in rows]}


def cells_of(verb: Verb, adverbs: F64) -> dict[str, Any]:
    """Adverbs (B, D), counted and told."""
    return told(verb, *counted(verb, adverbs))


def together(rows: Iterable[Mapping[str, Any]], now_s: float) -> list[dict[str, Any]]:
    """Cells of all servers, each weighted by how long ago its server said so."""
    return [
        {**cell, "weight": cell["weight"] * 0.5 ** (max(now_s - row.get("at_s", now_s), 0.0) / HALF_LIFE_S)}
        for row in rows
        for cell in row.get("cells", ())
    ]


def drawn(verb: Verb, cells: Sequence[Mapping[str, Any]], rng: np.random.Generator, count: int) -> F64:
    """Adverbs (count, D) of the domain, drawn from cells by their weights and within a cell uniformly.

    Cells of another number of adverbs, without a positive weight or wholly outside the domain are passed over; (0, D)
    where none is left.
    """
    dims, (_, side) = len(verb.adverbs), _grid(verb)
    rows = [[*cell["adverbs"], cell["weight"]] for cell in cells if len(cell["adverbs"]) == dims]
    table = np.array(rows, np.float64).reshape(-1, dims + 1)
    table = table[np.isfinite(table).all(axis=1) & (table[:, -1] > 0.0)]
    none = np.empty((0, dims))
    if not len(table):
        return none
    middles, weights = table[:, :-1], table[:, -1]
    kept: list[F64] = []
    for _ in range(DRAWS):
        picked = middles[rng.choice(len(table), size=count, p=weights / weights.sum())]
        points = picked + side * rng.uniform(-0.5, 0.5, picked.shape)
        kept.append(points[inside(verb.domain, verb.domain.chart.points(points))])
        if sum(map(len, kept)) >= count:
            break
    found = np.concatenate(kept)
    return np.resize(found, (count, dims)) if len(found) else none


def _grid(verb: Verb) -> tuple[F64, F64]:
    """Least adverbs (D,) of the examples, and the sides (D,) of a cell."""
    low, high = verb.values.min(axis=0), verb.values.max(axis=0)
    return low, np.maximum((high - low) / CELLS, 1e-12)
