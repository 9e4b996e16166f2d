"""Measures that each adverb names for itself: their values and derivatives in the weights.

Every row is a number in SI: a coordinate, a speed, an angle or a time of one joint at one or two knots of canonical
time. Rows need a vector (3,) and its Jacobian (3, N) first, then one component of it.

Source: ``docs/math.md``, section "Measures of adverbs".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.clock_rates import Times, blended_times, times_of
from verbs.kernels.compile import kernel
from verbs.kernels.pose import add_rotated, multiply
from verbs.kernels.sites import Motion, Sites, motion_of, move_site
from verbs.kernels.timewarp import Clock
from verbs.kernels.travelling import Places, places_of, travel_places

__all__ = ["COMPONENTS", "KINDS", "AdverbProblem", "AdverbScratch", "measure_adverbs", "measured_adverbs", "scratch_of"]

(POSITION, VELOCITY, SPEED, ORIENTATION, ANGULAR_VELOCITY, DISPLACEMENT, ROOT_MOTION, FOOT_SPEED, TIME_TO,
 DURATION) = range(10)  # fmt: skip

KINDS = {
    "position": POSITION, "velocity": VELOCITY, "speed": SPEED, "orientation": ORIENTATION,
    "angular_velocity": ANGULAR_VELOCITY, "displacement": DISPLACEMENT, "root_motion": ROOT_MOTION,
    "foot_speed": FOOT_SPEED, "time_to": TIME_TO, "duration": DURATION,
}  # fmt: skip
"""Kinds of measures by name; the artifact stores names."""

(X, Y, Z, MAGNITUDE, AZIMUTH, ELEVATION, YAW, PITCH, ROLL, FORWARD, SIDEWAYS, TURN, RISE) = range(13)

COMPONENTS = {
    "x": X, "y": Y, "z": Z, "magnitude": MAGNITUDE, "azimuth": AZIMUTH, "elevation": ELEVATION, "yaw": YAW,
    "pitch": PITCH, "roll": ROLL, "forward": FORWARD, "sideways": SIDEWAYS, "turn": TURN, "rise": RISE,
}  # fmt: skip
"""Components by name; the artifact stores names."""

LEAST = 1e-12
"""Lengths (m, m/s) below which a direction has no derivative."""


class AdverbProblem(NamedTuple):
    """Everything that m measures need besides weights.

    Parameters
    ----------
    clock : Clock
    strides : (K, N, 4) float64
        Without rows where the root's position is blended.
    phases, knots : (P,) float64, (P,) int64
        Instants that are measured at, and the same as numbers of intervals.
    sites : Sites
    kinds, components : (m,) int64
        Numbers of :data:`KINDS` and :data:`COMPONENTS`.
    firsts : (m + 1,) int64
        Spans of row r are firsts[r] to firsts[r + 1].
    spans : (R, 6) int64
        Instant, site and site of the root where a span begins, then where it ends; -1 where there is none.
    centers : (m,) float64
        Angles are measured within half a turn of these, rad.
    bases : (m, 4) float64
        The quaternion that makes a rotation one since the examples' mean start: of the joint for an orientation, of the
        root where its heading counts; or the direction of a bone in the joint's frame, and a zero.
    """

    clock: Clock
    strides: F64
    phases: F64
    knots: I64
    sites: Sites
    kinds: I64
    components: I64
    firsts: I64
    spans: I64
    centers: F64
    bases: F64


class AdverbScratch(NamedTuple):
    """Scratch arrays: times, places and motion; two vectors (2, 3) and headings (2,), with their derivatives."""

    times: Times
    places: Places
    motion: Motion
    vector: F64
    d_vector: F64
    heading: F64
    d_heading: F64


@kernel
def scratch_of(problem: AdverbProblem) -> AdverbScratch:
    """Scratch arrays for a problem."""
    count, instants = problem.clock.log_lengths.shape[0], problem.phases.shape[0]
    return AdverbScratch(
        times_of(instants, count), places_of(instants, count), motion_of(problem.sites.instants.shape[0], count),
        np.empty((2, 3)), np.empty((2, 3, count)), np.empty(2), np.empty((2, count)),
    )  # fmt: skip


@kernel
def _near(angle: float, center: float) -> float:
    """The angle plus whole turns, within half a turn of a center."""
    return angle - 2.0 * np.pi * np.floor((angle - center) / (2.0 * np.pi) + 0.5)


@kernel
def _difference(motion: Motion, begin: int, end: int, vector: F64, d_vector: F64) -> None:
    """Position of one site minus that of another, with its Jacobian."""
    for a in range(3):
        vector[a] = motion.positions[end, a] - motion.positions[begin, a]
        for i in range(d_vector.shape[1]):
            d_vector[a, i] = motion.d_positions[end, a, i] - motion.d_positions[begin, a, i]


@kernel
def _over_time(vector: F64, d_vector: F64, seconds: float, d_seconds: F64) -> None:
    """Divide a vector and its Jacobian by seconds (or seconds per phase) and their derivatives (N,), in place."""
    for a in range(vector.shape[0]):
        vector[a] /= seconds
        for i in range(d_vector.shape[1]):
            d_vector[a, i] = (d_vector[a, i] - vector[a] * d_seconds[i]) / seconds


@kernel
def _velocity(span: I64, times: Times, motion: Motion, vector: F64, d_vector: F64) -> None:
    """Velocity of a site (m/s), or its mean velocity over a span."""
    if span[4] < 0:
        vector[:], d_vector[:] = motion.velocities[span[1]], motion.d_velocities[span[1]]
        _over_time(vector, d_vector, times.rates[span[0]], times.d_rates[span[0]])
        return
    _difference(motion, span[1], span[4], vector, d_vector)
    seconds = times.seconds[span[3]] - times.seconds[span[0]]
    _over_time(vector, d_vector, seconds, times.d_seconds[span[3]] - times.d_seconds[span[0]])


@kernel
def _direction(base: F64, motion: Motion, site: int, vector: F64, d_vector: F64) -> None:
    """A direction (3,) of a joint's frame as it points in the motion's frame."""
    vector[:] = 0.0
    add_rotated(motion.rotations[site], base, vector)
    turned = motion.d_rotations[site]
    for i in range(d_vector.shape[1]):
        d_vector[0, i] = turned[1, i] * vector[2] - turned[2, i] * vector[1]
        d_vector[1, i] = turned[2, i] * vector[0] - turned[0, i] * vector[2]
        d_vector[2, i] = turned[0, i] * vector[1] - turned[1, i] * vector[0]


@kernel
def _azimuth(vector: F64, d_vector: F64, center: float, out: F64) -> float:
    """Angle of a vector from +Z toward +X."""
    square = max(vector[0] * vector[0] + vector[2] * vector[2], LEAST * LEAST)
    for i in range(out.shape[0]):
        out[i] = (vector[2] * d_vector[0, i] - vector[0] * d_vector[2, i]) / square
    return _near(np.arctan2(vector[0], vector[2]), center)


@kernel
def _elevation(vector: F64, d_vector: F64, out: F64) -> float:
    """Angle of a vector above the horizontal plane."""
    level = max(np.sqrt(vector[0] * vector[0] + vector[2] * vector[2]), LEAST)
    square = level * level + vector[1] * vector[1]
    for i in range(out.shape[0]):
        along = (vector[0] * d_vector[0, i] + vector[2] * d_vector[2, i]) / level
        out[i] = (level * d_vector[1, i] - vector[1] * along) / square
    return np.arctan2(vector[1], level)


@kernel
def _length(vector: F64, d_vector: F64, level: bool, out: F64) -> float:
    """Length of a vector, or of its horizontal part."""
    height = 0.0 if level else vector[1]
    length = np.sqrt(vector[0] * vector[0] + height * height + vector[2] * vector[2])
    for i in range(out.shape[0]):
        dot = vector[0] * d_vector[0, i] + height * d_vector[1, i] + vector[2] * d_vector[2, i]
        out[i] = dot / max(length, LEAST)
    return length


@kernel
def _orientation(component: int, base: F64, center: float, motion: Motion, site: int, vector: F64, d_vector: F64,
                 out: F64) -> float:  # fmt: skip
    """An angle of a joint: of a bone's direction, or of its rotation R = G · base as yaw, pitch and roll."""
    if component in (AZIMUTH, ELEVATION):
        _direction(base, motion, site, vector[0], d_vector[0])
        if component == AZIMUTH:
            return _azimuth(vector[0], d_vector[0], center, out)
        return _elevation(vector[0], d_vector[0], out)
    axis = np.zeros(3)
    axis[0 if component == ROLL else 2] = 1.0
    _relative_direction(base, axis, motion, site, vector[0], d_vector[0])
    if component == YAW:
        return _azimuth(vector[0], d_vector[0], center, out)
    if component == PITCH:
        return _elevation(vector[0], d_vector[0], out)
    axis[0], axis[1] = 0.0, 1.0
    _relative_direction(base, axis, motion, site, vector[1], d_vector[1])
    sine, cosine = vector[0, 1], vector[1, 1]
    square = max(sine * sine + cosine * cosine, LEAST * LEAST)
    for i in range(out.shape[0]):
        out[i] = (cosine * d_vector[0, 1, i] - sine * d_vector[1, 1, i]) / square
    return _near(np.arctan2(sine, cosine), center)


