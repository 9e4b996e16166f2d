"""Method ``inverse``: weights between 0 and 1 that an optimiser fits to the goal. Accurate, but not continuous.

Source: Feng, Huang, Kallmann, Shapiro 2012, section 3 (inverse blending), which minimises Σ c_i n_i f_i over several
constraints. f is the squared distance here, as the paper's own measure of accuracy (§4.1): its sum is smooth where a
constraint is met, so that a second-order method applies.

The optimiser is a compiled Levenberg–Marquardt method whose steps minimise exactly over the simplex, see
:mod:`verbs.kernels.inverse`. General ones (SLSQP, L-BFGS-B) reach the same minima but spend their time in the
interpreter, which would make any comparison of speed one of languages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verbs.conventions import F64
from verbs.errors import OutOfRange, UnknownName
from verbs.goal import Goal
from verbs.kernels import inverse as kernels
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.timewarp import Clock
from verbs.verb import Measure, Verb

__all__ = ["Constraint", "Inverse"]

KINDS = ("goal", "position", "distance")

ENOUGH = 1e-12
"""A warm start that leaves less than this share of the examples' mean squared error cannot be improved visibly."""


@dataclass(frozen=True, slots=True)
class Constraint:
    """A condition on a blend; it counts priority × scale × squared error.

    Parameters
    ----------
    kind : {"goal", "position", "distance"}
        ``goal``: the goal of the adverbs: the verb's measured point, and the mean of each adverb that is not
        measured. ``position``: a joint is at ``target`` at a keytime. ``distance``: it is ``distance_m`` away from
        there.
    priority, scale : float
        c and n of the paper; the scale balances errors of different size or unit.
    joint, keytime : str
        Of ``position`` and ``distance``.
    target : (x, y, z)
        Metres, in the space of the motion; for a walking verb, in the frame that walks with it.
    distance_m : float
    """

    kind: str = "goal"
    priority: float = 1.0
    scale: float = 1.0
    joint: str = ""
    keytime: str = ""
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """Constraints of one verb, as arrays.

    Parameters
    ----------
    goal : Goal
        The verb's own.
    problem : Problem
    examples : (P, N, 3) float64
        Points that each example is measured at by itself.
    fixed : (P, 3) float64
        Required points; NaN where the query gives them.
    leaps : bool
        Whether the first three mean values are the displacement of a jump.
    unmeasured : tuple of int
        Adverbs that are the other mean values.
    k : int
        Examples that take part in a query.
    enough : float
        Sum of squares that needs no second try.
    """

    goal: Goal
    problem: kernels.Problem
    examples: F64
    fixed: F64
    leaps: bool
    unmeasured: tuple[int, ...]
    k: int
    enough: float

    @classmethod
    def of_verb(cls, verb: Verb, *, k: int = 10, constraints: Sequence[Constraint] = (Constraint(),)) -> Inverse:
        """Prepare a verb's constraints.

        Parameters
        ----------
        verb : Verb
        k : int
            Examples that take part: those that meet the constraints best by themselves.
        constraints : sequence of Constraint
            At most one of kind ``goal``.

        Raises
        ------
        UnknownName
            If a constraint names a kind, joint or keytime that does not exist.
        OutOfRange
            If there is nothing to meet, or a number is negative or not finite.
        """
        for constraint in constraints:
            _check(constraint)
        wanted = [c for c in constraints if c.kind == "goal"]
        if len(wanted) > 1 or not constraints or k < 1:
            raise OutOfRange("inverse blending needs k ≥ 1 and a constraint, of which at most one is the goal")
        goal, kind = Goal.of_verb(verb), verb.measure.kind
        if wanted and kind == measures.ADVERBS:
            raise OutOfRange(
                "the goal of adverbs that name measures of their own is no point; constrain joints instead"
            )
        leaps = bool(wanted) and kind == measures.JUMP
        unmeasured = tuple(a for a in range(len(verb.adverbs)) if wanted and a not in verb.measure.axes)
        points = [c for c in constraints if c.kind != "goal" or kind in (measures.POSITION, measures.VELOCITY)]
        goals = [goal if c.kind == "goal" else _joint_goal(verb, c) for c in points]
        count = len(verb.examples)
        examples = np.array([one.measured(np.eye(count)) for one in goals]).reshape(-1, count, 3)
        fixed = np.array([c.target if c.kind != "goal" else (np.nan,) * 3 for c in points]).reshape(-1, 3)
        problem = _problem(verb, points, goals, *_means(goal, wanted, leaps, unmeasured))
        spread = np.concatenate([(examples.std(axis=1) ** 2).sum(axis=1), problem.values.std(axis=1) ** 2])
        return cls(goal, problem, examples, fixed, leaps, unmeasured, k, ENOUGH * float(problem.factors**2 @ spread))

    def weights(self, adverbs: F64, start: F64 | None = None) -> F64:
        """Weights (B, N), between 0 and 1, at adverbs (B, D).

        Parameters
        ----------
        adverbs : (B, D) float64
        start : (N,) or (B, N) float64, optional
            Initial weights, for instance those of the previous frame. The result is never worse than
            either they or the result without them; where they lead to the goal it is also sooner found.

        Raises
        ------
        OutOfRange
            If the start has the wrong shape, or no positive weight.
        """
        batch, count = len(adverbs), self.examples.shape[1]
        out = np.empty((batch, count))
        earlier = np.empty((0, count)) if start is None else _on_simplex(start, (batch, count))
        targets, means = self._targets(adverbs)
        kernels.solve(self.problem, self.examples, self.k, targets, means, earlier, self.enough, out)
        return out

    def cost(self, adverbs: F64, weights: F64) -> F64:
        """Σ c n f (B,) that weights (B, N) leave at adverbs (B, D): what :meth:`weights` minimises."""
        out = np.empty(len(adverbs))
        kernels.costs(self.problem, *self._targets(adverbs), weights, out)
        return out

    def _targets(self, adverbs: F64) -> tuple[F64, F64]:
        """Points (B, P, 3) and mean values (B, V) that adverbs (B, D) require."""
        targets = np.repeat(self.fixed[None], len(adverbs), axis=0)
        for p in np.flatnonzero(np.isnan(self.fixed[:, 0])):
            targets[:, p] = self.goal.points(adverbs)
        covered = self.goal.points(adverbs) if self.leaps else adverbs[:, :0]
        return targets, np.ascontiguousarray(np.concatenate([covered, adverbs[:, self.unmeasured]], axis=1))


