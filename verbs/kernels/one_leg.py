"""One leg of a pose: where its joints are, and two-bone inverse kinematics.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel
from verbs.kernels.vectors import about, arc, cross, dot, inverse, mul, rotate

__all__ = [
    "SCRATCH",
    "STRAIGHT",
    "STRAIGHTEST",
    "YIELD",
    "bend_leg",
    "clip",
    "find_leg",
    "get",
    "lengths",
    "put",
    "smoothstep",
    "triple",
]

STRAIGHT, STRAIGHTEST, YIELD = 0.995, 0.998, 0.003
"""Shares of a leg's length: up to which it stretches freely (a knee bent by 11 degrees where thigh and shank are
equal); up to which it does if it is as straight in the pose (7 degrees); and beyond these, within which it yields."""

UPRIGHT = 0.1
"""Weight of the usual axis of a straight knee beside the one of its pose, which weighs the sine of its angle."""

PLAIN = 0.5
"""Sine of the angle from which on the axis of a knee is that of its pose only."""

LITTLE_BENT = 0.02
"""Change of a straight knee's bend that takes it into its usual plane, radians; a knee that is overstretched takes half
its bend more."""

SCRATCH = 32
"""Numbers of scratch that a foot needs."""


@kernel
def clip(value: float) -> float:
    """A cosine or sine within -1 and 1."""
    return min(max(value, -1.0), 1.0)


@kernel
def get(rotations: Any, joint: int) -> Any:
    """Rotation of one joint, as a tuple of double precision."""
    q = rotations[joint]
    return (np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))


@kernel
def put(rotations: Any, joint: int, q: Any) -> None:
    """Replace a rotation; of both quaternions of the new one, the one that is near the old one."""
    old = get(rotations, joint)
    sign = -1.0 if old[0] * q[0] + old[1] * q[1] + old[2] * q[2] + old[3] * q[3] < 0.0 else 1.0
    for a in range(4):
        rotations[joint, a] = sign * q[a]


@kernel
def triple(point: F64) -> Any:
    """A vector (3,) as a tuple."""
    return (point[0], point[1], point[2])


@kernel
def smoothstep(value: float) -> float:
    """From 0 to 1 as a value does, with slope 0 at both."""
    value = min(max(value, 0.0), 1.0)
    return value * value * (3.0 - 2.0 * value)


@kernel
def find_leg(root: Any, rotations: Any, chain: I64, offsets: F64, out: F64) -> Any:
    """Forward kinematics of a leg, to ``out``; returns the global rotation of the foot."""
    length = chain.shape[0]
    hip = length - 4
    x, y, z = np.float64(root[0]), np.float64(root[1]), np.float64(root[2])
    q = (0.0, 0.0, 0.0, 1.0)
    for c in range(length - 1):
        joint = chain[c]
        if joint < 0:
            continue
        if joint > 0:
            dx, dy, dz = rotate(q, offsets[joint, 0], offsets[joint, 1], offsets[joint, 2])
            x, y, z = x + dx, y + dy, z + dz
        if c >= hip:
            at = 2 + 3 * (c - hip)
            out[at], out[at + 1], out[at + 2] = x, y, z
        if c == hip:
            out[11], out[12], out[13], out[14] = q
        q = mul(q, get(rotations, joint))
        if c == hip:
            out[15], out[16], out[17], out[18] = q
        elif c == hip + 1:
            out[19], out[20], out[21], out[22] = q
    return q


@kernel
def lengths(out: F64) -> Any:
    """Length of a leg, and the distance from hip to ankle that it has in the pose."""
    thigh = np.sqrt((out[5] - out[2]) ** 2 + (out[6] - out[3]) ** 2 + (out[7] - out[4]) ** 2)
    shank = np.sqrt((out[8] - out[5]) ** 2 + (out[9] - out[6]) ** 2 + (out[10] - out[7]) ** 2)
    now = np.sqrt((out[8] - out[2]) ** 2 + (out[9] - out[3]) ** 2 + (out[10] - out[4]) ** 2)
    return thigh, shank, now


@kernel
def _hinge(upper: Any, lower: Any, usual: Any, scale: float) -> Any:
    """Unit axis about which a knee is bent, and the cosine of its angle to the usual one.

    The axis is near the usual one or its opposite where the knee is straight; the cosine is below 0 where it is
    overstretched.
    """
    cx, cy, cz = cross(upper, lower)
    cx, cy, cz = cx / scale, cy / scale, cz / scale
    near = UPRIGHT * max(1.0 - np.sqrt(cx * cx + cy * cy + cz * cz) / PLAIN, 0.0)
    if dot((cx, cy, cz), usual) < 0.0:
        near = -near
    cx, cy, cz = cx + near * usual[0], cy + near * usual[1], cz + near * usual[2]
    size = np.sqrt(cx * cx + cy * cy + cz * cz)
    axis = (cx / size, cy / size, cz / size)
    return axis[0], axis[1], axis[2], dot(axis, usual)


@kernel
def _spin(axis: Any, usual: Any, line: Any, share: float) -> Any:
    """Rotation about the line from hip to ankle that takes a knee a share of the way into its usual plane.

    The angle is from 0 to 2 pi: an overstretched knee turns always to the same side.
    """
    angle = np.arctan2(dot(line, cross(axis, usual)), dot(axis, usual))
    return about(line[0], line[1], line[2], share * (angle if angle >= 0.0 else angle + 2.0 * np.pi))


@kernel
def bend_leg(rotations: Any, chain: I64, hinge: F64, pose: F64, shift: float, free: float) -> None:
    """Bend one leg so that its ankle and foot are as wanted, after the pelvis has moved.

    It yields beyond a length, ``free``.
    """
    length = chain.shape[0]
    hip, knee, ankle = chain[length - 4], chain[length - 3], chain[length - 2]
    if pose[0] == 0.0:  # only the pelvis moves: the foot stays where it is
        pose[23], pose[24], pose[25] = pose[8], pose[9], pose[10]
        shank = (pose[19], pose[20], pose[21], pose[22])
        pose[26], pose[27], pose[28], pose[29] = mul(shank, get(rotations, ankle))
    thigh, shin, _ = lengths(pose)
    wanted = (pose[23] - pose[2], pose[24] - pose[3] - shift, pose[25] - pose[4])
    reach = max(np.sqrt(wanted[0] ** 2 + wanted[1] ** 2 + wanted[2] ** 2), 1e-9)
    distance, whole = reach, thigh + shin
    if distance > free:
        give = min(YIELD * whole, max(0.5 * (whole - free), 1e-6))
        distance = free + give * (1.0 - np.exp(-(distance - free) / give))
    distance = max(distance, 1.05 * abs(thigh - shin) + 1e-3)
    upper = (pose[5] - pose[2], pose[6] - pose[3], pose[7] - pose[4])
    lower = (pose[8] - pose[5], pose[9] - pose[6], pose[10] - pose[7])
    parent = (pose[11], pose[12], pose[13], pose[14])
    hip_q, knee_q = (pose[15], pose[16], pose[17], pose[18]), (pose[19], pose[20], pose[21], pose[22])
    ax, ay, az, cosine = _hinge(upper, lower, rotate(hip_q, *triple(hinge)), thigh * shin)
    bent = np.arctan2(dot(cross(upper, lower), (ax, ay, az)), dot(upper, lower))
    wanted_bend = np.pi - np.arccos(clip((thigh**2 + shin**2 - distance**2) / (2.0 * thigh * shin)))
    turn = about(ax, ay, az, wanted_bend - bent)
    knee_q = mul(turn, knee_q)
    lower = rotate(turn, lower[0], lower[1], lower[2])
    aim = arc((upper[0] + lower[0], upper[1] + lower[1], upper[2] + lower[2]), wanted)
    hip_q, knee_q = mul(aim, hip_q), mul(aim, knee_q)
    if cosine < 0.0:
        changed = abs(wanted_bend - bent) / (0.5 * bent + LITTLE_BENT)
        share = smoothstep(pose[1] + changed) * smoothstep(-cosine)
        line = (wanted[0] / reach, wanted[1] / reach, wanted[2] / reach)
        spin = _spin(rotate(aim, ax, ay, az), rotate(hip_q, *triple(hinge)), line, share)
        thigh_to, shank_to = rotate(aim, *upper), rotate(aim, *lower)
        hip_q = mul(arc(thigh_to, rotate(spin, *thigh_to)), hip_q)  # without a twist
        knee_q = mul(arc(shank_to, rotate(spin, *shank_to)), knee_q)
    put(rotations, hip, mul(inverse(parent), hip_q))
    put(rotations, knee, mul(inverse(hip_q), knee_q))
    put(rotations, ankle, mul(inverse(knee_q), (pose[26], pose[27], pose[28], pose[29])))
