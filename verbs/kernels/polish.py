"""Polish: small rotations of the joints between the root and the effector, bounded joint by joint.

Damped least squares on the chain, from the blended pose. The root stays where it is.

Source: Rose, Sloan, Cohen 2001, section 4.3, end (a short inverse-kinematics pass after blending); the damping is
that of C. W. Wampler, "Manipulator inverse kinematic solutions based on vector formulations and damped least-squares
methods", 1986.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.pose import add_rotated, multiply

__all__ = ["polish"]


@kernel
def _exponential(vector: F64, out: F64) -> None:
    """Unit quaternion (4,) of a rotation vector (3,)."""
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    scale = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    out[0], out[1], out[2], out[3] = scale * vector[0], scale * vector[1], scale * vector[2], np.cos(0.5 * angle)


@kernel
def _walk_chain(root: F64, locals_: F64, vectors: F64, offsets: F64, globals_: F64, positions: F64, point: F64) -> None:
    """Global rotations (L, 4) and positions (L, 3) of a chain whose joints also rotate by ``vectors`` (L, 3)."""
    extra, local, before = np.empty(4), np.empty(4), np.zeros(4)
    before[3] = 1.0
    point[:] = root
    for j in range(locals_.shape[0]):
        _exponential(vectors[j], extra)
        multiply(locals_[j], extra, local)
        multiply(before, local, globals_[j])
        positions[j] = point
        add_rotated(globals_[j], offsets[j], point)
        before[:] = globals_[j]


@kernel
def _levers(globals_: F64, positions: F64, point: F64, jacobian: F64, normal: F64) -> None:
    """Effector velocities per rotation of each joint about its own axes (L, 3, 3), and their sum of products (3, 3)."""
    axis, column = np.empty(3), np.empty(3)
    normal[:] = 0.0
    for j in range(1, globals_.shape[0]):
        x, y, z = point[0] - positions[j, 0], point[1] - positions[j, 1], point[2] - positions[j, 2]
        for k in range(3):
            axis[:] = 0.0
            axis[k] = 1.0
            column[:] = 0.0
            add_rotated(globals_[j], axis, column)
            jacobian[j, 0, k] = column[1] * z - column[2] * y
            jacobian[j, 1, k] = column[2] * x - column[0] * z
            jacobian[j, 2, k] = column[0] * y - column[1] * x
            for a in range(3):
                for b in range(3):
                    normal[a, b] += jacobian[j, a, k] * jacobian[j, b, k]


@kernel
def polish(root: F64, locals_: F64, offsets: F64, goal: F64, limit: float, damping: float, vectors: F64) -> float:
    """Rotate a chain's joints until its effector is at the goal; return the remaining distance.

    Parameters
    ----------
    root : (3,) float64
        Root position.
    locals_ : (L, 4) float64
        Local rotations from the root to the effector's parent.
    offsets : (L, 3) float64
        Offset of the next joint; the last one is the effector's.
    goal : (3,) float64
    limit : float
        Largest rotation of one joint, radians.
    damping : float
        Square metres added to the normal matrix.
    vectors : (L, 3) float64
        Written: rotation vectors after the joints' own rotations. The root's stays zero.
    """
    links = locals_.shape[0]
    globals_, positions, point = np.empty((links, 4)), np.empty((links, 3)), np.empty(3)
    jacobian, normal, residual = np.empty((links, 3, 3)), np.empty((3, 3)), np.empty(3)
    vectors[:] = 0.0
    distance = 0.0
    for _ in range(30):
        _walk_chain(root, locals_, vectors, offsets, globals_, positions, point)
        for a in range(3):
            residual[a] = goal[a] - point[a]
        distance = np.sqrt(residual[0] ** 2 + residual[1] ** 2 + residual[2] ** 2)
        if distance < 1e-9:
            break
        _levers(globals_, positions, point, jacobian, normal)
        for a in range(3):
            normal[a, a] += damping
        pull = np.linalg.solve(normal, residual)
        for j in range(1, links):
            size = 0.0
            for k in range(3):
                for a in range(3):
                    vectors[j, k] += jacobian[j, a, k] * pull[a]
                size += vectors[j, k] ** 2
            size = np.sqrt(size)
            if size > limit:
                for k in range(3):
                    vectors[j, k] *= limit / size
    return distance
