"""Joints at knots of canonical time: position, rotation, velocity and spin, and their derivatives in the weights.

A site is one joint at one knot, with the rows of its chain from the root. Body rates of a joint come from the blended
row s and its derivative s' in phase; world rates add up along the chain, and so do their derivatives, example by
example. Velocities are per unit of phase here; :mod:`verbs.kernels.adverb_measures` divides by seconds.

Source: ``docs/math.md``, section "Measures of adverbs"; the recursions are those of rigid-body kinematics
(R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, section 4.1), the right Jacobian that of J. Solà, J. Deray
and D. Atchuthan, "A micro Lie theory for state estimation in robotics", 2018.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel
from verbs.kernels.pose import ROTATION_VECTOR, SHORTEST, finish_rotation, multiply

__all__ = ["Motion", "Sites", "motion_of", "move_site"]


class Sites(NamedTuple):
    """S sites with T links in all.

    Parameters
    ----------
    mode : int
        How rotations blend, see :mod:`verbs.kernels.pose`.
    instants : (S,) int64
        Number of the site's phase.
    ends : (S + 1,) int64
        Links of site s are ends[s] to ends[s + 1], from the root to the joint itself.
    roots, root_rates : (S, 3, N) float64
        Root position of each example, and its derivative in phase.
    rows, rates : (T, 4, N) float64
        Rotation rows and their derivatives in phase.
    references : (T, 4) float64
    offsets : (T, 3) float64
        Offset to the next link; zero at the last one of a site.
    """

    mode: int
    instants: I64
    ends: I64
    roots: F64
    root_rates: F64
    rows: F64
    rates: F64
    references: F64
    offsets: F64


class Motion(NamedTuple):
    """Motion of S sites, as :func:`move_site` writes it; rates are per unit of phase.

    Parameters
    ----------
    positions, velocities, spins : (S, 3) float64
        In the motion's frame.
    rotations : (S, 4) float64
        Global rotations.
    d_positions, d_rotations, d_velocities, d_spins : (S, 3, N) float64
        Derivatives in the weights; that of a rotation is the rotation vector, in the motion's frame.
    """

    positions: F64
    rotations: F64
    velocities: F64
    spins: F64
    d_positions: F64
    d_rotations: F64
    d_velocities: F64
    d_spins: F64


@kernel
def motion_of(sites: int, count: int) -> Motion:
    """Arrays for so many sites and examples."""
    shape = (sites, 3, count)
    return Motion(
        np.empty((sites, 3)), np.empty((sites, 4)), np.empty((sites, 3)), np.empty((sites, 3)),
        np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape),
    )  # fmt: skip


@kernel
def _rotated(q: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector rotated by a unit quaternion (4,)."""
    p, r, s = 2.0 * (q[1] * z - q[2] * y), 2.0 * (q[2] * x - q[0] * z), 2.0 * (q[0] * y - q[1] * x)
    return x + q[3] * p + q[1] * s - q[2] * r, y + q[3] * r + q[2] * p - q[0] * s, z + q[3] * s + q[0] * r - q[1] * p


