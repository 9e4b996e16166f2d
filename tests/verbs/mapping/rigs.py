"""Target skeletons with other proportions, rest poses, bone axes, spines and units, made of a preset."""

from __future__ import annotations

import numpy as np

from verbs.kernels import fk, quat
from verbs.mapping.rig import Rig
from verbs.skeleton import Skeleton


def remade(
    rig: Rig, *, scale: float = 1.0, arms: float = 1.0, legs: float = 1.0, roll: int | None = None, lowered: float = 0.0
) -> Rig:
    """The rig with scaled limbs, bones that have other axes (a seed), and arms lowered by an angle, radians."""
    skeleton = rig.skeleton
    offsets = skeleton.offsets * scale
    for bone, joint in rig.roles.bones.items():
        part = bone.removeprefix("left").removeprefix("right")
        offsets[joint] *= {"LowerArm": arms, "Hand": arms, "LowerLeg": legs, "Foot": legs}.get(part, 1.0)
    tips, pose = skeleton.tip_offsets * scale, rig.reference.copy()
    whole, places = fk.forward(np.zeros(3), pose, skeleton.parents, offsets)
    if roll is not None:
        axes = quat.normalize(np.random.default_rng(roll).normal(size=(len(skeleton), 4)))
        turned = quat.mul(whole, axes)
        above = skeleton.parents[1:]
        offsets[1:] = quat.rotate(quat.conjugate(turned[above]), places[1:] - places[above])
        carriers = skeleton.tip_parents
        tips = quat.rotate(quat.conjugate(turned[carriers]), quat.rotate(whole[carriers], tips))
        pose = turned.copy()
        pose[1:] = quat.mul(quat.conjugate(turned[above]), turned[1:])
    whole, _ = fk.forward(np.zeros(3), pose, skeleton.parents, offsets)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        joint = rig.roles.bones[f"{side}UpperArm"]
        turn = quat.exp(np.array([0.0, 0.0, sign * lowered]))
        pose[joint] = quat.mul(quat.conjugate(whole[skeleton.parents[joint]]), quat.mul(turn, whole[joint]))
    made = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.tip_parents, tips)
    return Rig("remade", made, pose, pose, np.zeros(3))


def with_spine(rig: Rig, count: int) -> Rig:
    """The rig with another number of spine joints, evenly between the pelvis and the joint that carries the arms."""
    skeleton, spine = rig.skeleton, rig.roles.spine
    _, places = rig.frames
    hips, chest = rig.roles.bones["hips"], spine[-1]
    kept = [joint for joint in range(len(skeleton)) if joint not in spine[:-1]]
    names, parents, at = [], [], []
    for joint in kept:
        if joint == chest:
            for k in range(1, count):
                names.append(f"spine_{k:02d}")
                parents.append(len(names) - 2 if k > 1 else names.index(skeleton.names[hips]))
                at.append(places[hips] + (places[chest] - places[hips]) * k / count)
        above = int(skeleton.parents[joint])
        names.append(skeleton.names[joint])
        if joint == chest:
            parents.append(len(names) - 2 if count > 1 else names.index(skeleton.names[hips]))
        else:
            parents.append(names.index(skeleton.names[above]) if above >= 0 else -1)
        at.append(places[joint])
    offsets = np.array(at)
    offsets[1:] -= np.array(at)[parents[1:]]
    offsets[0] = 0.0
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1))
    tips = [names.index(skeleton.names[joint]) for joint in skeleton.tip_parents]
    made = Skeleton(tuple(names), np.array(parents), offsets, np.array(tips), skeleton.tip_offsets)
    return Rig("respined", made, still, still, np.zeros(3))
