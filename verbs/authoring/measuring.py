"""The measure that a source names: its joint, keytime and adverbs resolved, its units checked."""

from __future__ import annotations

import numpy as np

from verbs.adverb_measure import Span
from verbs.authoring import apex
from verbs.authoring.own_measures import own_measure
from verbs.authoring.source import Source
from verbs.conventions import F64, I64
from verbs.errors import SourceError, UnknownName
from verbs.kernels import measure as measures
from verbs.motion import Motion
from verbs.units import dimension, known_of, si
from verbs.verb import Measure

__all__ = ["measure_of"]

_DIMENSIONS = {
    measures.POSITION: ("length", "length", "length"),
    measures.JUMP: ("length", "angle", "length"),
    measures.VELOCITY: ("speed", "angular speed", "speed"),
}


def measure_of(
    source: Source, motions: list[Motion], keytimes: F64, phases: F64, stances: tuple[Span, ...] = ()
) -> Measure:
    """The measure that verb.toml names.

    Parameters
    ----------
    source : Source
    motions : list of Motion, length N
        With one skeleton.
    keytimes, phases : (N, M), (M,) float64
        Seconds from the start of each file, and their canonical phases.
    stances : tuple of Span
        Where feet stand in every example.

    Raises
    ------
    SourceError
        If the measure lacks a joint, a keytime or adverbs, or an adverb's unit does not fit it.
    """
    axes = np.array([k for k, adverb in enumerate(source.adverbs) if not adverb.style], np.int64)
    kind, zero = measures.MEASURES[source.measure], np.zeros(3)
    try:
        effector = motions[0].skeleton.index(source.effector) if source.effector else 0
    except UnknownName as err:
        raise SourceError(source.path, f"effector: {err}") from err
    if kind == measures.ADVERBS:
        return own_measure(source, motions, keytimes, phases, effector, stances)
    if kind == measures.NOTHING:
        return Measure(kind, effector, -1, axes[:0], zero, np.zeros((3, 0)))
    if (kind == measures.VELOCITY) != source.looping:
        needed = "true" if kind == measures.VELOCITY else "false"
        raise SourceError(source.path, f"measure '{source.measure}' needs looping = {needed}")
    factors = np.array([si(source.adverbs[a].unit) for a in axes])
    if kind == measures.POSITION:
        origin, frame = _position(source, axes)
        return Measure(kind, effector, source.effector_keytime, axes, origin, frame * factors)
    if len(axes) != 3:
        raise SourceError(source.path, f"measure '{source.measure}' needs exactly three measured adverbs")
    _check_units(source, kind, axes)
    keytime = source.keytime_names.index(apex.NAME) if kind == measures.JUMP else -1
    return Measure(kind, effector, keytime, axes, zero, np.diag(factors))


def _position(source: Source, axes: I64) -> tuple[F64, F64]:
    """Origin (3,) and frame (3, m), in SI, of a joint position: of [goal], or of the axes that the adverbs are."""
    if source.effector_keytime < 0 or source.effector is None:
        raise SourceError(source.path, "measure 'joint_position' needs effector and effector_keytime_index")
    if source.goal:
        frame = np.array(source.goal[1:]).T
        if np.linalg.matrix_rank(frame) < len(axes):
            raise SourceError(source.path, "the axes of [goal] must be independent of each other")
        return np.array(source.goal[0]), frame
    _check_units(source, measures.POSITION, axes)
    if len(axes) == 3:
        return np.zeros(3), np.eye(3)
    names = [source.adverbs[a].name for a in axes]
    if not names or not set(names) <= {"x", "y", "z"}:
        raise SourceError(
            source.path, "measure 'joint_position' needs three measured adverbs, or fewer called x, y or z"
        )
    return np.zeros(3), np.array([[1.0 if name == axis else 0.0 for name in names] for axis in "xyz"])


def _check_units(source: Source, kind: int, axes: I64) -> None:
    """Refuse a measured adverb whose unit is not one of what is measured; no unit stands for SI."""
    for axis, wanted in zip(axes, _DIMENSIONS[kind], strict=False):
        adverb = source.adverbs[axis]
        if dimension(adverb.unit) not in ("none", wanted):
            raise SourceError(
                source.path,
                f"measure '{source.measure}' takes adverb '{adverb.name}' as a {wanted}, but its unit is "
                f"'{adverb.unit}'; use {' or '.join(known_of(wanted))}",
            )
