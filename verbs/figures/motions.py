"""Whole motions of examples and of blends by each method: foot slide, peak acceleration and peak speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.figures.study import Progress
from verbs.quality import foot_contact
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.verb import Verb

__all__ = ["EXAMPLES", "METHODS", "Motions", "Peaks", "motions"]

METHODS = ("rbf", "barycentric", "corrected")

EXAMPLES = "examples"
"""Key of the examples themselves beside those of methods."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """Peaks of whole motions at 60 Hz: median and largest of the motions.

    Parameters
    ----------
    acceleration_median_m_s2, acceleration_max_m_s2 : float
        Of the joint that accelerates most.
    speed_median_m_s, speed_max_m_s : float
        Of the effector.
    """

    acceleration_median_m_s2: float
    acceleration_max_m_s2: float
    speed_median_m_s: float
    speed_max_m_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Whole motions of one verb.

    Parameters
    ----------
    verb : Verb
    slides : mapping of str to Slides
        Of the examples, and by method.
    peaks : mapping of str to Peaks
        The same.
    """

    verb: Verb
    slides: Mapping[str, foot_contact.Slides]
    peaks: Mapping[str, Peaks]


def motions(verb: Verb, progress: Progress) -> Motions:
    """Evaluate the motions of a verb's examples, and those of random goals by every method."""
    evaluator, adverbs, steps = Evaluator(verb), foot_contact.goals(verb), 1 + len(METHODS)
    progress(f"whole motions of {verb.name}", 0, steps)
    found = foot_contact.contacts(evaluator)
    slides = {EXAMPLES: foot_contact.NONE if found is None else foot_contact.example_slides(evaluator, found)}
    peaks = {EXAMPLES: _peaks(evaluator, foot_contact.examples(evaluator))}
    for k, name in enumerate(METHODS, 1):
        progress(f"whole motions of {verb.name}", k, steps)
        slides[name] = (
            foot_contact.NONE if found is None else foot_contact.slides(evaluator, found, adverbs, method=name)
        )
        peaks[name] = _peaks(evaluator, [evaluator.blend(row[None], method=name) for row in adverbs])
    progress(f"whole motions of {verb.name}", steps, steps)
    return Motions(verb, slides, peaks)


def _peaks(evaluator: Evaluator, blends: list[Blend]) -> Peaks:
    rows = np.array([_peak(evaluator, blend) for blend in blends])
    (acceleration, speed), (most, fastest) = np.median(rows, axis=0), rows.max(axis=0)
    return Peaks(float(acceleration), float(most), float(speed), float(fastest))


def _peak(evaluator: Evaluator, blend: Blend) -> F64:
    """Largest acceleration of any joint (m/s²), and largest speed of the effector (m/s), over a whole motion."""
    _, positions = foot_contact.sampled(evaluator, blend)
    accelerations = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=-1) * foot_contact.RATE_HZ**2
    speeds = (
        np.linalg.norm(np.diff(positions[:, evaluator.verb.measure.effector], axis=0), axis=-1) * foot_contact.RATE_HZ
    )
    return np.array([accelerations.max(), speeds.max()])
