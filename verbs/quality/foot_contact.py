"""Foot slide and penetration: how far points of the feet move while they stand, and how deep they go.

When a point stands is part of the verb (:mod:`verbs.contacts`): the contact of the examples, blended like the pose. A
detector run on the blend itself would miss a foot that slides fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from verbs.authoring import contact_detection
from verbs.contacts import Contacts
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.kernels import contacts as kernels
from verbs.kernels.compile import direct
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.runtime.ground import from_ground
from verbs.runtime.whole_motion import MIDDLE, RATE_HZ, examples, one_of, sampled, sampled_rotations
from verbs.verb import Verb

__all__ = ["GOALS", "GOALS_SEED", "NONE", "RATE_HZ", "Slides", "by_example", "contacts", "example_slides", "examples",
           "goals", "of_frames", "sampled", "slide_rows", "slides", "standing"]  # fmt: skip

GOALS, GOALS_SEED = 60, 3
"""Number of random goals in the domain whose motions are evaluated, and their seed."""

_contact, _heights = direct(kernels.contact), direct(kernels.heights)


@dataclass(frozen=True, slots=True)
class Slides:
    """How far points of the feet slide while they stand, and how deep they go.

    The slide of a stance is the largest distance over the ground of the point from its mean position in that stance.
    The penetration is the largest depth of a point below its standing height, at any time.

    Parameters
    ----------
    stances : int
        Number of stances; the slides are NaN where there are none.
    median_m, p90_m, max_m : float
        Median, 90th percentile and largest slide of all stances, metres.
    penetration_m : float
        Metres; NaN if not evaluated.
    """

    stances: int
    median_m: float
    p90_m: float
    max_m: float
    penetration_m: float = np.nan

    @classmethod
    def of(cls, found: F64, penetration_m: float = np.nan) -> Slides:
        """Summary of the slides (S,) of all stances, metres."""
        if not len(found):
            return cls(0, np.nan, np.nan, np.nan, penetration_m)
        median, high, largest = np.percentile(found, (50.0, 90.0, 100.0))
        return cls(len(found), float(median), float(high), float(largest), penetration_m)


NONE = Slides(0, np.nan, np.nan, np.nan)
"""No stance, or not evaluated."""


def contacts(evaluator: Evaluator) -> Contacts | None:
    """Contacts of a verb: its own, or those found now in a verb that was stored without; None where there are none."""
    return evaluator.verb.contacts or contact_detection.find(evaluator.verb)


def example_slides(evaluator: Evaluator, found: Contacts) -> Slides:
    """Slides of the examples themselves."""
    return _summary(evaluator, found, examples(evaluator))


def by_example(evaluator: Evaluator, found: Contacts) -> list[Slides]:
    """Slides of each example."""
    return [_summary(evaluator, found, [blend]) for blend in examples(evaluator)]


def slide_rows(verb: Verb) -> list[dict[str, Any]]:
    """Slide and penetration of each example, metres, as JSON values; empty where a verb has no contacts."""
    if verb.contacts is None:
        return []
    found = by_example(Evaluator(verb), verb.contacts)
    return [
        {
            "example": name,
            "stances": one.stances,
            "slide_p90_m": one.p90_m if one.stances else None,
            "slide_max_m": one.max_m if one.stances else None,
            "penetration_m": one.penetration_m,
        }
        for name, one in zip(verb.examples, found, strict=True)
    ]


def slides(
    evaluator: Evaluator, found: Contacts, adverbs: F64, *, method: str | None = None, plant: bool = False
) -> Slides:
    """Slides of the whole motions at adverbs (B, D), by a method, with planted feet or as they are blended."""
    blends = evaluator.blend(adverbs, method=method)
    return _summary(evaluator, found, [one_of(blends, k) for k in range(len(adverbs))], plant=plant)


def goals(verb: Verb) -> F64:
    """Adverbs (60, D) of random goals in the domain, the same every time."""
    return random_points(verb, np.random.default_rng(GOALS_SEED), GOALS)


def _summary(evaluator: Evaluator, found: Contacts, blends: list[Blend], *, plant: bool = False) -> Slides:
    parts = [_of_motion(evaluator, found, blend, plant=plant) for blend in blends]
    return Slides.of(np.concatenate([distances for distances, _ in parts]), max(depth for _, depth in parts))


def _of_motion(evaluator: Evaluator, found: Contacts, blend: Blend, *, plant: bool) -> tuple[F64, float]:
    """Slide (S,) of every stance of a motion, and the largest depth, metres."""
    phases, rotations, positions = sampled_rotations(evaluator, blend, plant=plant)
    rotations, positions = from_ground(evaluator, blend, phases, rotations, positions)
    return of_frames(found, blend.weights[0], phases, rotations, positions, looping=evaluator.verb.looping)


def standing(found: Contacts, weights: F64, phases: F64, *, looping: bool) -> tuple[F64, F64]:
    """Contact (F, P) of one blend at phases (F,), and heights (P,) of its points while they stand, metres."""
    rows = np.ascontiguousarray(np.broadcast_to(weights, (len(phases), len(weights))))
    share, heights = np.empty((len(phases), len(found))), np.empty((1, len(found)))
    _contact(rows, phases, found.values, looping, share)
    _heights(rows[:1], found.heights, heights)
    return share, heights[0]


def of_frames(
    found: Contacts, weights: F64, phases: F64, rotations: F64, positions: F64, *, looping: bool
) -> tuple[F64, float]:
    """Slide (S,) of every stance of one blend, and the largest depth, metres.

    Parameters
    ----------
    found : Contacts
    weights : (N,) float64
    phases : (F,) float64
    rotations : (F, J, 4) float64
        Global rotations at 60 Hz, over level ground.
    positions : (F, J, 3) float64
    looping : bool
    """
    share, heights = standing(found, weights, phases, looping=looping)
    distances, deepest = [], 0.0
    for p in range(len(found)):
        path = contact_detection.point_positions(rotations, positions, int(found.joints[p]), found.offsets[p])
        deepest = max(deepest, float((heights[p] - path[:, 1]).max()))
        distances += _distances(phases, path, share[:, p] > 0.5, looping=looping)
    return np.array(distances), deepest


def _distances(phases: F64, path: F64, standing: npt.NDArray[np.bool_], *, looping: bool) -> list[float]:
    """Slide of every stance of a path (F, 3), metres; of a loop, of those that begin in its middle cycle."""
    found = []
    for first, last in contact_detection.runs(standing):
        frames = np.arange(first, last)
        if looping:
            cycles = phases[frames] // 1.0
            endless = first == 0 and cycles[-1] > MIDDLE
            frames = frames[cycles == MIDDLE] if endless else frames[: len(frames) * (cycles[0] == MIDDLE)]
        if len(frames):
            over = path[frames][:, [0, 2]]
            found.append(float(np.linalg.norm(over - over.mean(axis=0), axis=1).max()))
    return found
