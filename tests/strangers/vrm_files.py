"""A minimal VRM 1.0 avatar: the bones of a humanoid in its T-pose, without a mesh."""

from __future__ import annotations

import numpy as np

from verbs.io.glb import GlbBuilder
from verbs.io.humanoid import bones_of, t_pose
from verbs.kernels import fk, quat
from verbs.skeleton import Skeleton

LICENCE = "https://vrm.dev/licenses/1.0/"


def avatar(skeleton: Skeleton, *, scale: float = 1.0, limbs: float = 1.0, turned: bool = False) -> bytes:
    """A VRM of the bones of a skeleton; its limbs are longer, and its nodes rest turned, on request."""
    bones = bones_of(skeleton)
    order = sorted(bones, key=bones.__getitem__)
    joints = [bones[bone] for bone in order]
    places = t_places(skeleton, scale=scale, limbs=limbs)
    above = [next_above(skeleton, joints, joint) for joint in joints]
    rng = np.random.default_rng(4)
    turns = (
        quat.normalize(rng.normal(size=(len(joints), 4))) if turned else np.tile([0.0, 0.0, 0.0, 1.0], (len(joints), 1))
    )
    builder = GlbBuilder()
    for k, bone in enumerate(order):
        place, turn = places[joints[k]], turns[k]
        if above[k] >= 0:
            back = quat.conjugate(turns[above[k]])
            place, turn = quat.rotate(back, place - places[joints[above[k]]]), quat.mul(back, turn)
        children = [child for child, parent in enumerate(above) if parent == k]
        row = {"name": f"bone {bone}", "translation": place.tolist(), "rotation": turn.tolist()}
        builder.add("nodes", row | ({"children": children} if children else {}))
    builder.add("scenes", {"nodes": [0]})
    meta = {"name": "Test", "authors": ["Test"], "licenseUrl": LICENCE}
    human = {bone: {"node": k} for k, bone in enumerate(order)}
    builder.table |= {
        "scene": 0,
        "extensionsUsed": ["VRMC_vrm"],
        "extensions": {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": human}}},
    }
    return builder.content()


def t_places(skeleton: Skeleton, *, scale: float = 1.0, limbs: float = 1.0) -> np.ndarray:
    """Positions (J, 3) of the joints of the avatar in its T-pose, on the ground."""
    whole = t_pose(skeleton, bones_of(skeleton))
    local = whole.copy()
    local[1:] = quat.mul(quat.conjugate(whole[skeleton.parents[1:]]), whole[1:])
    offsets, tips = scaled(skeleton, scale, limbs)
    places = fk.forward(np.zeros((1, 3)), local[None], skeleton.parents, offsets)[1][0]
    ends = places[skeleton.tip_parents] + quat.rotate(whole[skeleton.tip_parents], tips)
    return places - [0.0, np.concatenate([places, ends])[:, 1].min(), 0.0]


def scaled(skeleton: Skeleton, scale: float, limbs: float) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the joints and tips of another body."""
    long = np.array([name.endswith(("ForeArm", "Leg", "Hand")) for name in skeleton.names])
    factors = np.where(long, scale * limbs, scale)
    return skeleton.offsets * factors[:, None], skeleton.tip_offsets * scale


def next_above(skeleton: Skeleton, joints: list[int], joint: int) -> int:
    """Place in a list of joints of the next one above a joint; -1 if there is none."""
    parent = int(skeleton.parents[joint])
    while parent >= 0 and parent not in joints:
        parent = int(skeleton.parents[parent])
    return joints.index(parent) if parent >= 0 else -1
