"""Seed 1, figures 4 and 5: the parts of a cardinal basis of three examples on a line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from verbs.authoring.basis import cardinal, chart_of
from verbs.conventions import F64
from verbs.figures import canvas
from verbs.kernels import radial_basis
from verbs.verb import Basis

__all__ = ["EXAMPLES", "draw_cardinal", "parts"]

EXAMPLES = np.array([0.15, 0.30, 0.75])
VALUES = np.array([0.9, 1.4, 1.1])
"""Adverbs, and a degree of freedom (rad), of the three examples; the paper prints the adverbs in a picture only."""

_STYLES = ("-", "--", "-.")


def parts(basis: Basis, adverbs: F64) -> tuple[F64, F64]:
    """Linear parts (B, N), and radial parts (B, C, N) of each example's basis by center, at adverbs (B, 1)."""
    points = basis.chart.points(adverbs)
    bumps = radial_basis.radial_matrix(basis.radial_basis, points, basis.centers, basis.radii)
    linear = radial_basis.polynomial_matrix(points, basis.degree) @ basis.poly
    return linear, bumps[:, :, None] * basis.radial[None]


def draw_cardinal(path: Path) -> Path:
    """Draw the parts of the first example's basis, all bases, and the sum scaled by a degree of freedom."""
    basis = cardinal(chart_of(EXAMPLES[:, None], ("1",)), EXAMPLES[:, None])
    at = np.linspace(0.0, 1.0, 401)
    linear, radial = parts(basis, at[:, None])
    weights = linear + radial.sum(axis=1)
    figure = canvas.canvas(
        12, 4.2, title="Cardinal basis of examples at p = 0.15, 0.30, 0.75 (seed 1, figures 4 and 5)"
    )
    first, second, third = figure.subplots(1, 3)
    first.plot(at, linear[:, 0], color=canvas.COLOURS["rbf"], label="linear part")
    for k, style in enumerate(_STYLES):
        label = f"radial part at p{k + 1}"
        first.plot(at, radial[:, k, 0], style, color=canvas.COLOURS["inverse"], lw=1.3, label=label)
    first.plot(at, weights[:, 0], color=canvas.COLOURS["hybrid"], lw=2, label="their sum, w1")
    colours = [canvas.COLOURS[name] for name in ("hybrid", "barycentric", "corrected")]
    for k, colour in enumerate(colours):
        second.plot(at, weights[:, k], _STYLES[k], color=colour, lw=1.8, label=f"w{k + 1}")
        third.plot(at, weights[:, k] * VALUES[k], _STYLES[k], color=colour, lw=1, label=f"x{k + 1} w{k + 1}")
    second.plot(at, weights.sum(axis=1), ":", color="gray", label="w1 + w2 + w3")
    second.plot(EXAMPLES, np.ones(3), "o", color="gray", ms=5)
    third.plot(at, weights @ VALUES, color=canvas.COLOURS["inverse"], lw=2.2, label="x = Σ x w")
    third.plot(EXAMPLES, VALUES, "o", color=canvas.COLOURS["inverse"], label="examples")
    _finish(first, "first example: linear and radial parts", "weight (no unit)")
    _finish(second, "cardinal basis functions", "weight (no unit)")
    _finish(third, "scaled sum for one degree of freedom", "angle (rad)")
    return canvas.save(figure, path)


def _finish(axes: Any, title: str, label: str) -> None:
    for adverb in EXAMPLES:
        axes.axvline(adverb, color="0.85", lw=1, zorder=0)
    axes.axhline(0.0, color="0.6", lw=0.8, zorder=0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.42 * (high - low))  # room for the legend
    axes.set(title=title, xlabel="adverb p (no unit)", ylabel=label)
    axes.legend(fontsize=8, ncols=2, loc="upper center", frameon=False)