@kernel
def _relative_direction(base: F64, axis: F64, motion: Motion, site: int, vector: F64, d_vector: F64) -> None:
    """Where a direction points that a relative rotation G · base turns from ``axis`` (3,)."""
    local = np.zeros(3)
    add_rotated(base, axis, local)
    _direction(local, motion, site, vector, d_vector)


@kernel
def _twist(q: F64, d_begin: F64, d_end: F64, out: F64) -> float:
    """Vertical part of a rotation R = E · conj(B), and its derivative from those of E and B (3, N)."""
    square = max(q[1] * q[1] + q[3] * q[3], LEAST)
    moved = np.zeros(3)
    for i in range(out.shape[0]):
        moved[:] = 0.0
        add_rotated(q, d_begin[:, i].copy(), moved)
        x, y, z = d_end[0, i] - moved[0], d_end[1, i] - moved[1], d_end[2, i] - moved[2]
        vertical, real = q[3] * y + z * q[0] - x * q[2], -(x * q[0] + y * q[1] + z * q[2])
        out[i] = (q[3] * vertical - q[1] * real) / square
    return 2.0 * np.arctan2(q[1], q[3])


@kernel
def _heading(span: I64, end: int, base: F64, problem: AdverbProblem, scratch: AdverbScratch) -> None:
    """Heading of the root where a span begins (0) or ends (1), since the examples' mean start."""
    instant, root = span[3 * end], span[3 * end + 2]
    if problem.strides.shape[0]:
        scratch.heading[end] = scratch.places.places[instant, 2]
        scratch.d_heading[end] = scratch.places.d_places[instant, 2]
        return
    q = np.empty(4)
    multiply(scratch.motion.rotations[root], base, q)
    turned = scratch.motion.d_rotations[root]
    scratch.heading[end] = _near(_twist(q, np.zeros_like(turned), turned, scratch.d_heading[end]), 0.0)


