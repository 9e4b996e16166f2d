"""Seed 1, figures 6, 8, 9, 11 and 13: where regular grids of adverbs arrive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.evaluate import Evaluator
from verbs.goal import Goal
from verbs.measure.domain import plane
from verbs.measure.figures import board
from verbs.measure.figures.refining import Refinement, hybrid_errors, weights_of
from verbs.verb import Verb

__all__ = ["draw_arm", "draw_reach"]

_SIDE = 17
_FINE = 6
"""Lines of a grid, and points between two of them: a warped line is a curve."""

_ASKED, _REACHED = "0.78", board.COLOURS["rbf"]
_EXAMPLES, _PSEUDO = board.COLOURS["barycentric"], board.COLOURS["corrected"]


def draw_arm(path: Path, one: Refinement) -> Path:
    """Draw asked and reached grids of the planar arm: raw, searched, with pseudo-examples, with both."""
    some = min(20, max(one.bases))
    stages = [("raw basis (fig. 6)", 0, 0), ("one line search (fig. 9)", 0, 1),
              (f"{some} pseudo-examples (fig. 11, left)", some, 0),
              (f"hybrid: {some} and one search (fig. 11, right)", some, 1)]  # fmt: skip
    figure = board.canvas(14, 5.3, title="Planar arm: asked grid, reached grid, and the error in % of the diagonal")
    panels = figure.subplots(1, len(stages), sharex=True, sharey=True)
    for axes, (title, pseudo, searches) in zip(panels, stages, strict=True):
        mean, worst = hybrid_errors(one, one.sought, pseudo, searches)
        _warped(axes, one, pseudo, searches)
        axes.set_title(f"{title}\nmean {mean:.2f} %, max {worst:.2f} %", fontsize=10)
        axes.set_xlabel("x (m)")
        axes.set_aspect("equal")
    panels[0].set_ylabel("y (m)")
    _poses(panels[0], one.verb)
    panels[2].plot(*one.places[:some].T, "D", color=_PSEUDO, ms=5, mec="white", mew=0.6, label="pseudo-examples")
    panels[3].plot(*one.places[:some].T, "D", color=_PSEUDO, ms=5, mec="white", mew=0.6)
    handles = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles), frameon=False)
    return board.save(figure, path)


def _warped(axes: Any, one: Refinement, pseudo: int, searches: int) -> None:
    """Draw the asked and the reached grid of one stage, and join the ends of its largest error."""
    evaluator = Evaluator(one.verb)
    nodes = (_SIDE - 1) * _FINE + 1
    asked = plane(one.verb, (0, 1), [0.5, 0.5], nodes).adverbs
    flat = asked.reshape(-1, 2)
    weights = weights_of(one, flat, pseudo, searches)
    blend = evaluator.measure("", weights, flat, np.zeros(len(flat), bool))
    reached = blend.measured.reshape(asked.shape)
    for grid, colour, width, label in ((asked, _ASKED, 0.7, "asked"), (reached, _REACHED, 0.9, "reached")):
        for k in range(0, nodes, _FINE):
            axes.plot(*grid[k].T, color=colour, lw=width, label=label if k == 0 else None)
            axes.plot(*grid[:, k].T, color=colour, lw=width)
    axes.plot(*one.verb.values.T, "o", color=_EXAMPLES, ms=6, mec="black", mew=0.6, label="examples", zorder=5)
    worst = int(blend.error.argmax())
    ends = np.stack([flat[worst], blend.measured[worst]])
    axes.plot(*ends.T, "-x", color=board.COLOURS["inverse"], lw=2.2, ms=7, label="largest error", zorder=6)


def _poses(axes: Any, verb: Verb) -> None:
    """Draw the arm of every example at its reach, faintly."""
    evaluator, chain = Evaluator(verb), verb.skeleton.chain(verb.measure.effector)
    poses = evaluator.pose(verb.values, phase=float(verb.phases[verb.measure.keytime]), method="rbf")
    places = evaluator.positions(poses)[1][:, chain]
    flat = (places - verb.measure.origin) @ np.linalg.pinv(verb.measure.frame).T
    for k, points in enumerate(flat):
        axes.plot(*points.T, "-", color="0.45", lw=1.6, alpha=0.5, zorder=1, label=None if k else "arm at examples")


def draw_reach(path: Path, one: Refinement) -> Path:
    """Draw a plane of adverbs and where the body's wrist arrives, before and after refinement."""
    most = max(one.bases)
    figure = board.canvas(12.5, 6.4, title="Built-in reach: a plane of adverbs at mid depth (seed 1, figures 8, 13)")
    panels = [figure.add_subplot(1, 2, k + 1, projection="3d") for k in (0, 1)]
    for axes, pseudo in zip(panels, (0, most), strict=True):
        mean, worst = hybrid_errors(one, one.check, pseudo, 0)
        title = f"{pseudo} pseudo-examples" if pseudo else "before refinement"
        axes.set_title(f"{title}: mean {mean:.2f} %, max {worst:.2f} %", fontsize=10)
        _warped_plane(axes, one, pseudo)
        axes.scatter(*_upright(one.verb.values), color=_EXAMPLES, edgecolor="black", lw=0.5, s=34, label="examples")
        axes.set(xlabel="x (m)", ylabel="z (m)", zlabel="y, up (m)")
        axes.set_box_aspect(np.ptp(_upright(one.verb.values), axis=1), zoom=1.0)
        axes.view_init(elev=14, azim=-62)
        axes.tick_params(labelsize=8)
        axes.locator_params(axis="y", nbins=3)
    panels[1].scatter(*_upright(one.places), color=_PSEUDO, marker="D", s=12, alpha=0.8, label="pseudo-examples")
    board.legend_below(figure, panels[1], 4)
    return board.save(figure, path)


def _warped_plane(axes: Any, one: Refinement, pseudo: int) -> None:
    verb, nodes = one.verb, (_SIDE - 1) * 3 + 1
    section = plane(verb, (0, 1), [0.5] * 3, nodes)
    flat = section.adverbs.reshape(-1, 3)
    weights = weights_of(one, flat, pseudo, 0)
    goal = Goal.of_verb(verb)
    reached = goal.compare(flat, goal.reached(weights))[0].reshape(section.adverbs.shape)
    for grid, colour, width, label in (
        (section.adverbs, "0.7", 0.7, "asked"),
        (reached, _REACHED, 0.9, "reached"),
    ):
        shown = np.where(section.inside[..., None], grid, np.nan)
        lines = [shown[k] for k in range(0, nodes, 3)] + [shown[:, k] for k in range(0, nodes, 3)]
        for k, line in enumerate(lines):
            axes.plot(*_upright(line), color=colour, lw=width, label=None if k else label)


def _upright(places: F64) -> F64:
    """Places (B, 3) as plot axes (3, B): x, z, and y upward."""
    return np.asarray(places[:, [0, 2, 1]].T)