def _check(constraint: Constraint) -> None:
    """Check a constraint."""
    if constraint.kind not in KINDS:
        raise UnknownName("kind of constraint", constraint.kind, KINDS)
    numbers = (constraint.priority, constraint.scale, constraint.distance_m)
    if not (np.isfinite((*numbers, *constraint.target)).all() and min(numbers) >= 0):
        raise OutOfRange("a constraint's numbers must be finite, and its priority, scale and distance not negative")


def _joint_goal(verb: Verb, constraint: Constraint) -> Goal:
    """Goal of a joint at a keytime, as if the verb were made for it."""
    if constraint.keytime not in verb.keytime_names:
        raise UnknownName("keytime", constraint.keytime, verb.keytime_names)
    joint, keytime = verb.skeleton.index(constraint.joint), verb.keytime_names.index(constraint.keytime)
    measure = Measure(measures.POSITION, joint, keytime, np.empty(0, np.int64), np.zeros(3), np.zeros((3, 0)))
    still = verb.strides[:0]  # a walking verb's curves are poses in the frame that walks with it
    return Goal.of_verb(replace(verb, measure=measure, root_motion=poses.ABSOLUTE, strides=still))


def _balance(goal: Goal, adverb: int) -> float:
    """Scale of an unmeasured adverb's error: its whole range counts as much as the whole extent of the goals."""
    values = goal.verb.values
    extent = float((np.ptp(goal.points(values), axis=0) ** 2).sum()) if goal.measurable else 1.0
    span = float(np.ptp(values[:, adverb]))
    return extent / (span * span if span > 0 else 1.0)


def _means(goal: Goal, wanted: list[Constraint], leaps: bool, unmeasured: tuple[int, ...]) -> tuple[F64, F64]:
    """Values (V, N) whose means the goal requires, and their shares (V,) in the sum."""
    verb, count = goal.verb, len(goal.verb.examples)
    covered = goal.measured(np.eye(count)).T if leaps else np.zeros((0, count))
    balance = np.array([1.0] * len(covered) + [_balance(goal, adverb) for adverb in unmeasured])
    weight = wanted[0].priority * wanted[0].scale if wanted else 0.0
    return np.concatenate([covered, verb.values[:, unmeasured].T]), weight * balance


def _problem(verb: Verb, points: list[Constraint], goals: list[Goal], values: F64, shares: F64) -> kernels.Problem:
    """Everything that the kernel needs; all arrays are copies in C order, so that it is compiled once."""
    count = len(verb.examples)
    chained = [one for one in goals if one.verb.measure.kind == measures.POSITION]
    ends = np.cumsum([0, *(len(one.chain.references) if one in chained else 0 for one in goals)])
    roots = [one.chain.roots if one in chained else np.zeros((3, count)) for one in goals]
    weighed = np.array([c.priority * c.scale for c in points])
    return kernels.Problem(
        mode=verb.rotation_mode,
        kinds=np.array([one.verb.measure.kind for one in goals], np.int64),
        factors=np.sqrt(np.concatenate([weighed, shares])),
        radii=np.array([c.distance_m if c.kind == "distance" else -1.0 for c in points], np.float64),
        spans=np.array([ends[:-1], ends[1:]], np.int64).T.copy(order="C"),
        roots=np.concatenate([np.zeros((0, count)), *roots]),
        rows=np.concatenate([np.zeros((0, count)), *(one.chain.rows for one in chained)]),
        references=np.concatenate([np.zeros((0, 4)), *(one.chain.references for one in chained)]),
        offsets=np.concatenate([np.zeros((0, 3)), *(one.chain.offsets for one in chained)]),
        strides=verb.strides.copy(order="C"),
        clock=Clock(verb.phases.copy(order="C"), np.log(np.diff(verb.keytimes, axis=1)), True),
        values=values.copy(order="C"),
    )


def _on_simplex(start: F64, shape: tuple[int, int]) -> F64:
    """Earlier weights (B, N), cut off at 0 and summing to 1."""
    start = np.asarray(start, np.float64)
    if start.shape not in (shape, shape[1:]) or not np.isfinite(start).all():
        raise OutOfRange(f"start must be finite and have the shape {shape[1:]} or {shape}, not {start.shape}")
    cut = np.maximum(np.broadcast_to(start, shape), 0.0)
    sums = cut.sum(axis=1, keepdims=True)
    if not (sums > 0).all():
        raise OutOfRange("start has no positive weight")
    return np.ascontiguousarray(cut / sums)
