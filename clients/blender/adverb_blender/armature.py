"""Armatures of Blender: made of a verb's skeleton, posed, keyed, and read."""

from __future__ import annotations

from typing import Any

import bpy
from mathutils import Quaternion, Vector

from . import coordinates
from .example import Clip

Json = dict[str, Any]

SHORTEST_M = 0.01
"""Length of a bone whose joint has no child at a distance."""


def build(name: str, skeleton: Json) -> Any:
    """Make an armature of a verb's skeleton, with one bone for each joint from its position to that of a child."""
    data = bpy.data.armatures.new(name)
    found = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(found)
    bpy.context.view_layer.objects.active = found
    bpy.ops.object.mode_set(mode="EDIT")
    heads: list[Vector] = []
    for joint, (title, parent) in enumerate(zip(skeleton["names"], skeleton["parents"], strict=True)):
        offset = Vector(coordinates.to_blender(skeleton["offsets"][joint])) if parent >= 0 else Vector((0.0, 0.0, 0.0))
        heads.append(heads[parent] + offset if parent >= 0 else offset)
        bone = data.edit_bones.new(title)
        bone.head = heads[joint]
        bone.tail = heads[joint] + _limb(skeleton, joint)
        if parent >= 0:
            bone.parent = data.edit_bones[skeleton["names"][parent]]
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in found.pose.bones:
        bone.rotation_mode = "QUATERNION"
    return found


def _limb(skeleton: Json, joint: int) -> Any:
    """From a joint to the middle of its children; upward where there is none."""
    offsets = [skeleton["offsets"][k] for k, parent in enumerate(skeleton["parents"]) if parent == joint]
    mean = Vector(
        coordinates.to_blender(
            [sum(axis) / len(offsets) for axis in zip(*offsets, strict=True)] if offsets else [0] * 3
        )
    )
    return mean if mean.length > SHORTEST_M else Vector((0.0, 0.0, 5 * SHORTEST_M))


def apply(armature: Any, names: list[str], root: list[float], rotations: list[list[float]]) -> None:
    """Show a pose: root position (m) and local rotations x, y, z, w in the server's axes."""
    for joint, name in enumerate(names):
        bone = armature.pose.bones[name]
        rest = bone.bone.matrix_local.to_quaternion()
        x, y, z, w = coordinates.rotation_to_blender(rotations[joint])
        local = rest.inverted() @ Quaternion((w, x, y, z)) @ rest
        before = bone.rotation_quaternion
        bone.rotation_quaternion = local if local.dot(before) >= 0.0 else -local
        if joint == 0:
            bone.location = rest.inverted() @ (Vector(coordinates.to_blender(root)) - bone.bone.head_local)


def bake(armature: Any, names: list[str], sequence: Json, start: int) -> int:
    """Key a sequence, one frame of the scene for each of its frames; returns the last frame."""
    for k, (root, rotations) in enumerate(zip(sequence["root"], sequence["rotations"], strict=True)):
        apply(armature, names, root, rotations)
        for joint, name in enumerate(names):
            bone = armature.pose.bones[name]
            bone.keyframe_insert("rotation_quaternion", frame=start + k)
            if joint == 0:
                bone.keyframe_insert("location", frame=start + k)
    return start + len(sequence["root"]) - 1


def points(armature: Any, names: list[str]) -> list[tuple[float, float, float]]:
    """Joint positions of the shown pose, m, in the server's axes and the space of the armature."""
    return [coordinates.from_blender(armature.pose.bones[name].head) for name in names]


def read(armature: Any, scene: Any, first: int, last: int) -> Clip:
    """The motion of an armature over frames of the scene, whatever moves it; in the server's axes."""
    bones = list(armature.pose.bones)  # parents before children
    index = {bone.name: k for k, bone in enumerate(bones)}
    parents = [index[bone.parent.name] if bone.parent else -1 for bone in bones]
    if parents.count(-1) != 1:
        raise ValueError("the armature has several bones without a parent; an example has one root")
    size = armature.matrix_world.to_scale()
    offsets = []
    for bone, parent in zip(bones, parents, strict=True):
        head = bone.bone.head_local - (bones[parent].bone.head_local if parent >= 0 else Vector((0, 0, 0)))
        offsets.append(coordinates.from_blender(size * head))
    turn = armature.matrix_world.to_quaternion()
    roots, rotations = [], []
    before = scene.frame_current
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        globals_ = [turn @ bone.matrix.to_quaternion() @ _rest(bone).inverted() for bone in bones]
        roots.append(coordinates.from_blender(armature.matrix_world @ bones[parents.index(-1)].head))
        local = [
            value if parent < 0 else globals_[parent].inverted() @ value
            for value, parent in zip(globals_, parents, strict=True)
        ]
        rotations.append([coordinates.rotation_from_blender((value.x, value.y, value.z, value.w)) for value in local])
    scene.frame_set(before)
    fps = scene.render.fps / scene.render.fps_base
    return Clip([bone.name for bone in bones], parents, offsets, fps, roots, rotations)


def _rest(bone: Any) -> Any:
    return bone.bone.matrix_local.to_quaternion()
