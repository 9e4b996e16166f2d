"""One evaluation per verb and method, shared by all figures and tables of seed 2."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from verbs import refine as refining
from verbs.authoring.basis import cardinal, smooth
from verbs.authoring.fit import build
from verbs.blend.methods import METHODS, usable
from verbs.conventions import F64
from verbs.domain import Points, Slice, accuracy_points, describe, plane, random_points
from verbs.figures.canvas import SHOWN
from verbs.goal import diagonal
from verbs.quality.report import Quality, quality_of
from verbs.quality.smoothness import curvature
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["MOCAP", "Progress", "Study", "found", "study"]

Progress = Callable[[str, int, int], None]
"""Called with a stage, the steps done, and the number of steps."""

MOCAP = ("reach", "punch", "kick", "jump", "locomotion")
"""Verbs of seed 2, in its order."""

SOLVED = {"rbf": "rbf", "search": "rbf", "refined": "refined", "hybrid": "refined", "corrected": "smooth"}
"""Basis of the methods that use one solved in advance; the others solve their own, or need none."""

NODES, QUICK_NODES = 61, 13
PSEUDO, QUICK_PSEUDO = 100, 4


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Quality of every method on one verb.

    Parameters
    ----------
    verb : Verb
        With a refined basis.
    figures : mapping of str to Quality
        By method.
    section : Slice
        The plane of the maps.
    errors, curvatures : mapping of str to (m, n) float64
        Maps of the shown methods; NaN outside the hull.
    size : float
        Diagonal that 100 % stands for, in the measure's unit.
    pseudo : int
        Pseudo-examples of the refined basis.
    """

    verb: Verb
    figures: Mapping[str, Quality]
    section: Slice
    errors: Mapping[str, F64]
    curvatures: Mapping[str, F64]
    size: float
    pseudo: int


def found(data: Path) -> list[Verb]:
    """Build the verbs of seed 2 that a folder contains."""
    return [build(data / name).verb for name in MOCAP if (data / name / "verb.toml").is_file()]


def study(verb: Verb, *, quick: bool, progress: Progress) -> Study:
    """Refine a verb and evaluate every method on it.

    Parameters
    ----------
    verb : Verb
    quick : bool
        Coarse grids, few points, few pseudo-examples.
    progress : callable
    """
    rules = refining.Rules(target_error=1e-3, max_pseudo=QUICK_PSEUDO if quick else PSEUDO, seed=1)
    started = time.perf_counter()
    step = list(refining.refine(verb, rules))[-1]
    held = refining.with_basis(verb, step.basis, rules, step.mark)
    prepared = _solving_s(held, time.perf_counter() - started)
    nodes, points = NODES, accuracy_points(held)
    if quick:
        nodes, count = QUICK_NODES, 200
        adverbs = random_points(held, np.random.default_rng(1), count)
        points = Points(adverbs, f"{count} random points (seed 1) in the {describe(held)}")
    names = [name for name in METHODS if name in usable(held)]
    rows: dict[str, Quality] = {}
    for k, name in enumerate(names):
        progress(f"quality of {held.name}", k, len(names))
        row = quality_of(held, name, nodes=nodes, points=points)
        rows[name] = replace(row, precompute_s=row.precompute_s + (prepared[SOLVED[name]] if name in SOLVED else 0))
    progress(f"quality of {held.name}", len(names), len(names))
    section, evaluator = _section(held, nodes), Evaluator(held)
    maps = {name: _maps(evaluator, section, name) for name in SHOWN if name in rows}
    errors, bends = ({name: pair[k] for name, pair in maps.items()} for k in (0, 1))
    return Study(held, rows, section, errors, bends, diagonal(held), step.pseudo)


def _solving_s(verb: Verb, refining_s: float) -> dict[str, float]:
    """Seconds to solve each basis: a build does it once, and a comparison of methods counts it."""
    started = time.perf_counter()
    cardinal(verb.bases["rbf"].chart, verb.values)
    between = time.perf_counter()
    smooth(verb.bases["smooth"].chart, verb.values)
    return {"rbf": between - started, "smooth": time.perf_counter() - between, "refined": refining_s}


def _section(verb: Verb, nodes: int) -> Slice:
    """Middle plane of the first two chart axes; the paper's maps fix the third in mid-range, as this does."""
    dims = len(verb.adverbs)
    return plane(verb, (0, min(1, dims - 1)), [0.5] * dims, nodes)


def _maps(evaluator: Evaluator, section: Slice, method: str) -> tuple[F64, F64]:
    """Error (m, n), in the measure's unit, and κ (m, n) over a slice."""
    blend = evaluator.blend(section.adverbs.reshape(-1, section.adverbs.shape[-1]), method=method)
    error = np.where(section.inside, blend.error.reshape(section.inside.shape), np.nan)
    return error, curvature(blend.weights.reshape(*section.inside.shape, -1), section.inside)
