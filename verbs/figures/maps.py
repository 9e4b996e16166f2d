"""Seed 2, figures 2, 3 and 4: domains, and maps of error and κ over a slice, verbs down and methods across."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from verbs.conventions import F64
from verbs.domain import bounds
from verbs.figures import canvas
from verbs.figures.study import Study
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.verb import Verb

__all__ = ["draw_curvatures", "draw_domains", "draw_errors"]

_PIECES = 5
"""Pieces per side of a hull's triangle: straight in the chart, curved among adverbs."""


def draw_domains(path: Path, verbs: list[Verb]) -> Path:
    """Draw the examples of every verb and the hull that is its domain."""
    columns = min(3, len(verbs))
    lines = -(-len(verbs) // columns)
    figure = canvas.canvas(
        4.1 * columns, 3.9 * lines + 0.4, title="Domains: examples and their hull (seed 2, figure 2)"
    )
    for k, verb in enumerate(verbs):
        solid = len(verb.adverbs) > 2
        axes = figure.add_subplot(lines, columns, k + 1, **({"projection": "3d"} if solid else {}))
        axes.set_title(f"{verb.name}: {len(verb.examples)} examples", fontsize=10)
        if solid:
            _solid(axes, verb)
        else:
            _flat(axes, verb)
    return canvas.save(figure, path)


def _flat(axes: Any, verb: Verb) -> None:
    first, second = verb.adverbs
    corners = verb.values[ConvexHull(verb.domain.chart.points(verb.values)).vertices]
    axes.fill(*corners.T, color=canvas.COLOURS["knn"], alpha=0.3)
    axes.plot(*verb.values.T, "o", color=canvas.COLOURS["rbf"])
    axes.set(xlabel=f"{first.name} ({first.unit})", ylabel=f"{second.name} ({second.unit})")


def _solid(axes: Any, verb: Verb) -> None:
    """Hull and examples in three adverbs; among positions y is drawn upward."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    position = verb.measure.kind == measures.POSITION
    order, names = [0, 2, 1] if position else [0, 1, 2], _names(verb)
    points = verb.domain.chart.points(verb.values)
    triangles = points[ConvexHull(points).simplices]
    faces = _shown(verb, _pieces(triangles))[..., order]
    edges = _shown(verb, _edges(triangles))[..., order]
    axes.add_collection3d(Poly3DCollection(faces, facecolor=canvas.COLOURS["knn"], alpha=0.10, edgecolor="none"))
    for edge in edges:
        axes.plot(*edge.T, color=canvas.COLOURS["knn"], lw=0.7)
    style = {"color": canvas.COLOURS["inverse"], "edgecolor": "black", "lw": 0.4, "s": 24}
    axes.scatter(*_shown(verb, points)[:, order].T, depthshade=False, **style)
    labels = [names[a] for a in order]
    axes.set(xlabel=labels[0], ylabel=labels[1], zlabel=labels[2])
    axes.tick_params(labelsize=7)
    axes.locator_params(nbins=5)
    if position:
        axes.set_aspect("equal")
    axes.set_box_aspect(None if not position else np.ptp(faces.reshape(-1, 3), axis=0), zoom=0.85)


def _shown(verb: Verb, points: F64) -> F64:
    """Adverbs (..., 3) of normalised chart points (..., 3); of a jump its chart, in which directions do not wrap."""
    chart = verb.domain.chart
    return points / chart.scale + chart.shift if chart.kind == charts.PLANAR else verb.domain.chart.adverbs(points)


def _names(verb: Verb) -> list[str]:
    """Names, with units, of adverbs; of a jump, of its chart's axes."""
    names = [f"{adverb.name.replace('_', ' ')} ({adverb.unit})" for adverb in verb.adverbs]
    chart = verb.domain.chart
    if chart.kind == charts.PLANAR:
        names[chart.axes[0]], names[chart.axes[1]] = "jumped to the left (m)", "jumped forward (m)"
    return names


def _pieces(triangles: F64) -> F64:
    """Split triangles (T, 3, D) into smaller ones (T · n², 3, D)."""
    steps, out = np.arange(_PIECES + 1) / _PIECES, []
    for first, second, third in triangles:

        def at(i: int, j: int, a: F64 = first, b: F64 = second - first, c: F64 = third - first) -> F64:
            return np.asarray(a + steps[i] * b + steps[j] * c)

        for i in range(_PIECES):
            for j in range(_PIECES - i):
                out.append((at(i, j), at(i + 1, j), at(i, j + 1)))
                if i + j < _PIECES - 1:
                    out.append((at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)))
    return np.array(out)


