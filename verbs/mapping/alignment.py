"""Two skeletons that stand: how the target's limbs turn to point where the source's do, and how long their legs are.

The body of the target is turned to face as that of the source does, and each limb of it is turned on, by the smallest
rotation, to the direction of the source's limb: an A-pose becomes a T-pose. Trunk, head and shoulders keep their own
shape, and feet are turned about the vertical only, so that what is flat stays flat.
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.kernels import quat
from verbs.mapping.plan import Row
from verbs.mapping.rig import STILL, Rig, body_frame
from verbs.mapping.source import Source

__all__ = [
    "alignment", "driven_above", "flat_pitch", "ground", "leg_height", "leg_ratio", "level", "sole_thickness", "up_of",
]  # fmt: skip

PITCHED_RAD = 0.3
"""Pitch of a foot in the standing pose from which on it is taken as no flat foot."""

_NEXT = {
    "UpperArm": ("LowerArm",), "LowerArm": ("Hand",), "Hand": ("MiddleProximal", "IndexProximal"),
    "UpperLeg": ("LowerLeg",), "LowerLeg": ("Foot",),
    **{
        f"{finger}{a}": (f"{finger}{b}",)
        for finger in ("Index", "Middle", "Ring", "Little")
        for a, b in (("Proximal", "Intermediate"), ("Intermediate", "Distal"))
    },
    "ThumbMetacarpal": ("ThumbProximal",), "ThumbProximal": ("ThumbDistal",),
}  # fmt: skip
"""Bones whose direction counts, with those that they lead to."""

UPRIGHT = ("hips", "head", "spine", "neck", "Shoulder")
"""Bones that keep their own shape."""


def alignment(source: Source, target: Rig, rows: list[Row]) -> F64:
    """Rotations (K + 1, 4) from the target's standing pose to the source's: of each driven joint, and of the body."""
    own, other = source.rig.frames[1], target.frames[1]
    base = STILL
    if source.roles and target.roles:
        base = quat.mul(body_frame(own, source.roles), quat.conjugate(body_frame(other, target.roles)))
    index = {row.target: k for k, row in enumerate(rows)}
    turns = np.empty((len(rows) + 1, 4))
    turns[-1] = base
    up = quat.rotate(body_frame(own, source.roles), np.array([0.0, 1.0, 0.0]))
    for k, row in enumerate(rows):
        above = driven_above(target, index, row.target)
        side, part = _side(row.bone)
        turn = turns[above] if above >= 0 else base
        if row.bone in UPRIGHT or part in UPRIGHT:
            turn = base
        elif part in ("Foot", "Toes"):
            turn = turns[above] if part == "Toes" and above >= 0 else _foot_turn(source, target, side, base, up)
        else:
            pair = _next_pair(source, target, rows, k, side, part)
            if pair is not None:
                ahead = quat.rotate(turn, other[pair[1]] - other[row.target])
                turn = quat.mul(quat.arc(ahead, own[pair[0]] - own[row.first]), turn)
        turns[k] = turn
    return turns


def _side(bone: str) -> tuple[str, str]:
    for side in ("left", "right"):
        if bone.startswith(side):
            return side, bone[len(side) :]
    return "", bone


def _next_pair(source: Source, target: Rig, rows: list[Row], k: int, side: str, part: str) -> tuple[int, int] | None:
    """Joints of source and target to which a limb leads; None where no direction counts."""
    if part in _NEXT:
        for after in _NEXT[part]:
            bone = f"{side}{after}"
            mapped = [row for row in rows if row.bone == bone]
            if mapped:
                return mapped[0].first, mapped[0].target
        return None
    if rows[k].bone:
        return None
    index = {row.target: n for n, row in enumerate(rows)}
    below = [row for row in rows if driven_above(target, index, row.target) == k]
    return (below[0].first, below[0].target) if len(below) == 1 else None


def _foot_turn(source: Source, target: Rig, side: str, base: F64, up: F64) -> F64:
    """Turn of a foot about the vertical into the direction of the source's, then by the pitch at which that is flat."""
    bones, others = source.roles.bones, target.roles.bones
    names = (f"{side}Foot", f"{side}Toes")
    own, other = source.rig.frames[1], target.frames[1]
    turn = base
    if all(name in bones and name in others for name in names):
        ahead = level(own[bones[names[1]]] - own[bones[names[0]]], up)
        behind = level(quat.rotate(base, other[others[names[1]]] - other[others[names[0]]]), up)
        turn = quat.mul(quat.arc(behind, ahead), base)
    if f"{side}Foot" in bones:
        turn = quat.mul(quat.conjugate(flat_pitch(source, bones[f"{side}Foot"], up)), turn)
    return turn


