"""Target skeletons by name: the joints and proportions of widely used humanoids.

Every joint of a preset rests without rotation: its axes are those of the world in the rest pose, which is the T-pose,
or, of Unreal's mannequin, an A-pose. These are VRM's normalized bones and SMPL's pose parameters. Of a rig whose bones
have other axes, use its file as the target.

Lengths are those of an adult of average height; positions of the left side are stated, those of the right mirror them.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from verbs.errors import UnknownName
from verbs.mapping.names import roles_of
from verbs.mapping.rig import Rig
from verbs.skeleton import Skeleton

__all__ = ["PRESETS", "preset"]

Row = tuple[str, str, tuple[float, float, float]]

_BODY: dict[str, tuple[float, float, float]] = {
    "hips": (0.0, 0.96, 0.0), "spine": (0.0, 1.06, -0.005), "chest": (0.0, 1.18, -0.01),
    "upperChest": (0.0, 1.29, -0.01), "neck": (0.0, 1.45, -0.01), "head": (0.0, 1.54, 0.01),
    "leftShoulder": (0.03, 1.42, 0.0), "leftUpperArm": (0.17, 1.415, -0.015), "leftLowerArm": (0.445, 1.415, -0.015),
    "leftHand": (0.695, 1.415, -0.015), "leftUpperLeg": (0.09, 0.90, 0.0), "leftLowerLeg": (0.09, 0.49, 0.005),
    "leftFoot": (0.09, 0.085, -0.01), "leftToes": (0.09, 0.02, 0.12),
}  # fmt: skip
"""Positions of the bones in the T-pose, metres."""

_FINGERS = {"Index": 0.025, "Middle": 0.003, "Ring": -0.018, "Little": -0.037}
"""Fingers with their distance to the front from the middle of the hand."""


def _fingers() -> dict[str, tuple[float, float, float]]:
    hand = np.array(_BODY["leftHand"])
    places = {}
    for finger, ahead in _FINGERS.items():
        for part, along in zip(("Proximal", "Intermediate", "Distal"), (0.088, 0.126, 0.152), strict=True):
            places[f"left{finger}{part}"] = tuple((hand + np.array((along, 0.0, ahead))).tolist())
    for part, at in zip(
        ("Metacarpal", "Proximal", "Distal"), ((0.02, -0.012, 0.025), (0.055, -0.02, 0.05), (0.08, -0.022, 0.064)),
        strict=True,
    ):  # fmt: skip
        places[f"leftThumb{part}"] = tuple((hand + at).tolist())
    return places


def _both(rows: dict[str, tuple[float, float, float]]) -> dict[str, tuple[float, float, float]]:
    mirrored = {
        bone.replace("left", "right", 1): (-x, y, z) for bone, (x, y, z) in rows.items() if bone.startswith("left")
    }
    return rows | mirrored


_PLACES = _both(_BODY | _fingers())

_ABOVE = {
    "hips": "", "spine": "hips", "chest": "spine", "upperChest": "chest", "neck": "upperChest", "head": "neck",
    "Shoulder": "upperChest", "UpperArm": "Shoulder", "LowerArm": "UpperArm", "Hand": "LowerArm", "UpperLeg": "hips",
    "LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toes": "Foot",
}  # fmt: skip


def _parent(bone: str) -> str:
    """The bone above a VRM bone."""
    if bone in _ABOVE:
        return _ABOVE[bone]
    side = "left" if bone.startswith("left") else "right"
    part = bone.removeprefix(side)
    if part in _ABOVE:
        above = _ABOVE[part]
        return above if above in _ABOVE and above[0].islower() else f"{side}{above}"
    for later, earlier in (("Distal", "Intermediate"), ("Intermediate", "Proximal")):
        if part.endswith(later):
            thumb = "Proximal" if "Thumb" in part else earlier
            return f"{side}{part.removesuffix(later)}{thumb}"
    return f"{side}ThumbMetacarpal" if part == "ThumbProximal" else f"{side}Hand"


def _vrm() -> list[Row]:
    return [(bone, _parent(bone), at) for bone, at in _PLACES.items()]


_MIXAMO = {
    "hips": "Hips", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2", "neck": "Neck", "head": "Head",
    "Shoulder": "Shoulder", "UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand", "UpperLeg": "UpLeg",
    "LowerLeg": "Leg", "Foot": "Foot", "Toes": "ToeBase",
}  # fmt: skip


def _mixamo_name(bone: str) -> str:
    if bone in _MIXAMO:
        return f"mixamorig:{_MIXAMO[bone]}"
    side = "Left" if bone.startswith("left") else "Right"
    part = bone[len(side) :]
    if part in _MIXAMO:
        return f"mixamorig:{side}{_MIXAMO[part]}"
    numbers = {"Metacarpal": 1, "Proximal": 2 if "Thumb" in part else 1, "Intermediate": 2, "Distal": 3}
    for word, number in numbers.items():
        if part.endswith(word):
            finger = part.removesuffix(word).replace("Little", "Pinky")
            return f"mixamorig:{side}Hand{finger}{number}"
    raise UnknownName("bone", bone, _PLACES)


def _mixamo() -> list[Row]:
    return [(_mixamo_name(bone), _mixamo_name(above) if above else "", at) for bone, above, at in _vrm()]


_UNREAL = {
    "Shoulder": "clavicle", "UpperArm": "upperarm", "LowerArm": "lowerarm", "Hand": "hand", "UpperLeg": "thigh",
    "LowerLeg": "calf", "Foot": "foot", "Toes": "ball",
}  # fmt: skip

_LOWERED = np.radians(48.0)
"""Angle of the upper arms below the horizontal in the A-pose."""


def _unreal() -> list[Row]:
    """The mannequin: a root on the ground, three spine joints, an A-pose with the elbows slightly bent."""
    rows: list[Row] = [
        ("root", "", (0.0, 0.0, 0.0)), ("pelvis", "root", (0.0, 0.968, 0.0)),
        ("spine_01", "pelvis", (0.0, 1.075, -0.01)),
        ("spine_02", "spine_01", (0.0, 1.26, -0.035)), ("spine_03", "spine_02", (0.0, 1.39, -0.03)),
        ("neck_01", "spine_03", (0.0, 1.55, -0.025)), ("head", "neck_01", (0.0, 1.645, -0.005)),
    ]  # fmt: skip
    shoulder = np.array([0.175, 1.49, -0.035])
    arm = np.array([np.cos(_LOWERED), -np.sin(_LOWERED), 0.03])
    fore = np.array([np.cos(_LOWERED + 0.08), -np.sin(_LOWERED + 0.08), 0.28])
    arm, fore = arm / np.linalg.norm(arm), fore / np.linalg.norm(fore)
    elbow = shoulder + 0.303 * arm
    hand = elbow + 0.27 * fore
    left: dict[str, tuple[str, tuple[float, ...]]] = {
        "clavicle": ("spine_03", (0.038, 1.505, -0.005)), "upperarm": ("clavicle", tuple(shoulder)),
        "lowerarm": ("upperarm", tuple(elbow)), "hand": ("lowerarm", tuple(hand)),
        "thigh": ("pelvis", (0.09, 0.953, 0.005)), "calf": ("thigh", (0.115, 0.528, 0.01)),
        "foot": ("calf", (0.135, 0.13, -0.03)), "ball": ("foot", (0.15, 0.025, 0.115)),
    }  # fmt: skip
    across = np.array([0.0, 0.0, 1.0]) - fore * fore[2]
    across /= np.linalg.norm(across)
    for finger, ahead in (*_FINGERS.items(), ("Thumb", 0.03)):
        above = "hand"
        steps = (0.02, 0.055, 0.08) if finger == "Thumb" else (0.09, 0.128, 0.154)
        for number, along in enumerate(steps, start=1):
            name = f"{finger.lower().replace('little', 'pinky')}_0{number}"
            left[name] = (
                above,
                tuple(hand + along * fore + (1.0 + 0.4 * number * (finger == "Thumb")) * ahead * across),
            )
            above = name
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for name, (above, at) in left.items():
            parent = above if above in ("spine_03", "pelvis") else f"{above}_{side}"
            rows.append((f"{name}_{side}", parent, (sign * float(at[0]), float(at[1]), float(at[2]))))
    return rows


_SMPL: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("pelvis", "", (0.0, 0.0, 0.0)), ("left_hip", "pelvis", (0.069, -0.091, -0.006)),
    ("spine1", "pelvis", (0.0, 0.109, -0.027)), ("left_knee", "left_hip", (0.036, -0.379, -0.007)),
    ("spine2", "spine1", (0.0, 0.135, 0.001)), ("left_ankle", "left_knee", (-0.015, -0.398, -0.043)),
    ("spine3", "spine2", (0.0, 0.053, 0.025)), ("left_foot", "left_ankle", (0.026, -0.052, 0.121)),
    ("neck", "spine3", (0.0, 0.214, -0.043)), ("left_collar", "spine3", (0.080, 0.120, -0.036)),
    ("head", "neck", (0.0, 0.065, 0.051)), ("left_shoulder", "left_collar", (0.094, 0.032, -0.009)),
    ("left_elbow", "left_shoulder", (0.257, -0.013, -0.025)), ("left_wrist", "left_elbow", (0.252, 0.008, -0.003)),
    ("left_hand", "left_wrist", (0.084, -0.007, -0.013)),
)  # fmt: skip
"""Joints with their parents and offsets, in the order of the model; the right of each pair follows the left."""

_SMPL_GROUND_M = 0.945
"""Height of the pelvis above the ground in the T-pose."""


def _smpl() -> list[Row]:
    offsets: dict[str, tuple[str, tuple[float, float, float]]] = {}
    for name, above, (x, y, z) in _SMPL:
        offsets[name] = (above, (x, y, z))
        if name.startswith("left"):
            offsets[name.replace("left", "right")] = (above.replace("left", "right"), (-x, y, z))
    places: dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]] = {}
    rows: list[Row] = []
    for name, (above, offset) in offsets.items():
        places[name] = places[above] + offset if above else np.array([0.0, _SMPL_GROUND_M, 0.0])
        x, y, z = places[name].tolist()
        rows.append((name, above, (x, y, z)))
    return rows


_ROWS = {"vrm": _vrm, "unreal": _unreal, "mixamo": _mixamo, "smpl": _smpl}

PRESETS: tuple[str, ...] = tuple(_ROWS)
"""Names of the presets. ``vrm`` has the bones of VRM and of Unity's humanoid."""

