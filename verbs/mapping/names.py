"""Bones of a humanoid by the names of joints: VRM, Unity, Unreal, Mixamo, SMPL, Biped, BVH captures and the like.

Names decide the limbs, the head and the fingers; the hierarchy decides the rest. The hips are where the legs meet the
trunk, the spine is everything from there to the joint where the arms meet it, and the neck what is left below the head.
``tools/mapping_table.py`` writes the tables of this module for the TypeScript client, which matches in the same way.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = [
    "ALIASES", "DROPPED", "EXCLUDED", "FINGER", "FINGER_NAMES", "FINGER_PARTS", "HEAD", "HIPS", "LEFT", "PREFIX",
    "RIGHT", "SEPARATORS", "SIDE_LETTER", "Roles", "label", "roles_of",
]  # fmt: skip

PREFIX = r"^(?:mixamorig\d*|bip\d+|valvebiped|cc_base|j_bip|character\d*|def|org|rig)"
"""Prefixes of rigs, in lower case; removed repeatedly where a separator or a capital follows."""

SEPARATORS = r"^[_\s.-]+"

SIDE_LETTER = r"(^|[^A-Za-z])([LR])(?=[UF][A-Z][a-z])"
"""An L or R before an upper or fore part, as in Motive's LUArm and LFArm; a word of its own."""

LEFT, RIGHT = ("left", "l", "lf", "lft"), ("right", "r", "rt", "rgt")
"""Words that name a side."""

DROPPED = ("c", "m", "joint", "jnt", "bone", "bn", "jt", "bind", "skin", "sk")
"""Words that have no meaning."""

EXCLUDED = (
    "twist", "roll", "ik", "fk", "pole", "ctrl", "control", "target", "end", "nub", "tip", "helper", "null", "effector",
    "socket", "site", "weapon", "prop", "cloth", "skirt", "sleeve", "hair", "breast", "bust", "tail", "wing", "ear",
    "eye", "jaw", "share", "corrective", "bulge", "virtual", "attach", "cape",
)  # fmt: skip
"""Words of joints that are no bone of the body."""

ALIASES: dict[str, tuple[str, ...]] = {
    "Shoulder": ("clavicle", "collar", "collarbone", "clav", "scapula", "shoulder"),
    "UpperArm": ("upperarm", "uparm", "uarm", "arm", "armupper", "humerus", "shldr", "shldrbend", "bicep", "shoulder"),
    "LowerArm": ("lowerarm", "forearm", "farm", "lowarm", "armlower", "forearmbend", "elbow", "radius"),
    "Hand": ("wrist", "hand"),
    "UpperLeg": ("upperleg", "upleg", "thigh", "legupper", "thighbend", "femur", "leg", "hip"),
    "LowerLeg": ("lowerleg", "lowleg", "leglower", "calf", "shin", "knee", "tibia", "shank", "leg"),
    "Foot": ("ankle", "foot"),
    "Toes": ("toes", "toe", "toebase", "ball", "toe0", "forefoot", "foot"),
}
"""Names of the bones that both sides have, without the side and in lower case; the first ones are preferred."""

UNSURE = ("shoulder", "hip", "leg", "foot")
"""Names that stand for two bones. A shoulder is the arm, unless another joint of the side is surely the arm. A hip is
the thigh, unless another joint may be; a leg is the shank, unless another joint surely is and none is the thigh. A foot
is the toes where the side has an ankle."""

HEAD, HIPS = ("head", "skull"), ("hips", "hip", "pelvis", "hipcenter", "centerhip", "root")

FINGER = r"^(?:hand|f|finger)?(thumb|index|middle|mid|ring|pinky|little)(?:finger)?(.*)$"
"""A finger and its part."""

FINGER_NAMES = {
    "thumb": "Thumb", "index": "Index", "middle": "Middle", "mid": "Middle", "ring": "Ring", "pinky": "Little",
    "little": "Little",
}  # fmt: skip

FINGER_PARTS = {"Thumb": ("Metacarpal", "Proximal", "Distal"), "": ("Proximal", "Intermediate", "Distal")}
"""Parts of the thumb, and of the other fingers, from the hand on."""

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


@dataclass(frozen=True, slots=True)
class Roles:
    """The humanoid of a skeleton.

    Parameters
    ----------
    bones : mapping of str to int
        Joint of each VRM bone, but for the spine and the neck.
    spine : tuple of int
        Joints above the hips up to the one that carries the arms, that included.
    neck : tuple of int
        Joints between that and the head.
    """

    bones: Mapping[str, int]
    spine: tuple[int, ...]
    neck: tuple[int, ...]

    def __bool__(self) -> bool:
        return "hips" in self.bones


def label(name: str) -> tuple[str, str]:
    """Side (``left``, ``right`` or empty) and plain name of a joint; an empty name for joints that are no bones."""
    name = re.split(r"[:|/]", name)[-1].strip()
    while (found := re.match(PREFIX, name.lower())) and (rest := name[found.end() :]) and not rest[0].islower():
        name = re.sub(SEPARATORS, "", rest)
    words = [word.lower() for word in _WORDS.findall(re.sub(SIDE_LETTER, r"\1\2_", name))]
    words = [str(int(word)) if word.isdigit() else word for word in words]
    if any(word in EXCLUDED for word in words):
        return "", ""
    side = ""
    at = next((k for k, word in enumerate(words) if word in LEFT or word in RIGHT), None)
    if at is not None:
        side = "left" if words.pop(at) in LEFT else "right"
    words = [word for word in words if word not in DROPPED] or words
    plain = "".join(words)
    if not side:
        side, plain = _joined_side(plain)
    return side, plain


