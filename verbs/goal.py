"""Goals and measured points of a verb, as points of one space.

A goal is a point: an effector position (m), a jump's displacement and rise (m), or a cycle's speeds (m/s, rad/s).
The error is the distance between goal and measured point. For speeds a turn rate counts as the speed of a point
one metre from the root, so that it too is in m/s. Where each adverb names its own measure, points have one number for
each, in SI, and the error is the root of the sum of their squared differences: none of them is larger.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import measure as kernels
from verbs.kernels import root_velocity
from verbs.kernels.adverb_measures import COMPONENTS, KINDS, AdverbProblem, measured_adverbs
from verbs.kernels.columns import BATCH
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Chain, effector_positions
from verbs.kernels.position_batch import effector_positions_batch
from verbs.kernels.sites import Sites
from verbs.kernels.timewarp import Clock
from verbs.verb import Verb

__all__ = ["Goal", "diagonal"]

_goals, _compare = direct(kernels.goals), direct(kernels.compare)
_effector_positions, _root_velocities = direct(effector_positions), direct(kernels.root_velocities)
_effector_positions_batch, _measured_adverbs = direct(effector_positions_batch), direct(measured_adverbs)

_SPLINE_AT_KNOT = np.array([1.0, 4.0, 1.0]) / 6.0
_SLOPE_AT_KNOT = np.array([-0.5, 0.0, 0.5])


def _at_keytime(verb: Verb, keytime: int) -> F64:
    """Every example's row (N, 4 + 4·J) at a keytime, which is at a key."""
    return _at_knot(verb, round(verb.phases[keytime] * verb.intervals), _SPLINE_AT_KNOT)


def _at_knot(verb: Verb, key: int, taps: F64) -> F64:
    """Every example's row (N, 4 + 4·J) at a key, or its derivative per interval."""
    return np.asarray(np.einsum("t,tnc->nc", taps, verb.curves[key : key + 3].astype(np.float64)))


