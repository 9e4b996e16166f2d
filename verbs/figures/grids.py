"""Seed 1, figures 6 to 13: measured positions of regular grids of adverbs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.domain import plane
from verbs.figures import canvas
from verbs.figures.refining import Refinement, errors, hybrid_errors, weights_of
from verbs.goal import Goal
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

__all__ = ["draw_arm", "draw_board", "draw_reach"]

_SIDE = 17
_FINE = 6
"""Lines of a grid, and points between two of them: warped lines are curves."""

_STAR_M = 0.36
"""Radius of the drawing, which fits on the board."""

_REQUESTED, _MEASURED = "0.78", canvas.COLOURS["rbf"]
_EXAMPLES, _PSEUDO = canvas.COLOURS["barycentric"], canvas.COLOURS["corrected"]


def draw_arm(path: Path, one: Refinement) -> Path:
    """Draw requested and measured grids of the planar arm: raw, searched, with pseudo-examples, with both."""
    some, stages = min(20, max(one.bases)), _stages(one, ("6", "9", "11, left", "11, right"))
    figure = canvas.canvas(
        14, 5.3, title="Planar arm: requested grid, measured grid, and the error in % of the diagonal"
    )
    panels = figure.subplots(1, len(stages), sharex=True, sharey=True)
    for axes, (title, pseudo, searches) in zip(panels, stages, strict=True):
        mean, worst = hybrid_errors(one, one.sought, pseudo, searches)
        _warped(axes, one, pseudo, searches)
        axes.set_title(f"{title}\nmean {mean:.2f} %, max {worst:.2f} %", fontsize=10)
        axes.set_xlabel("x (m)")
        axes.set_aspect("equal")
    panels[0].set_ylabel("y (m)")
    _poses(panels[0], one.verb)
    panels[2].plot(
        *one.pseudo_adverbs[:some].T, "D", color=_PSEUDO, ms=5, mec="white", mew=0.6, label="pseudo-examples"
    )
    panels[3].plot(*one.pseudo_adverbs[:some].T, "D", color=_PSEUDO, ms=5, mec="white", mew=0.6)
    handles = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles), frameon=False)
    return canvas.save(figure, path)


def _warped(axes: Any, one: Refinement, pseudo: int, searches: int) -> None:
    """Draw the requested and the measured grid of one stage, and join the ends of its largest error."""
    evaluator = Evaluator(one.verb)
    nodes = (_SIDE - 1) * _FINE + 1
    requested = plane(one.verb, (0, 1), [0.5, 0.5], nodes).adverbs
    flat = requested.reshape(-1, 2)
    weights = weights_of(one, flat, pseudo, searches)
    blend = evaluator.measure("", weights, flat, np.zeros(len(flat), bool))
    measured = blend.measured.reshape(requested.shape)
    for grid, colour, width, label in (
        (requested, _REQUESTED, 0.7, "requested"),
        (measured, _MEASURED, 0.9, "measured"),
    ):
        for k in range(0, nodes, _FINE):
            axes.plot(*grid[k].T, color=colour, lw=width, label=label if k == 0 else None)
            axes.plot(*grid[:, k].T, color=colour, lw=width)
    axes.plot(*one.verb.values.T, "o", color=_EXAMPLES, ms=6, mec="black", mew=0.6, label="examples", zorder=5)
    worst = int(blend.error.argmax())
    ends = np.stack([flat[worst], blend.measured[worst]])
    axes.plot(*ends.T, "-x", color=canvas.COLOURS["inverse"], lw=2.2, ms=7, label="largest error", zorder=6)


def _poses(axes: Any, verb: Verb) -> None:
    """Draw the arm of every example at its keytime, faintly."""
    evaluator, chain = Evaluator(verb), verb.skeleton.chain(verb.measure.effector)
    poses = evaluator.pose(verb.values, phase=float(verb.phases[verb.measure.keytime]), method="rbf")
    positions = evaluator.positions(poses)[1][:, chain]
    flat = (positions - verb.measure.origin) @ np.linalg.pinv(verb.measure.frame).T
    for k, points in enumerate(flat):
        axes.plot(*points.T, "-", color="0.45", lw=1.6, alpha=0.5, zorder=1, label=None if k else "arm at examples")


def draw_board(path: Path, one: Refinement) -> Path:
    """Draw a grid on the board and a drawing, as measured: raw, searched, with pseudo-examples, with both."""
    stages = _stages(one, ("7", "10", "12, left", "12, right"))
    title = "Built-in board: requested and measured grid, depth is the distance off the board; a drawing from the front"
    figure = canvas.canvas(14, 7.4, title=title)
    grid = plane(one.verb, (0, 1), [0.5, 0.5], (_SIDE - 1) * _FINE + 1).adverbs
    found = [_on_board(one, grid, pseudo, searches) for _, pseudo, searches in stages]
    top = max(float(error.max()) for _, error in found)
    spaces, sheets = [], []
    for k, (heading, pseudo, searches) in enumerate(stages):
        mean, worst = hybrid_errors(one, one.sought, pseudo, searches)
        spaces.append(figure.add_subplot(2, len(stages), k + 1, projection="3d"))
        lines = _warped_sheet(spaces[-1], grid, *found[k], top)
        spaces[-1].set_title(f"{heading}\nmean {mean:.2f} %, max {worst:.2f} %", fontsize=10)
        sheets.append(figure.add_subplot(2, len(stages), len(stages) + k + 1))
        _drawing(sheets[-1], one, pseudo, searches)
    for axes in spaces:
        axes.scatter(one.verb.values[:, 0], 0.0 * one.verb.values[:, 0], one.verb.values[:, 1], color=_EXAMPLES,
                     edgecolor="black", lw=0.5, s=22, depthshade=False)  # fmt: skip
    figure.colorbar(lines, ax=spaces, label="error (% of the diagonal)", pad=0.02, shrink=0.75, aspect=16)
    sheets[0].set_ylabel("v, up the board (m)")
    sheets[0].plot([], [], "o", color=_EXAMPLES, ms=6, mec="black", mew=0.6, label="examples")
    canvas.legend_below(figure, sheets[0], 3)
    return canvas.save(figure, path, dpi=100)


def _stages(one: Refinement, numbers: tuple[str, str, str, str]) -> list[tuple[str, int, int]]:
    """Names of the four stages, with their pseudo-examples and line searches."""
    some = min(20, max(one.bases))
    names = ("raw basis", "one line search", f"{some} pseudo-examples", f"hybrid: {some} and one search")
    counts = ((0, 0), (0, 1), (some, 0), (some, 1))
    return [(f"{name} (fig. {k})", *count) for name, k, count in zip(names, numbers, counts, strict=True)]


def _on_board(one: Refinement, adverbs: F64, pseudo: int, searches: int) -> tuple[F64, F64]:
    """Measured positions (..., 3) at adverbs (..., 2), m: u, v and distance off the board; and the error, %."""
    goal, flat = Goal.of_verb(one.verb), adverbs.reshape(-1, 2)
    weights = weights_of(one, flat, pseudo, searches)
    left, up = one.verb.measure.frame.T
    axes = np.stack([left, up, np.cross(left, up)], axis=1)  # off the board is away from the writer
    positions = (goal.measured(weights) - one.verb.measure.origin) @ axes
    return positions.reshape(*adverbs.shape[:-1], 3), errors(one.verb, weights, flat).reshape(adverbs.shape[:-1])


def _warped_sheet(axes: Any, requested: F64, measured: F64, error: F64, top: float) -> Any:
    """Draw the requested grid, and the measured one coloured by its error; return the latter."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    nodes = len(requested)
    for k in range(0, nodes, _FINE):
        axes.plot(requested[k, :, 0], 0.0 * requested[k, :, 0], requested[k, :, 1], color=_REQUESTED, lw=0.6)
        axes.plot(requested[:, k, 0], 0.0 * requested[:, k, 0], requested[:, k, 1], color=_REQUESTED, lw=0.6)
    shown = measured[..., [0, 2, 1]]
    rows = [(shown[k], error[k]) for k in range(0, nodes, _FINE)]
    rows += [(shown[:, k], error[:, k]) for k in range(0, nodes, _FINE)]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line, _ in rows])
    lines = Line3DCollection(pieces, cmap="viridis_r", lw=1.1)
    lines.set_array(np.concatenate([0.5 * (values[1:] + values[:-1]) for _, values in rows]))
    lines.set_clim(0.0, top)
    axes.add_collection3d(lines)
    axes.set(xlim=(0.55, -0.55), ylim=(-0.15, 0.15), zlim=(-0.42, 0.42))  # the writer's left is to the left
    axes.set_box_aspect((1.1, 0.3, 0.84), zoom=1.15)
    axes.view_init(elev=12, azim=-40)
    axes.tick_params(labelsize=7, pad=-1)
    axes.set_yticks([-0.1, 0.1])
    axes.set_xlabel("u (m)", fontsize=8)
    axes.set_zlabel("v (m)", fontsize=8)
    return lines


