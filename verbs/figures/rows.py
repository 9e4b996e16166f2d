"""Seed 1, figures 15 to 18: rows of poses along each adverb."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from verbs.conventions import F64
from verbs.domain import plane
from verbs.figures.draw import draw_poses, points
from verbs.figures.strips import chart_labels
from verbs.figures.study import Progress
from verbs.kernels import measure as measures
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["draw"]

_ACROSS = 6


def draw(folder: Path, verbs: list[Verb], progress: Progress) -> list[Path]:
    """Draw one picture per verb; captured verbs are marked in the file name."""
    paths = []
    for k, verb in enumerate(verbs):
        progress("poses", k, len(verbs))
        path = folder / f"seed1_fig15_18_{verb.name}{'_captured' if k else ''}.png"
        _draw_verb(path, verb)
        paths.append(path)
    progress("poses", len(verbs), len(verbs))
    return paths


def _draw_verb(path: Path, verb: Verb) -> None:
    """One row per chart axis, the others at mid-range, at the measured instant."""
    evaluator, position = Evaluator(verb), verb.measure.kind == measures.POSITION
    lines = [_line(verb, axis) for axis in range(len(verb.adverbs))]
    adverbs = np.concatenate(lines)
    phase = float(verb.phases[verb.measure.keytime]) if verb.measure.keytime >= 0 else 0.25
    poses = evaluator.pose(adverbs, phase=phase)
    bodies = points(verb.skeleton, poses.root, poses.rotations)
    if not position:  # travelling figures are drawn side by side
        bodies = bodies - poses.root[:, None] * np.array([1.0, 0.0, 1.0])
    goals = evaluator.goal.points(adverbs) if position else None
    draw_poses(
        verb.skeleton,
        list(bodies),
        path,
        view="three_quarter",
        columns=_ACROSS,
        labels=[text for axis, line in enumerate(lines) for text in chart_labels(verb, axis, line)],
        marks=() if goals is None else list(goals),
        pixels_per_m=100.0,
    )


def _line(verb: Verb, axis: int) -> F64:
    """Adverbs (n, D), evenly spaced along one chart axis as far as the hull goes."""
    fine = plane(verb, (axis, axis), [0.5] * len(verb.adverbs), 201)
    inside = np.flatnonzero(fine.inside[:, 0])
    chosen = np.round(np.linspace(inside[0], inside[-1], _ACROSS)).astype(int)
    return np.ascontiguousarray(fine.adverbs[chosen, 0])
