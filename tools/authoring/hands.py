"""Shapes of a hand: rotations of its fingers and thumb, set over time."""

from __future__ import annotations

import numpy as np

from tools.authoring.figure import Figure
from verbs.conventions import F64, Floats
from verbs.errors import UnknownName
from verbs.kernels import quat

__all__ = ["SHAPES", "shape"]

SHAPES = {
    "open": (4.0, 8.0, (-0.62, -0.12, 0.78)),
    "flat": (2.0, 3.0, (-0.45, -0.05, 0.89)),
    "pinch": (48.0, 42.0, (-0.76, -0.62, 0.20)),
    "fist": (84.0, 114.0, (-0.52, -0.74, -0.43)),
}
"""Of the right hand: flexion of the knuckles and of the fingers, degrees; direction of the thumb, palm down.

The relaxed hand is that of the rest pose.
"""


def shape(figure: Figure, rotations: Floats, side: str, name: str, share: Floats) -> F64:
    """Bring the fingers of one hand toward a shape.

    Parameters
    ----------
    figure : Figure
        The humanoid.
    rotations : (F, J, 4)
        Local rotations; only those of this hand's fingers and thumb are replaced.
    side : {"Left", "Right"}
    name : str
        One of :data:`SHAPES`, or ``relaxed``.
    share : (F,)
        How far each frame is on the way from its own shape to the named one, 0 to 1.

    Returns
    -------
    rotations : (F, J, 4) float64
    """
    result: F64 = np.array(rotations, np.float64)
    joints = figure.joints(*(f"{side}Hand{part}" for part in ("Middle1", "Middle2", "Thumb1")))
    goal = figure.rest.rotations[joints] if name == "relaxed" else _rotations(figure, side, name)
    own = result[:, joints]
    way = quat.log(quat.mul(quat.conjugate(own), quat.align(np.broadcast_to(goal, own.shape), own)))
    result[:, joints] = quat.mul(own, quat.exp(np.asarray(share)[:, None, None] * way))
    return result


def _rotations(figure: Figure, side: str, name: str) -> F64:
    """Local rotations (3, 4) of knuckles, fingers and thumb."""
    if name not in SHAPES:
        raise UnknownName("hand shape", name, ("relaxed", *SHAPES))
    knuckles, fingers, thumb = SHAPES[name]
    tip = list(figure.skeleton.tip_parents).index(figure.skeleton.index("RightHandThumb1"))
    start = figure.skeleton.tip_offsets[tip]
    start, end = start / np.linalg.norm(start), np.array(thumb) / np.linalg.norm(thumb)
    across = np.cross(start, end)
    turn = across / np.linalg.norm(across) * np.arccos(start @ end)
    vectors = np.array([[0.0, 0.0, np.radians(knuckles)], [0.0, 0.0, np.radians(fingers)], turn])
    # Mirroring maps rotation vectors (x, y, z) to (x, -y, -z).
    return quat.exp(vectors * (1.0 if side == "Right" else np.array([1.0, -1.0, -1.0])))
