"""Quality of one method on one verb: error, smoothness, support, time."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from math import isnan

import numpy as np

from verbs.authoring import basis
from verbs.blend import methods
from verbs.conventions import F64
from verbs.domain import Points, accuracy_points, random_points
from verbs.goal import diagonal
from verbs.quality import foot_contact
from verbs.quality.smoothness import smoothness, zoom_ratios
from verbs.runtime.evaluate import Evaluator
from verbs.units import quantity
from verbs.verb import Verb

__all__ = ["Quality", "quality_of", "recommend"]

OUTSIDE_SEED = 2


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of one method: the fields of ``adverb measure --json``.

    Errors are distances, in metres (speeds: m/s) and in percent of the diagonal of the examples' bounding box in the
    space of goals; ``error_outside`` is taken between the hull and the hull grown by a tenth. κ is dimensionless and
    belongs to its grid; ``zoom_ratio`` is the least ratio of its last two halvings around its maximum: 4 where weights
    are twice differentiable, 2 at kinks, 1 at jumps. ``precompute_s`` counts from the examples; ``query_us`` is the
    least of several runs. ``support`` is that of :class:`verbs.runtime.support.Support`, where the error is measured.
    Slides of feet are those of :mod:`verbs.quality.foot_contact`; NaN if not requested, or without toes.
    """

    method: str
    error_mean_m: float
    error_max_m: float
    error_mean_pct: float
    error_max_pct: float
    smoothness: float
    smoothness_max: float
    weight_sum_max: float
    error_outside_mean_m: float
    error_outside_max_m: float
    zoom_ratio: float
    precompute_s: float
    query_us: float
    samples: int
    domain: str
    grid: str
    support_mean: float = float("nan")
    support_min: float = float("nan")
    slide_median_m: float = float("nan")
    slide_p90_m: float = float("nan")
    slide_max_m: float = float("nan")

    def as_dict(self) -> dict[str, str | int | float | None]:
        """JSON values; a value that does not exist is null."""
        return {
            key: None if isinstance(value, float) and isnan(value) else value for key, value in asdict(self).items()
        }


def quality_of(
    verb: Verb,
    method: str,
    *,
    nodes: int = 61,
    points: Points | None = None,
    zoom: bool = True,
    slide: bool = False,
) -> Quality:
    """Evaluate the quality of a method on a verb.

    Parameters
    ----------
    verb : Verb
    method : str
    nodes : int
        Nodes on a side of the slices on which smoothness is evaluated.
    points : Points, optional
        Where the error is evaluated; by default :func:`accuracy_points`.
    zoom : bool
        Whether to evaluate ``zoom_ratio``, which takes as long as all the rest.
    slide : bool
        Whether to evaluate foot slide.
    """
    where, evaluator = points or accuracy_points(verb), Evaluator(verb)
    blend = evaluator.blend(where.adverbs, method=method)
    mean, top, grid = smoothness(evaluator, method, nodes=nodes)
    support = evaluator.support(blend)
    size, slides = diagonal(verb), _slides(evaluator, method) if slide else foot_contact.NONE
    error_mean, error_max = _mean_and_max(evaluator, blend.error)
    around = random_points(verb, np.random.default_rng(OUTSIDE_SEED), len(where.adverbs), gauge=(1.0, 1.1))
    outside = _mean_and_max(evaluator, evaluator.blend(around, method=method).error)
    return Quality(
        method=method,
        error_mean_m=float(error_mean),
        error_max_m=float(error_max),
        error_mean_pct=float(100 * error_mean / size),
        error_max_pct=float(100 * error_max / size),
        smoothness=mean,
        smoothness_max=top,
        weight_sum_max=float(np.abs(blend.weights).sum(axis=1).max()),
        error_outside_mean_m=outside[0],
        error_outside_max_m=outside[1],
        zoom_ratio=min(zoom_ratios(evaluator, method, nodes=nodes)[-2:]) if zoom else float("nan"),
        precompute_s=_precompute_s(verb, method),
        query_us=_query_us(evaluator, method, where),
        samples=len(where.adverbs),
        domain=where.text,
        grid=grid,
        support_mean=float(support.mean()),
        support_min=float(support.min()),
        slide_median_m=slides.median_m,
        slide_p90_m=slides.p90_m,
        slide_max_m=slides.max_m,
    )


def _slides(evaluator: Evaluator, method: str) -> foot_contact.Slides:
    """Slides of feet by a method; none where there are no toes."""
    found = foot_contact.contacts(evaluator)
    return (
        foot_contact.NONE
        if found is None
        else foot_contact.slides(evaluator, found, foot_contact.goals(evaluator.verb), method=method)
    )


def _mean_and_max(evaluator: Evaluator, error: F64) -> tuple[float, float]:
    if not evaluator.goal.measurable:
        return float("nan"), float("nan")
    return float(error.mean()), float(error.max())


def _precompute_s(verb: Verb, method: str) -> float:
    """Seconds from the examples' adverbs to a method that is ready, kernels being compiled; the least of three."""
    best = np.inf
    for _ in range(3):
        started = time.perf_counter()
        if method == "corrected":
            basis.smooth(verb.bases["smooth"].chart, verb.values)
        elif method in ("rbf", "search"):
            basis.cardinal(verb.bases["rbf"].chart, verb.values)
        methods.make(method, verb)
        best = min(best, time.perf_counter() - started)
    return float(best)


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


def recommend(rows: list[Quality], unit: str = "m") -> str:
    """Recommend a method, with reasons, from the quality of at least one method.

    Among the methods whose weights do not jump (zoom ratio of at least 3), those whose largest error is within a factor
    of two of the smallest count; the smoothest of them is recommended. Where every method jumps, all count.
    """
    steady = [row for row in rows if row.zoom_ratio >= 3.0 or np.isnan(row.zoom_ratio)] or rows
    if np.isnan(steady[0].error_max_m):
        best = min(steady, key=lambda row: row.smoothness)
        return (
            f"Use {best.method}: nothing can be measured, and its weights are the smoothest (κ {best.smoothness:.2e})."
        )
    least = min(row.error_max_m for row in steady)
    best = min((row for row in steady if row.error_max_m <= 2.0 * least), key=lambda row: row.smoothness)
    reasons = [f"its largest error is {quantity(best.error_max_m, unit, 2)} and its weights do not jump"]
    smoothest = min(rows, key=lambda row: row.smoothness)
    if smoothest.method != best.method:
        kappas = f"κ {smoothest.smoothness:.2e} against {best.smoothness:.2e}"
        reasons.append(
            f"{smoothest.method} is smoother ({kappas}), its error up to {quantity(smoothest.error_max_m, unit, 2)}"
        )
    fastest = min(rows, key=lambda row: row.query_us)
    if fastest.method != best.method:
        ratio = best.query_us / fastest.query_us
        reasons.append(
            f"{fastest.method} is {ratio:.0f}× faster, its mean error {quantity(fastest.error_mean_m, unit, 2)}"
        )
    return f"Use {best.method}: {'; '.join(reasons)}."
