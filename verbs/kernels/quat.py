"""Quaternion algebra on arrays (..., 4), order (x, y, z, w), Hamilton product, right-handed.

Every function takes leading batch axes and returns new arrays; none checks its input. ``mul(a, b)`` rotates by
``b`` first. Rotation vectors are axis times angle, radians.

Source: the unit-quaternion chapters of any graphics text; numerical forms are our own.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, Floats

__all__ = [
    "align",
    "arc",
    "conjugate",
    "exp",
    "from_euler",
    "from_matrix",
    "log",
    "mul",
    "normalize",
    "principal",
    "rotate",
    "to_matrix",
    "unroll",
]

_AXES = {"X": 0, "Y": 1, "Z": 2}


def mul(left: Floats, right: Floats) -> F64:
    """Product of quaternions (..., 4) × (..., 4): the rotation ``right`` followed by ``left``."""
    x1, y1, z1, w1 = np.moveaxis(np.asarray(left, np.float64), -1, 0)
    x2, y2, z2, w2 = np.moveaxis(np.asarray(right, np.float64), -1, 0)
    return np.stack(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ],
        axis=-1,
    )


def conjugate(rotations: Floats) -> F64:
    """Inverse of unit quaternions (..., 4)."""
    return np.asarray(rotations, np.float64) * np.array([-1.0, -1.0, -1.0, 1.0])


def normalize(rotations: Floats) -> F64:
    """Quaternions (..., 4) scaled to length 1; a zero quaternion becomes the identity."""
    rotations = np.asarray(rotations, np.float64)
    length = np.linalg.norm(rotations, axis=-1, keepdims=True)
    safe = np.where(length > 1e-12, rotations, [0.0, 0.0, 0.0, 1.0])
    return np.asarray(safe / np.where(length > 1e-12, length, 1.0))


def rotate(rotations: Floats, vectors: Floats) -> F64:
    """Vectors (..., 3) rotated by unit quaternions (..., 4)."""
    rotations, vectors = np.asarray(rotations, np.float64), np.asarray(vectors, np.float64)
    axis, scalar = rotations[..., :3], rotations[..., 3:]
    twice = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + scalar * twice + np.cross(axis, twice))


def arc(start: Floats, end: Floats) -> F64:
    """Smallest rotation (4,) from the direction of a vector (3,) to that of another; none where one has no length.

    Half a turn between opposite directions is about +Z, or +Y for vectors along Z.
    """
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    a, b = float(np.linalg.norm(start)), float(np.linalg.norm(end))
    if a < 1e-9 or b < 1e-9:
        return np.array([0.0, 0.0, 0.0, 1.0])
    start, end = start / a, end / b
    cosine = float(start @ end)
    if cosine < -1.0 + 1e-9:
        axis = np.array([0.0, 0.0, 1.0]) - start[2] * start
        axis = axis if np.linalg.norm(axis) > 1e-3 else np.array([0.0, 1.0, 0.0]) - start[1] * start
        return np.append(axis / np.linalg.norm(axis), 0.0)
    return normalize(np.append(np.cross(start, end), 1.0 + cosine))


def exp(vectors: Floats) -> F64:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), radians."""
    vectors = np.asarray(vectors, np.float64)
    half = 0.5 * np.linalg.norm(vectors, axis=-1, keepdims=True)
    # np.sinc(x) is sin(πx)/(πx): smooth at zero, where a division would not be.
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)], axis=-1)


def log(rotations: Floats) -> F64:
    """Rotation vectors (..., 3) of unit quaternions (..., 4), of the smaller angle: length ≤ π."""
    rotations = np.asarray(rotations, np.float64)
    rotations = np.where(rotations[..., 3:] < 0, -rotations, rotations)
    sine = np.linalg.norm(rotations[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, rotations[..., 3:])
    scale = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 2.0)
    return np.asarray(scale * rotations[..., :3])


def align(rotations: Floats, reference: Floats) -> F64:
    """Give each quaternion (..., 4) the sign that puts it into the hemisphere of ``reference`` (..., 4)."""
    rotations = np.asarray(rotations, np.float64)
    dots = np.sum(rotations * reference, axis=-1, keepdims=True)
    return np.where(dots < 0, -rotations, rotations)


def unroll(rotations: Floats) -> F64:
    """Choose signs along the first axis of (F, ..., 4) so that neighbours lie in one hemisphere."""
    rotations = np.asarray(rotations, np.float64)
    dots = np.sum(rotations[1:] * rotations[:-1], axis=-1)
    signs = np.ones(rotations.shape[:-1])
    signs[1:] = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.asarray(rotations * signs[..., None])


def principal(rotations: Floats) -> F64:
    """Mean of quaternions over the first axis of (N, ..., 4), blind to their signs.

    The eigenvector of the largest eigenvalue of Σ q qᵀ; its scalar part is made non-negative.

    Source: F. L. Markley et al., "Averaging Quaternions", 2007, equation 12.
    """
    rotations = np.asarray(rotations, np.float64)
    outer = np.einsum("n...i,n...j->...ij", rotations, rotations)
    mean = np.linalg.eigh(outer)[1][..., -1]
    return np.where(mean[..., 3:] < 0, -mean, mean)


def from_euler(order: str, angles: Floats) -> F64:
    """Unit quaternions of Euler angles (..., 3), radians, in BVH's sense.

    ``order`` names the axes in the order of the channels: ``"ZXY"`` means R = Rz · Rx · Ry (intrinsic).
    """
    angles = np.asarray(angles, np.float64)
    result: F64 | None = None
    for column, axis in enumerate(order):
        rotation = np.zeros((*angles.shape[:-1], 4))
        rotation[..., _AXES[axis]] = np.sin(0.5 * angles[..., column])
        rotation[..., 3] = np.cos(0.5 * angles[..., column])
        result = rotation if result is None else mul(result, rotation)
    assert result is not None  # an order names at least one axis
    return result


def from_matrix(matrices: Floats) -> F64:
    """Unit quaternions (..., 4) of rotation matrices (..., 3, 3); their scalar part is not negative.

    The eigenvector of the largest eigenvalue: rounding in the matrix does no harm.

    Source: I. Y. Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation Matrix", 2000.
    """
    m = np.asarray(matrices, np.float64)
    sums = np.empty((*m.shape[:-2], 4, 4))
    sums[..., :3, :3] = m + np.swapaxes(m, -1, -2)
    trace = np.trace(m, axis1=-2, axis2=-1)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        sums[..., k, k] -= trace
        sums[..., k, 3] = sums[..., 3, k] = m[..., j, i] - m[..., i, j]
    sums[..., 3, 3] = trace
    found = np.linalg.eigh(sums)[1][..., -1]
    return np.where(found[..., 3:] < 0, -found, found)


def to_matrix(rotations: Floats) -> F64:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    x, y, z, w = np.moveaxis(np.asarray(rotations, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
