"""Maps of quality over a plane of adverbs: error, curvature κ of the weights, and support by the examples.

Source: Feng, Huang, Kallmann, Shapiro 2012, figures 3 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64
from verbs.domain import inside
from verbs.errors import OutOfRange, RequestError
from verbs.quality.smoothness import curvature
from verbs.runtime.evaluate import Evaluator

__all__ = ["MOST_NODES", "Map", "over"]

MOST_NODES = 101


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """Error, smoothness and support of a method over a plane.

    Parameters
    ----------
    method : str
    across, up : str
        Adverbs of the axes; equal where the verb has one adverb.
    held : dict of str to float
        The other adverbs.
    rows, columns : (m,), (n,) float64
        Values of ``up`` and of ``across``; one row where they are the same adverb.
    inside : (m, n) bool
        Which nodes lie in the domain.
    error : (m, n) float64
        In the measure's unit; NaN where nothing is measured.
    smoothness : (m, n) float64
        κ, which scales with the square of the spacing; NaN at nodes whose neighbours do not all lie inside.
    support : (m, n) float64
        How well the examples support the blend, 0 to 1.
    """

    method: str
    across: str
    up: str
    held: dict[str, float]
    rows: F64
    columns: F64
    inside: npt.NDArray[np.bool_]
    error: F64
    smoothness: F64
    support: F64


def over(
    evaluator: Evaluator,
    *,
    method: str | None = None,
    across: str | None = None,
    up: str | None = None,
    held: Mapping[str, float] | None = None,
    nodes: int = 41,
) -> Map:
    """Evaluate a method on a grid over two adverbs.

    Parameters
    ----------
    evaluator : Evaluator
    method : str, optional
        Default: the verb's.
    across, up : str, optional
        Adverbs of the axes. Default: the first ones that are not held.
    held : mapping, optional
        Values of the other adverbs. Default: the middle of the examples' range.
    nodes : int
        To a side, 3 to :data:`MOST_NODES`.

    Raises
    ------
    UnknownName
        An adverb or a method that does not exist.
    RequestError
        Both axes are one adverb, an adverb of an axis is held, or a number is out of range.
    """
    if not 3 <= nodes <= MOST_NODES:
        raise OutOfRange(f"nodes is {nodes}; it must lie between 3 and {MOST_NODES}")
    verb = evaluator.verb
    first, second = _axes(evaluator, across, up, held or {})
    values = _held(evaluator, held or {}, (first, second))
    line = first == second
    columns = np.linspace(verb.adverbs[first].minimum, verb.adverbs[first].maximum, nodes)
    rows = np.linspace(verb.adverbs[second].minimum, verb.adverbs[second].maximum, nodes)[: 1 if line else None]
    grid = np.broadcast_to(values, (len(rows), nodes, len(values))).copy()
    if not line:
        grid[..., second] = rows[:, None]
    grid[..., first] = columns
    fits = inside(verb.domain, verb.domain.chart.points(grid))
    blend = evaluator.blend(grid.reshape(-1, len(values)), method=method)
    weights = blend.weights.reshape(len(rows), nodes, -1)
    bend = curvature(weights[0][:, None], fits[0][:, None]).T if line else curvature(weights, fits)
    names = [adverb.name for adverb in verb.adverbs]
    others = {name: float(values[k]) for k, name in enumerate(names) if k not in (first, second)}
    error, support = (
        np.where(fits, values.reshape(fits.shape), np.nan) for values in (blend.error, evaluator.support(blend))
    )
    return Map(blend.method, names[first], names[second], others, rows, columns, fits, error, bend, support)


def _axes(evaluator: Evaluator, across: str | None, up: str | None, held: Mapping[str, float]) -> tuple[int, int]:
    verb = evaluator.verb
    given = [None if name is None else verb.adverb_index(name) for name in (across, up)]
    if len(verb.adverbs) == 1:
        return 0, 0
    if given[0] is not None and given[0] == given[1]:
        raise RequestError(f"both axes are adverb '{across}'; choose two")
    free = [k for k, adverb in enumerate(verb.adverbs) if k not in given and adverb.name not in held]
    if len(free) < given.count(None):
        raise RequestError("too many adverbs are held; leave two for the axes")
    first = free.pop(0) if given[0] is None else given[0]
    return first, free.pop(0) if given[1] is None else given[1]


def _held(evaluator: Evaluator, held: Mapping[str, float], axes: tuple[int, int]) -> F64:
    """All adverbs (D,); those of the axes are placeholders."""
    verb = evaluator.verb
    values = np.array([0.5 * (adverb.minimum + adverb.maximum) for adverb in verb.adverbs])
    for name, value in held.items():
        index = verb.adverb_index(name)
        if index in axes:
            raise RequestError(f"adverb '{name}' is an axis of the map; it cannot be held")
        values[index] = value
    evaluator.check(values[None])
    return values
