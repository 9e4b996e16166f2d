"""Acceptance test of a refinement: lower errors at held-out points, and smoothness within a limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from service.refinement.usage_cells import sample_cells
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.goal import diagonal
from verbs.quality.smoothness import smoothness
from verbs.runtime.evaluate import Evaluator
from verbs.units import quantity
from verbs.verb import Verb

__all__ = ["HELD_OUT", "SMOOTHNESS_LIMIT", "Comparison", "Figures", "compare", "held_out", "method_of"]

SMOOTHNESS_LIMIT = 1.25
"""Largest accepted ratio of the mean curvature κ of the weights, new version to current one, on the same slices.

Refinement raises κ a little: 1.0 to 1.2 times that of the unrefined basis for the built-in verbs.
"""

HELD_OUT = 3_000
"""Number of held-out points; with recorded usage half of them are sampled from it."""

_STREAM = 3
"""Random stream of held-out points; a refinement uses streams 0 to 2 of the same seed."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Quality of a version by one method: errors at the held-out points, metres (speeds: m/s), and mean κ."""

    method: str
    error_mean_m: float
    error_max_m: float
    smoothness: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of comparing a new version with the one that it was refined from.

    Parameters
    ----------
    now, new : Figures
        Figures of the earlier version and of the new one.
    points : int
        Number of held-out points.
    diagonal_m : float
        Diagonal of the examples' goals, in the unit of the error.
    unit : str
        Unit of the error: m, or m/s.
    reasons : tuple of str
        Why the new one is not better; empty if it is.
    """

    now: Figures
    new: Figures
    points: int
    diagonal_m: float
    unit: str
    reasons: tuple[str, ...]

    @property
    def better(self) -> bool:
        """Whether the new version may be published."""
        return not self.reasons

    @property
    def text(self) -> str:
        """One sentence with the figures."""
        now, new = self.now, self.new
        mean, largest, mean_now, largest_now = (
            quantity(error, self.unit)
            for error in (new.error_mean_m, new.error_max_m, now.error_mean_m, now.error_max_m)
        )
        text = (
            f"at {self.points} held-out points the mean error by '{new.method}' is {mean}, the largest {largest} "
            f"(before, by '{now.method}': {mean_now} and {largest_now}), and κ is {new.smoothness:.3g} "
            f"(before {now.smoothness:.3g})"
        )
        return text if self.better else f"not better: {', '.join(self.reasons)}; {text}"

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self) | {
            "better": self.better,
            "reasons": list(self.reasons),
            "smoothness_limit": SMOOTHNESS_LIMIT,
        }


def held_out(verb: Verb, seed: int, cells: Sequence[Mapping[str, Any]] | None) -> F64:
    """Adverbs (:data:`HELD_OUT`, D) at which versions are compared; half of them from usage cells, if there are any."""
    weighted = sample_cells(verb, cells or (), np.random.default_rng([seed, _STREAM, 1]), HELD_OUT // 2)
    uniform = random_points(verb, np.random.default_rng([seed, _STREAM, 0]), HELD_OUT - len(weighted))
    return np.concatenate([uniform, weighted])


def method_of(verb: Verb, method: str) -> str:
    """The method that a version is measured by: the requested one, or ``rbf`` without a refined basis."""
    return method if "refined" in verb.bases else "rbf"


def compare(now: Verb, new: Verb, method: str, points: F64) -> Comparison:
    """Compare a refined version with the one before it, at held-out points (B, D)."""
    old, fresh = _figures(now, method_of(now, method), points), _figures(new, method, points)
    reasons = []
    if not fresh.error_mean_m < old.error_mean_m:
        reasons.append("its mean error is not lower")
    if not fresh.error_max_m < old.error_max_m:
        reasons.append("its largest error is not lower")
    if not fresh.smoothness <= SMOOTHNESS_LIMIT * old.smoothness:
        reasons.append(f"its κ is more than {SMOOTHNESS_LIMIT} times the current one's")
    return Comparison(old, fresh, len(points), diagonal(now), now.measure.unit, tuple(reasons))


def _figures(verb: Verb, method: str, points: F64) -> Figures:
    evaluator = Evaluator(verb)
    error = evaluator.blend(points, method=method).error
    return Figures(method, float(error.mean()), float(error.max()), smoothness(evaluator, method)[0])