def _drawing(axes: Any, one: Refinement, pseudo: int, searches: int) -> None:
    """Draw a star in its circle, as requested and as measured."""
    angles = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = _STAR_M * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    tips = _STAR_M * np.array([[np.sin(4.0 * np.pi * k / 5.0), np.cos(4.0 * np.pi * k / 5.0)] for k in range(6)])
    star = np.concatenate([np.linspace(tips[k], tips[k + 1], 40) for k in range(5)])
    off = 0.0
    for k, stroke in enumerate((circle, star)):
        positions, _ = _on_board(one, stroke, pseudo, searches)
        off = max(off, float(np.abs(positions[:, 2]).max()))
        axes.plot(*stroke.T, color="0.6", lw=2.2, label=None if k else "requested")
        axes.plot(positions[:, 0], positions[:, 1], color=_MEASURED, lw=1.2, label=None if k else "measured")
    axes.set(xlim=(0.42, -0.42), ylim=(-0.40, 0.40), aspect="equal", xlabel="u, to the writer's left (m)")
    axes.set_title(f"up to {1000 * off:.0f} mm off the board", fontsize=9)
    axes.tick_params(labelsize=8)


def draw_reach(path: Path, one: Refinement) -> Path:
    """Draw a plane of adverbs and the measured wrist positions, before and after refinement."""
    most = max(one.bases)
    figure = canvas.canvas(12.5, 6.4, title="Built-in reach: a plane of adverbs at mid depth (seed 1, figures 8, 13)")
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
    panels[1].scatter(
        *_upright(one.pseudo_adverbs), color=_PSEUDO, marker="D", s=12, alpha=0.8, label="pseudo-examples"
    )
    canvas.legend_below(figure, panels[1], 4)
    return canvas.save(figure, path)


def _warped_plane(axes: Any, one: Refinement, pseudo: int) -> None:
    verb, nodes = one.verb, (_SIDE - 1) * 3 + 1
    section = plane(verb, (0, 1), [0.5] * 3, nodes)
    flat = section.adverbs.reshape(-1, 3)
    weights = weights_of(one, flat, pseudo, 0)
    goal = Goal.of_verb(verb)
    measured = goal.compare(flat, goal.measured(weights))[0].reshape(section.adverbs.shape)
    for grid, colour, width, label in (
        (section.adverbs, "0.7", 0.7, "requested"),
        (measured, _MEASURED, 0.9, "measured"),
    ):
        shown = np.where(section.inside[..., None], grid, np.nan)
        lines = [shown[k] for k in range(0, nodes, 3)] + [shown[:, k] for k in range(0, nodes, 3)]
        for k, line in enumerate(lines):
            axes.plot(*_upright(line), color=colour, lw=width, label=None if k else label)


def _upright(positions: F64) -> F64:
    """Positions (B, 3) as plot axes (3, B): x, z, and y upward."""
    return np.asarray(positions[:, [0, 2, 1]].T)
