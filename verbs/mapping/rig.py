"""A skeleton at rest: what a target of a mapping is, and the pose in which two skeletons are compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from verbs.conventions import F64, freeze
from verbs.kernels import fk, quat
from verbs.mapping.names import Roles, roles_of
from verbs.skeleton import Skeleton

__all__ = ["STILL", "Rig", "body_frame", "choose_reference", "standing_score"]

STILL = np.array([0.0, 0.0, 0.0, 1.0])

STANDS = 0.8
"""Least score of a pose that stands; see :func:`standing_score`."""

UP_RAD, SIDE_RAD = 0.35, 0.1
"""A body whose up, and whose side, is within these angles of an axis of its file has that axis."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A target skeleton at rest.

    Parameters
    ----------
    name : str
        Of the preset or file.
    skeleton : Skeleton
        Offsets in metres, in the frames of the parents.
    rest : (J, 4) float64
        Local rotations that joints without a source keep.
    reference : (J, 4) float64
        Local rotations of the standing pose that is compared with that of the source.
    origin : (3,) float64
        Position of the root in that pose, metres.
    ground : float or None
        Height of the ground in that pose along the body's up, metres; None takes the lowest joint or tip.
    grounded_at_lowest : bool
        Whether ``ground`` counts from the lowest joint or tip: the file has no rest position (BVH, npz).
    given : mapping of str to int
        Joints of VRM bones that the file names.
    unit : str
        Unit of length of the file.
    nodes : tuple of int
        Nodes of the joints in a glTF file.
    path : Path or None
        The file.
    root_position, root_rotation, root_scale : (3,), (4,), (3,) float64
        Translation, rotation and scale of the nodes above the joints, in the unit of the file.
    metres : float
        Metres per unit.
    notes : tuple of str
        What reading the file changed or left out.
    """

    name: str
    skeleton: Skeleton
    rest: F64
    reference: F64
    origin: F64
    ground: float | None = None
    grounded_at_lowest: bool = False
    given: Mapping[str, int] = field(default_factory=dict)
    unit: str = "m"
    nodes: tuple[int, ...] = ()
    path: Path | None = None
    root_position: F64 = field(default_factory=lambda: np.zeros(3))
    root_rotation: F64 = field(default_factory=lambda: STILL)
    root_scale: F64 = field(default_factory=lambda: np.ones(3))
    metres: float = 1.0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def roles(self) -> Roles:
        """The humanoid of the skeleton."""
        return roles_of(self.skeleton.names, self.skeleton.parents.tolist(), self.given)

    @cached_property
    def frames(self) -> tuple[F64, F64]:
        """Global rotations (J, 4) and positions (J, 3) in the reference pose."""
        return fk.forward(self.origin, self.reference, self.skeleton.parents, self.skeleton.offsets)

    def tips(self) -> F64:
        """Positions (T, 3) of the tips in the reference pose."""
        rotations, positions = self.frames
        carriers = self.skeleton.tip_parents
        return np.asarray(positions[carriers] + quat.rotate(rotations[carriers], self.skeleton.tip_offsets))


def choose_reference(skeleton: Skeleton, roles: Roles, candidates: Sequence[F64]) -> F64:
    """The first of some poses (J, 4) that stands, else the one that comes nearest.

    The zero pose of a capture may be any heap of bones; a frame of its motion then serves.
    """
    best, most = candidates[0], -np.inf
    for pose in candidates:
        score = standing_score(skeleton, roles, pose)
        if score >= STANDS:
            return pose
        if score > most:
            best, most = pose, score
    return best


def standing_score(skeleton: Skeleton, roles: Roles, pose: F64) -> float:
    """How much a pose (J, 4) is a standing one with straight limbs, at most 1; 1 for what is no humanoid."""
    if not {"leftUpperLeg", "rightUpperLeg", "leftUpperArm", "rightUpperArm"} <= set(roles.bones):
        return 1.0
    _, places = fk.forward(np.zeros(3), pose, skeleton.parents, skeleton.offsets)
    bones = {bone: places[joint] for bone, joint in roles.bones.items()}
    legs = 0.5 * (bones["leftUpperLeg"] + bones["rightUpperLeg"])
    arms = 0.5 * (bones["leftUpperArm"] + bones["rightUpperArm"])
    up = _unit(arms - legs)
    values = []
    for side in ("left", "right"):
        for above, below in (("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")):
            if f"{side}{above}" in bones and f"{side}{below}" in bones:
                values.append(-float(_unit(bones[f"{side}{below}"] - bones[f"{side}{above}"]) @ up))
        chain = [f"{side}{part}" for part in ("UpperArm", "LowerArm", "Hand")]
        if all(part in bones for part in chain):
            upper, lower = (_unit(bones[b] - bones[a]) for a, b in pairwise(chain))
            raised = max(float(upper @ up), 0.0)  # arms hang or point to the sides
            values.append(float(upper @ lower) - raised)
    return min(values, default=1.0)


def body_frame(rig_positions: F64, roles: Roles) -> F64:
    """Rotation (4,) from our axes (+X left, +Y up, +Z forward) to those of a body that stands at positions (J, 3).

    Axes of the file are taken where the body is nearly along them.
    """
    bones = {bone: rig_positions[joint] for bone, joint in roles.bones.items()}
    pairs = [
        (bones[f"left{part}"], bones[f"right{part}"])
        for part in ("UpperLeg", "UpperArm", "Shoulder", "Hand")
        if f"left{part}" in bones and f"right{part}" in bones
    ]
    if not pairs or "hips" not in bones:
        return STILL
    low = 0.5 * sum(pairs[0], start=np.zeros(3))
    high = bones.get("head", 0.5 * sum(pairs[-1], start=np.zeros(3)))
    if "leftFoot" in bones and "rightFoot" in bones:
        low = 0.5 * (bones["leftFoot"] + bones["rightFoot"])
    side = sum((left - right for left, right in pairs[:2]), start=np.zeros(3))
    up = _snapped(high - low, UP_RAD)
    left = _snapped(side - up * (side @ up), SIDE_RAD)
    left = _unit(left - up * (left @ up))
    return quat.from_matrix(np.stack([left, up, np.cross(left, up)], axis=1))


def _snapped(vector: F64, within: float) -> F64:
    """Unit vector; along an axis where it nearly is."""
    unit = _unit(vector)
    axis = int(np.argmax(np.abs(unit)))
    near = np.zeros(3)
    near[axis] = np.sign(unit[axis])
    return near if float(unit @ near) > np.cos(within) else unit


def _unit(vector: F64) -> F64:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
