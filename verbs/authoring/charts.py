"""Choice of the chart of a verb's domain.

The rule was chosen on some verbs and checked on others; ``docs/math.md``, "Kernel and chart", has the figures.
"""

from __future__ import annotations

import numpy as np

from verbs.authoring import basis
from verbs.authoring.source import Source
from verbs.conventions import F64
from verbs.errors import SourceError
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.units import si
from verbs.verb import Chart, Measure

__all__ = ["choose", "plain"]

SPAN = np.radians(120.0)
"""Examples that span more than this about the start have a hull that contains the body."""

LEAST_GAP = np.radians(45.0)
"""Least gap between examples at which a cylinder can be cut."""


def plain(source: Source, measure: Measure, values: F64) -> Chart:
    """Chart of the paper's basis: the adverbs as they are, a jump's direction on a circle."""
    units = tuple(adverb.unit for adverb in source.adverbs)
    if measure.kind == measures.JUMP:
        radians = measure.frame[1, 1]
        bend = np.array([0.0 if radians == 1.0 else radians, 0.0, 0.0, 0.0])
        return basis.chart_of(values, units, kind=charts.PLANAR, axes=measure.axes, bend=bend)
    return basis.chart_of(values, units)


def choose(source: Source, measure: Measure, values: F64, *, start: F64) -> tuple[Chart, str]:
    """Chart of the domain and of smooth weights, and the reason as a sentence.

    Parameters
    ----------
    source : Source
        Its ``chart`` decides, where it is given.
    measure : Measure
    values : (N, D) float64
    start : (3,) float64
        Mean root position at the start, metres: the cylinder's axis.

    Raises
    ------
    SourceError
        If the source sets a cylinder that is not possible, or the adverbs that bend have different units.
    """
    if measure.kind == measures.JUMP:
        return plain(source, measure, values), "planar: a direction lives on its circle"
    full = measure.kind == measures.POSITION and measure.axes.shape == (3,) and not source.goal
    if not full or source.chart == "identity":
        if source.chart == "cylinder":
            raise SourceError(source.path, "chart 'cylinder' needs a joint position with three measured adverbs")
        why = "set in the source" if source.chart else "the adverbs are not a position in space"
        return plain(source, measure, values), f"identity: {why}"
    units = [source.adverbs[axis].unit for axis in measure.axes]
    x, z = (values[:, measure.axes[a]] * si(units[a]) - start[a] for a in (0, 2))
    angles = np.sort(np.arctan2(x, z) % (2 * np.pi))
    gaps = np.diff(np.concatenate([angles, angles[:1] + 2 * np.pi]))
    widest = int(np.argmax(gaps))
    span, gap = 2 * np.pi - gaps[widest], gaps[widest]
    words = f"the examples span {np.degrees(span):.0f}° about the start, with a gap of {np.degrees(gap):.0f}°"
    if source.chart != "cylinder" and (span <= SPAN or gap < LEAST_GAP):
        return plain(source, measure, values), f"identity: {words}"
    if gap < np.radians(5.0):
        raise SourceError(source.path, f"chart 'cylinder' cannot be cut: {words}")
    cut = (angles[widest] + 0.5 * gap) % (2 * np.pi)
    if units[0] != units[2]:
        names = " and ".join(f"'{source.adverbs[measure.axes[a]].name}' ({units[a]})" for a in (0, 2))
        raise SourceError(source.path, f"{names} lie on a cylinder about the start: give them one unit")
    factor = si(units[0])
    bend = np.array([start[0] / factor, start[2] / factor, cut, float(np.hypot(x, z).mean()) / factor])
    every = tuple(adverb.unit for adverb in source.adverbs)
    chart = basis.chart_of(values, every, kind=charts.CYLINDER, axes=measure.axes, bend=bend)
    why = "set in the source" if source.chart else "a straight hull would hold the body, which no example supports"
    return chart, f"cylinder: {words}; {why}"
