"""Retarget a clip to a skeleton with the same joints and other bone lengths.

Local rotations are kept and the root's height is scaled by the length of the legs. Inverse kinematics then puts the
soles where they were in plan, at scaled heights above y = 0, and the effector where it was. The root sinks where a leg
would be too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verbs.clips.feet import Point, feet, leg_length, point_positions
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64, I64
from verbs.errors import SkeletonMismatch
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["KIND", "Retargeted", "bone_reports", "retarget"]

KIND = "retarget"

BONE_M = 1e-4
"""Difference of a bone from which on it is reported."""

MOST_BONES = 3
"""Bones that the report of a clip names: those that differ most."""

ITERATIONS = 80
"""Most steps of the inverse kinematics."""

DAMPING = 1e-4
"""Damping of a step, as a share of the squared length of the chain."""

CLOSE_M = 1e-6
"""Distance from its goal at which a chain is done."""

MOST_RAD = 0.5
"""Largest rotation of a joint in one step."""


STRAIGHT, SOFT_M = 0.999, 0.004
"""Share of its length up to which a leg stretches; softness of the limit from which the root sinks instead."""


@dataclass(frozen=True, slots=True, eq=False)
class Retargeted:
    """A retargeted motion with figures.

    Parameters
    ----------
    motion : Motion
        On the new skeleton.
    scale : float
        Length of the new legs over that of the old; 1 without legs.
    effector_m, feet_m : float
        Largest distance of the effector, and of any sole, from its goal at any frame; 0 without one.
    """

    motion: Motion
    scale: float
    effector_m: float
    feet_m: float

    def report(self, skeleton: str, bones: Sequence[Report]) -> Report:
        """The report of the whole clip, of those of its bones; ``skeleton`` names the clip with the new skeleton."""
        first = sorted(bones, key=lambda bone: -bone.figure)[:MOST_BONES]
        more = f", and {len(bones) - len(first)} more" if len(bones) > len(first) else ""
        figures = f"effector within {1000.0 * self.effector_m:.1f} mm, soles within {1000.0 * self.feet_m:.1f} mm"
        return Report(
            Mend(KIND),
            f"bones differ from those of '{skeleton}': {'; '.join(bone.found for bone in first)}{more}",
            f"retargeted, root height × {self.scale:.3f}: {figures}",
            1000.0 * max(self.effector_m, self.feet_m),
            "mm",
        )


def bone_reports(skeleton: Skeleton, other: Skeleton) -> list[Report]:
    """A report on each bone of a skeleton that differs from that of another skeleton with the same joints."""
    own, wanted = (np.linalg.norm(one.offsets, axis=1) for one in (skeleton, other))
    apart = np.linalg.norm(skeleton.offsets - other.offsets, axis=1)
    return [
        Report(
            Mend(KIND, skeleton.names[joint]),
            f"the bone to '{skeleton.names[joint]}' is {1000 * own[joint]:.1f} mm long instead of "
            f"{1000 * wanted[joint]:.1f} mm",
            "[retarget] adapts it",
            float(1000.0 * apart[joint]),
            "mm",
            proposed=False,
        )
        for joint in np.flatnonzero(apart > BONE_M)
    ]


def retarget(motion: Motion, skeleton: Skeleton, *, effector: int | None = None, plant: bool = True) -> Retargeted:
    """Retarget a motion whose ground is y = 0.

    Parameters
    ----------
    motion : Motion
    skeleton : Skeleton
        The same joints with the same parents.
    effector : int, optional
        The joint whose position is kept at every frame, where the chain from the root reaches. The root is scaled
        with the legs instead.
    plant : bool
        Keep the soles: without, the legs keep their local rotations.

    Raises
    ------
    SkeletonMismatch
        Other joints or parents.
    """
    old = motion.skeleton
    if old.names != skeleton.names or not np.array_equal(old.parents, skeleton.parents):
        raise SkeletonMismatch(f"cannot retarget: the skeleton {skeleton.difference(old)}")
    turns, places = fk.forward(motion.root, motion.rotations, old.parents, old.offsets)
    soles = [foot[-1] for foot in feet(old, turns, places)]
    legs = [(leg_length(old, sole.foot), leg_length(skeleton, sole.foot)) for sole in soles]
    short = sum(one for one, _ in legs)
    scale = sum(other for _, other in legs) / short if short > 0.0 else 1.0
    root, rotations = motion.root * np.array([1.0, scale, 1.0]), motion.rotations.copy()
    # a foot that is the effector keeps its position, not its height
    planted = [sole for sole in soles if plant and effector not in old.chain(sole.joint)[1:]]
    goals = [_ankle_goal(skeleton, sole, turns, places, scale) for sole in planted]
    root[:, 1] -= _drop(root, turns[:, 0], skeleton, planted, goals)
    worst = 0.0
    for sole, goal in zip(planted, goals, strict=True):
        worst = max(worst, _plant(root, rotations, skeleton, sole.foot, turns, goal))
    missed = 0.0
    if effector is not None and effector != 0:
        missed = _reach(root, rotations, skeleton, skeleton.chain(effector), places[:, effector])
    return Retargeted(Motion(skeleton, motion.fps, root, rotations), scale, missed, worst)


def _ankle_goal(skeleton: Skeleton, sole: Point, turns: F64, places: F64, scale: float) -> F64:
    """Position (F, 3) of an ankle whose sole is at its old place in plan, at its scaled height.

    ``turns`` (F, J, 4) and ``places`` (F, J, 3) are the global rotations and the positions of the old motion.
    """
    goal = point_positions(turns, places, sole.joint, sole.offset) * np.array([1.0, scale, 1.0])
    chain = skeleton.chain(sole.joint)
    for joint in chain[int(np.flatnonzero(chain == sole.foot)[0]) + 1 :]:
        goal -= quat.rotate(turns[:, skeleton.parents[joint]], skeleton.offsets[joint])
    return np.asarray(goal - quat.rotate(turns[:, sole.joint], _tip(skeleton, sole)))


def _drop(root: F64, turns: F64, skeleton: Skeleton, soles: list[Point], goals: list[F64]) -> F64:
    """Distance (F,) by which the root must sink so that all legs reach, smooth over time."""
    if not soles:
        return np.zeros(len(root))
    need = np.full((1, len(root)), -1.0)
    for sole, goal in zip(soles, goals, strict=True):
        hip = root + quat.rotate(turns, skeleton.offsets[skeleton.chain(sole.foot)[1]])
        flat = np.sum((hip - goal)[:, [0, 2]] ** 2, axis=1)
        length = STRAIGHT * leg_length(skeleton, sole.foot)
        above = hip[:, 1] - goal[:, 1] - np.sqrt(np.maximum(length**2 - flat, 0.0))
        need = np.concatenate([need, above[None]])
    most = need.max(axis=0)
    return np.asarray(0.5 * (most + np.hypot(most, SOFT_M)))


def _plant(root: F64, rotations: F64, skeleton: Skeleton, foot: int, turns: F64, goal: F64) -> float:
    """Put an ankle to its goal (F, 3); the foot keeps its global rotation. Rotations are changed in place.

    The result is the largest distance from the goal, metres.
    """
    chain = skeleton.chain(foot)
    missed = _reach(root, rotations, skeleton, chain, goal)
    above, _ = fk.forward(root, rotations[:, chain], np.arange(-1, len(chain) - 1), skeleton.offsets[chain])
    rotations[:, foot] = quat.mul(quat.conjugate(above[:, -2]), turns[:, foot])
    return missed


def _tip(skeleton: Skeleton, sole: Point) -> F64:
    """Offset (3,) of a sole's point on another skeleton: that of the joint's tip which is nearest."""
    tips = skeleton.tip_offsets[skeleton.tip_parents == sole.joint]
    if not len(tips) or not sole.offset.any():
        return sole.offset
    nearest: F64 = tips[np.argmin(np.linalg.norm(tips - sole.offset, axis=1))]
    return nearest


def _reach(root: F64, rotations: F64, skeleton: Skeleton, chain: I64, goal: F64) -> float:
    """Rotate the joints of a chain, apart from the root, until its last joint is at its goal (F, 3), in place.

    Damped least squares over joints with three degrees of freedom, those near the end first. The result is the
    largest remaining distance, metres.

    Source: S. R. Buss, "Introduction to Inverse Kinematics with Jacobian Transpose, Pseudoinverse and Damped Least
    Squares Methods", 2004, section 6.
    """
    parents, offsets = np.arange(-1, len(chain) - 1), skeleton.offsets[chain]
    weights = (np.arange(1, len(chain) - 1) / max(len(chain) - 2, 1)) ** 2
    damping = DAMPING * float(np.linalg.norm(offsets[1:], axis=1).sum()) ** 2 * np.eye(3)
    for left in range(ITERATIONS, -1, -1):
        turns, places = fk.forward(root, rotations[:, chain], parents, offsets)
        miss = goal - places[:, -1]
        worst = float(np.linalg.norm(miss, axis=1).max())
        if worst < CLOSE_M or not left or not len(weights):
            break
        arms = places[:, -1:] - places[:, 1:-1]
        square = np.einsum("k,fka,fka->f", weights, arms, arms)[:, None, None] * np.eye(3)
        square -= np.einsum("k,fka,fkb->fab", weights, arms, arms)
        pull = np.linalg.solve(square + damping, miss[..., None])[..., 0]
        steps = weights[:, None] * np.cross(arms, pull[:, None])
        size = np.linalg.norm(steps, axis=-1, keepdims=True).max(axis=1, keepdims=True)
        steps *= np.minimum(1.0, MOST_RAD / np.maximum(size, 1e-12))
        local = quat.rotate(quat.conjugate(turns[:, :-2]), steps)
        inner = chain[1:-1]
        rotations[:, inner] = quat.normalize(quat.mul(quat.exp(local), rotations[:, inner]))
    return worst