def _chain(verb: Verb) -> Chain:
    """Joints from the root to the effector at its keytime."""
    joints, count = verb.skeleton.chain(verb.measure.effector), len(verb.examples)
    references = np.ascontiguousarray(verb.references[joints[:-1]])
    offsets = np.ascontiguousarray(verb.skeleton.offsets[joints[1:]])
    roots, rows = np.zeros((3, count)), np.zeros((0, count))
    if verb.measure.kind == kernels.POSITION:
        at_key = _at_keytime(verb, verb.measure.keytime)
        roots = np.ascontiguousarray(at_key[:, :3].T)
        rotations = at_key[:, 4:].reshape(count, -1, 4)[:, joints[:-1]]
        rows = np.ascontiguousarray(rotations.transpose(1, 2, 0)).reshape(-1, count)
    return Chain(verb.rotation_mode, roots, rows, references, offsets)


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Goals of a verb, with the arrays that measuring needs.

    Parameters
    ----------
    verb : Verb
    clock : Clock
        Keytimes of the verb.
    space : GoalSpace
        How adverbs become goals.
    chain : Chain
        Joints from the root to the effector at its keytime; without examples where no position is measured.
    roots : (3, N, 3) float64
        Root positions at a jump's start, apex and end; empty for other measures.
    cycle : Cycle
        Strides of a cycle; without rows where no velocity is measured.
    own : AdverbProblem or None
        Measures that the adverbs name for themselves; None for other measures.
    factors : (m,) float64
        SI per unit of each measured adverb; empty for other measures.
    """

    verb: Verb
    clock: Clock
    space: kernels.GoalSpace
    chain: Chain
    roots: F64
    cycle: root_velocity.Cycle
    own: AdverbProblem | None = None
    factors: F64 = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of_verb(cls, verb: Verb) -> Goal:
        """Gather the arrays of one verb."""
        measure, roots = verb.measure, np.zeros((0, 0, 3))
        clock = Clock(verb.phases, np.log(np.diff(verb.keytimes, axis=1)), verb.looping)
        inverse = np.ascontiguousarray(np.linalg.pinv(measure.frame))
        space = kernels.GoalSpace(measure.kind, measure.axes, measure.origin, measure.frame, inverse)
        if measure.kind == kernels.JUMP:
            marks = (0, measure.keytime, len(verb.phases) - 1)
            roots = np.stack([_at_keytime(verb, mark)[:, :3] for mark in marks])
        if measure.kind == kernels.VELOCITY:
            cycle = root_velocity.cycle_of(verb.strides, clock)
        else:
            cycle = root_velocity.Cycle(np.zeros((0, 0)), np.zeros(len(verb.examples)), clock)
        own = _own_problem(verb, clock) if measure.kind == kernels.ADVERBS else None
        factors = np.array([row.factor for row in measure.rows])
        return cls(verb, clock, space, _chain(verb), roots, cycle, own, factors)

    @property
    def measurable(self) -> bool:
        """False where the verb has style adverbs only."""
        return self.verb.measure.kind != kernels.NOTHING

    @property
    def width(self) -> int:
        """Numbers P of a point: 3, or one for each measured adverb."""
        return 3 if self.own is None else len(self.factors)

    def points(self, adverbs: F64) -> F64:
        """Goals (B, P) of adverbs (B, D)."""
        if self.own is not None:
            return np.ascontiguousarray(np.asarray(adverbs, np.float64)[:, self.space.axes] * self.factors)
        out = np.empty((len(adverbs), 3))
        _goals(self.space, np.ascontiguousarray(adverbs, np.float64), out)
        return out

    def compare(self, adverbs: F64, points: F64) -> tuple[F64, F64]:
        """Measured adverbs (B, m) of measured points (B, P), and their distance (B,) to the goals of adverbs (B, D)."""
        if self.own is not None:
            distance = np.linalg.norm(points - self.points(adverbs), axis=1)
            return np.asarray(points / self.factors), np.asarray(distance)
        measured, error = np.empty((len(points), len(self.space.axes))), np.empty(len(points))
        adverbs, points = np.ascontiguousarray(adverbs, np.float64), np.ascontiguousarray(points, np.float64)
        _compare(self.space, adverbs, points, measured, error)
        return measured, error

    def measured(self, weights: F64) -> F64:
        """Points (B, P) that blends of weights (B, N) are measured at; NaN where nothing is measured."""
        kind, out = self.verb.measure.kind, np.full((len(weights), self.width), np.nan)
        weights = np.ascontiguousarray(weights, np.float64)
        if self.own is not None:
            _measured_adverbs(weights, self.own, out)
        if kind == kernels.POSITION:
            kernel = _effector_positions if len(weights) < BATCH else _effector_positions_batch
            kernel(weights, self.chain, out)
        elif kind == kernels.JUMP:
            kernels.jumps(weights, self.roots, out)
        elif kind == kernels.VELOCITY:
            _root_velocities(weights, self.cycle, out)
        return out


def _own_problem(verb: Verb, clock: Clock) -> AdverbProblem:
    """Arrays of the measures that adverbs name: instants and sites once each, spans by their numbers."""
    instants: dict[int, int] = {}
    sites: dict[tuple[int, int], int] = {}
    spans, firsts, rows = [], [0], verb.measure.rows
    for row in rows:
        rooted, jointed = row.kind in ("root_motion", "foot_speed"), row.kind not in ("time_to", "duration")
        for span in row.spans:
            numbers: list[int] = []
            for phase in (span.begin, span.end):
                if phase is None:
                    numbers += [-1, -1, -1]
                    continue
                at = instants.setdefault(round(phase * verb.intervals), len(instants))
                joint = sites.setdefault((span.joint, at), len(sites)) if jointed else -1
                numbers += [at, joint, sites.setdefault((0, at), len(sites)) if rooted else -1]
            spans.append(numbers)
        firsts.append(len(spans))
    knots = np.array(list(instants), np.int64)
    return AdverbProblem(
        clock=Clock(verb.phases.copy(), clock.log_lengths, clock.looping),
        strides=np.array(verb.strides, order="C"),
        phases=knots / verb.intervals,
        knots=knots,
        sites=_sites(verb, list(sites), knots),
        kinds=np.array([KINDS[row.kind] for row in rows], np.int64),
        components=np.array([COMPONENTS[row.component] for row in rows], np.int64),
        firsts=np.array(firsts, np.int64),
        spans=np.array(spans, np.int64),
        centers=np.array([row.center for row in rows], np.float64),
        bases=np.array([row.base for row in rows], np.float64),
    )


def _sites(verb: Verb, wanted: list[tuple[int, int]], knots: I64) -> Sites:
    """Chains of joints (joint, number of the instant) at knots."""
    count, ends, links = len(verb.examples), [0], []
    roots, root_rates = np.zeros((len(wanted), 3, count)), np.zeros((len(wanted), 3, count))
    rows, rates, offsets = [np.zeros((0, 4, count))], [np.zeros((0, 4, count))], [np.zeros((0, 3))]
    for s, (joint, instant) in enumerate(wanted):
        chain, key = verb.skeleton.chain(joint), int(knots[instant])
        at, slope = _at_knot(verb, key, _SPLINE_AT_KNOT), verb.intervals * _at_knot(verb, key, _SLOPE_AT_KNOT)
        roots[s], root_rates[s] = at[:, :3].T, slope[:, :3].T
        for part, whole in ((at, rows), (slope, rates)):
            whole.append(part[:, 4:].reshape(count, -1, 4)[:, chain].transpose(1, 2, 0))
        offsets += [verb.skeleton.offsets[chain[1:]], np.zeros((1, 3))]
        links += chain.tolist()
        ends.append(len(links))
    return Sites(
        verb.rotation_mode, np.array([instant for _, instant in wanted], np.int64), np.array(ends, np.int64),
        roots, root_rates, np.concatenate(rows), np.concatenate(rates),
        verb.references[np.array(links, np.int64)].reshape(-1, 4).copy(), np.concatenate(offsets),
    )  # fmt: skip


def diagonal(verb: Verb) -> float:
    """Diagonal of the bounding box of the examples' goals, in the unit of the error."""
    points = Goal.of_verb(verb).points(verb.values)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
