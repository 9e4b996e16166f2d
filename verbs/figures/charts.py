"""Curves and bars: error against pseudo-examples (seed 1, figure 14), and methods compared (seed 2, figures 5, 7)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.figures import canvas
from verbs.figures.refining import Refinement, hybrid_errors
from verbs.figures.study import Study

__all__ = ["draw_bars", "draw_curves", "draw_overview"]

_FLOOR_PCT = 1e-4
"""Errors below this are drawn here: a millionth of the diagonal, thousandths of a millimetre."""

_STEPS = (1, 2, 5, 10, 20, 50, 100)


def draw_curves(path: Path, refined: list[Refinement]) -> Path:
    """Draw how mean and largest error fall with the number of pseudo-examples."""
    figure = canvas.canvas(11.5, 4.8, title="Error against pseudo-examples (seed 1, figure 14)")
    panels = figure.subplots(1, len(refined), sharey=True)
    for axes, one in zip(panels, refined, strict=True):
        for rule, colour in (("local", canvas.COLOURS["rbf"]), ("global", canvas.COLOURS["inverse"])):
            pseudo, mean, largest = one.curves[rule].T
            axes.plot(pseudo, mean, "-", color=colour, lw=1.8, label=f"{rule} radii, mean")
            axes.plot(pseudo, largest, "--", color=colour, lw=1.2, label=f"{rule} radii, max")
        steps = [step for step in (0, *_STEPS) if step in one.bases]
        both = np.array([hybrid_errors(one, one.sought, step, 1) for step in steps])
        axes.plot(steps, both[:, 0], "-o", color=canvas.COLOURS["corrected"], ms=4, label="hybrid (local), mean")
        axes.plot(steps, both[:, 1], "--o", color=canvas.COLOURS["corrected"], ms=4, lw=1, label="hybrid (local), max")
        axes.set(yscale="log", xlabel="pseudo-examples", title=f"{one.verb.name}, {len(one.verb.examples)} examples")
        axes.grid(visible=True, which="both", color="0.9", lw=0.6)
    panels[0].set_ylabel("error (% of the diagonal)")
    canvas.legend_below(figure, panels[0], 3)
    return canvas.save(figure, path)


def draw_bars(path: Path, studies: list[Study]) -> Path:
    """Draw error, κ, precomputation and query time of the shown methods on every verb."""
    figure = canvas.canvas(12.5, 7.6, title="Methods compared (seed 2, figure 5); every scale is logarithmic")
    panels = figure.subplots(2, 2)
    columns = (
        ("error_mean_pct", "mean error (% of the diagonal)"),
        ("smoothness", f"mean κ ({studies[0].section.inside.shape[0]} nodes to a side)"),
        ("precompute_s", "precomputation (s)"),
        ("query_us", "time per query (µs)"),
    )
    for axes, (field, label) in zip(panels.flat, columns, strict=True):
        _bars(axes, studies, field)
        axes.set_ylabel(label)
    panels[0, 0].set_ylim(_FLOOR_PCT / 3, None)
    panels[0, 0].axhline(_FLOOR_PCT, color="0.5", lw=0.8, ls=":")
    panels[0, 0].set_title(f"▼ below {_FLOOR_PCT:g} % (0.001 mm of a metre)", fontsize=9)
    canvas.legend_below(figure, panels[0, 0], len(canvas.SHOWN))
    return canvas.save(figure, path)


def _bars(axes: Any, studies: list[Study], field: str) -> None:
    width = 0.8 / len(canvas.SHOWN)
    for k, method in enumerate(canvas.SHOWN):
        values = np.array([getattr(one.figures[method], field) if method in one.figures else np.nan for one in studies])
        at = np.arange(len(studies)) + (k - 0.5 * (len(canvas.SHOWN) - 1)) * width
        low = (values < _FLOOR_PCT) & (field == "error_mean_pct")
        shown = np.where(low, np.nan, values)
        axes.bar(at, shown, width, color=canvas.COLOURS[method], label=method, edgecolor="white", lw=0.4)
        axes.plot(at[low], np.full(low.sum(), _FLOOR_PCT / 1.6), "v", color=canvas.COLOURS[method], ms=6)
    axes.set_yscale("log")
    axes.set_xticks(range(len(studies)), [one.verb.name for one in studies])
    axes.grid(visible=True, axis="y", color="0.9", lw=0.6)
    axes.set_axisbelow(True)


def draw_overview(path: Path, studies: list[Study]) -> Path:
    """Draw mean error against mean κ: accurate to the left, smooth below."""
    figure = canvas.canvas(
        8.6, 6.2, title="Accuracy and smoothness (seed 2, figure 7): small marks are verbs, large ones their median"
    )
    axes = figure.subplots()
    for method in canvas.SHOWN:
        rows = [one.figures[method] for one in studies if method in one.figures]
        points = np.array([(max(row.error_mean_pct, _FLOOR_PCT), row.smoothness) for row in rows])
        mark: dict[str, Any] = {"color": canvas.COLOURS[method], "marker": canvas.MARKERS[method], "ls": ""}
        axes.plot(*points.T, ms=6, alpha=0.55, **mark)
        axes.plot(*_middle(points), ms=17, mec="black", mew=1, label=method, **mark)
    axes.axvline(_FLOOR_PCT, color="0.5", lw=0.8, ls=":")
    axes.text(_FLOOR_PCT * 1.15, 0.99, f"{_FLOOR_PCT:g} % or less", transform=axes.get_xaxis_transform(), rotation=90,
              va="top", fontsize=8, color="0.35")  # fmt: skip
    axes.set(xscale="log", yscale="log", ylabel="mean κ (rougher ↑, smoother ↓)")
    axes.set_xlabel("mean error (% of the diagonal; more accurate ←)")
    axes.grid(visible=True, color="0.9", lw=0.6)
    canvas.legend_below(figure, axes, 5, scale=0.6)
    return canvas.save(figure, path)


def _middle(points: F64) -> F64:
    """Median (2,) of points (B, 2), as columns for plotting; a mean would follow the one verb without error."""
    return np.asarray(np.median(points, axis=0)[:, None])
