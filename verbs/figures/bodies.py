"""Bodies of poses: outlines of rounded limbs, trunk, feet and head on a screen, sorted by depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, Floats
from verbs.kernels import fk, quat
from verbs.skeleton import Skeleton

__all__ = ["Limb", "Piece", "limbs_of", "pieces", "points"]

# End of a joint's name: radius of the limb that leads to it, at its parent and at itself, metres.
_RADII = {
    "ToeBase": (0.042, 0.036),
    "Foot": (0.054, 0.040),
    "UpLeg": (0.080, 0.084),
    "Leg": (0.084, 0.056),
    "Hand": (0.043, 0.032),
    "Middle1": (0.034, 0.033),
    "Middle2": (0.031, 0.026),
    "Thumb1": (0.020, 0.020),
    "ForeArm": (0.054, 0.043),
    "Arm": (0.058, 0.058),
    "Shoulder": (0.080, 0.060),
    "Neck": (0.085, 0.050),
    "Neck1": (0.050, 0.048),
    "Head": (0.048, 0.048),
    "Hips": (0.092, 0.092),
    "Spine": (0.105, 0.108),
    "Spine1": (0.100, 0.112),
    "Spine2": (0.112, 0.115),
}
_TIP_RADII = {
    "Hand": (0.037, 0.027),
    "Middle2": (0.026, 0.020),
    "Thumb1": (0.019, 0.014),
    "ToeBase": (0.036, 0.027),
}
_TIP_SHARE = {"Hand": 0.72, "Middle2": 0.8}  # the rest of the way to a tip is inside the rounded end
_TRUNK = ("Spine1", "Spine2", "Neck", "Neck1", "Head", "Shoulder", "Arm")
_CHEST = ("LeftArm", "RightArm", "Spine2", "Spine1")
_WAIST = ("Spine1", "Spine", "Hips")
_PELVIS = ("LeftUpLeg", "RightUpLeg", "Hips")
_HEEL_M, _HEEL_ANGLE, _HEEL_RADIUS = 0.075, np.radians(97.0), 0.033
_ARC = np.linspace(0.0, np.pi, 13)


@dataclass(frozen=True, slots=True)
class Limb:
    """A rounded piece between two points: its ends, its radii, whose side it is on, and the share that is drawn."""

    start: int
    end: int
    radii: tuple[float, float]
    side: str
    share: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A filled outline (N, 2) on the screen, m.

    Parameters
    ----------
    outline : (N, 2) float64
    side : str
        A key of the palette: left, right, centre, hips.
    depth : float
        Distance toward the viewer, m.
    edge : bool
        Whether the outline is drawn; the filling alone covers the outlines of pieces below it.
    """

    outline: F64
    side: str
    depth: float
    edge: bool = True


def points(skeleton: Skeleton, root: Floats, rotations: Floats) -> F64:
    """Positions of all joints, then all tips, of poses.

    Parameters
    ----------
    skeleton : Skeleton
        The joints.
    root : (..., 3)
        Position of the root, metres.
    rotations : (..., J, 4)
        Local rotations.

    Returns
    -------
    points : (..., J + T, 3) float64
    """
    global_rotations, positions = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)
    tips = quat.rotate(global_rotations[..., skeleton.tip_parents, :], skeleton.tip_offsets)
    return np.concatenate([positions, positions[..., skeleton.tip_parents, :] + tips], axis=-2)


def limbs_of(skeleton: Skeleton) -> list[Limb]:
    """Limbs of a skeleton; radii come from names of joints, or from lengths where a name is not known."""
    sided = any(name.startswith(("Left", "Right")) for name in skeleton.names)
    limbs = []
    for joint in range(1, len(skeleton)):
        name, length = skeleton.names[joint], float(np.linalg.norm(skeleton.offsets[joint]))
        if name in (*_WAIST, *_PELVIS) and set(_PELVIS) <= set(skeleton.names):
            continue  # inside the waist or the pelvis
        side = "trunk" if _ending(_RADII, name) in _TRUNK else _side(name, sided=sided)
        limbs.append(Limb(int(skeleton.parents[joint]), joint, _radii(_RADII, name, length), side))
    for tip, joint in enumerate(skeleton.tip_parents):
        name, length = skeleton.names[joint], float(np.linalg.norm(skeleton.tip_offsets[tip]))
        if name != "Head" and length > 0:
            share = _TIP_SHARE.get(_ending(_TIP_SHARE, name), 1.0)
            radii = _radii(_TIP_RADII, name, length)
            limbs.append(Limb(int(joint), len(skeleton) + tip, radii, _side(name, sided=sided), share))
    return limbs


def pieces(skeleton: Skeleton, limbs: list[Limb], screen: F64) -> list[Piece]:
    """Outlines of one pose, the farthest first.

    Parameters
    ----------
    skeleton : Skeleton
    limbs : list of Limb
        As :func:`limbs_of` returns them.
    screen : (N, 3) float64
        Joints, and tips where there are any: right, up, toward the viewer, m.
    """
    found = [_limb(skeleton, limb, screen) for limb in limbs if limb.side != "trunk" and limb.end < len(screen)]
    trunk = [limb for limb in limbs if limb.side == "trunk"]
    depth = float(np.mean([screen[limb.end, 2] for limb in trunk])) if trunk else 0.0
    found += _heads(skeleton, screen, depth if trunk else -np.inf)
    front = [piece for piece in found if piece.depth > depth]
    behind = [piece for piece in found if piece.depth <= depth]
    order = lambda piece: piece.depth  # noqa: E731 - one key for both halves
    return [*sorted(behind, key=order), *_trunk(skeleton, trunk, screen, depth), *sorted(front, key=order)]


