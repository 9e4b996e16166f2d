"""Measures of adverbs taken from poses: an oracle in plain NumPy that shares nothing with the kernels.

Velocities are differences of fourth order over poses after an instant, so they have the error of such differences.
"""

from __future__ import annotations

import numpy as np

from verbs.adverb_measure import AdverbMeasure
from verbs.kernels import quat
from verbs.kernels.pose import travelled
from verbs.runtime.evaluate import Blend, Evaluator

STEP_S = 5e-4
STENCIL = np.arange(5.0)
SLOPE = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12.0
"""To one side, because acceleration jumps at keytimes: canonical time has one continuous derivative only."""

AHEAD, RIGHT, UP = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


class Posed:
    """One blend of a verb, posed at instants."""

    def __init__(self, evaluator: Evaluator, blend: Blend) -> None:
        self.evaluator, self.blend = evaluator, blend

    def at(self, phase: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Global rotations (J, 4), positions (J, 3) and seconds at a phase."""
        poses = self.evaluator.pose_of(self.blend, phase=phase, plant=False)
        rotations, positions = self.evaluator.positions(poses)
        return rotations[0], positions[0], float(poses.time_s[0])

    def after(self, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """Global rotations (5, J, 4) and positions (5, J, 3) from the instant of a phase on."""
        poses = self.evaluator.pose_of(self.blend, time_s=self.at(phase)[2] + STEP_S * STENCIL, plant=False)
        return self.evaluator.positions(poses)

    def value(self, row: AdverbMeasure) -> float:
        """The measure of an adverb, in SI."""
        found = _VALUES[row.kind](self, row)
        if row.dimension == "angle":
            found -= 2.0 * np.pi * round((found - row.center) / (2.0 * np.pi))
        return float(found)

    def moved(self, joint: int, begin: float, end: float) -> tuple[np.ndarray, float]:
        """Displacement (3,) of a joint, and the seconds that it takes."""
        (_, first, started), (_, last, ended) = self.at(begin), self.at(end)
        return last[joint] - first[joint], ended - started

    def heading(self, phase: float, base) -> float:
        """Heading of a striding root's path; of another root the vertical part of its rotation since the mean start."""
        verb = self.evaluator.verb
        if len(verb.strides):
            path = travelled(np.repeat(self.blend.weights, 2, axis=0), verb.strides, np.array([0.0, phase]),
                             looping=verb.looping)  # fmt: skip
            return float(path[1, 2])
        turned = quat.mul(self.at(phase)[0][0], np.array(base))
        return float(2.0 * np.arctan2(turned[1], turned[3]))


def azimuth(vector) -> float:
    """Angle of a vector from +Z toward +X."""
    return float(np.arctan2(vector[0], vector[2]))


def elevation(vector) -> float:
    """Angle of a vector above the horizontal plane."""
    return float(np.arctan2(vector[1], np.hypot(vector[0], vector[2])))


def about_up(angle: float, vector) -> np.ndarray:
    """A vector rotated about the vertical."""
    return quat.rotate(quat.exp(angle * UP), np.asarray(vector))


def component(vector, axis: str) -> float:
    """A coordinate of a vector, its length, or its azimuth."""
    if axis in "xyz":
        return float(vector["xyz".index(axis)])
    return azimuth(vector) if axis == "direction" else float(np.linalg.norm(vector))


def horizontal(vector, axis: str) -> float:
    """Forward, sideways, rise or horizontal length of a vector in the frame of a heading."""
    known = {"forward": vector[2], "sideways": vector[0], "rise": vector[1]}
    return float(known[axis] if axis in known else np.hypot(vector[0], vector[2]))


def _position(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    return component(posed.at(span.begin)[1][span.joint], row.axis)


def _velocity(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    if span.end is None:
        return component(SLOPE @ posed.after(span.begin)[1][:, span.joint] / STEP_S, row.axis)
    vector, seconds = posed.moved(span.joint, span.begin, span.end)
    return component(vector / seconds, row.axis)


def _angular_velocity(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    rotations = posed.after(span.begin)[0][:, span.joint]
    turned = np.array([quat.log(quat.mul(one, quat.conjugate(rotations[0]))) for one in rotations])
    return component(SLOPE @ turned / STEP_S, row.axis)


def _orientation(posed: Posed, row: AdverbMeasure) -> float:
    (span,), base = row.spans, np.array(row.base)
    rotation = posed.at(span.begin)[0][span.joint]
    if row.axis in ("azimuth", "elevation"):
        bone = quat.rotate(rotation, base[:3])
        return azimuth(bone) if row.axis == "azimuth" else elevation(bone)
    ahead, right, up = (quat.rotate(quat.mul(rotation, base), one) for one in (AHEAD, RIGHT, UP))
    return {"yaw": azimuth(ahead), "pitch": elevation(ahead), "roll": float(np.arctan2(right[1], up[1]))}[row.axis]


def _displacement(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    return component(posed.moved(span.joint, span.begin, span.end)[0], row.axis)


def _root_motion(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    start = posed.heading(span.begin, row.base)
    if row.axis == "turn":
        return posed.heading(span.end, row.base) - start
    return horizontal(about_up(-start, posed.moved(0, span.begin, span.end)[0]), row.axis)


def _foot_speed(posed: Posed, row: AdverbMeasure) -> float:
    total, seconds = np.zeros(3), 0.0
    for span in row.spans:
        root, time = posed.moved(0, span.begin, span.end)
        start, stop = (posed.heading(phase, row.base) for phase in (span.begin, span.end))
        middle = start + 0.5 * (stop - start - 2.0 * np.pi * round((stop - start) / (2.0 * np.pi)))
        total += about_up(-middle, root - posed.moved(span.joint, span.begin, span.end)[0])
        seconds += time
    return horizontal(total / seconds, row.axis)


def _time(posed: Posed, row: AdverbMeasure) -> float:
    (span,) = row.spans
    return posed.at(span.end)[2] - posed.at(span.begin)[2]


_VALUES = {
    "position": _position, "velocity": _velocity, "speed": _velocity, "orientation": _orientation,
    "angular_velocity": _angular_velocity, "displacement": _displacement, "root_motion": _root_motion,
    "foot_speed": _foot_speed, "time_to": _time, "duration": _time,
}  # fmt: skip
