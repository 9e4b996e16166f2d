"""What was asked and what was reached, as points of one space.

A goal is a point: an effector position (m), a jump's displacement and rise (m), or a cycle's speeds (m/s, rad/s).
The error is the distance between goal and reached point; among speeds a turn rate counts as the speed of a point
one metre from the root, so that it too is in m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import measure as kernels
from verbs.kernels import root_velocity
from verbs.verb import Verb

__all__ = ["Goal", "diagonal"]

_SPLINE_AT_KNOT = np.array([1.0, 4.0, 1.0]) / 6.0


def _at_keytime(verb: Verb, keytime: int) -> F64:
    """Every example's row (N, 4 + 4·J) at a keytime, which lies on a key."""
    key = round(verb.phases[keytime] * verb.intervals)
    return np.asarray(np.einsum("t,tnc->nc", _SPLINE_AT_KNOT, verb.curves[key : key + 3].astype(np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """The measured side of a verb, with the arrays that measuring needs.

    Parameters
    ----------
    verb : Verb
    roots : (N, 3) or (3, N, 3) float64
        Root positions: at the effector's keytime, or at a jump's start, apex and end.
    rows : (L, N, 4) float64
        Rotation rows of the chain at the effector's keytime.
    references : (L, 4) float64
    offsets : (L, 3) float64
    log_lengths : (N, M - 1) float64
    inverse : (m, 3) float64
        Pseudo-inverse of the measure's frame.
    starts, chain : (3, N), (4·L, N) float64
        Roots and rows with the examples last, as correction wants them.
    walk, turns : (2·G + H, C), (N,) float64
        Strides as rows and turns over the cycle, see :func:`verbs.kernels.root_velocity.walk_of`; no rows where no
        speed is measured.
    """

    verb: Verb
    roots: F64
    rows: F64
    references: F64
    offsets: F64
    log_lengths: F64
    inverse: F64
    starts: F64
    chain: F64
    walk: F64
    turns: F64

    @classmethod
    def of_verb(cls, verb: Verb) -> Goal:
        """Gather the arrays of one verb."""
        measure = verb.measure
        chain = verb.skeleton.chain(measure.effector)
        roots, rows = np.zeros((0, 0, 3)), np.zeros((0, len(verb.examples), 4))
        if measure.kind == kernels.POSITION:
            at_key = _at_keytime(verb, measure.keytime)
            roots = np.ascontiguousarray(at_key[:, :3])
            rotations = at_key[:, 4:].reshape(len(verb.examples), -1, 4)
            rows = np.ascontiguousarray(rotations[:, chain[:-1]].transpose(1, 0, 2))
        elif measure.kind == kernels.JUMP:
            marks = (0, measure.keytime, len(verb.phases) - 1)
            roots = np.stack([_at_keytime(verb, mark)[:, :3] for mark in marks])
        walk, turns = np.zeros((0, 0)), np.zeros(len(verb.examples))
        if measure.kind == kernels.VELOCITY:
            walk = root_velocity.walk_of(verb.strides, verb.phases, turns)
        return cls(
            verb,
            roots,
            rows,
            np.ascontiguousarray(verb.references[chain[:-1]]),
            np.ascontiguousarray(verb.skeleton.offsets[chain[1:]]),
            np.log(np.diff(verb.keytimes, axis=1)),
            np.ascontiguousarray(np.linalg.pinv(measure.frame)),
            np.ascontiguousarray(roots.T) if roots.ndim == 2 else np.zeros((3, 0)),
            np.ascontiguousarray(rows.transpose(0, 2, 1)).reshape(-1, len(verb.examples)),
            walk,
            turns,
        )

    @property
    def measurable(self) -> bool:
        """False where the verb has style adverbs only."""
        return self.verb.measure.kind != kernels.NOTHING

    def points(self, adverbs: F64) -> F64:
        """Goals (B, 3) of adverbs (B, D)."""
        measure, out = self.verb.measure, np.empty((len(adverbs), 3))
        kernels.goals(measure.kind, adverbs, measure.axes, measure.origin, measure.frame, out)
        return out

    def compare(self, adverbs: F64, points: F64) -> tuple[F64, F64]:
        """Measured adverbs (B, m) of reached points (B, 3), and their distance (B,) from what adverbs (B, D) ask."""
        measure = self.verb.measure
        measured, error = np.empty((len(points), len(measure.axes))), np.empty(len(points))
        kernels.compare(
            measure.kind,
            adverbs,
            points,
            measure.axes,
            measure.origin,
            measure.frame,
            self.inverse,
            measured,
            error,
        )
        return measured, error

    def reached(self, weights: F64) -> F64:
        """Points (B, 3) that blends of weights (B, N) reach; NaN where nothing can be measured."""
        verb, out = self.verb, np.full((len(weights), 3), np.nan)
        if verb.measure.kind == kernels.POSITION:
            kernels.positions(weights, verb.rotation_mode, self.roots, self.rows, self.references, self.offsets, out)
        elif verb.measure.kind == kernels.JUMP:
            kernels.jumps(weights, self.roots, out)
        elif verb.measure.kind == kernels.VELOCITY:
            kernels.root_velocities(weights, self.walk, self.turns, verb.phases, self.log_lengths, out)
        return out


def diagonal(verb: Verb) -> float:
    """Diagonal of the bounding box of the examples' goals, in the unit of the error."""
    points = Goal.of_verb(verb).points(verb.values)
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