def _limb(skeleton: Skeleton, limb: Limb, screen: F64) -> Piece:
    start = screen[limb.start]
    end = start + limb.share * (screen[limb.end] - start)
    # Thighs go behind the trunk unless they are well before it, so that hips look the same in every pose.
    behind = 0.08 if skeleton.names[limb.start].endswith("UpLeg") else 0.0
    outline = _capsule(start[:2], end[:2], *limb.radii)
    if limb.end < len(skeleton) and skeleton.names[limb.end].endswith("ToeBase"):
        outline = _with_heel(outline, skeleton, limb, screen)
    return Piece(outline, limb.side, 0.5 * float(start[2] + end[2]) - behind)


def _with_heel(outline: F64, skeleton: Skeleton, limb: Limb, screen: F64) -> F64:
    """Outline of a foot that has a heel below and behind its ankle; without one where foot and shin are in line."""
    ankle, shin = screen[limb.start], screen[limb.start] - screen[skeleton.parents[limb.start]]
    foot = (screen[limb.end] - ankle) / max(float(np.linalg.norm(screen[limb.end] - ankle)), 1e-9)
    down = shin - (shin @ foot) * foot
    length = float(np.linalg.norm(down))
    if length < 0.2 * float(np.linalg.norm(shin)):
        return outline
    heel = ankle + _HEEL_M * (np.cos(_HEEL_ANGLE) * foot + np.sin(_HEEL_ANGLE) * down / length)
    return _hull([outline, _disc(heel[:2], _HEEL_RADIUS)])


def _heads(skeleton: Skeleton, screen: F64, least: float) -> list[Piece]:
    found = []
    for tip, joint in enumerate(skeleton.tip_parents):
        if skeleton.names[joint] == "Head" and len(skeleton) + tip < len(screen):
            top, base = screen[len(skeleton) + tip, :2], screen[joint, :2]
            outline = _capsule(0.72 * base + 0.28 * top, 0.42 * base + 0.58 * top, 0.080, 0.096)
            # In front of the trunk, or the neck would show through the face.
            found.append(Piece(outline, "centre", max(float(screen[joint, 2]), least) + 0.02))
    return found


def _trunk(skeleton: Skeleton, limbs: list[Limb], screen: F64, depth: float) -> list[Piece]:
    """Trunk, every outline before every filling, so that its parts melt into one; then the pelvis."""
    outlines = [_capsule(screen[limb.start, :2], screen[limb.end, :2], *limb.radii) for limb in limbs]
    outlines += _joined(skeleton, _CHEST, screen)
    outlines += _joined(skeleton, _WAIST, screen)
    edges = [Piece(outline, "centre", depth) for outline in outlines]
    filled = [Piece(outline, "centre", depth, edge=False) for outline in outlines]
    return edges + filled + [Piece(outline, "hips", depth) for outline in _joined(skeleton, _PELVIS, screen)]


def _joined(skeleton: Skeleton, names: tuple[str, ...], screen: F64) -> list[F64]:
    """Outline around the discs of some joints; nothing where the skeleton lacks one of them."""
    if not set(names) <= set(skeleton.names):
        return []
    return [_hull([_disc(screen[skeleton.index(name), :2], _joined_radius(name)) for name in names])]


def _joined_radius(name: str) -> float:
    """Radius of a disc of the trunk at a joint; hips are narrower than thighs, which begin in them."""
    return 0.9 * _radii(_RADII, name, 0.1)[1] if name.endswith("UpLeg") else _radii(_RADII, name, 0.1)[1]


def _radii(table: dict[str, tuple[float, float]], name: str, length: float) -> tuple[float, float]:
    """Radii of a limb by its joint's name; by its length where the table lacks the name."""
    return table.get(_ending(table, name), (min(0.06, 0.14 * length), min(0.05, 0.11 * length)))


def _ending(table: dict[str, tuple[float, float]] | dict[str, float], name: str) -> str:
    """Longest ending of a joint's name that stands in a table, or nothing."""
    return max((ending for ending in table if name.endswith(ending)), key=len, default="")


def _side(name: str, *, sided: bool) -> str:
    if not sided:
        return "right"  # one colour for a skeleton without sides
    return "left" if name.startswith("Left") else "right" if name.startswith("Right") else "centre"


def _hull(outlines: list[F64]) -> F64:
    from scipy.spatial import ConvexHull

    corners = np.concatenate(outlines)
    return np.asarray(corners[ConvexHull(corners).vertices])


def _disc(centre: F64, radius: float) -> F64:
    return np.asarray(centre + radius * np.stack([np.cos(2 * _ARC), np.sin(2 * _ARC)], axis=-1))


def _capsule(start: F64, end: F64, start_radius: float, end_radius: float) -> F64:
    """Outline (N, 2) of two discs and the straight sides that touch them both."""
    along = end - start
    length = float(np.hypot(*along))
    if length <= abs(start_radius - end_radius):  # one disc hides the other
        return _disc(start, start_radius) if start_radius >= end_radius else _disc(end, end_radius)
    heading = np.arctan2(along[1], along[0])
    lean = np.arcsin((start_radius - end_radius) / length)
    far = heading - np.pi / 2 + lean + (_ARC / np.pi) * (np.pi - 2 * lean)
    near = heading + np.pi / 2 - lean + (_ARC / np.pi) * (np.pi + 2 * lean)
    caps = [
        centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for centre, radius, angle in ((end, end_radius, far), (start, start_radius, near))
    ]
    return np.concatenate(caps)