def _edges(triangles: F64) -> F64:
    """Sides (S, n + 1, D) of triangles (T, 3, D), in pieces."""
    steps = np.arange(_PIECES + 1)[:, None] / _PIECES
    ends = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, triangles.shape[-1])
    return np.asarray(ends[:, None, 0] + steps * (ends[:, None, 1] - ends[:, None, 0]))


def draw_errors(path: Path, studies: list[Study]) -> Path:
    """Draw maps of the error; every row has one colour scale, in the verb's unit."""
    from matplotlib.colors import Normalize

    def scale(one: Study) -> Any:
        # Clipped at the 99th percentile, so that a single corner does not set the scale.
        top = 1000 * np.nanpercentile(np.stack(list(one.errors.values())), 99)
        return Normalize(0.0, max(float(top), 1e-6))

    millimetres = {one.verb.name: {name: 1000 * error for name, error in one.errors.items()} for one in studies}
    title = "Error over a slice at mid-range (seed 2, figure 3): brighter is larger"
    return _draw_maps(path, studies, millimetres, scale, title, "error")


def draw_curvatures(path: Path, studies: list[Study]) -> Path:
    """Draw maps of κ on logarithmic scales, one to a row."""
    from matplotlib.colors import LogNorm

    def scale(one: Study) -> Any:
        values = np.stack(list(one.curvatures.values()))
        top = float(np.nanpercentile(values, 99.5))
        return LogNorm(top / 1e3, top)

    title = "κ of the weights over a slice at mid-range (seed 2, figure 4): brighter is rougher, logarithmic"
    return _draw_maps(path, studies, {one.verb.name: one.curvatures for one in studies}, scale, title, "κ")


def _draw_maps(
    path: Path, studies: list[Study], values: Mapping[str, Mapping[str, F64]], scale: Any, title: str, quantity: str
) -> Path:
    figure = canvas.canvas(13, 2.45 * len(studies) + 0.6, title=title)
    panels = figure.subplots(len(studies), len(canvas.SHOWN), squeeze=False)
    for row, one in zip(panels, studies, strict=True):
        norm, (labels, extent) = scale(one), _axes_of(one)
        image = None
        for axes, method in zip(row, canvas.SHOWN, strict=True):
            if method not in values[one.verb.name]:
                axes.set_axis_off()
                continue
            grid = values[one.verb.name][method]
            image = _map(axes, grid, norm, extent)
            axes.set_title(f"{method}: mean {_number(float(np.nanmean(grid)))}", fontsize=9)
            axes.set_xlabel(labels[0], fontsize=8)
        row[0].set_ylabel(f"$\\bf{{{one.verb.name}}}$\n{labels[1]}", fontsize=9)
        unit = f" (m{one.verb.measure.unit})" if quantity == "error" else ""
        figure.colorbar(image, ax=list(row), label=quantity + unit, extend="max", pad=0.01, aspect=14)
    return canvas.save(figure, path)


def _map(axes: Any, grid: F64, norm: Any, extent: tuple[float, ...]) -> Any:
    # Values below the scale are drawn with its lowest colour; outside the hull is grey.
    axes.set_facecolor("0.88")
    shown = np.clip(grid, norm.vmin, None)
    image = axes.imshow(shown.T, origin="lower", extent=extent, aspect="auto", cmap="viridis", norm=norm)
    axes.tick_params(labelsize=7)
    return image


def _number(value: float) -> str:
    return f"{value:.3f}" if 0.001 <= value < 1e4 else f"{value:.0e}"


def _axes_of(one: Study) -> tuple[tuple[str, str], tuple[float, float, float, float]]:
    """Names, with units, and ranges of the two chart axes that a verb's maps span."""
    verb, chart = one.verb, one.verb.domain.chart
    low, high = (point / chart.scale + chart.shift for point in bounds(verb))
    names = _names(verb)
    ranges = [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
    if chart.kind == charts.CYLINDER:
        first = chart.axes[0]
        names[first] = "angle about the body (°)"
        angles = [float(np.degrees(value / chart.bend[3] + chart.bend[2])) for value in ranges[first]]
        away = 360.0 * round(0.5 * sum(angles) / 360.0)
        ranges[first] = (angles[0] - away, angles[1] - away)
    first, second = one.section.axes
    return (names[first], names[second]), (*ranges[first], *ranges[second])
