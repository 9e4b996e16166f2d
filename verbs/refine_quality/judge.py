"""Comparison of a verb before and after a refinement for quality, at goals that the refinement has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.domain import random_points
from verbs.quality import foot_contact
from verbs.quality.smoothness import smoothness, zoom_ratios
from verbs.refine_quality.cost import EXCESS, PEAK, MotionCost, planted
from verbs.refine_quality.guards import evaluator_with, plain_basis, point_curvature
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["GOALS", "ROWS", "Comparison", "Figures", "compare", "held_out_goals"]

GOALS, ERROR_POINTS, WORST = 200, 3_000, 6
"""Held-out goals whose motions are judged; points at which error and weights are; goals that are listed."""

SEED_STREAM = 6

ROWS = (
    ("cost_mean", "mean cost", "", 1.0),
    ("peak_p95_m_s2", "peak acceleration, p95", "m/s²", 1.0),
    ("peak_max_m_s2", "peak acceleration, max", "m/s²", 1.0),
    ("over_ratio", "harder than any example", "%", 100.0),
    ("range_p95_rad", "range excess, p95", "°", 180.0 / np.pi),
    ("slide_median_m", "slide, median", "mm", 1e3),
    ("slide_p90_m", "slide, p90", "mm", 1e3),
    ("slide_max_m", "slide, max", "mm", 1e3),
    ("error_max_m", "error, max", "", 1.0),
    ("weight_sum_max", "Σ|w|, max", "", 1.0),
    ("smoothness", "κ on slices, mean", "", 1.0),
    ("smoothness_points", "κ at points, mean", "", 1.0),
    ("zoom_ratio", "zoom ratio", "", 1.0),
)
"""Figures in the order of tables: field, name, unit, and the factor from SI to it."""

CHANGED = 0.1
"""Share by which the cost of a goal has to change for the goal to count as better or worse."""


def held_out_goals(verb: Verb, seed: int, count: int = GOALS) -> F64:
    """Adverbs (count, D) of goals that the refinement of this seed does not use."""
    return random_points(verb, np.random.default_rng([seed, SEED_STREAM]), count)


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one version at held-out goals.

    Parameters
    ----------
    method : str
        ``corrected``.
    cost_mean : float
    peak_p95_m_s2, peak_max_m_s2 : float
        Of the largest acceleration of a joint in each motion.
    over_ratio : float
        Share of motions with a larger peak than the hardest example.
    range_p95_rad : float
        Of the largest excess over a joint's range in each motion.
    slide_median_m, slide_p90_m, slide_max_m : float or None
        Slide of standing feet, without planting; None without feet.
    error_mean_m, error_max_m : float
        In the unit of the measure.
    weight_sum_max : float
    smoothness, smoothness_points : float
        Mean curvature of the weights on slices, and at random points.
    zoom_ratio : float
    """

    method: str
    cost_mean: float
    peak_p95_m_s2: float
    peak_max_m_s2: float
    over_ratio: float
    range_p95_rad: float
    slide_median_m: float | None
    slide_p90_m: float | None
    slide_max_m: float | None
    error_mean_m: float
    error_max_m: float
    weight_sum_max: float
    smoothness: float
    smoothness_points: float
    zoom_ratio: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of comparing a refined version with the one before it.

    Parameters
    ----------
    now, new : Figures
        Figures before and after.
    goals : int
        Number of held-out goals.
    better_ratio, worse_ratio : float
        Shares of the goals whose cost falls, or rises, by more than a tenth.
    planted : bool
        Whether feet are planted, so that slide is not limited.
    worst : sequence of mapping
        The costliest goals before: ``adverbs`` by name, and cost, peak and range excess ``before`` and ``after``.
    reasons : tuple of str
        Why the new version is not better; empty if it is.
    """

    now: Figures
    new: Figures
    goals: int
    better_ratio: float
    worse_ratio: float
    planted: bool
    worst: Sequence[dict[str, Any]]
    reasons: tuple[str, ...]

    @property
    def better(self) -> bool:
        """Whether the new version may be published."""
        return not self.reasons

    @property
    def text(self) -> str:
        """One sentence with the figures."""
        now, new = self.now, self.new
        text = (
            f"at {self.goals} held-out goals the mean cost is {new.cost_mean:.3g} (before {now.cost_mean:.3g}), the "
            f"95th percentile of the peak acceleration {new.peak_p95_m_s2:.3g} m/s² (before "
            f"{now.peak_p95_m_s2:.3g}), of the "
            f"range excess {np.degrees(new.range_p95_rad):.3g}° (before {np.degrees(now.range_p95_rad):.3g}°)"
        )
        if new.slide_p90_m is not None and now.slide_p90_m is not None:
            text += f", slide p90 {1000 * new.slide_p90_m:.3g} mm (before {1000 * now.slide_p90_m:.3g})"
        text += f", and {self.better_ratio:.0%} of the goals are better, {self.worse_ratio:.0%} worse"
        return text if self.better else f"not better: {', '.join(self.reasons)}; {text}"

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self) | {"for": "quality", "better": self.better, "reasons": list(self.reasons)}


def compare(now: Verb, new: Verb, seed: int) -> Comparison:
    """Compare a version refined with ``seed`` with the one before it."""
    goals = held_out_goals(now, seed)
    before = evaluator_with(now, now.bases["smooth"])
    after = evaluator_with(now, new.bases["smooth"])
    plain = evaluator_with(now, plain_basis(now)).blend(goals, method="corrected")
    cost = MotionCost.of_verb(now, plain.weights)
    known = foot_contact.contacts(before)
    rows = [_judged(evaluator, cost, goals, seed, known is not None) for evaluator in (before, after)]
    (old, old_rows), (fresh, fresh_rows) = rows
    ratios = fresh_rows[:, 0] / np.maximum(old_rows[:, 0], 1e-12)
    better, worse = float(np.mean(ratios < 1.0 - CHANGED)), float(np.mean(ratios > 1.0 + CHANGED))
    stands = planted(now)
    reasons = _reasons(old, fresh, better, worse, stands=stands)
    return Comparison(
        old, fresh, len(goals), better, worse, stands, _worst(now, goals, old_rows, fresh_rows), tuple(reasons)
    )


def _judged(evaluator: Evaluator, cost: MotionCost, goals: F64, seed: int, feet: bool) -> tuple[Figures, F64]:
    """Figures of one version, and cost, peak and range excess (B, 3) at each goal."""
    verb = evaluator.verb
    moved = cost.figures(evaluator.blend(goals, method="corrected").weights)
    rows = np.stack([cost.of_figures(moved), moved[:, PEAK], moved[:, EXCESS]], axis=1)
    found = foot_contact.contacts(evaluator) if feet else None
    slides = foot_contact.NONE if found is None else foot_contact.slides(evaluator, found, goals, method="corrected")
    points = random_points(verb, np.random.default_rng([seed, SEED_STREAM, 1]), ERROR_POINTS)
    blend = evaluator.blend(points, method="corrected")
    charted = verb.domain.chart.points(points[:600])
    figures = Figures(
        method="corrected",
        cost_mean=float(rows[:, 0].mean()),
        peak_p95_m_s2=float(np.percentile(rows[:, 1], 95)),
        peak_max_m_s2=float(rows[:, 1].max()),
        over_ratio=float(np.mean(rows[:, 1] > cost.hardest_m_s2)),
        range_p95_rad=float(np.percentile(rows[:, 2], 95)),
        slide_median_m=slides.median_m if slides.stances else None,
        slide_p90_m=slides.p90_m if slides.stances else None,
        slide_max_m=slides.max_m if slides.stances else None,
        error_mean_m=float(blend.error.mean()),
        error_max_m=float(blend.error.max()),
        weight_sum_max=float(np.abs(blend.weights).sum(axis=1).max()),
        smoothness=smoothness(evaluator, "corrected")[0],
        smoothness_points=float(point_curvature(evaluator, charted).mean()),
        zoom_ratio=min(zoom_ratios(evaluator, "corrected")[-2:]),
    )
    return figures, rows


def _reasons(now: Figures, new: Figures, better: float, worse: float, *, stands: bool) -> list[str]:
    """Why a version is not better than the one before it."""
    slides = new.slide_p90_m is None or now.slide_p90_m is None or new.slide_p90_m <= 1.05 * now.slide_p90_m
    kept = {
        "its mean cost does not fall by 5 %": new.cost_mean <= 0.95 * now.cost_mean,
        "its peak accelerations rise": new.peak_p95_m_s2 <= now.peak_p95_m_s2,
        "its range excess rises by more than 1°": new.range_p95_rad <= now.range_p95_rad + np.radians(1.0),
        "too many goals are worse": better >= 3.0 * worse,
        "feet slide more": stands or slides,
        "its error is larger than 1e-8": new.error_max_m <= 1e-8,
        "its sum of absolute weights rises by more than a quarter": new.weight_sum_max <= 1.25 * now.weight_sum_max,
        "its κ rises by more than 12 %": new.smoothness <= 1.12 * now.smoothness,
        "its κ at random points rises by more than 12 %": new.smoothness_points <= 1.12 * now.smoothness_points,
        "its weights are less smooth": new.zoom_ratio >= min(3.9, 0.98 * now.zoom_ratio),
    }
    return [reason for reason, holds in kept.items() if not holds]


def _worst(verb: Verb, goals: F64, before: F64, after: F64) -> list[dict[str, Any]]:
    """The costliest goals before, with their figures before and after."""
    names = [adverb.name for adverb in verb.adverbs]
    order = np.argsort(-before[:, 0], kind="stable")[:WORST]
    keys = ("cost", "peak_m_s2", "range_rad")
    return [
        {
            "adverbs": dict(zip(names, goals[k].tolist(), strict=True)),
            "before": dict(zip(keys, before[k].tolist(), strict=True)),
            "after": dict(zip(keys, after[k].tolist(), strict=True)),
        }
        for k in order
    ]
