"""A verb: everything that evaluating a parameterised motion needs, as arrays."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from verbs.adverb_measure import AdverbMeasure, error_unit
from verbs.contacts import Contacts
from verbs.conventions import F32, F64, I64, MAX_ADVERBS, MAX_EXAMPLES, MAX_KEYS, MAX_KEYTIMES, freeze
from verbs.errors import IllPosedVerb, UnknownName
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.compile import direct
from verbs.kernels.radial_basis import RADIAL_BASES, BasisArrays
from verbs.skeleton import Skeleton

NAME = re.compile(r"[a-z][a-z0-9_-]{0,62}")
"""Names of verbs: they are parts of addresses, file names and metric labels."""


_normalise, _denormalise = direct(charts.normalise), direct(charts.denormalise)


def _check(holds: bool, problem: str) -> None:
    if not holds:
        raise IllPosedVerb(problem)


def _set_arrays(instance: Chart | Domain | Basis, arrays: tuple[Any, ...]) -> None:
    object.__setattr__(instance, "arrays", arrays)


@dataclass(frozen=True, slots=True)
class Adverb:
    """One parameter of a verb.

    Parameters
    ----------
    name, unit, description : str
        Name, unit, and meaning.
    style : bool
        True where the motion cannot be measured for it ("tired"), False where it can (a wrist position).
    minimum, maximum : float
        Range over the examples, in its unit.
    """

    name: str
    unit: str
    description: str
    style: bool
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Where distances between adverbs are taken: a bend of the axes, then a shift and a scale.

    Parameters
    ----------
    kind : int
        A number of :data:`verbs.kernels.chart.CHARTS`.
    axes : (3,) int64
        Adverbs that bend.
    bend : (4,) float64
        The cylinder's axis x, z, cut (rad) and unrolling radius, lengths in the unit of the adverbs; or first the
        radians per unit of a planar direction, where 0 stands for 1.
    shift, scale : (D,) float64
        Normalised coordinates are (bent adverbs - shift) · scale.
    arrays : ChartArrays
        All of these, for kernels.
    """

    kind: int
    axes: I64
    bend: F64
    shift: F64
    scale: F64
    arrays: charts.ChartArrays = field(init=False, repr=False)

    def __post_init__(self) -> None:
        freeze(self)
        _set_arrays(self, charts.ChartArrays(self.kind, self.axes, self.bend, self.shift, self.scale))
        dims = len(self.shift)
        _check(self.kind in charts.CHARTS.values(), f"chart number {self.kind} does not exist")
        _check(self.axes.shape == (3,) and self.bend.shape == (4,), "a chart has 3 axes and 4 bend numbers")
        _check(self.kind == charts.IDENTITY or bool(np.all((self.axes >= 0) & (self.axes < dims))), "chart axis")
        _check(self.scale.shape == (dims,) and bool(np.all(self.scale > 0)), "a chart's scales must be positive")
        _check(self.kind != charts.CYLINDER or self.bend[3] > 0, "a cylinder's radius must be positive")

    def points(self, adverbs: F64) -> F64:
        """Normalised chart points (..., D) of adverbs (..., D)."""
        return self._through(_normalise, adverbs)

    def adverbs(self, points: F64) -> F64:
        """Adverbs (..., D) of normalised chart points (..., D)."""
        return self._through(_denormalise, points)

    def _through(self, kernel: Callable[..., None], rows: F64) -> F64:
        flat = np.ascontiguousarray(rows, np.float64).reshape(-1, len(self.shift))
        out = np.empty(flat.shape)
        kernel(flat, self.arrays, out)
        return out.reshape(rows.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Domain:
    """The convex hull of the examples in a chart: {u : facets · (u - middle) ≤ 1}.

    Parameters
    ----------
    chart : Chart
    facets : (F, D) float64
    middle : (D,) float64
        A point inside, in normalised chart coordinates.
    sharpness : float
        Order of the smooth maximum over facets.
    arrays : DomainArrays
        All of these, for kernels.
    """

    chart: Chart
    facets: F64
    middle: F64
    sharpness: float
    arrays: charts.DomainArrays = field(init=False, repr=False)

    def __post_init__(self) -> None:
        freeze(self)
        _set_arrays(self, charts.DomainArrays(self.chart.arrays, self.facets, self.middle, self.sharpness))
        dims = len(self.chart.shift)
        _check(self.middle.shape == (dims,), "the domain's middle has the wrong length")
        _check(self.facets.ndim == 2 and self.facets.shape[1] == dims, "the domain's facets have the wrong shape")
        _check(len(self.facets) > dims and 2 <= self.sharpness <= 4096, "the domain has too few facets")


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """A cardinal basis: adverbs in, one weight per example out.

    Parameters
    ----------
    chart : Chart
        Where its distances are taken.
    radial_basis, degree : int
        Radial function (a number of :data:`verbs.kernels.radial_basis.RADIAL_BASES`) and polynomial degree, 0 to 2.
    centers : (C, D) float64
        Examples first, pseudo-examples after them, in normalised chart coordinates.
    radii : (C,) float64
    radial : (C, N) float64
    poly : (L, N) float64
    condition : float
        Condition number of the solved system.
    arrays : BasisArrays
        All but the condition, for kernels.
    """

    chart: Chart
    radial_basis: int
    degree: int
    centers: F64
    radii: F64
    radial: F64
    poly: F64
    condition: float
    arrays: BasisArrays = field(init=False, repr=False)

    def __post_init__(self) -> None:
        freeze(self)
        parts = (self.radial_basis, self.degree, self.centers, self.radii, self.radial, self.poly)
        _set_arrays(self, BasisArrays(self.chart.arrays, *parts))
        count, dims = self.centers.shape
        length = {0: 1, 1: dims + 1, 2: 1 + dims + dims * (dims + 1) // 2}.get(self.degree, -1)
        known = self.radial_basis in RADIAL_BASES.values()
        _check(known, f"radial function number {self.radial_basis} does not exist")
        _check(len(self.chart.shift) == dims, "the basis and its chart differ in dimension")
        _check(self.radii.shape == (count,) and bool(np.all(self.radii > 0)), "radii must be positive")
        _check(self.radial.ndim == 2 and len(self.radial) == count, "radial coefficients have the wrong shape")
        _check(self.poly.shape == (length, self.radial.shape[1]), "polynomial coefficients have the wrong shape")


@dataclass(frozen=True, slots=True, eq=False)
class Measure:
    """How a blend is measured.

    Parameters
    ----------
    kind : int
        A number of :data:`verbs.kernels.measure.MEASURES`.
    effector : int
        Joint whose position matters.
    keytime : int
        Keytime at which a joint position is measured, or a jump's apex; -1 where the whole motion is.
    axes : (m,) int64
        Adverbs that are measured, in the order of the measure.
    origin : (3,) float64
    frame : (3, m) float64
        A position goal is origin + frame · measured adverbs, metres; for other kinds the diagonal holds SI per unit of
        each measured adverb.
    rows : tuple of AdverbMeasure, length m
        What each measured adverb names for itself; empty for other kinds. Origin and frame are then zero.
    """

    kind: int
    effector: int
    keytime: int
    axes: I64
    origin: F64
    frame: F64
    rows: tuple[AdverbMeasure, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def unit(self) -> str:
        """Unit of the error."""
        if self.kind == measures.ADVERBS:
            return error_unit(self.rows)
        return {measures.NOTHING: "", measures.VELOCITY: "m/s"}.get(self.kind, "m")


@dataclass(frozen=True, slots=True, eq=False)
class Verb:
    """A parameterised motion.

    Parameters
    ----------
    name, description : str
    looping : bool
        True where the end of a cycle is the start of the next.
    skeleton : Skeleton
    adverbs : tuple of Adverb, length D
    examples : tuple of str, length N
        Names of the examples.
    values : (N, D) float64
        Adverbs of the examples, measured ones as measured on the stored curves.
    keytime_names : tuple of str, length M
    keytimes : (N, M) float64
        Keytimes of the examples, seconds from the first one.
    phases : (M,) float64
        Canonical time of the keytimes: 0 … 1, multiples of 1 / K.
    curves : (K + 3, N, 4 + 4·J) float32
        Spline coefficients, see :mod:`verbs.kernels.pose`.
    references : (J, 4) float64
        Reference rotation of each joint.
    rotation_mode, root_motion : int
        Numbers of :mod:`verbs.kernels.pose`.
    strides : (K, N, 4) float64
        Steps of a striding root: sideways, forward (m), turn (rad), rise (m); (0, N, 4) where the root's position is
        blended.
    measure : Measure
    domain : Domain
    bases : mapping of str to Basis
        ``"rbf"`` always; others as methods need them.
    quality, provenance : mapping
        JSON values: measured figures, and where the verb came from.
    contacts : Contacts or None
        When the feet stand in the examples; None in a verb without feet, and in files that were written without.
    """

    name: str
    description: str
    looping: bool
    skeleton: Skeleton
    adverbs: tuple[Adverb, ...]
    examples: tuple[str, ...]
    values: F64
    keytime_names: tuple[str, ...]
    keytimes: F64
    phases: F64
    curves: F32
    references: F64
    rotation_mode: int
    root_motion: int
    strides: F64
    measure: Measure
    domain: Domain
    bases: Mapping[str, Basis]
    quality: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    contacts: Contacts | None = None

    def __post_init__(self) -> None:
        freeze(self)
        count, dims, joints, marks = (
            len(self.examples),
            len(self.adverbs),
            len(self.skeleton),
            len(self.phases),
        )
        keys = self.curves.shape[0] - 2
        _check(NAME.fullmatch(self.name) is not None, f"'{self.name}' is not a verb name ({NAME.pattern})")
        _check(1 <= dims <= MAX_ADVERBS and 2 <= count <= MAX_EXAMPLES, "too few or too many adverbs or examples")
        _check(2 <= marks <= MAX_KEYTIMES and 2 <= keys <= MAX_KEYS, "too few or too many keytimes or keys")
        _check(len({adverb.name for adverb in self.adverbs}) == dims, "two adverbs have one name")
        _check(self.values.shape == (count, dims), "values must be examples × adverbs")
        _check(len(self.keytime_names) == marks and self.keytimes.shape == (count, marks), "keytimes")
        _check(bool(np.all(np.diff(self.keytimes, axis=1) > 0)), "keytimes must rise")
        _check(bool(np.all(np.diff(self.phases) > 0)), "phases must rise")
        _check(self.phases[0] == 0.0 and self.phases[-1] == 1.0, "phases run from 0 to 1")
        _check(self.curves.shape[1:] == (count, 4 + 4 * joints), "curves must be keys × examples × channels")
        _check(self.references.shape == (joints, 4), "references must be joints × 4")
        _check(self.rotation_mode in (poses.NLERP, poses.ROTATION_VECTOR), "unknown rotation mode")
        striding = self.root_motion == poses.STRIDE
        _check(striding or self.root_motion == poses.ABSOLUTE, "unknown root motion")
        _check(
            self.strides.shape == ((keys - 1) * striding, count, 4),
            "strides must be intervals × examples × 4",
        )
        self._check_measure(dims, joints, marks)
        _check(len(self.domain.chart.shift) == dims, "the domain has another dimension than the adverbs")
        _check("rbf" in self.bases, "the basis 'rbf' is missing")
        for name, basis in self.bases.items():
            fits = basis.centers.shape[1] == dims and basis.radial.shape[1] == count
            _check(fits, f"basis '{name}' does not fit the examples")
        if self.contacts is not None:
            self._check_contacts(self.contacts, count, joints)

    def _check_contacts(self, contacts: Contacts, count: int, joints: int) -> None:
        shape = (self.intervals + 1, count, len(contacts))
        _check(contacts.values.shape == shape, "contacts must be keys × examples × points")
        for indices in (contacts.feet, contacts.joints):
            _check(bool(np.all((indices >= 0) & (indices < joints))), "contacts of a joint that does not exist")
        within = self.looping or bool(np.all(contacts.intervals[:, 1] <= 1.0))
        _check(within, "a contact ends after the motion")

    def _check_measure(self, dims: int, joints: int, marks: int) -> None:
        measure = self.measure
        _check(measure.kind in measures.MEASURES.values(), "unknown measure")
        _check(0 <= measure.effector < joints and -1 <= measure.keytime < marks, "effector or its keytime")
        inside = bool(np.all((measure.axes >= 0) & (measure.axes < dims)))
        _check(inside and measure.frame.shape == (3, len(measure.axes)), "measured adverbs")
        _check(measure.origin.shape == (3,), "the measure's origin has three numbers")
        marked = measure.kind not in (measures.POSITION, measures.JUMP) or measure.keytime >= 0
        _check(marked, "a joint position needs its keytime, and a jump its apex")
        absolute = self.root_motion == poses.ABSOLUTE
        _check(
            measure.kind not in (measures.POSITION, measures.JUMP) or absolute,
            "a position needs an absolute root",
        )
        _check(
            measure.kind != measures.VELOCITY or self.root_motion == poses.STRIDE,
            "root velocity needs strides",
        )
        own = measure.kind == measures.ADVERBS
        _check(len(measure.rows) == (len(measure.axes) if own else 0), "measures of adverbs")
        _check(not own or 1 <= len(measure.rows) == len(set(measure.axes.tolist())), "an adverb measured twice")
        for row in measure.rows:
            row.check(joints, self.intervals)

    @property
    def intervals(self) -> int:
        """Number K of intervals between canonical samples."""
        return int(self.curves.shape[0]) - 3

    def adverb_index(self, name: str) -> int:
        """Index of an adverb by name; raises :class:`UnknownName` with the names that exist."""
        names = [adverb.name for adverb in self.adverbs]
        if name not in names:
            raise UnknownName("adverb", name, names)
        return names.index(name)
