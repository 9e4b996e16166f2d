"""Operations on unit quaternions x, y, z, w, over any leading axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["mul", "rotate", "slerp"]

F64 = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.floating[Any]]

SMALL_ANGLE_RAD = 1e-4
"""Below it an arc is a straight line within the precision of float32."""


def mul(first: Numbers, second: Numbers) -> F64:
    """Product (..., 4): the rotation by ``second``, then by ``first``, both (..., 4)."""
    ax, ay, az, aw = np.moveaxis(np.asarray(first, np.float64), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(second, np.float64), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def rotate(rotations: Numbers, vectors: Numbers) -> F64:
    """Vectors (..., 3) rotated by rotations (..., 4)."""
    qx, qy, qz, qw = np.moveaxis(np.asarray(rotations, np.float64), -1, 0)
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    tx, ty, tz = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
    return np.stack(
        [x + qw * tx + qy * tz - qz * ty, y + qw * ty + qz * tx - qx * tz, z + qw * tz + qx * ty - qy * tx], axis=-1
    )


def slerp(start: Numbers, end: Numbers, share: float | Numbers) -> F64:
    """Spherical linear interpolation on the shorter arc.

    Parameters
    ----------
    start, end : (..., 4)
    share : float or (...)
        0 is the start, 1 the end; above 1 extrapolates.

    Returns
    -------
    (..., 4) float64
        Unit quaternions.
    """
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (a * b).sum(-1, keepdims=True)
    b = np.where(along < 0.0, -b, b)  # q and -q are the same rotation
    angle = np.arccos(np.minimum(np.abs(along), 1.0))
    shares = np.asarray(share, np.float64)[..., None]
    straight = angle < SMALL_ANGLE_RAD
    sine = np.where(straight, 1.0, np.sin(angle))
    of_a = np.where(straight, 1.0 - shares, np.sin((1.0 - shares) * angle) / sine)
    of_b = np.where(straight, shares, np.sin(shares * angle) / sine)
    between = of_a * a + of_b * b
    turned: F64 = between / np.linalg.norm(between, axis=-1, keepdims=True)
    return turned
