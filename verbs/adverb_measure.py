"""The measure that one adverb names for itself: a number in SI of a blended motion, at one or two instants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.errors import IllPosedVerb
from verbs.units import SI_UNITS

__all__ = ["FORMS", "AdverbMeasure", "Form", "Span", "error_unit"]

MAX_SPANS = 64
MAX_ANGLE_RAD = 1e3


@dataclass(frozen=True, slots=True)
class Form:
    """What a kind of measure consists of.

    Parameters
    ----------
    axes : mapping of str to (str, str)
        Names of its axes in ``verb.toml``; for each the component and the dimension, which are names of
        :data:`verbs.kernels.adverb_measures.COMPONENTS` and of :func:`verbs.units.dimension`.
    default : str
        Axis where none is named; empty where one must be.
    joint : bool
        Whether it names a joint.
    at, between : bool
        Whether it is taken at one instant, and between two.
    """

    axes: Mapping[str, tuple[str, str]]
    default: str = ""
    joint: bool = True
    at: bool = False
    between: bool = False


def _vector(dimension: str) -> dict[str, tuple[str, str]]:
    return {axis: (axis, dimension) for axis in "xyz"}


_ANGLES = {name: (name, "angle") for name in ("yaw", "pitch", "roll", "azimuth", "elevation")}
_TRAVEL = {name: (name, "length") for name in ("forward", "sideways", "rise")}

FORMS: dict[str, Form] = {
    "position": Form(_vector("length"), at=True),
    "velocity": Form(_vector("speed"), at=True, between=True),
    "speed": Form({"speed": ("magnitude", "speed")}, "speed", at=True, between=True),
    "orientation": Form(_ANGLES, at=True),
    "angular_velocity": Form(
        _vector("angular speed") | {"speed": ("magnitude", "angular speed")}, at=True
    ),
    "displacement": Form(
        _vector("length") | {"distance": ("magnitude", "length"), "direction": ("azimuth", "angle")}, between=True
    ),
    "root_motion": Form(
        _TRAVEL | {"distance": ("magnitude", "length"), "turn": ("turn", "angle")}, joint=False, between=True
    ),
    "foot_speed": Form(
        {"speed": ("magnitude", "speed"), "forward": ("forward", "speed"), "sideways": ("sideways", "speed")},
        "speed", joint=False, between=True,
    ),
    "time_to": Form({"time": ("magnitude", "time")}, "time", joint=False, between=True),
    "duration": Form({"time": ("magnitude", "time")}, "time", joint=False, between=True),
}  # fmt: skip
"""Every kind of measure that an adverb may name."""


@dataclass(frozen=True, slots=True)
class Span:
    """A joint (its index) at a canonical phase, or from one phase to a later ``end``."""

    joint: int
    begin: float
    end: float | None = None


@dataclass(frozen=True, slots=True)
class AdverbMeasure:
    """What one adverb measures.

    Parameters
    ----------
    kind, axis : str
        A name of :data:`FORMS`, and one of its axes.
    spans : tuple of Span
        One; several only for ``foot_speed``, one for each stance. Phases are knots of canonical time.
    factor : float
        SI per unit of the adverb.
    center : float
        An angle is measured within half a turn of it, rad.
    base : (4,) floats
        The quaternion that makes a rotation one since the examples' mean start, of the joint or of the root; for the
        azimuth and elevation of a bone its direction in the joint's frame, and a zero.
    """

    kind: str
    axis: str
    spans: tuple[Span, ...]
    factor: float
    center: float = 0.0
    base: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @property
    def component(self) -> str:
        """Name of the component, of :data:`verbs.kernels.adverb_measures.COMPONENTS`."""
        return FORMS[self.kind].axes[self.axis][0]

    @property
    def dimension(self) -> str:
        """Dimension of the measured number."""
        return FORMS[self.kind].axes[self.axis][1]

    def check(self, joints: int, intervals: int) -> None:
        """Raise :class:`IllPosedVerb` where a field is impossible in a verb with so many joints and intervals."""
        form = FORMS.get(self.kind)
        _check(form is not None and self.axis in form.axes, f"measure '{self.kind:.40}' with axis '{self.axis:.40}'")
        assert form is not None
        several = MAX_SPANS if self.kind == "foot_speed" else 1
        _check(1 <= len(self.spans) <= several, f"measure '{self.kind}' has {len(self.spans)} spans")
        for span in self.spans:
            fits = form.at if span.end is None else form.between
            _check(fits, f"measure '{self.kind}' {'needs' if span.end is None else 'has no'} end of its span")
            _check(0 <= span.joint < joints, f"measure '{self.kind}' of joint {span.joint}, which does not exist")
            ends = (span.begin,) if span.end is None else (span.begin, span.end)
            _check(all(0.0 <= phase <= 1.0 for phase in ends) and ends[0] <= ends[-1], "a phase outside the motion")
            _check(len(set(ends)) == len(ends), "a span without length")
            knots = np.array(ends) * intervals
            _check(bool(np.abs(knots - np.round(knots)).max() < 1e-6), "a measured phase between two samples")
        _check(math.isfinite(self.factor) and 0.0 < self.factor <= 1e9, "SI per unit must be positive")
        _check(abs(self.center) <= MAX_ANGLE_RAD, "the centre of an angle")  # NaN compares false
        square = sum(number * number for number in self.base)
        _check(len(self.base) == 4 and abs(square - 1.0) < 1e-6, "a measure's base must have length 1")


def _check(holds: bool, problem: str) -> None:
    if not holds:
        raise IllPosedVerb(problem)


def error_unit(measures: tuple[AdverbMeasure, ...]) -> str:
    """Unit of the error of several measures: that of their dimension if they share one, otherwise ``SI``."""
    dimensions = {one.dimension for one in measures}
    return SI_UNITS[dimensions.pop()] if len(dimensions) == 1 else "SI"
