"""Charts, domains and cardinal bases of examples.

Source: Rose, Sloan, Cohen 2001, section 3.1 (equations 2 and 4, and the systems after them).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError
from scipy.spatial import ConvexHull, QhullError

from verbs.conventions import F64, I64
from verbs.errors import IllPosedVerb
from verbs.kernels import chart as charts
from verbs.kernels import radial_basis
from verbs.units import dimension, si
from verbs.verb import Basis, Chart, Domain

__all__ = ["cardinal", "chart_of", "domain_of", "smooth", "solve_smooth"]

HULL_DIMENSIONS = 6
"""Above this a convex hull has too many facets; the domain is the bounding box instead."""

SMOOTH_SHARE = 0.2
"""The multiquadric's c in median nearest-neighbour distances; see ``docs/math.md``, "Kernel and chart"."""

_FREE_AXES = np.zeros(3, np.int64)


def chart_of(
    values: F64,
    units: tuple[str, ...],
    *,
    kind: int = charts.IDENTITY,
    axes: I64 | None = None,
    bend: F64 | None = None,
) -> Chart:
    """Chart of examples with adverbs ``values`` (N, D), scaled so that adverbs of different dimensions compare.

    Adverbs of one dimension share the scale of the largest range; where dimensions differ each has its own. An adverb
    that does not vary gets the scale 1: any other value of it then lies off the examples, not at infinity.
    """
    dims = values.shape[1]
    where = _FREE_AXES if axes is None else np.asarray(axes, np.int64)
    bend = np.zeros(4) if bend is None else bend
    plain = Chart(kind, where, bend, np.zeros(dims), np.ones(dims))
    bent = plain.points(values)
    if kind == charts.PLANAR:  # a direction becomes a coordinate like the distance
        units = tuple(units[where[0]] if k == where[1] else unit for k, unit in enumerate(units))
    low, high = bent.min(axis=0), bent.max(axis=0)
    span = high - low
    if len({dimension(unit) for unit in units}) == 1:
        factors = np.array([si(unit) for unit in units])
        span = (factors * span).max() / factors
    return Chart(kind, where, bend, 0.5 * (low + high), 1.0 / np.where(span > 0, span, 1.0))


def domain_of(chart: Chart, values: F64) -> Domain:
    """Convex hull of the examples in a chart, ready for the smooth clamp."""
    points = chart.points(values)
    dims = points.shape[1]
    if dims == 1 or dims > HULL_DIMENSIONS:
        low, high = points.min(axis=0), points.max(axis=0)
        middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
        facets = np.concatenate([np.diag(1.0 / half), np.diag(-1.0 / half)])
    else:
        try:
            hull = ConvexHull(points)
        except QhullError as err:  # _check_spread refuses flat sets: this one is nearly flat
            raise IllPosedVerb("the examples lie almost in one plane of the adverb space; spread them out") from err
        middle = points[hull.vertices].mean(axis=0)
        # Qhull splits a facet with many corners into simplices that share one plane: keep each plane once.
        planes = hull.equations[np.unique(np.round(hull.equations, 9), axis=0, return_index=True)[1]]
        facets = planes[:, :-1] / -(planes[:, :-1] @ middle + planes[:, -1])[:, None]
    return Domain(chart, np.ascontiguousarray(facets), middle, _sharpness(points, facets, middle))


def _sharpness(points: F64, facets: F64, middle: F64) -> float:
    """Least order, 24 or more, at which no example's smooth gauge comes near the limit of free movement."""
    limit = 1.0 + 0.75 * (charts.FREE_GAUGE - 1.0)
    order = 24.0
    while order < 2048 and max(charts.gauge(point, facets, middle, order) for point in points) > limit:
        order *= 2.0
    return order


def cardinal(
    chart: Chart,
    values: F64,
    *,
    function: int = radial_basis.BSPLINE,
    degree: int = 1,
    radii: F64 | None = None,
    names: tuple[str, ...] = (),
) -> Basis:
    """Cardinal basis of examples at adverbs ``values`` (N, D), exactly as seed 1 §3.1 by default.

    The polynomial part is fitted first in the least-squares sense to the identity; the radial part then takes up
    what is left, so that each weight is 1 at its own example and 0 at the others. Radii default to the distance to
    the nearest other example, which makes the B-spline's support twice that.

    Raises
    ------
    IllPosedVerb
        If two examples have the same adverbs, or the system cannot be solved; names the examples.
    """
    points = chart.points(values)
    count = len(points)
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    nearest = np.where(np.eye(count, dtype=bool), np.inf, distances)
    if nearest.min() < 1e-9:
        first, second = np.unravel_index(np.argmin(nearest), nearest.shape)
        pair = [names[k] if names else str(k) for k in (first, second)]
        raise IllPosedVerb(
            f"examples '{pair[0]}' and '{pair[1]}' have the same adverbs; leave one out, or add an adverb that differs"
        )
    sizes = nearest.min(axis=1) if radii is None else radii
    system = radial_basis.radial_matrix(function, points, points, sizes)
    powers = radial_basis.polynomial_matrix(points, degree)
    poly = np.asarray(np.linalg.lstsq(powers, np.eye(count), rcond=None)[0], np.float64)
    try:
        radial = np.linalg.solve(system, np.eye(count) - powers @ poly)
    except LinAlgError as err:
        raise IllPosedVerb("the radial system is singular; examples lie too close to each other") from err
    return Basis(
        chart, function, degree, points, sizes, np.asarray(radial, np.float64), poly, float(np.linalg.cond(system))
    )


def smooth(
    chart: Chart,
    values: F64,
    *,
    share: float = SMOOTH_SHARE,
    degree: int = 1,
    names: tuple[str, ...] = (),
) -> Basis:
    """Smooth cardinal basis for correction: multiquadric with c = ``share`` × median nearest-neighbour distance.

    Solved with its polynomial part, affine or (degree 0) constant, in one system, so that the radial part is orthogonal
    to it.

    Raises
    ------
    IllPosedVerb
        If the system cannot be solved.
    """
    points = chart.points(values)
    count = len(points)
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    nearest = np.where(np.eye(count, dtype=bool), np.inf, distances).min(axis=1)
    try:
        return solve_smooth(chart, points, np.eye(count), radius=share * float(np.median(nearest)), degree=degree)
    except LinAlgError as err:
        some = f" among {', '.join(names[:3])} …" if names else ""
        raise IllPosedVerb(f"the smooth system is singular; examples lie too close to each other{some}") from err


def solve_smooth(chart: Chart, points: F64, targets: F64, *, radius: float, degree: int) -> Basis:
    """Multiquadric basis with weights ``targets`` (C, N) at centers ``points`` (C, D): [Φ Π; Πᵀ 0] [ρ; α] = [T; 0].

    Raises
    ------
    numpy.linalg.LinAlgError
        If the system is singular.
    """
    count = len(points)
    radii = np.full(count, radius)
    radial = radial_basis.radial_matrix(radial_basis.MULTIQUADRIC, points, points, radii)
    powers = radial_basis.polynomial_matrix(points, degree)
    width = powers.shape[1]
    system = np.block([[radial, powers], [powers.T, np.zeros((width, width))]])
    right = np.concatenate([targets, np.zeros((width, targets.shape[1]))])
    solved = np.linalg.solve(system, right)
    condition = float(np.linalg.cond(system))
    return Basis(
        chart, radial_basis.MULTIQUADRIC, degree, points, radii, solved[:count].copy(), solved[count:].copy(), condition
    )
