"""Rotations between the coordinates of a server (+Y up, +Z forward) and of Blender (+Z up, −Y forward).

Quaternions are (x, y, z, w) here; Blender's are (w, x, y, z).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = [
    "conjugate",
    "from_blender",
    "multiply",
    "rotate",
    "rotation_from_blender",
    "rotation_to_blender",
    "to_blender",
    "zxy",
]

Numbers = Sequence[float]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def to_blender(point: Numbers) -> Vector:
    """A point or direction of the server in Blender's axes."""
    return (point[0], -point[2], point[1])


def from_blender(point: Numbers) -> Vector:
    """A point or direction of Blender in the server's axes."""
    return (point[0], point[2], -point[1])


def rotation_to_blender(rotation: Numbers) -> Quaternion:
    """A rotation of the server in Blender's axes."""
    return (*to_blender(rotation[:3]), rotation[3])


def rotation_from_blender(rotation: Numbers) -> Quaternion:
    """A rotation of Blender in the server's axes."""
    return (*from_blender(rotation[:3]), rotation[3])


def multiply(a: Numbers, b: Numbers) -> Quaternion:
    """The rotation by ``b``, then by ``a``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(a: Numbers) -> Quaternion:
    """The inverse of a unit quaternion."""
    return (-a[0], -a[1], -a[2], a[3])


def rotate(a: Numbers, v: Numbers) -> Vector:
    """A vector rotated by a unit quaternion."""
    x, y, z, _ = multiply(multiply(a, (*v, 0.0)), conjugate(a))
    return (x, y, z)


def zxy(rotation: Numbers) -> Vector:
    """Angles about Z, X, Y, degrees, of the rotation Z · X · Y, as channels of BVH."""
    x, y, z, w = rotation
    sine = max(-1.0, min(1.0, 2.0 * (y * z + x * w)))
    if abs(sine) > 1.0 - 1e-12:  # X is ±90°: Y and Z have the same axis
        return (math.degrees(2.0 * math.atan2(z, w)), math.degrees(math.asin(sine)), 0.0)
    about_z = math.atan2(2.0 * (z * w - x * y), 1.0 - 2.0 * (x * x + z * z))
    about_y = math.atan2(2.0 * (y * w - x * z), 1.0 - 2.0 * (x * x + y * y))
    return (math.degrees(about_z), math.degrees(math.asin(sine)), math.degrees(about_y))