def flat_pitch(source: Source, ankle: int, up: F64) -> F64:
    """Rotation (4,) that makes a foot flat which is pitched in the standing pose; none where it nearly is flat.

    The heel is known from contacts, and not exactly: that of a foot which never stands on it is a guess.
    """
    feet, whole = source.feet, source.rig.frames[0]
    for f in np.flatnonzero(feet.joints[:, 2] == ankle).tolist():
        if not feet.known[f, 0]:
            continue
        along = quat.rotate(whole[ankle], feet.points[f, 1] - feet.points[f, 0])
        size = float(np.linalg.norm(along))
        flat = level(along, up)
        length = float(np.linalg.norm(flat))
        if size < 1e-6 or length < 0.3 * size:
            continue
        rise = float(feet.levels[f, 1] - feet.levels[f, 0])
        wanted = flat / length * np.sqrt(max(size**2 - rise**2, 0.0)) + up * rise
        turn = quat.arc(along, wanted)
        if 2.0 * float(np.arccos(min(abs(turn[3]), 1.0))) > PITCHED_RAD:
            return turn
    return STILL


def level(vector: F64, up: F64) -> F64:
    """The part (3,) of a vector across the up."""
    return np.asarray(vector - up * float(vector @ up))


def up_of(rig: Rig) -> F64:
    """The up (3,) of the body of a standing pose."""
    return np.asarray(quat.rotate(body_frame(rig.frames[1], rig.roles), np.array([0.0, 1.0, 0.0])))


def ground(rig: Rig, sole: float = 0.0) -> float:
    """Height of the ground of a standing pose along its up: where not stated, ``sole`` below the lowest point."""
    if rig.ground is not None and not rig.grounded_at_lowest:
        return rig.ground
    lowest = float((np.concatenate([rig.frames[1], rig.tips()]) @ up_of(rig)).min())
    return lowest - sole if rig.ground is None else lowest + rig.ground


def sole_thickness(source: Source, target: Rig) -> float:
    """Thickness of the target's soles below its lowest point, where its ground is not known: as that of the source."""
    feet = source.feet
    if not len(feet.joints):
        return 0.0
    heights = [_standing(source, f)[1] for f in range(len(feet.joints))]
    own = float((np.concatenate([source.rig.frames[1], source.rig.tips()]) @ up_of(source.rig)).min())
    thickness = max(float(np.mean(heights)) + own, 0.0)
    return thickness * leg_height(target) / max(leg_height(source.rig), 1e-6)


def _standing(source: Source, f: int) -> tuple[float, float]:
    """Length of a leg of the source from hip to sole, and the height of its standing pose's zero above the ground."""
    places, up = source.rig.frames[1], up_of(source.rig)
    hip, knee, ankle, _ = source.feet.joints[f].tolist()
    length = float(np.linalg.norm(places[hip] - places[knee]) + np.linalg.norm(places[knee] - places[ankle]))
    turn = flat_pitch(source, ankle, up)
    ball = float(quat.rotate(turn, quat.rotate(source.rig.frames[0][ankle], source.feet.points[f, 1])) @ up)
    ankle_height = max(float(source.feet.levels[f, 1]) - ball, 0.0)
    return length + ankle_height, ankle_height - float(places[ankle] @ up)


def leg_height(rig: Rig, sole: float = 0.0) -> float:
    """Length of the legs of a skeleton, from the middle of the hips to the ground, along the bones; 1 without legs."""
    bones, places, up = rig.roles.bones, rig.frames[1], up_of(rig)
    total = []
    for side in ("left", "right"):
        chain = [f"{side}{part}" for part in ("UpperLeg", "LowerLeg", "Foot")]
        if all(bone in bones for bone in chain):
            hip, knee, ankle = (places[bones[bone]] for bone in chain)
            length = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
            total.append(length + max(float(ankle @ up) - ground(rig, sole), 0.0))
    return float(np.mean(total)) if total else 1.0


def leg_ratio(source: Source, target: Rig) -> float:
    """Length of the target's legs over that of the source's; 1 where one has no legs."""
    legs = {f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg", "Foot")}
    if not (legs <= set(source.roles.bones) and legs <= set(target.roles.bones)):
        return 1.0
    total = [_standing(source, f)[0] for f in range(len(source.feet.joints))]
    own = float(np.mean(total)) if total else leg_height(source.rig)
    return leg_height(target, sole_thickness(source, target)) / own if own > 1e-6 else 1.0


def driven_above(target: Rig, index: dict[int, int], joint: int) -> int:
    """Number of the next driven joint above a joint; -1 for none."""
    parent = int(target.skeleton.parents[joint])
    while parent >= 0 and parent not in index:
        parent = int(target.skeleton.parents[parent])
    return index.get(parent, -1)
