"""Whole-body inverse kinematics: the least effort from rest that meets every constraint.

A pose is the rest pose plus a vector of ``values``: the root's displacement (metres) and one angle (radians) per
degree of freedom, each about its joint's own axis. A *term* maps a batch of bodies to residuals; soft terms are
minimised in the least-squares sense, hard terms are driven to zero.

Source: sequential quadratic programming on a Gauss-Newton Hessian that a symmetric rank-one update completes:
J. Nocedal, S. Wright, "Numerical Optimization", 2006, equations 18.9, 10.23 and 6.24.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tools.authoring.figure import Figure, Pose
from verbs.conventions import F64, I64, Floats
from verbs.kernels import fk, quat

__all__ = [
    "Body",
    "Term",
    "aim",
    "balance",
    "height",
    "keep_direction",
    "limits",
    "orient",
    "place",
    "pose",
    "posture",
    "solve",
    "vectors",
]

_ROOT_STIFFNESS = (6.0, 1.5, 6.0)  # cost of one metre sideways, up and forward
_DIFFERENCE = 1e-5  # step of the central differences: error about 1e-10, far below what is written
_LARGEST_STEP = 0.35  # radians or metres per iteration: keeps every solve on the branch that it started on
_LEAST_CURVATURE = 0.1  # cost per square radian: keeps steps finite where the model has no cost
_MAX_ITERATIONS = 300


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A batch of bodies during a solve.

    Parameters
    ----------
    vectors : (B, J, 3) float64
        Rotation vector of each joint about its rest pose, radians.
    shift : (B, 3) float64
        Displacement of the root from rest, metres.
    global_rotations : (B, J, 4) float64
    positions : (B, J, 3) float64
        Joint positions, metres.
    """

    vectors: F64
    shift: F64
    global_rotations: F64
    positions: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """Soft residuals (R,) and hard gaps (C,) at some values, with their slopes (R, N) and (C, N)."""

    residuals: F64
    slopes: F64
    gaps: F64
    gap_slopes: F64


Term = Callable[[Body], F64]
"""Residuals (B, R) of a batch of bodies."""


def posture(figure: Figure) -> Term:
    """Soft: stay at rest, each joint with its own stiffness."""
    weights = np.sqrt(figure.stiffness)
    root = np.sqrt(_ROOT_STIFFNESS)
    return lambda body: np.concatenate([_flat(body.vectors * weights), body.shift * root], axis=-1)


def limits(figure: Figure, weight: float = 8.0) -> Term:
    """Soft: a spring that pulls back from beyond the joint limits."""

    def residual(body: Body) -> F64:
        beyond = np.maximum(body.vectors - figure.upper, 0.0) + np.maximum(figure.lower - body.vectors, 0.0)
        return _flat(weight * beyond)

    return residual


def place(joints: I64, targets: Floats, weight: float = 1.0) -> Term:
    """Put joints at target positions (len(joints), 3)."""
    return lambda body: _flat(weight * (body.positions[:, joints] - targets))


def orient(joints: I64, rotations: Floats, weight: float = 1.0) -> Term:
    """Give joints the global rotations (len(joints), 4)."""
    inverse = quat.conjugate(rotations)
    return lambda body: _flat(weight * quat.log(quat.mul(inverse, body.global_rotations[:, joints])))


def aim(joint: int, axis: Floats, target: Floats, weight: float) -> Term:
    """Soft: point the local ``axis`` (3,) of a joint at a target position (3,)."""

    def residual(body: Body) -> F64:
        direction = np.asarray(target) - body.positions[:, joint]
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        return np.asarray(weight * (quat.rotate(body.global_rotations[:, joint], np.asarray(axis)) - direction))

    return residual


def keep_direction(joint: int, axis: Floats, direction: Floats, weight: float) -> Term:
    """Soft: keep the local ``axis`` (3,) of a joint pointing along a global direction (3,), e.g. a hanging arm."""
    return lambda body: np.asarray(
        weight * (quat.rotate(body.global_rotations[:, joint], np.asarray(axis)) - direction)
    )


def balance(figure: Figure, point: Floats, weight: float) -> Term:
    """Keep the centre of mass above a point on the ground (3,)."""
    level = [0, 2]
    return lambda body: np.asarray(weight * (figure.centre_of_mass(body.positions) - point)[:, level])


def height(joint: int, level_m: float, weight: float) -> Term:
    """Soft: seek a height above the ground for a joint, metres."""
    return lambda body: np.asarray(weight * (body.positions[:, joint, 1:2] - level_m))


