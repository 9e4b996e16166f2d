"""The figures of one method on one verb: error, smoothness, time."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from math import isnan

import numpy as np

from verbs.blend import methods
from verbs.evaluate import Evaluator
from verbs.measure.domain import Points, accuracy_points
from verbs.measure.smoothness import smoothness
from verbs.verb import Verb

__all__ = ["Figures", "diagonal", "measure"]


@dataclass(frozen=True, slots=True)
class Figures:
    """What ``adverb measure`` prints for one method.

    Errors are distances, in metres (speeds: m/s) and in percent of the diagonal of the examples' bounding box in the
    space of goals; κ is dimensionless and belongs to its grid; ``query_us`` is the least of several runs.
    """

    method: str
    error_mean_m: float
    error_max_m: float
    error_mean_pct: float
    error_max_pct: float
    smoothness: float
    smoothness_max: float
    weight_sum_max: float
    precompute_s: float
    query_us: float
    samples: int
    domain: str
    grid: str

    def as_dict(self) -> dict[str, str | int | float | None]:
        """JSON values; a figure that does not exist is null."""
        return {
            key: None if isinstance(value, float) and isnan(value) else value for key, value in asdict(self).items()
        }


def diagonal(verb: Verb) -> float:
    """Diagonal of the examples' bounding box in the space of goals, in the measure's unit."""
    points = Evaluator(verb).goal.points(verb.values)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def measure(verb: Verb, method: str, *, nodes: int = 61, points: Points | None = None) -> Figures:
    """Measure a method on a verb.

    Parameters
    ----------
    verb : Verb
    method : str
    nodes : int
        Nodes to a side of the slices on which smoothness is measured.
    points : Points, optional
        Where to measure the error; by default :func:`accuracy_points`.
    """
    where = points or accuracy_points(verb)
    started = time.perf_counter()
    methods.make(method, verb)
    precompute = time.perf_counter() - started
    evaluator = Evaluator(verb)
    blend = evaluator.blend(where.adverbs, method=method)
    mean, top, grid = smoothness(evaluator, method, nodes=nodes)
    measurable, size = evaluator.goal.measurable, diagonal(verb)
    error_mean, error_max = (blend.error.mean(), blend.error.max()) if measurable else (np.nan, np.nan)
    return Figures(
        method=method,
        error_mean_m=float(error_mean),
        error_max_m=float(error_max),
        error_mean_pct=float(100 * error_mean / size),
        error_max_pct=float(100 * error_max / size),
        smoothness=mean,
        smoothness_max=top,
        weight_sum_max=float(np.abs(blend.weights).sum(axis=1).max()),
        precompute_s=precompute,
        query_us=_query_us(evaluator, method, where),
        samples=len(where.adverbs),
        domain=where.text,
        grid=grid,
    )


def _query_us(evaluator: Evaluator, method: str, points: Points) -> float:
    """Microseconds per query of weights, in a batch of up to 256; the least of 7 runs."""
    _, chosen = evaluator.method(method)
    batch = np.ascontiguousarray(points.adverbs[:256])
    best = np.inf
    for _ in range(7):
        started = time.perf_counter()
        chosen.weights(batch)
        best = min(best, time.perf_counter() - started)
    return float(1e6 * best / len(batch))
