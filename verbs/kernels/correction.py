"""Corrected blending: weights moved until the measured point is the goal, by smooth steps of a fixed form.

Each step is a minimum-norm Gauss–Newton step on the weights. The residual is saturated, so that no step overshoots
onto another branch of solutions; what must not change (the sum of the weights, blended style adverbs) is projected
out. Being a composition of smooth maps, the result is as smooth as the weights it starts from, and exact.

Source: ``docs/math.md``, section "Corrected blending"; the Jacobians are derived there.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import root_velocity
from verbs.kernels.compile import kernel
from verbs.kernels.pose import NLERP, ROTATION_VECTOR, finish_rotation, multiply

__all__ = [
    "correct_jumps",
    "correct_positions",
    "correct_velocities",
    "jump_jacobian",
    "position_jacobian",
    "reach_positions",
    "velocity_jacobian",
]

SQUARE = 100.0
"""A step of full length leaves this many times the square of the distance (1/m) at most: 1 to 20, where we measured."""


@kernel
def step(weights: F64, goal: F64, point: F64, jacobian: F64, held: F64, scale: F64, rules: F64) -> float:
    """Move weights (N,) one step from ``point`` (3,) toward ``goal`` (3,), in place; return the scaled distance.

    Parameters
    ----------
    jacobian : (3, N) float64
        Derivative of the point in the weights. Overwritten.
    held : (S, N) float64
        Orthonormal directions in which the weights must not move.
    scale : (3,) float64
        Units of the residual: 1 for metres, 1/range for mixed units.
    rules : (4,) float64
        Saturation of the residual, damping λ, distance at which to stop, most steps.
    """
    count = weights.shape[0]
    x, y, z = scale[0] * (goal[0] - point[0]), scale[1] * (goal[1] - point[1]), scale[2] * (goal[2] - point[2])
    squared = x * x + y * y + z * z
    distance = np.sqrt(squared)
    if distance < rules[2]:
        return distance
    shrink = 1.0 / np.sqrt(1.0 + squared / (rules[0] * rules[0]))
    for a in range(3):
        for i in range(count):
            jacobian[a, i] *= scale[a]
        for s in range(held.shape[0]):
            share = 0.0
            for i in range(count):
                share += jacobian[a, i] * held[s, i]
            for i in range(count):
                jacobian[a, i] -= share * held[s, i]
    xx, xy, xz, yy, yz, zz = rules[1], 0.0, 0.0, rules[1], 0.0, rules[1]
    for i in range(count):
        jx, jy, jz = jacobian[0, i], jacobian[1, i], jacobian[2, i]
        xx += jx * jx
        xy += jx * jy
        xz += jx * jz
        yy += jy * jy
        yz += jy * jz
        zz += jz * jz
    # Cholesky's factors of the symmetric 3×3 system, written out
    a0 = np.sqrt(xx)
    b0, c0 = xy / a0, xz / a0
    d0 = np.sqrt(max(yy - b0 * b0, 1e-300))
    e0 = (yz - b0 * c0) / d0
    f0 = np.sqrt(max(zz - c0 * c0 - e0 * e0, 1e-300))
    x /= a0
    y = (y - b0 * x) / d0
    z = (z - c0 * x - e0 * y) / f0
    z /= f0
    y = (y - e0 * z) / d0
    x = (x - b0 * y - c0 * z) / a0
    for i in range(count):
        weights[i] += shrink * (jacobian[0, i] * x + jacobian[1, i] * y + jacobian[2, i] * z)
    return distance


@kernel
def _rates(mode: int, reference: F64, blended: F64, length: float, out: F64) -> None:
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
    back, turn, v = np.empty(4), np.empty(4), np.empty(3)
    back[0], back[1], back[2], back[3] = -reference[0], -reference[1], -reference[2], reference[3]
    multiply(back, blended, turn)
    sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    angle = 2.0 * np.arctan2(sine, turn[3])
    for a in range(3):
        v[a] = turn[a] * (angle / sine if sine > 1e-9 else 2.0)
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
def _lever(turn: F64, x: float, y: float, z: float, rates: F64, out: F64) -> None:
    """Matrix (3, 4) from an example's row to the effector's velocity: (G · rates) × (point − place).

    ``turn`` (4,) is the joint's global rotation G; x, y, z is the way from the joint to the effector.
    """
    a, b, c, d = turn[0], turn[1], turn[2], turn[3]
    xx, yy, zz = 1.0 - 2.0 * (b * b + c * c), 1.0 - 2.0 * (a * a + c * c), 1.0 - 2.0 * (a * a + b * b)
    xy, xz, yz = 2.0 * (a * b - c * d), 2.0 * (a * c + b * d), 2.0 * (b * c - a * d)
    yx, zx, zy = 2.0 * (a * b + c * d), 2.0 * (a * c - b * d), 2.0 * (b * c + a * d)
    for k in range(4):
        p = xx * rates[0, k] + xy * rates[1, k] + xz * rates[2, k]
        q = yx * rates[0, k] + yy * rates[1, k] + yz * rates[2, k]
        r = zx * rates[0, k] + zy * rates[1, k] + zz * rates[2, k]
        out[0, k], out[1, k], out[2, k] = q * z - r * y, r * x - p * z, p * y - q * x


@kernel
def _position(
    weights: F64, mode: int, roots: F64, rows: F64, references: F64, offsets: F64,
    turns: F64, locals_: F64, places: F64, point: F64,
) -> None:  # fmt: skip
    """Effector position (3,), and what its Jacobian needs; arrays as in :func:`position_jacobian`."""
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
            locals_[j, a] = total
        x, y, z, w = locals_[j, 0], locals_[j, 1], locals_[j, 2], locals_[j, 3]
        length = np.sqrt(x * x + y * y + z * z + w * w)
        if mode == NLERP and length >= 0.3:
            x, y, z, w = x / length, y / length, z / length, w / length
            locals_[j, 0], locals_[j, 1], locals_[j, 2], locals_[j, 3] = x, y, z, w
        else:
            length = max(finish_rotation(mode, references[j], locals_[j]), 0.3)
            x, y, z, w = locals_[j, 0], locals_[j, 1], locals_[j, 2], locals_[j, 3]
        places[j, 0], places[j, 1], places[j, 2], places[j, 3] = point[0], point[1], point[2], length
        gx, gy, gz, gw = (
            gw * x + gx * w + gy * z - gz * y,
            gw * y - gx * z + gy * w + gz * x,
            gw * z + gx * y - gy * x + gz * w,
            gw * w - gx * x - gy * y - gz * z,
        )
        turns[j, 0], turns[j, 1], turns[j, 2], turns[j, 3] = gx, gy, gz, gw
        p, q, r = offsets[j, 0], offsets[j, 1], offsets[j, 2]
        x, y, z = 2.0 * (gy * r - gz * q), 2.0 * (gz * p - gx * r), 2.0 * (gx * q - gy * p)
        point[0] += p + gw * x + gy * z - gz * y
        point[1] += q + gw * y + gz * x - gx * z
        point[2] += r + gw * z + gx * y - gy * x


@kernel
def _spread(
    mode: int, roots: F64, rows: F64, references: F64, turns: F64, locals_: F64, places: F64, rates: F64, point: F64,
    jacobian: F64,
) -> None:  # fmt: skip
    """Jacobian (3, N) of the position that :func:`_position` left."""
    count = jacobian.shape[1]
    for a in range(3):
        for i in range(count):
            jacobian[a, i] = roots[a, i]
    for j in range(references.shape[0]):
        _rates(mode, references[j], locals_[j], places[j, 3], rates[0])
        x, y, z = point[0] - places[j, 0], point[1] - places[j, 1], point[2] - places[j, 2]
        _lever(turns[j], x, y, z, rates[0], rates[1])
        for a in range(3):
            p, q, r, s = rates[1, a, 0], rates[1, a, 1], rates[1, a, 2], rates[1, a, 3]
            for i in range(count):
                jacobian[a, i] += (
                    p * rows[4 * j, i] + q * rows[4 * j + 1, i] + r * rows[4 * j + 2, i] + s * rows[4 * j + 3, i]
                )


@kernel
def position_jacobian(
    weights: F64,
    mode: int,
    roots: F64,
    rows: F64,
    references: F64,
    offsets: F64,
    turns: F64,
    locals_: F64,
    places: F64,
    rates: F64,
    point: F64,
    jacobian: F64,
) -> None:
    """Effector position (3,) and its Jacobian (3, N) in the weights.

    Parameters
    ----------
    weights : (N,) float64
    mode : int
        How rotations blend, see :mod:`verbs.kernels.pose`.
    roots : (3, N) float64
        Root position of each example at the keytime.
    rows : (4·L, N) float64
        Rotation rows of the L joints of the chain from the root to the effector's parent.
    references : (L, 4) float64
    offsets : (L, 3) float64
        Offset of the next joint of the chain; the last one is the effector's.
    turns, locals_, places, rates : (L, 4), (L, 4), (L, 4), (2, 3, 4) float64
        Scratch: global and blended rotations; places and lengths of sums; matrices from rows to velocities.
    point, jacobian : (3,), (3, N) float64
        Written.
    """
    _position(weights, mode, roots, rows, references, offsets, turns, locals_, places, point)
    _spread(mode, roots, rows, references, turns, locals_, places, rates, point, jacobian)


@kernel
def jump_jacobian(weights: F64, roots: F64, point: F64, jacobian: F64) -> None:
    """Displacement x, z and rise (3,) of a jump and their Jacobian (3, N); arrays as in :func:`measure.jump`."""
    point[:] = 0.0
    for i in range(weights.shape[0]):
        jacobian[0, i] = roots[2, i, 0] - roots[0, i, 0]
        jacobian[1, i] = roots[2, i, 2] - roots[0, i, 2]
        jacobian[2, i] = roots[1, i, 1] - roots[0, i, 1]
        for a in range(3):
            point[a] += weights[i] * jacobian[a, i]


@kernel
def velocity_jacobian(
    weights: F64, strides: F64, phases: F64, log_lengths: F64, point: F64, jacobian: F64, shares: F64
) -> None:
    """Forward speed, turn rate, sideways speed (3,) over a cycle and their Jacobian (3, N).

    ``strides`` are (K, N, 3) and ``shares`` (2, N) is scratch. This lays the strides out at each call; who asks often
    does that once, as :func:`correct_velocities`.
    """
    count = weights.shape[0]
    walk = root_velocity.walk_of(strides, phases, shares[0])
    times, full, steps, rows, columns = root_velocity.scratch(walk, phases, count)
    root_velocity.mean_speeds(weights, walk, shares[0], phases, log_lengths, times, full, steps, point)
    root_velocity.speed_derivatives(walk, shares[0], phases, log_lengths, times, steps, point, rows, columns)
    for a in range(3):
        for i in range(count):
            jacobian[a, i] = columns[a, i]


@kernel
def correct_positions(
    weights: F64,
    goals: F64,
    held: F64,
    scale: F64,
    rules: F64,
    mode: int,
    roots: F64,
    rows: F64,
    references: F64,
    offsets: F64,
) -> None:
    """Correct weights (B, N) in place until effectors are at goals (B, 3).

    Positions come first, as no Jacobian is needed where the goal is met; a step that must have met it, being small,
    is not looked at again: it leaves :data:`SQUARE` times the square of the distance at most.
    """
    links, point, jacobian = references.shape[0], np.empty(3), np.empty((3, weights.shape[1]))
    turns, locals_, places = np.empty((links, 4)), np.empty((links, 4)), np.empty((links, 4))
    rates = np.empty((2, 3, 4))
    for b in range(weights.shape[0]):
        for _ in range(int(rules[3])):
            _position(weights[b], mode, roots, rows, references, offsets, turns, locals_, places, point)
            missing = 0.0
            for a in range(3):
                missing += (scale[a] * (goals[b, a] - point[a])) ** 2
            if missing < rules[2] * rules[2]:
                break
            _spread(mode, roots, rows, references, turns, locals_, places, rates, point, jacobian)
            step(weights[b], goals[b], point, jacobian, held, scale, rules)
            if SQUARE * missing < rules[2]:
                break


@kernel
def reach_positions(weights: F64, mode: int, roots: F64, rows: F64, references: F64, offsets: F64, out: F64) -> None:
    """Effector positions (B, 3) of weights (B, N); arrays as in :func:`position_jacobian`."""
    links = references.shape[0]
    turns, locals_, places = np.empty((links, 4)), np.empty((links, 4)), np.empty((links, 4))
    for b in range(weights.shape[0]):
        _position(weights[b], mode, roots, rows, references, offsets, turns, locals_, places, out[b])


@kernel
def correct_jumps(weights: F64, goals: F64, held: F64, scale: F64, rules: F64, roots: F64) -> None:
    """Correct weights (B, N) in place until jumps have the displacement and rise of goals (B, 3)."""
    point, jacobian = np.empty(3), np.empty((3, weights.shape[1]))
    for b in range(weights.shape[0]):
        for _ in range(int(rules[3])):
            jump_jacobian(weights[b], roots, point, jacobian)
            if step(weights[b], goals[b], point, jacobian, held, scale, rules) < rules[2]:
                break


@kernel
def correct_velocities(
    weights: F64, goals: F64, held: F64, scale: F64, rules: F64, walk: F64, turns: F64, phases: F64, log_lengths: F64
) -> None:
    """Correct weights (B, N) in place until cycles have the speeds of goals (B, 3).

    ``walk`` and ``turns`` are those of :func:`verbs.kernels.root_velocity.walk_of`; steps end as in
    :func:`correct_positions`.
    """
    point = np.empty(3)
    times, full, steps, shares, jacobian = root_velocity.scratch(walk, phases, weights.shape[1])
    for b in range(weights.shape[0]):
        for _ in range(int(rules[3])):
            root_velocity.mean_speeds(weights[b], walk, turns, phases, log_lengths, times, full, steps, point)
            missing = 0.0
            for a in range(3):
                missing += (scale[a] * (goals[b, a] - point[a])) ** 2
            if np.sqrt(missing) < rules[2]:
                break
            root_velocity.speed_derivatives(walk, turns, phases, log_lengths, times, steps, point, shares, jacobian)
            step(weights[b], goals[b], point, jacobian, held, scale, rules)
            if SQUARE * missing < rules[2]:
                break