def _joined_side(plain: str) -> tuple[str, str]:
    """Side at the start or end of a name in one case, such as ``leftupleg`` or ``rfemur``."""
    known = {alias for names in ALIASES.values() for alias in names}
    for side, words in (("left", LEFT), ("right", RIGHT)):
        for word in words:
            for rest in (plain.removeprefix(word), plain.removesuffix(word)):
                if rest != plain and (rest in known or (len(word) > 1 and re.match(FINGER, rest))):
                    return side, rest
    return "", plain


def roles_of(names: Sequence[str], parents: Sequence[int], given: Mapping[str, int] | None = None) -> Roles:
    """The humanoid of a skeleton, by names and hierarchy; without bones where it is none.

    Parameters
    ----------
    names : sequence of str, length J
    parents : sequence of int, length J
        Parents stand before their children; -1 for a root.
    given : mapping of str to int, optional
        Joints of VRM bones that the file itself names; they win.
    """
    labels = [label(name) for name in names]
    depths = _depths(parents)
    bones: dict[str, int] = {}
    for side in ("left", "right"):
        own = {joint: plain for joint, (each, plain) in enumerate(labels) if each == side}
        bones |= _limbs(side, own, depths, parents)
        bones |= _fingers(side, own, depths)
    heads = [joint for joint, (side, plain) in enumerate(labels) if not side and plain in HEAD]
    if heads:
        bones["head"] = min(heads, key=depths.__getitem__)
    trunk = ("hips", "spine", "chest", "upperChest", "neck")
    stated = {bone: joint for bone, joint in (given or {}).items() if bone not in trunk[1:]}
    bones = {bone: joint for bone, joint in bones.items() if joint not in stated.values()} | stated
    legs = [bones[bone] for bone in ("leftUpperLeg", "rightUpperLeg") if bone in bones]
    arms = [bones[bone] for bone in ("leftUpperArm", "rightUpperArm", "head") if bone in bones]
    if "hips" not in bones:
        named = [joint for joint, (side, plain) in enumerate(labels) if not side and plain in HIPS]
        if len(legs) == 2:
            bones["hips"] = _common(parents, legs + arms[:1])
        elif named:
            bones["hips"] = min(named, key=lambda joint: (HIPS.index(labels[joint][1]), depths[joint]))
    if "hips" not in bones or len(arms) < 2:
        return Roles(bones, (), ())
    chest = _common(parents, arms)
    spine = _between(parents, bones["hips"], chest)
    neck = _between(parents, chest, bones["head"])[:-1] if "head" in bones else ()
    return Roles(bones, spine, neck)


def _limbs(side: str, own: Mapping[int, str], depths: Sequence[int], parents: Sequence[int]) -> dict[str, int]:
    """Joints of the arm and the leg of a side."""
    sure = {
        bone for bone, aliases in ALIASES.items() for plain in own.values() if plain in aliases and plain not in UNSURE
    }
    found: dict[str, int] = {}
    for bone, aliases in ALIASES.items():
        rows = [
            (aliases.index(plain), depths[joint], joint)
            for joint, plain in own.items()
            if plain in aliases and _stands_for(plain, bone, sure, own)
        ]
        if rows:
            found[bone] = min(rows)[2]
    for above, below in (
        ("LowerArm", "Hand"),
        ("LowerLeg", "Foot"),
        ("UpperArm", "LowerArm"),
        ("UpperLeg", "LowerLeg"),
    ):
        if above not in found and below in found and parents[found[below]] not in (-1, *found.values()):
            found[above] = parents[found[below]]
    return {f"{side}{bone}": joint for bone, joint in found.items()}


def _stands_for(plain: str, bone: str, sure: set[str], own: Mapping[int, str]) -> bool:
    """Whether a name that may stand for two bones stands for this one."""
    if plain == "shoulder":
        return bone == ("Shoulder" if "UpperArm" in sure else "UpperArm")
    if plain == "hip":
        return bone == "UpperLeg" and "UpperLeg" not in sure and "leg" not in own.values()
    if plain == "leg":
        return bone == ("UpperLeg" if "UpperLeg" not in sure and "LowerLeg" in sure else "LowerLeg")
    if plain == "foot":
        return bone == ("Toes" if "ankle" in own.values() else "Foot")
    return True


def _fingers(side: str, own: Mapping[int, str], depths: Sequence[int]) -> dict[str, int]:
    """Joints of the fingers of a side, three of each, from the hand on."""
    rows: dict[str, list[int]] = {}
    for joint in sorted(own, key=lambda each: (depths[each], each)):
        match = re.match(FINGER, own[joint])
        if match is None:
            continue
        finger, part = FINGER_NAMES[match[1]], match[2]
        if finger == "Thumb" or "metacarpal" not in part:
            rows.setdefault(finger, []).append(joint)
    return {
        f"{side}{finger}{part}": joint
        for finger, joints in rows.items()
        for part, joint in zip(FINGER_PARTS.get(finger, FINGER_PARTS[""]), joints, strict=False)
    }


def _depths(parents: Sequence[int]) -> list[int]:
    depths: list[int] = []
    for parent in parents:
        depths.append(depths[parent] + 1 if parent >= 0 else 0)
    return depths


def _chain(parents: Sequence[int], joint: int) -> list[int]:
    """A joint and all above it, the joint first."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def _common(parents: Sequence[int], joints: Sequence[int]) -> int:
    """The lowest joint above all of some joints."""
    shared = set.intersection(*(set(_chain(parents, joint)) for joint in joints))
    return next(joint for joint in _chain(parents, joints[0]) if joint in shared) if shared else 0


def _between(parents: Sequence[int], above: int, joint: int) -> tuple[int, ...]:
    """Joints from below one down to another, that included; none where it is not below."""
    chain = _chain(parents, joint)
    return tuple(chain[: chain.index(above)][::-1]) if above in chain else ()
