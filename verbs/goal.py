"""Goals and measured points of a verb, as points of one space.

A goal is a point: an effector position (m), a jump's displacement and rise (m), or a cycle's speeds (m/s, rad/s).
The error is the distance between goal and measured point. For speeds a turn rate counts as the speed of a point
one metre from the root, so that it too is in m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import measure as kernels
from verbs.kernels import root_velocity
from verbs.kernels.columns import BATCH
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Chain, effector_positions
from verbs.kernels.position_batch import effector_positions_batch
from verbs.kernels.timewarp import Clock
from verbs.verb import Verb

__all__ = ["Goal", "diagonal"]

_goals, _compare = direct(kernels.goals), direct(kernels.compare)
_effector_positions, _root_velocities = direct(effector_positions), direct(kernels.root_velocities)
_effector_positions_batch = direct(effector_positions_batch)

_SPLINE_AT_KNOT = np.array([1.0, 4.0, 1.0]) / 6.0


def _at_keytime(verb: Verb, keytime: int) -> F64:
    """Every example's row (N, 4 + 4·J) at a keytime, which is at a key."""
    key = round(verb.phases[keytime] * verb.intervals)
    return np.asarray(np.einsum("t,tnc->nc", _SPLINE_AT_KNOT, verb.curves[key : key + 3].astype(np.float64)))


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
    """

    verb: Verb
    clock: Clock
    space: kernels.GoalSpace
    chain: Chain
    roots: F64
    cycle: root_velocity.Cycle

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
        return cls(verb, clock, space, _chain(verb), roots, cycle)

    @property
    def measurable(self) -> bool:
        """False where the verb has style adverbs only."""
        return self.verb.measure.kind != kernels.NOTHING

    def points(self, adverbs: F64) -> F64:
        """Goals (B, 3) of adverbs (B, D)."""
        out = np.empty((len(adverbs), 3))
        _goals(self.space, np.ascontiguousarray(adverbs, np.float64), out)
        return out

    def compare(self, adverbs: F64, points: F64) -> tuple[F64, F64]:
        """Measured adverbs (B, m) of measured points (B, 3), and their distance (B,) to the goals of adverbs (B, D)."""
        measured, error = np.empty((len(points), len(self.space.axes))), np.empty(len(points))
        adverbs, points = np.ascontiguousarray(adverbs, np.float64), np.ascontiguousarray(points, np.float64)
        _compare(self.space, adverbs, points, measured, error)
        return measured, error

    def measured(self, weights: F64) -> F64:
        """Points (B, 3) that blends of weights (B, N) are measured at; NaN where nothing is measured."""
        kind, out = self.verb.measure.kind, np.full((len(weights), 3), np.nan)
        weights = np.ascontiguousarray(weights, np.float64)
        if kind == kernels.POSITION:
            kernel = _effector_positions if len(weights) < BATCH else _effector_positions_batch
            kernel(weights, self.chain, out)
        elif kind == kernels.JUMP:
            kernels.jumps(weights, self.roots, out)
        elif kind == kernels.VELOCITY:
            _root_velocities(weights, self.cycle, out)
        return out


def diagonal(verb: Verb) -> float:
    """Diagonal of the bounding box of the examples' goals, in the unit of the error."""
    points = Goal.of_verb(verb).points(verb.values)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