_TIPS: dict[str, tuple[float, float, float]] = {
    "leftToes": (0.0, -0.01, 0.07), "rightToes": (0.0, -0.01, 0.07), "head": (0.0, 0.18, 0.01),
}  # fmt: skip
"""Ends of the toes and of the head, metres from their joints."""


@cache
def preset(name: str) -> Rig:
    """A preset by name.

    Raises
    ------
    UnknownName
        There is no such preset.
    """
    if name not in _ROWS:
        raise UnknownName("map", name, PRESETS)
    rows = _ROWS[name]()
    if name != "smpl":  # the model's order is its own
        rows = _depth_first(rows)
    names = tuple(row[0] for row in rows)
    parents = np.array([names.index(above) if above else -1 for _, above, _ in rows], np.int64)
    places = np.array([at for _, _, at in rows])
    offsets = places.copy()
    offsets[1:] -= places[parents[1:]]
    offsets[0] = 0.0
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1))
    bones = roles_of(names, parents.tolist()).bones
    tips = np.array([bones[bone] for bone in _TIPS], np.int64)
    skeleton = Skeleton(names, parents, offsets, tips, np.array(list(_TIPS.values())))
    return Rig(name, skeleton, still, still, places[0], ground=0.0)


def _depth_first(rows: list[Row]) -> list[Row]:
    """Rows so that what hangs on a joint follows it."""
    ordered: list[Row] = []

    def add(above: str) -> None:
        for row in rows:
            if row[1] == above:
                ordered.append(row)
                add(row[0])

    add("")
    return ordered
