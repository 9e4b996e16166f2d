"""The bones of a target as those of a VRM humanoid."""

from __future__ import annotations

from verbs.io.humanoid import BONES, Humanoid
from verbs.kernels import quat
from verbs.mapping.names import Roles
from verbs.mapping.rig import Rig, body_frame

__all__ = ["humanoid_of"]


def humanoid_of(rig: Rig) -> Humanoid:
    """Bones of a target, with those of its spine and its neck, and its standing pose, turned to face +Z."""
    rotations, positions = rig.frames
    back = quat.conjugate(body_frame(positions, rig.roles))
    known = {bone: joint for bone, joint in rig.roles.bones.items() if bone in BONES}
    return Humanoid(known | _trunk(rig.roles), quat.mul(back, rotations))


def _trunk(roles: Roles) -> dict[str, int]:
    """Bones of the spine and of the neck: the lowest joint of each, the uppermost of the spine, and one between."""
    spine, neck = roles.spine, roles.neck
    found = dict(zip(("spine", "chest"), spine, strict=False))
    if len(spine) > 2:
        found = {"spine": spine[0], "chest": spine[len(spine) // 2], "upperChest": spine[-1]}
    return found | ({"neck": neck[0]} if neck else {})
