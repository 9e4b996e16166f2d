"""Method ``barycentric``: linear inside simplices of examples.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 3. What the paper leaves open is decided here:

- *Facets*: neighbours give the same weights from both sides, because Delaunay simplices meet facet to facet. Where
  examples lie on one sphere (every grid does) the triangulation is ambiguous, and Qhull's own choice does not always
  meet facet to facet; a tiny fixed perturbation of the lifted heights, a function of the position alone, decides it.
- *Overlapping authored simplices*: the mean of all that contain the point, each counted by its least barycentric
  coordinate. That is 0 on its facets, so that none enters or leaves with a jump.
- *Outside the hull, and in the gaps between authored simplices*: the nearest point of all simplices. Outside a convex
  set this is continuous; in a gap it jumps where two sides are equally far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from verbs.conventions import F64, I64
from verbs.errors import IllPosedVerb, UnknownName
from verbs.kernels import simplex as kernels
from verbs.verb import Chart, Verb

__all__ = ["Barycentric"]

CHOICES = ("auto", "authored", "delaunay")

FLAT = 1e-6
"""A simplex thinner than this share of its length is flat and is omitted."""

PERTURBATION = 1e-6
"""Largest change of a lifted height; examples closer than this to a common sphere count as lying on it."""

MAX_SIMPLICES = 200_000

_SIMPLICES_PER_EXAMPLE = {1: 1, 2: 2, 3: 7, 4: 32, 5: 186, 6: 1_296}
"""Of uniform points, by dimension: whether a triangulation is affordable is known before Qhull starts."""

_GENERIC = 97.0 * np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0])
"""Directions in which no set of examples is regular."""


@dataclass(frozen=True, slots=True, eq=False)
class Barycentric:
    """Simplices of examples, ready for queries.

    Parameters
    ----------
    chart : Chart
        The domain's: simplices are straight in its normalised coordinates.
    examples : int
        Number N of examples.
    members : (S, D + 1) int64
        Examples at the corners of each simplex.
    corners : (S, D + 1, D) float64
    inverses : (S, D + 1, D + 1) float64
        Matrices from (point, 1) to barycentric coordinates.
    heights : (S, D + 1) float64
        Height of each simplex over each of its facets.
    overlapping : bool
        True for authored simplices, which may overlap.
    """

    chart: Chart
    examples: int
    members: I64
    corners: F64
    inverses: F64
    heights: F64
    overlapping: bool

    @classmethod
    def of_verb(cls, verb: Verb, *, simplices: str = "auto") -> Barycentric:
        """Prepare a verb's simplices.

        Parameters
        ----------
        verb : Verb
        simplices : {"auto", "authored", "delaunay"}
            Those that the verb's author wrote down, those of the Delaunay triangulation in the domain's chart, or the
            former where there are any.

        Raises
        ------
        UnknownName
            If there is no such choice.
        IllPosedVerb
            If there are no authored simplices, or the examples cannot be triangulated.
        """
        if simplices not in CHOICES:
            raise UnknownName("choice of simplices", simplices, CHOICES)
        chart = verb.domain.chart
        points = chart.points(verb.values)
        authored = simplices == "authored" or (simplices == "auto" and bool(verb.provenance.get("simplices")))
        chosen = _authored(verb) if authored else _delaunay(verb, points)
        members = np.ascontiguousarray(chosen[_thickness(points[chosen]) > FLAT])
        if not len(members):
            raise IllPosedVerb(f"verb '{verb.name}': every simplex of its examples is flat; spread the examples out")
        corners = points[members]
        ones = np.ones((*members.shape, 1))
        inverses = np.linalg.inv(np.concatenate([corners, ones], axis=2).transpose(0, 2, 1))
        heights = 1.0 / np.linalg.norm(inverses[..., :-1], axis=2)
        return cls(chart, len(points), members, corners, np.ascontiguousarray(inverses), heights, authored)

    def weights(self, adverbs: F64) -> F64:
        """Weights (B, N) at adverbs (B, D), between 0 and 1; those of an example, at the example, are a unit vector.

        The latter holds for every example that is a corner of some simplex and inside no other.
        """
        points, out = self.chart.points(adverbs), np.empty((len(adverbs), self.examples))
        kernels.barycentric(points, self.members, self.corners, self.inverses, self.heights, self.overlapping, out)
        return out


def _thickness(corners: F64) -> F64:
    """Least by largest singular value (S,) of the edges of simplices with corners (S, D + 1, D)."""
    sizes = np.linalg.svd(corners[:, 1:] - corners[:, :1], compute_uv=False)
    return np.asarray(sizes[:, -1] / np.maximum(sizes[:, 0], 1e-300))


def _authored(verb: Verb) -> I64:
    """Authored simplices (S, D + 1), checked again: an artifact may come from anywhere."""
    rows: Any = verb.provenance.get("simplices", ())
    count, width = len(verb.examples), len(verb.adverbs) + 1
    if not isinstance(rows, (list, tuple)) or not rows:
        raise IllPosedVerb(f"verb '{verb.name}' has no authored simplices; add 'simplices' to its verb.toml")
    for row in rows:
        fits = isinstance(row, (list, tuple)) and len(row) == width and all(type(item) is int for item in row)
        if not fits or len(set(row)) != width or not all(0 <= item < count for item in row):
            raise IllPosedVerb(f"verb '{verb.name}': simplex {row!r:.60} is not {width} different examples")
    return np.array(rows, np.int64)


def _delaunay(verb: Verb, points: F64) -> I64:
    """Delaunay simplices (S, D + 1) of points (N, D): the lower hull of the points lifted to a paraboloid."""
    count, dims = points.shape
    if dims not in _SIMPLICES_PER_EXAMPLE or count * _SIMPLICES_PER_EXAMPLE[dims] > MAX_SIMPLICES:
        raise IllPosedVerb(
            f"verb '{verb.name}': {count} examples in {dims} dimensions have too many simplices; write the ones to use "
            "into its verb.toml, or choose another method"
        )
    if count == dims + 1:
        return np.arange(count)[None]
    if dims == 1:
        order = np.argsort(points[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]], axis=1)
    heights = (points**2).sum(axis=1) + PERTURBATION * np.sin(points @ _GENERIC[:dims])
    try:
        hull = ConvexHull(np.column_stack([points, heights]))
    except QhullError:  # lifted examples in one plane, such as the corners of a box
        return _any_delaunay(verb, points)
    lower = np.sort(hull.simplices[hull.equations[:, -2] < -1e-9], axis=1)
    return np.asarray(lower[np.lexsort(lower.T[::-1])], np.int64)  # in an order that does not hang on Qhull's


def _any_delaunay(verb: Verb, points: F64) -> I64:
    """Delaunay simplices (S, D + 1) where many are equally good, as Qhull chooses them."""
    try:
        return np.asarray(np.sort(Delaunay(points).simplices, axis=1), np.int64)
    except QhullError as err:
        raise IllPosedVerb(f"verb '{verb.name}': its examples cannot be triangulated; spread them out") from err
