"""A low-poly body around a skeleton: a rounded bone from each joint to each joint and tip below it.

Every vertex follows one joint. Thickness comes from a table of humanoid bones, else from the length of the bone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F32, F64, I64
from verbs.io.humanoid import bones_of
from verbs.skeleton import Skeleton

__all__ = ["Mesh", "body", "rest_positions"]

_AROUND = 12
_CAP = np.linspace(0.0, 0.5 * np.pi, 4)
_STATURE_M = 0.95
"""Height of the hips at which the table of thickness holds; others are scaled."""

_SHORTEST_M = 1e-4

_WIDTHS = {
    "hips": (0.09, 0.085), "spine": (0.105, 0.08), "chest": (0.125, 0.095), "upperChest": (0.115, 0.085),
    "neck": (0.045, 0.045), "head": (0.075, 0.09), "Shoulder": (0.048, 0.048), "UpperArm": (0.045, 0.045),
    "LowerArm": (0.036, 0.036), "Hand": (0.02, 0.034), "UpperLeg": (0.072, 0.072), "LowerLeg": (0.05, 0.05),
    "Foot": (0.04, 0.04), "Toes": (0.036, 0.028), "": (0.011, 0.011),
}  # fmt: skip
"""Half widths across a bone in metres: along +X, or +Y for a bone along X, and along the third axis."""

_NARROWING = {"UpperArm": 0.8, "LowerArm": 0.7, "UpperLeg": 0.72, "LowerLeg": 0.66, "Hand": 0.8, "Foot": 0.85}
"""Width at the far end of a bone, as a share of that at its joint; 1 for the others."""


class Mesh(NamedTuple):
    """Triangles, each vertex bound to one joint.

    Parameters
    ----------
    positions, normals : (V, 3) float32
        In the rest pose with the root at the origin; metres.
    joints : (V,) int64
    triangles : (N, 3) uint32
        Counter-clockwise as seen from outside.
    """

    positions: F32
    normals: F32
    joints: I64
    triangles: npt.NDArray[np.uint32]


def rest_positions(skeleton: Skeleton) -> tuple[F64, F64]:
    """Positions of the joints (J, 3) and tips (T, 3) in the rest pose, with the root at the origin."""
    joints = np.zeros((len(skeleton), 3))
    for joint, parent in enumerate(skeleton.parents.tolist()[1:], start=1):
        joints[joint] = joints[parent] + skeleton.offsets[joint]
    return joints, joints[skeleton.tip_parents] + skeleton.tip_offsets


def body(skeleton: Skeleton) -> Mesh:
    """The body of a skeleton in its rest pose."""
    places, tips = rest_positions(skeleton)
    named = {joint: bone for bone, joint in bones_of(skeleton).items()}
    height = -float(np.concatenate([places, tips])[:, 1].min())
    scale = height / _STATURE_M if "hips" in named.values() and height > 0.0 else 1.0
    parents = skeleton.parents.tolist()
    ends = [(parents[joint], places[joint], False) for joint in range(1, len(skeleton))]
    ends += [(joint, tip, True) for joint, tip in zip(skeleton.tip_parents.tolist(), tips, strict=True)]
    parts, first = [], 0
    for joint, end, last in ends:
        length = float(np.linalg.norm(end - places[joint]))
        if length < _SHORTEST_M:
            continue
        widths = _widths(named.get(joint), length, scale)
        share = _NARROWING.get(_part(named.get(joint, "")), 1.0)
        points, normals, triangles = _capsule(places[joint], end, widths, share, last=last)
        parts.append((points, normals, np.full(len(points), joint), triangles + first))
        first += len(points)
    if not parts:
        points, normals, triangles = _capsule(np.zeros(3), np.array([0.0, 0.1, 0.0]), (0.05, 0.05), 1.0, last=False)
        parts.append((points, normals, np.zeros(len(points), np.int64), triangles))
    points, normals, joints, triangles = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Mesh(points.astype(np.float32), _unit32(normals), joints, triangles.astype(np.uint32))


def _widths(bone: str | None, length: float, scale: float) -> tuple[float, float]:
    if bone is None:
        width = min(max(0.12 * length, 0.008), 0.1)
        return width, width
    first, second = _WIDTHS[_part(bone)]
    return first * scale, second * scale


def _part(bone: str) -> str:
    """Key of the table for a bone; a finger has the empty one."""
    part = bone.removeprefix("left").removeprefix("right")
    return part if part in _WIDTHS else ""


def _capsule(
    start: F64, end: F64, widths: tuple[float, float], share: float, *, last: bool
) -> tuple[F64, F64, npt.NDArray[np.int64]]:
    """Points, normals and triangles of an elliptic capsule between two points; the last of a limb ends at its tip.

    ``share`` is the width at the end, as a share of that at the start.
    """
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    across = np.array([0.0, 1.0, 0.0]) if abs(along[0]) > 0.7 else np.array([1.0, 0.0, 0.0])
    across = across - along * (across @ along)
    across /= np.linalg.norm(across)
    side = np.cross(along, across)
    cap = min(*widths, 0.5 * length)
    stop = end - along * cap * share if last else end
    turns = np.arange(_AROUND) * (2.0 * np.pi / _AROUND)
    ring = np.cos(turns)[:, None] * across * widths[0] + np.sin(turns)[:, None] * side * widths[1]
    outward = np.cos(turns)[:, None] * across / widths[0] + np.sin(turns)[:, None] * side / widths[1]
    points, normals = [], []
    for center, sign, size, angles in ((start, -1.0, 1.0, _CAP[::-1]), (stop, 1.0, share, _CAP)):
        for angle in angles:
            points.append(center + size * (ring * np.cos(angle) + sign * along * cap * np.sin(angle)))
            normals.append(outward * np.cos(angle) + sign * along * np.sin(angle) / cap)
    rows, columns = np.meshgrid(np.arange(len(points) - 1), np.arange(_AROUND), indexing="ij")
    low, after = rows * _AROUND + columns, rows * _AROUND + (columns + 1) % _AROUND
    triangles = np.stack([low, after, after + _AROUND, low, after + _AROUND, low + _AROUND], axis=-1).reshape(-1, 3)
    return np.concatenate(points), np.concatenate(normals), triangles


def _unit32(vectors: F64) -> F32:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)