def solve(
    figure: Figure,
    soft: Sequence[Term],
    hard: Sequence[Term],
    *,
    start: Floats | None = None,
    tolerance: float = 1e-10,
) -> F64:
    """Find the values that minimise the soft terms among those that zero the hard ones.

    Parameters
    ----------
    figure : Figure
        The body; joints and axes without stiffness do not move.
    soft, hard : sequence of Term
        The hard terms must be independent of each other.
    start : (N,) float64, optional
        Values to start from; the rest pose unless given.
    tolerance : float
        Stop when a step is smaller than this, radians and metres.

    Returns
    -------
    values : (N,) float64
        For :func:`pose` and :func:`vectors`.

    Raises
    ------
    RuntimeError
        If the constraints cannot all be met: a mistake in the authoring code.
    """
    values: F64 = np.zeros(3 + len(_freedoms(figure))) if start is None else np.array(start, np.float64)
    model = _linearised(figure, soft, hard, values)
    curvature = np.zeros((len(values), len(values)))
    for _ in range(_MAX_ITERATIONS):
        try:
            step, forces = _constrained_step(model, curvature)
        except np.linalg.LinAlgError:
            break  # constraints pull against each other at the end of a straight limb
        scale = min(1.0, _LARGEST_STEP / np.abs(step).max(initial=1e-300))
        values = values + scale * step
        if np.abs(step).max() < tolerance:
            return values
        before, model = model, _linearised(figure, soft, hard, values)
        curvature = _learned(curvature, scale * step, before, model, forces)
    raise RuntimeError(f"no pose found: constraint residuals are still {np.abs(model.gaps).max():.2e}")


def vectors(figure: Figure, values: Floats) -> F64:
    """Rotation vectors (..., J, 3) about the rest pose of solved values (..., N)."""
    values = np.asarray(values, np.float64)
    result = np.zeros((*values.shape[:-1], len(figure.skeleton) * 3))
    result[..., _freedoms(figure)] = values[..., 3:]
    return result.reshape(*values.shape[:-1], -1, 3)


def pose(figure: Figure, values: Floats) -> Pose:
    """Pose of solved values (N,)."""
    rotated = quat.mul(figure.rest.rotations, quat.exp(vectors(figure, values)))
    return Pose(figure.rest.root + np.asarray(values)[:3], rotated)


def _flat(residuals: F64) -> F64:
    return np.asarray(residuals.reshape(len(residuals), -1))


def _freedoms(figure: Figure) -> I64:
    """Indices of the flattened (J, 3) axes that can move."""
    return np.flatnonzero(figure.stiffness.ravel() > 0)


def _body(figure: Figure, values: F64) -> Body:
    rotated = vectors(figure, values)
    rotations = quat.mul(figure.rest.rotations, quat.exp(rotated))
    root = figure.rest.root + values[..., :3]
    return Body(
        rotated,
        values[..., :3],
        *fk.forward(root, rotations, figure.skeleton.parents, figure.skeleton.offsets),
    )


def _linearised(figure: Figure, soft: Sequence[Term], hard: Sequence[Term], values: F64) -> _Model:
    """Residuals and their derivatives by central differences, all in one batch."""
    count, steps = len(values), _DIFFERENCE * np.eye(len(values))
    body = _body(figure, np.concatenate([values[None], values + steps, values - steps]))
    parts = []
    for terms in (soft, hard):
        residuals = np.concatenate([term(body) for term in terms], axis=-1)
        slopes = (residuals[1 : 1 + count] - residuals[1 + count :]) / (2 * _DIFFERENCE)
        parts += [residuals[0], slopes.T]
    return _Model(*parts)


def _constrained_step(model: _Model, curvature: F64) -> tuple[F64, F64]:
    """Step that minimises the modelled effort and closes the linearised gaps, and the constraints' forces."""
    count, constraints = model.slopes.shape[1], len(model.gaps)
    system = np.zeros((count + constraints, count + constraints))
    system[:count, :count] = _convex(model.slopes.T @ model.slopes + curvature)
    system[count:, :count] = model.gap_slopes
    system[:count, count:] = model.gap_slopes.T
    right = -np.concatenate([model.slopes.T @ model.residuals, model.gaps])
    solution = np.linalg.solve(system, right)
    return solution[:count], solution[count:]


def _convex(hessian: F64) -> F64:
    """Make a symmetric matrix positive definite, so that every step descends."""
    eigenvalues, axes = np.linalg.eigh(hessian)
    return np.asarray((axes * np.maximum(eigenvalues, _LEAST_CURVATURE)) @ axes.T)


def _learned(curvature: F64, step: F64, before: _Model, after: _Model, forces: F64) -> F64:
    """Symmetric rank-one update of the curvature of residuals and constraints that Gauss-Newton neglects."""
    change = (after.slopes - before.slopes).T @ after.residuals + (after.gap_slopes - before.gap_slopes).T @ forces
    missing = change - curvature @ step
    along = float(missing @ step)
    if abs(along) < 1e-6 * np.linalg.norm(missing) * np.linalg.norm(step):
        return curvature  # the update would divide by almost nothing
    return np.asarray(curvature + np.outer(missing, missing) / along)
