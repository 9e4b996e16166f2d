"""Cost of a whole motion: what makes a blend worse to look at than the examples are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.goal import Goal
from verbs.kernels.compile import direct
from verbs.kernels.motion_cost import FIGURES, MotionProblem, motion_figures
from verbs.quality.joint_ranges import Ranges
from verbs.quality.samples import sample
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.whole_motion import examples
from verbs.verb import Verb

__all__ = ["EXCESS", "IMPOSSIBLE", "PEAK", "MotionCost", "planted"]

SLACK_RAD, RANGE_RAD, SLIP_M_S, REST_SHARE = 0.05, 0.2, 0.1, 0.1
"""Excess over a range that costs nothing; the excess that costs 1; the least slip that costs 1; share of the mean
acceleration in the cost."""

PLANTED_SHARE = 0.25
"""Share of slip in the cost where feet are planted: slip is not seen then, but planting has to undo it."""

IMPOSSIBLE = 1e3
"""Cost of a motion whose duration is out of bounds."""

STRAIN, BEYOND, SLIP, RMS, PEAK, EXCESS, DURATION = range(len(FIGURES))

_figures = direct(motion_figures)


def planted(verb: Verb) -> bool:
    """Whether the feet of a verb's poses are planted, so that the slip of its blends is not seen."""
    return verb.contacts is not None


@dataclass(frozen=True, slots=True, eq=False)
class MotionCost:
    """Cost of the motions of one verb.

        cost = (P / P_max)² + (X / 0.2 rad)² + p (S / s)² + 0.1 (A / A_med)²

    P is the 8-norm of the accelerations of all joints in all frames, and P_max the largest of an example. X is the
    6-norm of the excess over the joints' ranges, beyond a slack of 0.05 rad. S is the root mean square of the speed
    over the ground of standing points of the feet, and s the 90th percentile of S over blends, at least 0.1 m/s; p is
    1, or ¼ where feet are planted. A is the root mean square of the accelerations, and A_med the median of the
    examples.

    Parameters
    ----------
    problem : MotionProblem
    scales : (4,) float64
        P_max, 0.2 rad, s / √p and A_med / √0.1.
    hardest_m_s2 : float
        Largest acceleration of a joint in an example.
    """

    problem: MotionProblem
    scales: F64
    hardest_m_s2: float

    @classmethod
    def of_verb(cls, verb: Verb, weights: F64) -> MotionCost:
        """Cost of a verb, with the slip of blends of ``weights`` (B, N) as the scale of slip."""
        problem, units = _problem(verb), np.eye(len(verb.examples))
        own, blends = np.empty((len(units), len(FIGURES))), np.empty((len(weights), len(FIGURES)))
        _figures(units, problem, own)
        _figures(np.ascontiguousarray(weights), problem, blends)
        slip = max(float(np.percentile(np.nan_to_num(blends[:, SLIP]), 90)), SLIP_M_S) / np.sqrt(
            PLANTED_SHARE if planted(verb) else 1.0
        )
        rest = float(np.median(own[:, RMS])) / np.sqrt(REST_SHARE)
        scales = np.maximum([float(own[:, STRAIN].max()), RANGE_RAD, slip, rest], 1e-9)
        return cls(problem, scales, float(own[:, PEAK].max()))

    def figures(self, weights: F64) -> F64:
        """Figures (B, 7) of :func:`verbs.kernels.motion_cost.motion_figures`."""
        out = np.empty((len(weights), len(FIGURES)))
        _figures(np.ascontiguousarray(weights, np.float64), self.problem, out)
        return out

    def costs(self, weights: F64) -> F64:
        """Cost (B,) of the motions of weights (B, N)."""
        return self.of_figures(self.figures(weights))

    def of_figures(self, figures: F64) -> F64:
        """Cost (B,) of figures (B, 7)."""
        squares = (figures[:, :4] / self.scales) ** 2
        return np.asarray(np.where(np.isfinite(squares).all(axis=1), squares.sum(axis=1), IMPOSSIBLE), np.float64)


def _problem(verb: Verb) -> MotionProblem:
    evaluator, skeleton, known = Evaluator(verb), verb.skeleton, verb.contacts
    ranges = Ranges.of_samples(verb.references, [sample(evaluator, blend) for blend in examples(evaluator)])
    count = len(verb.examples)
    return MotionProblem(
        curves=np.array(verb.curves), mode=verb.rotation_mode, references=np.array(verb.references),
        strides=np.array(verb.strides), clock=Goal.of_verb(verb).clock, parents=np.array(skeleton.parents),
        offsets=np.array(skeleton.offsets), low=ranges.low, high=ranges.high, slack=SLACK_RAD,
        points=np.zeros(0, np.int64) if known is None else np.array(known.joints),
        point_offsets=np.zeros((0, 3)) if known is None else np.array(known.offsets),
        contact=np.zeros((2, count, 0), np.float32) if known is None else np.array(known.values),
    )  # fmt: skip
