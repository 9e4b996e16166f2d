"""Corrected blending of verbs that are measured by a joint's position: its Jacobian, and the whole method in one call.

Source: ``docs/math.md``, section "Corrected blending"; the Jacobian is derived there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels import measure
from verbs.kernels.chart import DomainArrays, clamp
from verbs.kernels.compile import kernel
from verbs.kernels.correction import SQUARE, Correction, squared_distance, step
from verbs.kernels.measure import GoalSpace
from verbs.kernels.pose import NLERP, ROTATION_VECTOR, finish_rotation, multiply
from verbs.kernels.radial_basis import BasisArrays, cardinal
from verbs.kernels.sums import Sums

__all__ = [
    "Blended",
    "Chain",
    "ChainScratch",
    "PositionProblem",
    "chain_scratch",
    "correct_positions",
    "corrected_position",
    "effector_positions",
    "position_jacobian",
]


class Chain(NamedTuple):
    """The joints from the root to an effector, as every example has them at one phase.

    Parameters
    ----------
    mode : int
        How rotations blend, see :mod:`verbs.kernels.pose`.
    roots : (3, N) float64
        Root position of each example.
    rows : (4·L, N) float64
        Rotation rows of the L joints of the chain from the root to the effector's parent.
    references : (L, 4) float64
    offsets : (L, 3) float64
        Offset of the next joint of the chain; the last one is the effector's.
    """

    mode: int
    roots: F64
    rows: F64
    references: F64
    offsets: F64


class ChainScratch(NamedTuple):
    """Scratch arrays for a chain of L joints.

    Parameters
    ----------
    global_rotations, rotations : (L, 4) float64
        Blended rotations.
    joints : (L, 4) float64
        Positions of the joints, and lengths of the sums of their quaternions.
    rates : (2, 3, 4) float64
        Matrices from rows to angular and to effector velocities.
    """

    global_rotations: F64
    rotations: F64
    joints: F64
    rates: F64


class PositionProblem(NamedTuple):
    """Everything that corrected blending of a verb needs besides adverbs.

    Parameters
    ----------
    domain : DomainArrays
    basis : BasisArrays
    own_chart : bool
        Whether the basis has another chart than the domain.
    correction : Correction
    chain : Chain
    space : GoalSpace
    sums : Sums
        Root position and rotation rows of the chain.
    to_sums : (S, F) float64
        Sums of the basis's weights, of its F features.
    to_weights : (F + S, N) float64
        Weights of features and η.
    """

    domain: DomainArrays
    basis: BasisArrays
    own_chart: bool
    correction: Correction
    chain: Chain
    space: GoalSpace
    sums: Sums
    to_sums: F64
    to_weights: F64


class Blended(NamedTuple):
    """Results of B queries: weights (B, N), measured adverbs (B, m), error (B,); 1 where adverbs were clamped (B,)."""

    weights: F64
    measured: F64
    error: F64
    moved: F64


@kernel
def chain_scratch(links: int) -> ChainScratch:
    """Scratch arrays for a chain of so many joints."""
    return ChainScratch(np.empty((links, 4)), np.empty((links, 4)), np.empty((links, 4)), np.empty((2, 3, 4)))


@kernel
def _rotation_rates(mode: int, reference: F64, blended: F64, length: float, out: F64) -> None:
    """Matrix (3, 4) from an example's row to the angular velocity, in the joint's frame, as its weight grows.

    ``blended`` is the finished quaternion (4,), ``length`` that of the sum it came from. Sums of quaternions give
    2/|Σ w q| · vec(q⁻¹ q_i); rotation vectors give the exponential's right Jacobian at Σ w v.
    """
    if mode != ROTATION_VECTOR:
        s, x, y, z, w = 2.0 / length, blended[0], blended[1], blended[2], blended[3]
        out[0, 0], out[0, 1], out[0, 2], out[0, 3] = s * w, s * z, -s * y, -s * x
        out[1, 0], out[1, 1], out[1, 2], out[1, 3] = -s * z, s * w, s * x, -s * y
        out[2, 0], out[2, 1], out[2, 2], out[2, 3] = s * y, -s * x, s * w, -s * z
        return
    back, rotation, v = np.empty(4), np.empty(4), np.empty(3)
    back[0], back[1], back[2], back[3] = -reference[0], -reference[1], -reference[2], reference[3]
    multiply(back, blended, rotation)
    sine = np.sqrt(rotation[0] * rotation[0] + rotation[1] * rotation[1] + rotation[2] * rotation[2])
    angle = 2.0 * np.arctan2(sine, rotation[3])
    for a in range(3):
        v[a] = rotation[a] * (angle / sine if sine > 1e-9 else 2.0)
    square = angle * angle
    first = (1.0 - np.cos(angle)) / square if angle > 1e-4 else 0.5
    second = (angle - np.sin(angle)) / (square * angle) if angle > 1e-3 else 1.0 / 6.0
    out[:] = 0.0
    for a in range(3):
        out[a, a] = 1.0 - second * square
        for b in range(3):
            out[a, b] += second * v[a] * v[b]
    out[0, 1] += first * v[2]
    out[0, 2] -= first * v[1]
    out[1, 0] -= first * v[2]
    out[1, 2] += first * v[0]
    out[2, 0] += first * v[1]
    out[2, 1] -= first * v[0]


@kernel
def _lever(rotation: F64, x: float, y: float, z: float, rates: F64, out: F64) -> None:
    """Matrix (3, 4) from an example's row to the effector's velocity: (G · rates) × (effector − joint).

    ``rotation`` (4,) is the joint's global rotation G; x, y, z is the vector from the joint to the effector.
    """
    a, b, c, d = rotation[0], rotation[1], rotation[2], rotation[3]
    xx, yy, zz = 1.0 - 2.0 * (b * b + c * c), 1.0 - 2.0 * (a * a + c * c), 1.0 - 2.0 * (a * a + b * b)
    xy, xz, yz = 2.0 * (a * b - c * d), 2.0 * (a * c + b * d), 2.0 * (b * c - a * d)
    yx, zx, zy = 2.0 * (a * b + c * d), 2.0 * (a * c - b * d), 2.0 * (b * c + a * d)
    for k in range(4):
        p = xx * rates[0, k] + xy * rates[1, k] + xz * rates[2, k]
        q = yx * rates[0, k] + yy * rates[1, k] + yz * rates[2, k]
        r = zx * rates[0, k] + zy * rates[1, k] + zz * rates[2, k]
        out[0, k], out[1, k], out[2, k] = q * z - r * y, r * x - p * z, p * y - q * x


@kernel
def _effector(
    weights: F64, mode: int, roots: F64, rows: F64, references: F64, offsets: F64,
    global_rotations: F64, rotations: F64, joints: F64, point: F64,
) -> None:  # fmt: skip
    """Effector position (3,) of weights (N,), and what its Jacobian needs.

    Arrays as in :class:`Chain` and :class:`ChainScratch`. They come one by one: to pass a bundle costs two atomic
    operations for each array in it, in every step of every row.
    """
    count = weights.shape[0]
    for a in range(3):
        total = 0.0
        for i in range(count):
            total += weights[i] * roots[a, i]
        point[a] = total
    # Quaternions of the chain are kept in scalars: a view of a row costs as much as the product itself.
    gx, gy, gz, gw = 0.0, 0.0, 0.0, 1.0
    for j in range(references.shape[0]):
        for a in range(4):
            total = 0.0
            for i in range(count):
                total += weights[i] * rows[4 * j + a, i]
            rotations[j, a] = total
        x, y, z, w = rotations[j, 0], rotations[j, 1], rotations[j, 2], rotations[j, 3]
        length = np.sqrt(x * x + y * y + z * z + w * w)
        if mode == NLERP and length >= 0.3:
            x, y, z, w = x / length, y / length, z / length, w / length
            rotations[j, 0], rotations[j, 1], rotations[j, 2], rotations[j, 3] = x, y, z, w
        else:
            length = max(finish_rotation(mode, references[j], rotations[j]), 0.3)
            x, y, z, w = rotations[j, 0], rotations[j, 1], rotations[j, 2], rotations[j, 3]
        joints[j, 0], joints[j, 1], joints[j, 2], joints[j, 3] = point[0], point[1], point[2], length
        gx, gy, gz, gw = (
            gw * x + gx * w + gy * z - gz * y,
            gw * y - gx * z + gy * w + gz * x,
            gw * z + gx * y - gy * x + gz * w,
            gw * w - gx * x - gy * y - gz * z,
        )
        global_rotations[j, 0], global_rotations[j, 1], global_rotations[j, 2], global_rotations[j, 3] = gx, gy, gz, gw
        p, q, r = offsets[j, 0], offsets[j, 1], offsets[j, 2]
        x, y, z = 2.0 * (gy * r - gz * q), 2.0 * (gz * p - gx * r), 2.0 * (gx * q - gy * p)
        point[0] += p + gw * x + gy * z - gz * y
        point[1] += q + gw * y + gz * x - gx * z
        point[2] += r + gw * z + gx * y - gy * x


@kernel
def _jacobian(
    mode: int, roots: F64, rows: F64, references: F64,
    global_rotations: F64, rotations: F64, joints: F64, rates: F64, point: F64, jacobian: F64,
) -> None:  # fmt: skip
    """Jacobian (3, N) of the position that :func:`_effector` computed last."""
    count = jacobian.shape[1]
    for a in range(3):
        for i in range(count):
            jacobian[a, i] = roots[a, i]
    for j in range(references.shape[0]):
        _rotation_rates(mode, references[j], rotations[j], joints[j, 3], rates[0])
        x, y, z = point[0] - joints[j, 0], point[1] - joints[j, 1], point[2] - joints[j, 2]
        _lever(global_rotations[j], x, y, z, rates[0], rates[1])
        for a in range(3):
            p, q, r, s = rates[1, a, 0], rates[1, a, 1], rates[1, a, 2], rates[1, a, 3]
            for i in range(count):
                jacobian[a, i] += (
                    p * rows[4 * j, i] + q * rows[4 * j + 1, i] + r * rows[4 * j + 2, i] + s * rows[4 * j + 3, i]
                )


@kernel
def position_jacobian(weights: F64, chain: Chain, scratch: ChainScratch, point: F64, jacobian: F64) -> None:
    """Effector position (3,) of weights (N,), and its Jacobian (3, N) in them."""
    mode, roots, rows, references, offsets = chain
    global_rotations, rotations, joints, rates = scratch
    _effector(weights, mode, roots, rows, references, offsets, global_rotations, rotations, joints, point)
    _jacobian(mode, roots, rows, references, global_rotations, rotations, joints, rates, point, jacobian)


@kernel
def correct_positions(weights: F64, goals: F64, correction: Correction, chain: Chain) -> None:
    """Correct weights (B, N) in place until effectors are at goals (B, 3).

    Positions come first, as no Jacobian is needed where the goal is met. A short step leaves at most :data:`SQUARE`
    times the square of the distance, so that its result needs no check.
    """
    mode, roots, rows, references, offsets = chain
    fixed, scale, saturation, damping, stop, steps = correction
    point, jacobian = np.empty(3), np.empty((3, weights.shape[1]))
    global_rotations, rotations, joints, rates = chain_scratch(references.shape[0])
    for b in range(weights.shape[0]):
        for _ in range(steps):
            _effector(weights[b], mode, roots, rows, references, offsets, global_rotations, rotations, joints, point)
            squared = squared_distance(goals[b], point, scale)
            if squared < stop * stop:
                break
            _jacobian(mode, roots, rows, references, global_rotations, rotations, joints, rates, point, jacobian)
            step(weights[b], goals[b], point, jacobian, fixed, scale, (saturation, damping, stop))
            if SQUARE * squared < stop:
                break


@kernel
def effector_positions(weights: F64, chain: Chain, out: F64) -> None:
    """Effector positions (B, 3) of weights (B, N)."""
    mode, roots, rows, references, offsets = chain
    global_rotations, rotations, joints, _ = chain_scratch(references.shape[0])
    for b in range(weights.shape[0]):
        _effector(weights[b], mode, roots, rows, references, offsets, global_rotations, rotations, joints, out[b])


@kernel
def corrected_position(adverbs: F64, problem: PositionProblem, out: Blended) -> None:
    """Method ``corrected`` in one compiled call: weights at adverbs (B, D), measured adverbs and error, to ``out``."""
    inside, points = np.empty_like(adverbs), np.empty((adverbs.shape[0], 3))
    clamp(adverbs, problem.domain, inside, out.moved)
    cardinal(inside, problem.basis, out.weights)
    measure.goals(problem.space, inside, points)
    correct_positions(out.weights, points, problem.correction, problem.chain)
    effector_positions(out.weights, problem.chain, points)
    measure.compare(problem.space, adverbs, points, out.measured, out.error)
