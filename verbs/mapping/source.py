"""What a mapping needs of the skeleton that moves: its standing pose, its feet, and the point that has a goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from verbs.clips.feet import HEEL, TOE, feet, point_positions
from verbs.conventions import F64, I64
from verbs.kernels import fk, quat
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.easing import smootherstep
from verbs.mapping.names import Roles, roles_of
from verbs.mapping.rig import STILL, Rig, choose_reference
from verbs.motion import Motion
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.planting import Planting

__all__ = ["Effector", "Feet", "Source"]

SAMPLES, EXAMPLES = 9, 24
"""Poses of each example, and most examples, from which hinges and standing poses are taken."""

STANDING_PERCENTILE = 5.0
"""Share of the heights of a point, in percent, below which it stands, where no contacts are known."""


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Feet of a source: F of them.

    Parameters
    ----------
    joints : (F, 4) int64
        Hip, knee, ankle, and toe joint or -1.
    points : (F, 3, 3) float64
        Heel and ball in the ankle's frame, tip in that of the toe joint, metres.
    known : (F, 3) bool
        Which of them the foot has; every foot has a ball.
    levels : (F, 3) float64
        Heights of these while they stand, metres.
    """

    joints: I64
    points: F64
    known: npt.NDArray[np.bool_]
    levels: F64


@dataclass(frozen=True, slots=True)
class Effector:
    """The joint that has a goal, the phase at which it has it, and the phases before and after that have none."""

    joint: int
    phase: float
    before: float
    after: float

    def weights(self, phases: F64, *, looping: bool) -> F64:
        """How much the goal counts (B,) at canonical times: 1 at its own, smoothly 0 at the keytimes around it."""
        gaps = phases - self.phase
        if looping:
            gaps = gaps - np.round(gaps)
        span = np.where(gaps < 0.0, self.before, self.after)
        return smootherstep(1.0 - np.abs(gaps) / np.maximum(span, 1e-9))


@dataclass(frozen=True, eq=False)
class Source:
    """The skeleton that moves.

    Parameters
    ----------
    rig : Rig
        With its standing pose.
    feet : Feet
    rotations, positions : (F, J, 4), (F, J, 3) float64
        Global ones of sampled poses.
    effector : Effector or None
    center : (3,) float64
        The point about which lengths are scaled: on the ground, where the motion begins.
    looping : bool
    """

    rig: Rig
    feet: Feet
    rotations: F64
    positions: F64
    effector: Effector | None
    center: F64
    looping: bool = False

    @property
    def roles(self) -> Roles:
        """The humanoid of the skeleton."""
        return self.rig.roles

    @cached_property
    def hinges(self) -> dict[tuple[int, int, int], F64]:
        """Axes (3,) about which limbs bend, in the frame of the upper joint; by their three joints."""
        return {}

    def hinge(self, upper: int, lower: int, end: int) -> F64:
        """Unit axis (3,) about which a limb usually bends, in the frame of its upper joint."""
        key = (upper, lower, end)
        if key not in self.hinges:
            first = self.positions[:, lower] - self.positions[:, upper]
            second = self.positions[:, end] - self.positions[:, lower]
            total = quat.rotate(quat.conjugate(self.rotations[:, upper]), np.cross(first, second)).sum(axis=0)
            size = float(np.linalg.norm(total))
            self.hinges[key] = total / size if size > 1e-9 else np.array([1.0, 0.0, 0.0])
        return self.hinges[key]

    @classmethod
    def of_verb(cls, evaluator: Evaluator) -> Source:
        """The skeleton of a verb, with its contacts and its measure."""
        verb = evaluator.verb
        count = min(len(verb.examples), EXAMPLES)
        chosen = np.unique(np.linspace(0, len(verb.examples) - 1, count).round().astype(np.int64))
        weights = np.repeat(np.eye(len(verb.examples))[chosen], SAMPLES, axis=0)
        unmoved = np.zeros(len(weights), np.bool_)
        values = np.repeat(verb.values[chosen], SAMPLES, axis=0)
        phases = np.tile(np.arange(SAMPLES) / (SAMPLES - 1.0), len(chosen))
        found = evaluator.pose_of(evaluator.measure("example", weights, values, unmoved), phase=phases, plant=False)
        places = evaluator.positions(found)
        rig = _rig(verb.name, Motion(verb.skeleton, 1.0, found.root, found.rotations))
        planting = evaluator.planting()
        own = _planted(planting) if len(planting.joints) else _found_feet(rig, *places)
        center = np.zeros(3)
        if verb.root_motion != poses.STRIDE:
            center = found.root[phases == 0.0].mean(axis=0) * [1.0, 0.0, 1.0]
        return cls(rig, own, *places, _effector(evaluator), center, verb.looping)

    @classmethod
    def of_motion(cls, motion: Motion, effector: Effector | None = None) -> Source:
        """The skeleton of one motion whose ground is y = 0."""
        skeleton = motion.skeleton
        places = fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)
        rig = _rig("motion", motion)
        center = motion.root[0] * [1.0, 0.0, 1.0]
        return cls(rig, _found_feet(rig, *places), *places, effector, center)


