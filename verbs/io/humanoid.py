"""Bones of a humanoid by the names of our joints, and the T-pose in which VRM states rotations.

Source: VRM Consortium, "VRMC_vrm-1.0", humanoid.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels import quat
from verbs.skeleton import Skeleton

__all__ = ["BONES", "REQUIRED", "Humanoid", "bones_above", "bones_of", "missing", "t_pose"]

_CENTER = {
    "hips": "Hips", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2", "neck": "Neck", "head": "Head",
}  # fmt: skip
_SIDED = {
    "Shoulder": "Shoulder", "UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand", "UpperLeg": "UpLeg",
    "LowerLeg": "Leg", "Foot": "Foot", "Toes": "ToeBase",
    "ThumbMetacarpal": "HandThumb1", "ThumbProximal": "HandThumb2", "ThumbDistal": "HandThumb3",
    **{
        f"{finger}{part}": f"Hand{name}{number}"
        for finger, name in (("Index", "Index"), ("Middle", "Middle"), ("Ring", "Ring"), ("Little", "Pinky"))
        for number, part in enumerate(("Proximal", "Intermediate", "Distal"), start=1)
    },
}  # fmt: skip

BONES: dict[str, str] = _CENTER | {
    f"{side.lower()}{bone}": f"{side}{joint}" for side in ("Left", "Right") for bone, joint in _SIDED.items()
}
"""Joint of each VRM bone: the names of the built-in skeleton, of the captures and of Mixamo, without a prefix.

A joint that carries the VRM bone's own name is taken too. Case, spaces, ``_``, ``-`` and ``.`` do not count.
"""

REQUIRED = (
    "hips", "spine", "head",
    *(f"{side}{bone}" for side in ("left", "right")
      for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")),
)  # fmt: skip
"""Bones without which a VRM humanoid is not valid."""

_X = np.array([1.0, 0.0, 0.0])
_DOWN = np.array([0.0, -1.0, 0.0])
_STILL = np.array([0.0, 0.0, 0.0, 1.0])


class Humanoid(NamedTuple):
    """Bones of a skeleton whose names do not tell them, and how it stands.

    Parameters
    ----------
    bones : dict of str to int
        Joint of each VRM bone.
    standing : (J, 4) float64
        Global rotations of a standing pose that faces +Z.
    """

    bones: dict[str, int]
    standing: F64


def bones_of(skeleton: Skeleton) -> dict[str, int]:
    """Joint index of each VRM bone that the skeleton has, in the order of :data:`BONES`."""
    known = {_plain(name): joint for joint, name in reversed(list(enumerate(skeleton.names)))}
    found = {bone: known.get(_plain(name), known.get(_plain(bone), -1)) for bone, name in BONES.items()}
    return {bone: joint for bone, joint in found.items() if joint >= 0}


def missing(bones: dict[str, int]) -> list[str]:
    """Required bones that a map of bones lacks, each with the joint that would be taken."""
    return [f"{bone} ({BONES[bone]})" for bone in REQUIRED if bone not in bones]


def bones_above(parents: list[int], joints: list[int]) -> list[int]:
    """For each joint of a list, the place in the list of the next joint above it; -1 for the root."""
    place = {joint: k for k, joint in enumerate(joints)}
    above = []
    for joint in joints:
        parent = parents[joint]
        while parent >= 0 and parent not in place:
            parent = parents[parent]
        above.append(place.get(parent, -1))
    return above


def t_pose(skeleton: Skeleton, bones: dict[str, int], standing: F64 | None = None) -> F64:
    """Global rotations (J, 4) of a T-pose: arms along ±X, legs down, feet towards +Z.

    Each arm and leg bone of a standing pose is turned by the smallest rotation. Feet keep their pitch. The trunk stays,
    and joints that are no such bone turn with their parent. ``standing`` are global rotations (J, 4) of that pose; by
    default it is the pose without rotations.
    """
    whole = np.tile(_STILL, (len(skeleton), 1)) if standing is None else standing
    aims: dict[int, tuple[int, F64]] = {}
    for side, outward in (("left", _X), ("right", -_X)):
        for bone, after, direction in (
            ("UpperArm", "LowerArm", outward),
            ("LowerArm", "Hand", outward),
            ("Hand", "MiddleProximal", outward),
            ("UpperLeg", "LowerLeg", _DOWN),
            ("LowerLeg", "Foot", _DOWN),
        ):
            if f"{side}{bone}" in bones and f"{side}{after}" in bones:
                aims[bones[f"{side}{bone}"]] = (bones[f"{side}{after}"], direction)
    feet = {bones[f"{side}Foot"]: bones.get(f"{side}Toes", -1) for side in ("left", "right") if f"{side}Foot" in bones}
    result = np.tile(_STILL, (len(skeleton), 1))
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0:
            result[joint] = result[parent]
        if joint in aims:
            child, direction = aims[joint]
            result[joint] = quat.arc(_span(skeleton, whole, joint, child), direction)
        elif joint in feet:
            toes = feet[joint]
            result[joint] = _facing(_span(skeleton, whole, joint, toes)) if toes >= 0 else _STILL
    return result if standing is None else quat.mul(result, standing)


def _plain(name: str) -> str:
    """Joint name without prefix (``mixamorig:``), case and separators."""
    return re.sub(r"[\s_.\-]", "", name.rsplit(":", 1)[-1]).lower()


def _span(skeleton: Skeleton, whole: F64, joint: int, below: int) -> F64:
    """Vector (3,) from a joint to one below it in the pose with these global rotations (J, 4)."""
    total = np.zeros(3)
    while below != joint and (parent := int(skeleton.parents[below])) >= 0:
        total = total + quat.rotate(whole[parent], skeleton.offsets[below])
        below = parent
    return total


def _facing(vector: F64) -> F64:
    """Rotation (4,) about +Y that turns a vector's horizontal part to +Z; none where it has no such part."""
    if np.hypot(vector[0], vector[2]) < 1e-6:
        return _STILL
    half = -0.5 * np.arctan2(vector[0], vector[2])
    return np.array([0.0, np.sin(half), 0.0, np.cos(half)])
