"""Where a verb is asked for: adverbs counted in cells, and points drawn from the cells.

What a server tells the store is ``{"cells": [{"adverbs": [D numbers], "weight": w}, …]}``: the middle of a box, with a
1/32 of each adverb's range to a side, and how often adverbs in it were asked for. Cells of several servers add up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.measure.domain import inside
from verbs.verb import Verb

__all__ = ["CELLS", "MAX_CELLS", "cells_of", "drawn"]

CELLS = 32
"""Cells to the range of an adverb."""

DRAWS = 20
"""Rounds of drawing, before what is missing is filled up with the points that there are."""


MAX_CELLS = 4096
"""Cells that a server tells of a verb: the most asked-for."""


def cells_of(verb: Verb, adverbs: F64) -> dict[str, Any]:
    """Count adverbs (B, D), as they were after clamping to the domain; what a server hands to the store."""
    low, side = _grid(verb)
    indices = np.clip(np.floor((adverbs - low) / side), 0, CELLS - 1)
    found, counts = np.unique(indices, axis=0, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:MAX_CELLS]
    cells = [{"adverbs": (low + (found[k] + 0.5) * side).tolist(), "weight": float(counts[k])} for k in order]
    return {"cells": cells}


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
