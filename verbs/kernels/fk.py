"""Forward kinematics on arrays: local rotations to global rotations and joint positions.

This NumPy form serves authoring, quality and tests; the compiled form is in :mod:`verbs.kernels.pose`.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64, I64, Floats
from verbs.kernels import quat

__all__ = ["forward"]


def forward(root: Floats, rotations: Floats, parents: I64, offsets: Floats) -> tuple[F64, F64]:
    """Global rotations and positions of all joints.

    Parameters
    ----------
    root : (..., 3)
        Position of the root joint, metres.
    rotations : (..., J, 4)
        Local rotations, unit quaternions.
    parents : (J,) int
        Parent of each joint, standing before it; -1 for joint 0.
    offsets : (J, 3)
        Position of each joint in its parent's frame, metres; the root's is not used.

    Returns
    -------
    global_rotations : (..., J, 4) float64
    positions : (..., J, 3) float64
    """
    rotations = np.asarray(rotations, np.float64)
    global_rotations = np.empty(rotations.shape)
    positions = np.empty((*rotations.shape[:-1], 3))
    global_rotations[..., 0, :], positions[..., 0, :] = rotations[..., 0, :], root
    for joint in range(1, rotations.shape[-2]):
        parent = parents[joint]
        global_rotations[..., joint, :] = quat.mul(global_rotations[..., parent, :], rotations[..., joint, :])
        arm = quat.rotate(global_rotations[..., parent, :], offsets[joint])
        positions[..., joint, :] = positions[..., parent, :] + arm
    return global_rotations, positions