@kernel
def _relative(a: F64, x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Vector part of conj(a) · (x, y, z, w)."""
    return (
        a[3] * x - a[0] * w - a[1] * z + a[2] * y,
        a[3] * y - a[1] * w - a[2] * x + a[0] * z,
        a[3] * z - a[2] * w - a[0] * y + a[1] * x,
    )


@kernel
def _quaternion_rates(s: F64, s_rate: F64, row: F64, row_rate: F64, i: int, out: F64) -> None:
    """Body rotation ν (out 0 to 2) of example i, and change of the body rate ω (out 3 to 5); out 6 to 8 is ω.

    With s the sum of quaternions: ω = 2 vec(s̄ s') / |s|², ν = 2 vec(s̄ r) / |s|², and
    δω = (2 vec(s̄ r') + 2 vec(r̄ s') − 2 (s · r) ω) / |s|².
    """
    scale = 2.0 / (s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + s[3] * s[3])
    r0, r1, r2, r3 = row[0, i], row[1, i], row[2, i], row[3, i]
    dot = s[0] * r0 + s[1] * r1 + s[2] * r2 + s[3] * r3
    nx, ny, nz = _relative(s, r0, r1, r2, r3)
    wx, wy, wz = _relative(s, s_rate[0], s_rate[1], s_rate[2], s_rate[3])
    ax, ay, az = _relative(s, row_rate[0, i], row_rate[1, i], row_rate[2, i], row_rate[3, i])
    # vec(conj(r) s') = −vec(conj(s') r)
    bx, by, bz = _relative(s_rate, r0, r1, r2, r3)
    out[0], out[1], out[2] = scale * nx, scale * ny, scale * nz
    out[6], out[7], out[8] = scale * wx, scale * wy, scale * wz
    out[3] = scale * (ax - bx - dot * out[6])
    out[4] = scale * (ay - by - dot * out[7])
    out[5] = scale * (az - bz - dot * out[8])


@kernel
def _cross(a: F64, b: F64, out: F64) -> None:
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _exponential(angle: float) -> tuple[float, float, float, float]:
    """Numbers a, b of the right Jacobian 1 − a [v] + b [v]², and their derivatives in the angle, divided by it."""
    square = angle * angle
    if angle < 0.02:
        a, b = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        return a, b, -1.0 / 12.0 + square / 180.0, -1.0 / 60.0 + square / 1260.0
    sine, cosine = np.sin(angle), np.cos(angle)
    a, b = (1.0 - cosine) / square, (angle - sine) / (square * angle)
    slope_a = (angle * sine - 2.0 * (1.0 - cosine)) / (square * square)
    slope_b = (3.0 * sine - angle * cosine - 2.0 * angle) / (square * square * angle)
    return a, b, slope_a, slope_b


@kernel
def _right(v: F64, u: F64, a: float, b: float, out: F64) -> None:
    """Right Jacobian of the exponential at v, times u."""
    once, twice = np.empty(3), np.empty(3)
    _cross(v, u, once)
    _cross(v, once, twice)
    for k in range(3):
        out[k] = u[k] - a * once[k] + b * twice[k]


@kernel
def _vector_rates(s: F64, s_rate: F64, row: F64, row_rate: F64, i: int, out: F64) -> None:
    """:func:`_quaternion_rates` for a sum s of vectors: ω = R(s) s', ν = R(s) r, δω = R(s) r' + R'(s, r) s'."""
    v, rate, r, r_rate, found = s[:3], s_rate[:3], row[:3, i].copy(), row_rate[:3, i].copy(), np.empty(3)
    angle = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    a, b, slope_a, slope_b = _exponential(angle)
    _right(v, rate, a, b, out[6:9])
    _right(v, r, a, b, out[0:3])
    _right(v, r_rate, a, b, out[3:6])
    dot = v[0] * r[0] + v[1] * r[1] + v[2] * r[2]
    once, twice = np.empty(3), np.empty(3)
    _cross(v, rate, once)
    _cross(v, once, twice)
    for k in range(3):
        out[3 + k] += dot * (slope_b * twice[k] - slope_a * once[k])
    _cross(r, once, twice)
    for k in range(3):
        out[3 + k] += b * twice[k]
    _cross(r, rate, once)
    _cross(v, once, found)
    for k in range(3):
        out[3 + k] += b * found[k] - a * once[k]


@kernel
def _sum(weights: F64, rows: F64, out: F64) -> None:
    """Weighted sum of the columns of rows (A, N)."""
    for a in range(rows.shape[0]):
        total = 0.0
        for i in range(weights.shape[0]):
            total += weights[i] * rows[a, i]
        out[a] = total


@kernel
def _begin(weights: F64, s: int, sites: Sites, striding: bool, place: F64, place_rate: F64, d_place: F64,
           d_place_rate: F64, out: Motion) -> None:  # fmt: skip
    """Frame of the root of site ``s``: a striding root stands at its place and heading, at its own height."""
    root, rate = np.empty(3), np.empty(3)
    roots, root_rates = sites.roots[s], sites.root_rates[s]
    _sum(weights, roots, root)
    _sum(weights, root_rates, rate)
    out.positions[s], out.velocities[s], out.spins[s] = root, rate, 0.0
    out.d_positions[s], out.d_velocities[s] = roots, root_rates
    out.d_rotations[s], out.d_spins[s], out.rotations[s] = 0.0, 0.0, 0.0
    out.rotations[s, 3] = 1.0
    if not striding:
        return
    out.rotations[s, 1], out.rotations[s, 3] = np.sin(0.5 * place[2]), np.cos(0.5 * place[2])
    out.spins[s, 1] = place_rate[2]
    out.d_rotations[s, 1], out.d_spins[s, 1] = d_place[2], d_place_rate[2]
    out.positions[s, 0], out.positions[s, 2] = place[0], place[1]
    out.velocities[s, 0], out.velocities[s, 2] = place_rate[0], place_rate[1]
    out.d_positions[s, 0], out.d_positions[s, 2] = d_place[0], d_place[1]
    out.d_velocities[s, 0], out.d_velocities[s, 2] = d_place_rate[0], d_place_rate[1]
    out.positions[s, 1] += place[3]
    out.velocities[s, 1] += place_rate[3]
    for i in range(weights.shape[0]):
        out.d_positions[s, 1, i] += d_place[3, i]
        out.d_velocities[s, 1, i] += d_place_rate[3, i]


@kernel
def move_site(weights: F64, s: int, sites: Sites, striding: bool, place: F64, place_rate: F64, d_place: F64,
              d_place_rate: F64, out: Motion) -> None:  # fmt: skip
    """Motion of site ``s`` at weights (N,), to row ``s`` of ``out``.

    ``place`` (4,) and the three after it are those of :class:`verbs.kernels.travelling.Places` at the site's instant;
    they count where the root is ``striding``.
    """
    _begin(weights, s, sites, striding, place, place_rate, d_place, d_place_rate, out)
    mode, count = sites.mode, weights.shape[0]
    turn, spin, found = out.rotations[s], out.spins[s], np.empty(9)
    d_turn, d_spin, d_position, d_velocity = (
        out.d_rotations[s], out.d_spins[s], out.d_positions[s], out.d_velocities[s],
    )  # fmt: skip
    row, rate, q, product = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for link in range(sites.ends[s], sites.ends[s + 1]):
        rows, rates, offset = sites.rows[link], sites.rates[link], sites.offsets[link]
        _sum(weights, rows, row)
        _sum(weights, rates, rate)
        q[:] = row
        length = finish_rotation(mode, sites.references[link], q)
        held = mode != ROTATION_VECTOR and length < SHORTEST  # the reference rotation, which does not move
        multiply(turn, q, product)
        turn[:] = product
        bx, by, bz = 0.0, 0.0, 0.0  # the body rate in the motion's frame
        for i in range(count if not held else 0):
            if mode == ROTATION_VECTOR:
                _vector_rates(row, rate, rows, rates, i, found)
            else:
                _quaternion_rates(row, rate, rows, rates, i, found)
            if i == 0:
                bx, by, bz = _rotated(turn, found[6], found[7], found[8])
            x, y, z = _rotated(turn, found[0], found[1], found[2])
            d_turn[0, i] += x
            d_turn[1, i] += y
            d_turn[2, i] += z
            x, y, z = _rotated(turn, found[3], found[4], found[5])
            tx, ty, tz = d_turn[0, i], d_turn[1, i], d_turn[2, i]
            d_spin[0, i] += x + ty * bz - tz * by
            d_spin[1, i] += y + tz * bx - tx * bz
            d_spin[2, i] += z + tx * by - ty * bx
        spin[0] += bx
        spin[1] += by
        spin[2] += bz
        ox, oy, oz = _rotated(turn, offset[0], offset[1], offset[2])
        out.positions[s, 0] += ox
        out.positions[s, 1] += oy
        out.positions[s, 2] += oz
        out.velocities[s, 0] += spin[1] * oz - spin[2] * oy
        out.velocities[s, 1] += spin[2] * ox - spin[0] * oz
        out.velocities[s, 2] += spin[0] * oy - spin[1] * ox
        for i in range(count):
            tx, ty, tz = d_turn[0, i], d_turn[1, i], d_turn[2, i]
            x, y, z = ty * oz - tz * oy, tz * ox - tx * oz, tx * oy - ty * ox
            d_position[0, i] += x
            d_position[1, i] += y
            d_position[2, i] += z
            sx, sy, sz = d_spin[0, i], d_spin[1, i], d_spin[2, i]
            d_velocity[0, i] += sy * oz - sz * oy + spin[1] * z - spin[2] * y
            d_velocity[1, i] += sz * ox - sx * oz + spin[2] * x - spin[0] * z
            d_velocity[2, i] += sx * oy - sy * ox + spin[0] * y - spin[1] * x
