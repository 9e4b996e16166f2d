"""Charts: the coordinates in which an adverb space is convex, scaled and clamped.

A chart maps D adverbs to D chart coordinates; three of them may bend, the others pass through:

- ``identity``: nothing bends.
- ``cylinder``: a position (x, y, z) becomes (R·φ, y, r) about a vertical axis, φ measured from the largest gap
  between the examples, so that verbs that surround the body do not blend through it.
- ``planar``: (distance, direction, height) becomes (distance·sin, distance·cos, height), so that a direction lives
  on its circle and does not matter at distance 0.

The domain is the convex hull of the examples in the chart, {u : A (u − c) ≤ 1}.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = ["CHARTS", "CYLINDER", "IDENTITY", "PLANAR", "clamp", "from_chart", "gauge", "to_chart"]

IDENTITY, CYLINDER, PLANAR = range(3)

CHARTS = {"identity": IDENTITY, "cylinder": CYLINDER, "planar": PLANAR}
"""Chart numbers as the artifact stores them; never renumber."""

FREE_GAUGE = 1.08
"""Up to this gauge (1 is the hull's surface) a point is left where it is."""

LAST_GAUGE = 1.25
"""No clamped point lies farther out than this."""


@kernel
def to_chart(kind: int, axes: I64, bend: F64, adverbs: F64, out: F64) -> None:
    """Chart coordinates (D,) of adverbs (D,).

    ``axes`` (3,) are the adverbs that bend; ``bend`` (4,) holds the cylinder's axis x and z, the angle of its cut
    (radians) and its unrolling radius R (m).
    """
    for a in range(adverbs.shape[0]):
        out[a] = adverbs[a]
    if kind == CYLINDER:
        x, z = adverbs[axes[0]] - bend[0], adverbs[axes[2]] - bend[1]
        out[axes[0]] = bend[3] * ((np.arctan2(x, z) - bend[2]) % (2.0 * np.pi))
        out[axes[2]] = np.sqrt(x * x + z * z)
    elif kind == PLANAR:
        distance, direction = adverbs[axes[0]], adverbs[axes[1]]
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
        out[axes[1]] = np.arctan2(x, z) if x != 0.0 or z != 0.0 else 0.0


@kernel
def gauge(point: F64, facets: F64, middle: F64, sharpness: float) -> float:
    """Smooth gauge of a point (D,) against facets (F, D) about ``middle`` (D,): 1 on the hull's surface.

    The maximum of A (u − c) over facets, softened to a norm of order ``sharpness``. Where k facets meet it overstates
    by k^(1/sharpness); the build chooses the order so that no point of the hull passes :data:`FREE_GAUGE`.
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
def clamp(point: F64, facets: F64, middle: F64, sharpness: float) -> bool:
    """Draw a point (D,) that lies far outside the hull back to its surroundings, in place; say whether it moved.

    The identity up to gauge 1.08, then a hyperbolic tangent that never passes 1.25: twice differentiable, so that
    a goal that wanders off does not make the character jerk.
    """
    value = gauge(point, facets, middle, sharpness)
    if value <= FREE_GAUGE:
        return False
    span = LAST_GAUGE - FREE_GAUGE
    shrink = (FREE_GAUGE + span * np.tanh((value - FREE_GAUGE) / span)) / value
    for a in range(point.shape[0]):
        point[a] = middle[a] + (point[a] - middle[a]) * shrink
    return True
