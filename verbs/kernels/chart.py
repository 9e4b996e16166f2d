"""Charts: coordinates in which an adverb space is convex; normalisation and the clamp to the domain.

A chart maps D adverbs to D chart coordinates; three of them may bend, the others pass through:

- ``identity``: nothing bends.
- ``cylinder``: a position (x, y, z) becomes (R·φ, y, r) about a vertical axis, φ measured from the largest gap
  between the examples, so that verbs that surround the body do not blend through it.
- ``planar``: (distance, direction, height) becomes (distance·sin, distance·cos, height), so that a direction lives
  on its circle and does not matter at distance 0.

Normalised coordinates are shifted and scaled. The domain is the convex hull of the examples in them,
{u : A (u − c) ≤ 1}.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.columns import gather
from verbs.kernels.compile import kernel

__all__ = [
    "CHARTS",
    "CYLINDER",
    "IDENTITY",
    "PLANAR",
    "ChartArrays",
    "DomainArrays",
    "chart_columns",
    "clamp",
    "clamp_columns",
    "clamp_point",
    "denormalise",
    "from_chart",
    "gauge",
    "normalise",
    "normalise_columns",
    "to_chart",
]

IDENTITY, CYLINDER, PLANAR = range(3)

CHARTS = {"identity": IDENTITY, "cylinder": CYLINDER, "planar": PLANAR}
"""Chart numbers as the artifact stores them; never renumber."""

FREE_GAUGE = 1.08
"""Up to this gauge (1 is the hull's surface) a point is left where it is."""

LAST_GAUGE = 1.25
"""No clamped point lies farther out than this."""


class ChartArrays(NamedTuple):
    """A chart's arrays; see :class:`verbs.verb.Chart`.

    Parameters
    ----------
    kind : int
        A number of :data:`CHARTS`.
    axes : (3,) int64
        Adverbs that bend.
    bend : (4,) float64
        The cylinder's axis x and z, the angle of its cut (rad) and its unrolling radius R, lengths in the unit of the
        adverbs. Of a planar chart the first is the radians per unit of its direction; 0 stands for 1.
    shift, scale : (D,) float64
        Normalised coordinates are (chart coordinates - shift) · scale.
    """

    kind: int
    axes: I64
    bend: F64
    shift: F64
    scale: F64


class DomainArrays(NamedTuple):
    """A domain's arrays; see :class:`verbs.verb.Domain`."""

    chart: ChartArrays
    facets: F64
    middle: F64
    sharpness: float


@kernel
def to_chart(kind: int, axes: I64, bend: F64, adverbs: F64, out: F64) -> None:
    """Chart coordinates (D,) of adverbs (D,)."""
    for a in range(adverbs.shape[0]):
        out[a] = adverbs[a]
    if kind == CYLINDER:
        x, z = adverbs[axes[0]] - bend[0], adverbs[axes[2]] - bend[1]
        out[axes[0]] = bend[3] * ((np.arctan2(x, z) - bend[2]) % (2.0 * np.pi))
        out[axes[2]] = np.sqrt(x * x + z * z)
    elif kind == PLANAR:
        distance, direction = adverbs[axes[0]], adverbs[axes[1]] * (bend[0] if bend[0] != 0.0 else 1.0)
        out[axes[0]] = distance * np.sin(direction)
        out[axes[1]] = distance * np.cos(direction)


@kernel
def from_chart(kind: int, axes: I64, bend: F64, coordinates: F64, out: F64) -> None:
    """Adverbs (D,) of chart coordinates (D,): the inverse of :func:`to_chart`."""
    for a in range(coordinates.shape[0]):
        out[a] = coordinates[a]
    if kind == CYLINDER:
        angle, radius = coordinates[axes[0]] / bend[3] + bend[2], coordinates[axes[2]]
        out[axes[0]] = bend[0] + radius * np.sin(angle)
        out[axes[2]] = bend[1] + radius * np.cos(angle)
    elif kind == PLANAR:
        x, z = coordinates[axes[0]], coordinates[axes[1]]
        out[axes[0]] = np.sqrt(x * x + z * z)
        out[axes[1]] = np.arctan2(x, z) / (bend[0] if bend[0] != 0.0 else 1.0) if x != 0.0 or z != 0.0 else 0.0


@kernel
def normalise(adverbs: F64, chart: ChartArrays, out: F64) -> None:
    """Normalised chart coordinates of adverbs (B, D), written to ``out`` (B, D)."""
    kind, axes, bend, shift, scale = chart
    for b in range(adverbs.shape[0]):
        to_chart(kind, axes, bend, adverbs[b], out[b])
        for a in range(adverbs.shape[1]):
            out[b, a] = (out[b, a] - shift[a]) * scale[a]


@kernel
def denormalise(points: F64, chart: ChartArrays, out: F64) -> None:
    """Adverbs of normalised chart coordinates (B, D), written to ``out`` (B, D): the inverse of :func:`normalise`."""
    kind, axes, bend, shift, scale = chart
    coordinates = np.empty(points.shape[1])
    for b in range(points.shape[0]):
        for a in range(points.shape[1]):
            coordinates[a] = points[b, a] / scale[a] + shift[a]
        from_chart(kind, axes, bend, coordinates, out[b])


@kernel
def _greatest(point: F64, facets: F64, middle: F64) -> float:
    """Greatest of 0 and A (u - c) over facets, of a point (D,)."""
    top = 0.0
    for f in range(facets.shape[0]):
        value = 0.0
        for a in range(point.shape[0]):
            value += facets[f, a] * (point[a] - middle[a])
        top = max(top, value)
    return top


@kernel
def _surely_free(facets: F64, sharpness: float) -> float:
    """Greatest facet up to which the smooth gauge, at most F^(1/sharpness) times it, is below :data:`FREE_GAUGE`."""
    return (1.0 - 1e-9) * FREE_GAUGE * facets.shape[0] ** (-1.0 / sharpness)


@kernel
def gauge(point: F64, facets: F64, middle: F64, sharpness: float) -> float:
    """Smooth gauge of a point (D,) against facets (F, D) about ``middle`` (D,): 1 on the hull's surface.

    The maximum of A (u − c) over facets, softened to a norm of order ``sharpness``. Where k facets meet it overstates
    by k^(1/sharpness); authoring chooses the order so that no point of the hull passes :data:`FREE_GAUGE`.
    """
    top = _greatest(point, facets, middle)
    if top <= 0.0:
        return 0.0
    total = 0.0
    for f in range(facets.shape[0]):
        value = 0.0
        for a in range(point.shape[0]):
            value += facets[f, a] * (point[a] - middle[a])
        if value > 0.0:
            total += (value / top) ** sharpness
    return top * total ** (1.0 / sharpness)


@kernel
def clamp_point(point: F64, facets: F64, middle: F64, sharpness: float) -> bool:
    """Move a point (D,) far outside the hull back to its surroundings, in place; return whether it was moved.

    The identity up to gauge 1.08, then a hyperbolic tangent that never passes 1.25: twice differentiable, so that
    a goal that leaves the domain does not make the character jerk.
    """
    if _greatest(point, facets, middle) <= _surely_free(facets, sharpness):
        return False  # without its powers
    value = gauge(point, facets, middle, sharpness)
    if value <= FREE_GAUGE:
        return False
    span = LAST_GAUGE - FREE_GAUGE
    shrink = (FREE_GAUGE + span * np.tanh((value - FREE_GAUGE) / span)) / value
    for a in range(point.shape[0]):
        point[a] = middle[a] + (point[a] - middle[a]) * shrink
    return True


@kernel
def clamp(adverbs: F64, domain: DomainArrays, out: F64, moved: F64) -> None:
    """Adverbs (B, D) moved back to the domain, to ``out`` (B, D); ``moved`` (B,) is 1 where that changed them."""
    facets, middle, sharpness = domain.facets, domain.middle, domain.sharpness
    kind, axes, bend, shift, scale = domain.chart
    point = np.empty(adverbs.shape[1])
    for b in range(adverbs.shape[0]):
        to_chart(kind, axes, bend, adverbs[b], point)
        for a in range(point.shape[0]):
            point[a] = (point[a] - shift[a]) * scale[a]
        out[b], moved[b] = adverbs[b], 0.0
        if clamp_point(point, facets, middle, sharpness):
            moved[b] = 1.0
            for a in range(point.shape[0]):
                point[a] = point[a] / scale[a] + shift[a]
            from_chart(kind, axes, bend, point, out[b])


@kernel
def normalise_columns(chart: ChartArrays, adverbs: F64, out: F64) -> None:
    """Normalised chart coordinates (D, T) of adverbs (D, T), characters last."""
    kind, axes, bend, shift, scale = chart
    for a in range(adverbs.shape[0]):
        for k in range(adverbs.shape[1]):
            out[a, k] = adverbs[a, k]
    i, j, m = axes[0], axes[1], axes[2]
    if kind == CYLINDER:
        for k in range(adverbs.shape[1]):
            x, z = adverbs[i, k] - bend[0], adverbs[m, k] - bend[1]
            out[i, k] = bend[3] * ((np.arctan2(x, z) - bend[2]) % (2.0 * np.pi))
            out[m, k] = np.sqrt(x * x + z * z)
    elif kind == PLANAR:
        unit = bend[0] if bend[0] != 0.0 else 1.0
        for k in range(adverbs.shape[1]):
            distance, direction = adverbs[i, k], adverbs[j, k] * unit
            out[i, k], out[j, k] = distance * np.sin(direction), distance * np.cos(direction)
    for a in range(adverbs.shape[0]):
        for k in range(adverbs.shape[1]):
            out[a, k] = (out[a, k] - shift[a]) * scale[a]


@kernel
def _denormalise_columns(chart: ChartArrays, points: F64, out: F64) -> None:
    """Adverbs (D, T) of normalised chart coordinates (D, T), which become those of the adverbs.

    They differ where an angle is outside its turn or a radius negative.
    """
    kind, axes, bend, shift, scale = chart
    for a in range(points.shape[0]):
        for k in range(points.shape[1]):
            out[a, k] = points[a, k] / scale[a] + shift[a]
    i, j, m, folded = axes[0], axes[1], axes[2], False
    if kind == CYLINDER:
        for k in range(points.shape[1]):
            angle, radius = out[i, k] / bend[3], out[m, k]
            folded |= angle < 0.0 or angle >= 2.0 * np.pi or radius < 0.0
            angle += bend[2]
            out[i, k], out[m, k] = bend[0] + radius * np.sin(angle), bend[1] + radius * np.cos(angle)
    elif kind == PLANAR:
        unit = bend[0] if bend[0] != 0.0 else 1.0
        for k in range(points.shape[1]):
            x, z = out[i, k], out[j, k]
            out[i, k] = np.sqrt(x * x + z * z)
            out[j, k] = np.arctan2(x, z) / unit if x != 0.0 or z != 0.0 else 0.0
    if folded:
        normalise_columns(chart, out, points)


@kernel
def chart_columns(rows: F64, first: int, charted: bool, chart: ChartArrays, adverbs: F64, points: F64) -> None:
    """Adverbs and normalised chart coordinates (D, T), characters last, of rows (B, D) from ``first`` on.

    Rows are adverbs, or (``charted``) normalised coordinates. Past the end the last row is repeated.
    """
    gather(rows, first, points if charted else adverbs)
    if charted:
        _denormalise_columns(chart, points, adverbs)
    else:
        normalise_columns(chart, adverbs, points)


@kernel
def _greatest_facets(facets: F64, middle: F64, points: F64, out: F64) -> None:
    """Greatest of 0 and A (u - c) over facets (F, D), for points (D, T), to the first of two rows (2, T)."""
    for k in range(out.shape[1]):
        out[0, k] = 0.0
    for f in range(facets.shape[0]):
        offset = 0.0
        for a in range(middle.shape[0]):
            offset += facets[f, a] * middle[a]
        if middle.shape[0] == 3:
            _greatest_facet(facets[f, 0], facets[f, 1], facets[f, 2], offset, points, out)
            continue
        for k in range(out.shape[1]):
            out[1, k] = -offset
        for a in range(middle.shape[0]):
            share = facets[f, a]
            for k in range(out.shape[1]):
                out[1, k] += share * points[a, k]
        for k in range(out.shape[1]):
            out[0, k] = max(out[0, k], out[1, k])


@kernel
def _greatest_facet(x: float, y: float, z: float, offset: float, points: F64, out: F64) -> None:
    """Greater of row 0 and one facet's value, in three dimensions."""
    for k in range(out.shape[1]):
        value = x * points[0, k] + y * points[1, k] + z * points[2, k] - offset
        before = out[0, k]
        out[0, k] = value if value > before else before


@kernel
def clamp_columns(adverbs: F64, domain: DomainArrays, points: F64, inside: F64, moved: F64) -> None:
    """Clamp normalised points (D, T) in place, and adverbs (D, T) to ``inside``.

    The first row of ``moved`` (2, T) is 1 where that changed them; the second is scratch.
    """
    (kind, axes, bend, shift, scale), facets, middle, sharpness = domain
    _greatest_facets(facets, middle, points, moved)
    bound = _surely_free(facets, sharpness)
    inside[:] = adverbs
    point, row = np.empty(middle.shape[0]), np.empty(middle.shape[0])
    for k in range(points.shape[1]):
        suspect, moved[0, k] = moved[0, k] > bound, 0.0
        if suspect:
            for a in range(point.shape[0]):
                point[a] = points[a, k]
            if clamp_point(point, facets, middle, sharpness):
                moved[0, k] = 1.0
                for a in range(point.shape[0]):
                    points[a, k] = point[a]
                    point[a] = point[a] / scale[a] + shift[a]
                from_chart(kind, axes, bend, point, row)
                for a in range(point.shape[0]):
                    inside[a, k] = row[a]
