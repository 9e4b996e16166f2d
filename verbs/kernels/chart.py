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
from verbs.kernels.compile import kernel

__all__ = [
    "CHARTS",
    "CYLINDER",
    "IDENTITY",
    "PLANAR",
    "ChartArrays",
    "DomainArrays",
    "clamp",
    "clamp_point",
    "denormalise",
    "from_chart",
    "gauge",
    "normalise",
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
def gauge(point: F64, facets: F64, middle: F64, sharpness: float) -> float:
    """Smooth gauge of a point (D,) against facets (F, D) about ``middle`` (D,): 1 on the hull's surface.

    The maximum of A (u − c) over facets, softened to a norm of order ``sharpness``. Where k facets meet it overstates
    by k^(1/sharpness); authoring chooses the order so that no point of the hull passes :data:`FREE_GAUGE`.
    """
    top = 0.0
    for f in range(facets.shape[0]):
        value = 0.0
        for a in range(point.shape[0]):
            value += facets[f, a] * (point[a] - middle[a])
        top = max(top, value)
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