def _rig(name: str, motion: Motion) -> Rig:
    skeleton = motion.skeleton
    still = np.tile(STILL, (len(skeleton), 1))
    frames = motion.rotations[:: max(1, len(motion) // 200)]
    roles = roles_of(skeleton.names, skeleton.parents.tolist())
    reference = choose_reference(skeleton, roles, [still, *frames])
    return Rig(name, skeleton, still, reference, np.zeros(3))


def _planted(planting: Planting) -> Feet:
    legs = planting.legs
    return Feet(legs.chains[:, -4:], legs.points, legs.known.astype(bool), planting.levels)


def _found_feet(rig: Rig, rotations: F64, positions: F64) -> Feet:
    """Feet by names and geometry, with the heights at which they stand most often."""
    rows = []
    for points in feet(rig.skeleton, rotations, positions):
        chain = rig.skeleton.chain(points[0].foot)
        if len(chain) >= 4:
            rows.append((chain, points))
    joints = np.full((len(rows), 4), -1, np.int64)
    offsets, known = np.zeros((len(rows), 3, 3)), np.zeros((len(rows), 3), bool)
    levels = np.zeros((len(rows), 3))
    for f, (chain, points) in enumerate(rows):
        joints[f, :3] = chain[-3:]
        for point in points:
            k = 2 if point.part == TOE else 0 if point.part == HEEL else 1
            known[f, k] = True
            path = point_positions(rotations, positions, point.joint, point.offset)
            levels[f, k] = np.percentile(path[:, 1], STANDING_PERCENTILE)
            if k == 2 and rig.skeleton.parents[point.joint] == chain[-1]:
                joints[f, 3], offsets[f, k] = point.joint, point.offset
            else:
                offsets[f, k] = _in_ankle(path, rotations[:, chain[-1]], positions[:, chain[-1]])
    return Feet(joints, offsets, known, levels)


def _in_ankle(path: F64, rotations: F64, positions: F64) -> F64:
    """Position (3,) of a point in the frame of the ankle: the median of all frames."""
    return np.asarray(np.median(quat.rotate(quat.conjugate(rotations), path - positions), axis=0))


def _effector(evaluator: Evaluator) -> Effector | None:
    """The joint whose position a verb's adverbs say; None where they say none."""
    verb = evaluator.verb
    measure = verb.measure
    placed = [row.spans[0] for row in measure.rows if row.kind == "position"]
    if measure.kind != measures.POSITION and not placed:
        return None
    joint = placed[0].joint if placed else measure.effector
    phase = placed[0].begin if placed else float(verb.phases[measure.keytime])
    earlier, later = verb.phases[verb.phases < phase - 1e-9], verb.phases[verb.phases > phase + 1e-9]
    before = phase - float(earlier[-1]) if len(earlier) else 1.0
    after = float(later[0]) - phase if len(later) else 1.0
    return Effector(int(joint), phase, before, after)