@kernel
def _turn(span: I64, base: F64, center: float, problem: AdverbProblem, scratch: AdverbScratch, out: F64) -> float:
    """Change of the root's heading over a span."""
    if problem.strides.shape[0]:
        _heading(span, 0, base, problem, scratch)
        _heading(span, 1, base, problem, scratch)
        out[:] = scratch.d_heading[1] - scratch.d_heading[0]
        return scratch.heading[1] - scratch.heading[0]
    motion, q, back = scratch.motion, np.empty(4), np.empty(4)
    back[:] = -motion.rotations[span[2]]
    back[3] = -back[3]
    multiply(motion.rotations[span[5]], back, q)
    return _near(_twist(q, motion.d_rotations[span[2]], motion.d_rotations[span[5]], out), center)


@kernel
def _into_frame(angle: float, d_angle: F64, vector: F64, d_vector: F64) -> None:
    """Rotate a vector and its Jacobian about the vertical by minus an angle with derivatives (N,), in place."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, z = vector[0] * cosine - vector[2] * sine, vector[2] * cosine + vector[0] * sine
    for i in range(d_angle.shape[0]):
        dx, dz = d_vector[0, i], d_vector[2, i]
        d_vector[0, i] = dx * cosine - dz * sine - z * d_angle[i]
        d_vector[2, i] = dz * cosine + dx * sine + x * d_angle[i]
    vector[0], vector[2] = x, z


@kernel
def _foot_speed(r: int, problem: AdverbProblem, scratch: AdverbScratch, out: F64) -> float:
    """Speed at which the root leaves the standing feet, over all spans of a row together."""
    times, motion, vector, d_vector = scratch.times, scratch.motion, scratch.vector, scratch.d_vector
    vector[1], d_vector[1] = 0.0, 0.0
    seconds, d_seconds = 0.0, np.zeros(out.shape[0])
    for s in range(problem.firsts[r], problem.firsts[r + 1]):
        span = problem.spans[s]
        _heading(span, 0, problem.bases[r], problem, scratch)
        _heading(span, 1, problem.bases[r], problem, scratch)
        _difference(motion, span[4], span[1], vector[0], d_vector[0])
        for a in range(3):
            vector[0, a] += motion.positions[span[5], a] - motion.positions[span[2], a]
            d_vector[0, a] += motion.d_positions[span[5], a] - motion.d_positions[span[2], a]
        middle = scratch.heading[0] + 0.5 * _near(scratch.heading[1] - scratch.heading[0], 0.0)
        _into_frame(middle, 0.5 * (scratch.d_heading[0] + scratch.d_heading[1]), vector[0], d_vector[0])
        vector[1] += vector[0]
        d_vector[1] += d_vector[0]
        seconds += times.seconds[span[3]] - times.seconds[span[0]]
        d_seconds += times.d_seconds[span[3]] - times.d_seconds[span[0]]
    _over_time(vector[1], d_vector[1], seconds, d_seconds)
    return _horizontal(problem.components[r], vector[1], d_vector[1], out)


@kernel
def _horizontal(component: int, vector: F64, d_vector: F64, out: F64) -> float:
    """Forward, sideways, rise or horizontal length of a vector in the frame of a heading."""
    if component == MAGNITUDE:
        return _length(vector, d_vector, True, out)
    axis = 2 if component == FORWARD else 0 if component == SIDEWAYS else 1
    out[:] = d_vector[axis]
    return vector[axis]


@kernel
def _root_motion(component: int, base: F64, center: float, span: I64, problem: AdverbProblem, scratch: AdverbScratch,
                 out: F64) -> float:  # fmt: skip
    """Travel of the root over a span in the frame of its heading at the begin, or its turn."""
    if component == TURN:
        return _turn(span, base, center, problem, scratch, out)
    vector, d_vector = scratch.vector[0], scratch.d_vector[0]
    _heading(span, 0, base, problem, scratch)
    _difference(scratch.motion, span[2], span[5], vector, d_vector)
    _into_frame(scratch.heading[0], scratch.d_heading[0], vector, d_vector)
    return _horizontal(component, vector, d_vector, out)


@kernel
def _row(r: int, problem: AdverbProblem, scratch: AdverbScratch, out: F64) -> float:
    """Value of row ``r``, in SI; its derivatives (N,) go to ``out``."""
    kind, component, center = problem.kinds[r], problem.components[r], problem.centers[r]
    span, times, motion = problem.spans[problem.firsts[r]], scratch.times, scratch.motion
    if kind in (TIME_TO, DURATION):
        out[:] = times.d_seconds[span[3]] - times.d_seconds[span[0]]
        return times.seconds[span[3]] - times.seconds[span[0]]
    if kind == FOOT_SPEED:
        return _foot_speed(r, problem, scratch, out)
    if kind == ORIENTATION:
        return _orientation(component, problem.bases[r], center, motion, span[1], scratch.vector, scratch.d_vector, out)
    if kind == ROOT_MOTION:
        return _root_motion(component, problem.bases[r], center, span, problem, scratch, out)
    return _joint(kind, component, center, span, scratch, out)


@kernel
def _joint(kind: int, component: int, center: float, span: I64, scratch: AdverbScratch, out: F64) -> float:
    """Position, velocity, angular velocity or displacement of a joint: one component."""
    times, motion, vector, d_vector = scratch.times, scratch.motion, scratch.vector[0], scratch.d_vector[0]
    if kind == POSITION:
        vector[:], d_vector[:] = motion.positions[span[1]], motion.d_positions[span[1]]
    elif kind == ANGULAR_VELOCITY:
        vector[:], d_vector[:] = motion.spins[span[1]], motion.d_spins[span[1]]
        _over_time(vector, d_vector, times.rates[span[0]], times.d_rates[span[0]])
    elif kind == DISPLACEMENT:
        _difference(motion, span[1], span[4], vector, d_vector)
    else:
        _velocity(span, times, motion, vector, d_vector)
    if component == MAGNITUDE:
        return _length(vector, d_vector, False, out)
    if component == AZIMUTH:
        return _azimuth(vector, d_vector, center, out)
    out[:] = d_vector[component]
    return vector[component]


@kernel
def measure_adverbs(weights: F64, problem: AdverbProblem, scratch: AdverbScratch, out: F64, jacobian: F64) -> None:
    """Measures (m,) of weights (N,), in SI, and their Jacobian (m, N)."""
    times, places, motion = scratch.times, scratch.places, scratch.motion
    blended_times(weights, problem.clock, problem.phases, times)
    striding = problem.strides.shape[0] > 0
    if striding:
        travel_places(weights, problem.strides, problem.clock.looping, problem.knots, places)
    for s in range(problem.sites.instants.shape[0]):
        p = problem.sites.instants[s]
        move_site(
            weights, s, problem.sites, striding,
            places.places[p], places.rates[p], places.d_places[p], places.d_rates[p], motion,
        )  # fmt: skip
    for r in range(problem.kinds.shape[0]):
        out[r] = _row(r, problem, scratch, jacobian[r])


@kernel
def measured_adverbs(weights: F64, problem: AdverbProblem, out: F64) -> None:
    """Measures (B, m) of weights (B, N), in SI."""
    scratch, jacobian = scratch_of(problem), np.empty((out.shape[1], weights.shape[1]))
    for b in range(weights.shape[0]):
        measure_adverbs(weights[b], problem, scratch, out[b], jacobian)
