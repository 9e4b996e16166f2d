"""Planted feet: two-bone legs solved in closed form for whole motions."""

from __future__ import annotations

import numpy as np

from tools.authoring.figure import Figure
from verbs.conventions import F64, Floats
from verbs.kernels import fk, quat

__all__ = ["plant"]


def plant(figure: Figure, root: Floats, rotations: Floats, side: str, ankles: Floats, feet: Floats) -> F64:
    """Bend one leg so that its foot has a given position and rotation.

    The knee bends to the distance of the target, then the hip rotates by the smallest angle that brings the ankle to
    it. Poses that already meet the target do not change.

    Parameters
    ----------
    figure : Figure
        A body whose thighs and shanks point straight down in the zero pose, with knees that rotate about X.
    root : (F, 3)
        Root positions, metres.
    rotations : (F, J, 4)
        Local rotations; only this leg's are replaced.
    side : {"Left", "Right"}
        Which leg.
    ankles : (F, 3) or (3,)
        Target ankle positions, metres.
    feet : (F, 4) or (4,)
        Target global rotations of the foot.

    Returns
    -------
    rotations : (F, J, 4) float64
    """
    solved: F64 = np.array(rotations, np.float64)
    skeleton = figure.skeleton
    hip, knee, foot = figure.joints(side + "UpLeg", side + "Leg", side + "Foot")
    thigh, shank = -skeleton.offsets[knee, 1], -skeleton.offsets[foot, 1]
    global_rotations, positions = fk.forward(root, solved, skeleton.parents, skeleton.offsets)
    reach = np.asarray(ankles) - positions[:, hip]
    solved[:, knee] = _knee(np.linalg.norm(reach, axis=-1), thigh, shank)
    bent = skeleton.offsets[knee] + quat.rotate(solved[:, knee], skeleton.offsets[foot])
    swing = _shortest_rotation(quat.rotate(global_rotations[:, hip], bent), reach)
    parent = global_rotations[:, skeleton.parents[hip]]
    solved[:, hip] = quat.mul(quat.mul(quat.conjugate(parent), swing), global_rotations[:, hip])
    lower_leg = quat.mul(quat.mul(swing, global_rotations[:, hip]), solved[:, knee])
    solved[:, foot] = quat.mul(quat.conjugate(lower_leg), feet)
    return solved


def _knee(distances: F64, thigh: float, shank: float) -> F64:
    """Knee rotations (F, 4) that bring the ankle to distances (F,) from the hip joint, by the law of cosines."""
    cosine = (distances**2 - thigh**2 - shank**2) / (2.0 * thigh * shank)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return quat.exp(angle[:, None] * np.array([1.0, 0.0, 0.0]))


def _shortest_rotation(start: F64, end: F64) -> F64:
    """Rotations (F, 4) that take directions ``start`` (F, 3) to ``end`` (F, 3) by the smaller angle."""
    start = start / np.linalg.norm(start, axis=-1, keepdims=True)
    end = end / np.linalg.norm(end, axis=-1, keepdims=True)
    scalar = 1.0 + np.sum(start * end, axis=-1, keepdims=True)
    return quat.normalize(np.concatenate([np.cross(start, end), scalar], axis=-1))
