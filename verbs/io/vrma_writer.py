"""VRM animation writer: a motion of a humanoid as ``.vrma``, which drives any VRM avatar.

A ``.vrma`` file is a ``.glb`` with a map of humanoid bones to nodes. Readers take the rest pose of its nodes as the
T-pose, and apply rotations relative to it. Three steps bring a skeleton of any rest pose there:

- The nodes rest in the T-pose of :func:`verbs.io.humanoid.t_pose`, hips at the height at which that pose stands.
- Only joints that are humanoid bones become nodes. The rotation of one is the product of those from the bone above it
  down, so that a joint between two bones (a second neck joint) is not lost.
- Animated rotations are those of the motion; the rest rotations make up the difference.

Source: VRM Consortium, "VRMC_vrm_animation-1.0".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.errors import RequestError
from verbs.io.glb import GlbBuilder, Row
from verbs.io.gltf_writer import add_animation
from verbs.io.humanoid import Humanoid, bones_above, bones_of, missing, t_pose
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["dump"]

EXTENSION = "VRMC_vrm_animation"


def dump(
    motion: Motion, *, name: str = "motion", extras: Mapping[str, Any] | None = None, humanoid: Humanoid | None = None
) -> bytes:
    """Bytes of a ``.vrma`` file; equal arguments give equal bytes.

    Parameters
    ----------
    motion : Motion
        Without ``humanoid`` its joints are named as in :data:`verbs.io.humanoid.BONES`, and it rests facing +Z.
    name : str
        Name of the animation.
    extras : mapping, optional
        JSON values for ``asset.extras``; the rate is added as ``fps``.
    humanoid : Humanoid, optional
        Bones of the skeleton, and its standing pose.

    Raises
    ------
    RequestError
        The skeleton lacks a bone that a VRM humanoid must have; all of these are named.
    """
    skeleton = motion.skeleton
    bones, standing = (bones_of(skeleton), None) if humanoid is None else humanoid
    lacking = missing(bones)
    if lacking:
        raise RequestError(f"the skeleton is no VRM humanoid: it has no joint for {', '.join(lacking)}")
    order = sorted(bones.items(), key=lambda row: row[1])
    joints = [joint for _, joint in order]
    above = bones_above(skeleton.parents.tolist(), joints)
    turned = t_pose(skeleton, bones, standing)
    rest = _rest_places(skeleton, turned, bones["hips"])
    builder = GlbBuilder({**(extras or {}), "fps": motion.fps})
    _add_nodes(builder, [skeleton.names[joint] for joint in joints], above, rest[joints], turned[joints])
    builder.add("scenes", {"nodes": [0]})
    human = {bone: {"node": k} for k, (bone, _) in enumerate(order)}
    builder.table |= {
        "scene": 0,
        "extensionsUsed": [EXTENSION],
        "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": human}}},
    }
    add_animation(builder, name, motion.fps, _places(motion, bones["hips"]), _between(motion, joints, above))
    return builder.content()


def _add_nodes(builder: GlbBuilder, names: list[str], above: list[int], places: F64, turned: F64) -> None:
    """Nodes of N joints that rest at global positions (N, 3) and rotations (N, 4)."""
    for k, (name, parent) in enumerate(zip(names, above, strict=True)):
        place, turn = places[k], turned[k]
        if parent >= 0:
            back = quat.conjugate(turned[parent])
            place, turn = quat.rotate(back, place - places[parent]), quat.mul(back, turn)
        row: Row = {"name": name, "translation": place.tolist(), "rotation": turn.tolist()}
        children = [child for child, other in enumerate(above) if other == k]
        builder.add("nodes", row | ({"children": children} if children else {}))


def _rest_places(skeleton: Skeleton, turned: F64, hips: int) -> F64:
    """Positions (J, 3) of the joints in the T-pose that stands on the ground; joints above the hips do not count."""
    parents = skeleton.parents
    local = turned.copy()
    local[1:] = quat.mul(quat.conjugate(turned[parents[1:]]), turned[1:])
    places = fk.forward(np.zeros((1, 3)), local[None], parents, skeleton.offsets)[1][0]
    tips = places[skeleton.tip_parents] + quat.rotate(turned[skeleton.tip_parents], skeleton.tip_offsets)
    body = [joint for joint in range(len(skeleton)) if hips in skeleton.chain(joint)]
    lowest = float(np.concatenate([places[body], tips])[:, 1].min())
    return np.asarray(places - [places[hips, 0], lowest, places[hips, 2]])


def _places(motion: Motion, joint: int) -> F64:
    """Positions (F, 3) of a joint."""
    if joint == 0:
        return motion.root
    skeleton = motion.skeleton
    return fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)[1][:, joint]


def _between(motion: Motion, joints: list[int], above: list[int]) -> F64:
    """Rotations (F, N, 4) of joints relative to the joint of the list above each."""
    parents = motion.skeleton.parents.tolist()
    found = np.empty((len(motion), len(joints), 4))
    for k, joint in enumerate(joints):
        stop = joints[above[k]] if above[k] >= 0 else -1
        total, step = motion.rotations[:, joint], parents[joint]
        while step not in (stop, -1):
            total = quat.mul(motion.rotations[:, step], total)
            step = parents[step]
        found[:, k] = total
    return found
