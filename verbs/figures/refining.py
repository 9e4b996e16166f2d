"""Refinement runs that several figures and tables share: a built-in verb before, during and after."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from verbs import refine as refining
from verbs.blend.cardinal import basis_weights
from verbs.blend.refined import Hybrid
from verbs.blend.search import Search
from verbs.conventions import F64
from verbs.domain import accuracy_points, describe, random_points
from verbs.figures.study import Progress
from verbs.goal import Goal, diagonal
from verbs.verb import Basis, Verb

__all__ = ["CHECK", "Refinement", "errors", "hybrid_errors", "refinement", "weights_of"]

CHECK = 2_500
"""Random points, drawn from :data:`CHECK_SEED`, held out from refinement."""

CHECK_SEED = 7

MOST, QUICK_MOST = 100, 6


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """One verb refined with local and with global radii.

    Parameters
    ----------
    verb : Verb
    curves : mapping of str to (S, 3) float64
        By rule of the radii: pseudo-examples, mean and largest error (%) on the points where the worst was sought.
    bases : mapping of int to Basis
        Bases of the local rule by number of pseudo-examples.
    pseudo_adverbs : (P, D) float64
        Adverbs of the pseudo-examples, in order of insertion.
    sought, check : (B, D) float64
        Where the tables evaluate errors: the points of ``adverb measure``, and random points.
    size : float
        Diagonal that 100 % stands for, m.
    seconds : float
        Time of the local refinement.
    text : str
        Description of the points.
    """

    verb: Verb
    curves: Mapping[str, F64]
    bases: Mapping[int, Basis]
    pseudo_adverbs: F64
    sought: F64
    check: F64
    size: float
    seconds: float
    text: str


def refinement(verb: Verb, *, quick: bool, progress: Progress) -> Refinement:
    """Refine a verb with :data:`MOST` pseudo-examples by both rules; with few of them, and few points, if ``quick``."""
    most, count = (QUICK_MOST, 100) if quick else (MOST, CHECK)
    curves: dict[str, F64] = {}
    bases: dict[int, Basis] = {}
    pseudo_adverbs: list[F64] = []
    seconds = 0.0
    for rule in ("local", "global"):
        started, rows = time.perf_counter(), []
        for step in refining.refine(verb, refining.Rules(target_error=0.0, max_pseudo=most, seed=1, radii=rule)):
            rows.append((step.pseudo, 100 * step.after.mean, 100 * step.after.largest))
            progress(f"refining {verb.name}, {rule}", step.pseudo, most)
            if rule == "local":
                bases[step.pseudo] = step.basis
                pseudo_adverbs += [] if step.drawn is None else [step.drawn.adverbs]
        curves[rule] = np.array(rows)
        seconds = seconds or time.perf_counter() - started
    points, rng = accuracy_points(verb), np.random.default_rng(CHECK_SEED)
    sought = points.adverbs[:: 16 if quick else 1]
    where = describe(verb)
    text = f"{points.text}; check: {count:,} random points (seed {CHECK_SEED}) in the {where}"
    check = random_points(verb, rng, count)
    return Refinement(verb, curves, bases, np.array(pseudo_adverbs), sought, check, diagonal(verb), seconds, text)


def errors(verb: Verb, weights: F64, adverbs: F64) -> F64:
    """Error (B,), in % of the diagonal, of weights (B, N) at adverbs (B, D)."""
    goal = Goal.of_verb(verb)
    return np.asarray(100 * goal.compare(adverbs, goal.measured(weights))[1] / diagonal(verb))


def weights_of(one: Refinement, adverbs: F64, pseudo: int, searches: int) -> F64:
    """Weights (B, N) of the basis with ``pseudo`` pseudo-examples, after line searches."""
    basis = one.bases[pseudo]
    if searches == 0:
        return basis_weights(basis, adverbs)
    if pseudo == 0:
        return Search(basis, Goal.of_verb(one.verb), searches).weights(adverbs)
    held = replace(one.verb, bases={**one.verb.bases, "refined": basis})
    return Hybrid.of_verb(held, iterations=searches).weights(adverbs)


def hybrid_errors(one: Refinement, adverbs: F64, pseudo: int, searches: int) -> tuple[float, float]:
    """Mean and largest error, %, of :func:`weights_of`."""
    found = errors(one.verb, weights_of(one, adverbs, pseudo, searches), adverbs)
    return float(found.mean()), float(found.max())
