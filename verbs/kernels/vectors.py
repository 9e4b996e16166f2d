"""Rotations and vectors as tuples: for kernels that work on one pose, without arrays. Quaternions are x, y, z, w."""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.kernels.compile import kernel

__all__ = ["about", "arc", "cross", "dot", "inverse", "mul", "rotate"]


@kernel
def mul(a: Any, b: Any) -> Any:
    """Quaternion product of tuples."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@kernel
def inverse(a: Any) -> Any:
    """Inverse of a unit quaternion."""
    return (-a[0], -a[1], -a[2], a[3])


@kernel
def rotate(q: Any, x: float, y: float, z: float) -> Any:
    """Vector rotated by a unit quaternion."""
    u = 2.0 * (q[1] * z - q[2] * y)
    v = 2.0 * (q[2] * x - q[0] * z)
    w = 2.0 * (q[0] * y - q[1] * x)
    return (
        x + q[3] * u + q[1] * w - q[2] * v,
        y + q[3] * v + q[2] * u - q[0] * w,
        z + q[3] * w + q[0] * v - q[1] * u,
    )


@kernel
def about(x: float, y: float, z: float, angle: float) -> Any:
    """Rotation about a unit axis."""
    s = np.sin(0.5 * angle)
    return (s * x, s * y, s * z, np.cos(0.5 * angle))


@kernel
def arc(a: Any, b: Any) -> Any:
    """The smallest rotation from the direction of one vector to that of another."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    w += np.sqrt((a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) * (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]))
    length = np.sqrt(x * x + y * y + z * z + w * w)
    if length < 1e-12:
        return (0.0, 0.0, 0.0, 1.0)
    return (x / length, y / length, z / length, w / length)


@kernel
def cross(a: Any, b: Any) -> Any:
    """Cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a: Any, b: Any) -> Any:
    """Scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
