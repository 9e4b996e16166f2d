"""Meet an error bound with the least work: ``rbf``, then ``search``, ``corrected``, and a polish of the joints.

Source: Rose, Sloan, Cohen 2001, section 4 (search, and a short inverse-kinematics pass for the last millimetres).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from verbs.conventions import F64
from verbs.kernels import measure as measures
from verbs.kernels import quat
from verbs.kernels.polish import polish as polish_kernel
from verbs.runtime.evaluate import Blend, Evaluator, Poses

__all__ = ["LADDER", "Escalated", "apply_polish", "escalate", "polish"]

LADDER = ("rbf", "search", "corrected")
"""Methods in the order in which they are tried; the polish comes after the last."""

TURN_LIMIT_RAD = 0.35
"""Largest rotation of one joint by the polish: 20°. Beyond, the pose would no longer be the animator's."""

DAMPING_M2 = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Escalated:
    """The result of meeting a bound.

    Parameters
    ----------
    blend : Blend
        One row; measured and error include the polish.
    tried : tuple of str
        Methods in the order in which they were tried; ``"polish"`` last where it was.
    rotation_vectors : (L, 3) float64 or None
        The polish: rotation vectors of the chain's joints at the effector's keytime.
    """

    blend: Blend
    tried: tuple[str, ...]
    rotation_vectors: F64 | None


def escalate(evaluator: Evaluator, adverbs: F64, max_error: float, *, method: str | None = None) -> Escalated:
    """Weights at adverbs (1, D) whose error is at most ``max_error``, if any method can.

    A given method is where the ladder starts; otherwise it starts at its foot.
    """
    rungs = LADDER[LADDER.index(method) :] if method in LADDER else ((method,) if method else LADDER)
    tried: list[str] = []
    best: Blend | None = None
    for rung in rungs:
        if rung == "corrected" and "smooth" not in evaluator.verb.bases:
            continue
        blend = evaluator.blend(adverbs, method=rung)
        tried.append(rung)
        if best is None or not blend.error[0] >= best.error[0]:
            best = blend
        if not blend.error[0] > max_error:  # NaN, where nothing is measured, has no better method
            return Escalated(blend, tuple(tried), None)
    assert best is not None  # every ladder has a rung that every verb can take
    if evaluator.verb.measure.kind != measures.POSITION:
        return Escalated(best, tuple(tried), None)
    blend, vectors = polish(evaluator, best, adverbs)
    return Escalated(blend, (*tried, "polish"), vectors)


def polish(evaluator: Evaluator, blend: Blend, adverbs: F64, *, limit_rad: float = TURN_LIMIT_RAD) -> tuple[Blend, F64]:
    """Rotate the joints of a blend's chain (one row) until the effector meets adverbs (1, D) at its keytime.

    Returns the blend as it is measured then, and rotation vectors (L, 3) in radians, none above ``limit_rad``.
    """
    verb, goal = evaluator.verb, evaluator.goal
    chain = verb.skeleton.chain(verb.measure.effector)[:-1]
    at_keytime = evaluator.pose_of(blend, phase=float(verb.phases[verb.measure.keytime]), plant=False)
    locals_ = np.ascontiguousarray(at_keytime.rotations[0, chain])
    vectors, target = np.empty((len(chain), 3)), goal.points(adverbs)[0]
    polish_kernel(at_keytime.root[0], locals_, goal.chain.offsets, target, limit_rad, DAMPING_M2, vectors)
    rotations = at_keytime.rotations.copy()
    rotations[0, chain] = quat.mul(locals_, quat.exp(vectors))
    _, positions = evaluator.positions(replace(at_keytime, rotations=rotations))
    measured, error = goal.compare(adverbs, positions[:, verb.measure.effector])
    return replace(blend, measured=measured, error=error), vectors


def apply_polish(evaluator: Evaluator, poses: Poses, rotation_vectors: F64) -> Poses:
    """Poses with a polish: whole at the effector's keytime, fading to nothing at the neighbouring keytimes."""
    verb = evaluator.verb
    chain = verb.skeleton.chain(verb.measure.effector)[:-1]
    middle, marks = verb.measure.keytime, verb.phases
    centre = marks[middle]
    start = marks[middle - 1] if middle > 0 else centre - 1.0
    end = marks[middle + 1] if middle + 1 < len(marks) else centre + 1.0
    distance = np.where(
        poses.phase < centre, (centre - poses.phase) / (centre - start), (poses.phase - centre) / (end - centre)
    )
    u = np.clip(distance, 0.0, 1.0)
    share = 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0))  # minimum jerk: no jump in speed or acceleration
    rotations = poses.rotations.copy()
    extra = quat.exp(share[:, None, None] * rotation_vectors)
    rotations[:, chain] = quat.mul(rotations[:, chain], extra)
    return replace(poses, rotations=rotations)
