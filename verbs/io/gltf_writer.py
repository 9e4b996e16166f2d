"""glTF 2.0 writer: a motion as ``.glb``, with a skeleton, an animation and, on request, a body to look at.

The file holds one node for each joint and tip, a skin, and one animation with linear samplers: the translation of the
root and the rotation of every joint. Lengths are metres, +Y is up and the figure faces +Z, as everywhere here. The
root rests at the height at which the rest pose stands on the ground.

Source: Khronos, "glTF 2.0 Specification".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.errors import MotionFileError
from verbs.io import mannequin as figure
from verbs.io.glb import ELEMENT_ARRAY, VERTEX_ARRAY, GlbBuilder, Row
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["add_animation", "dump"]

_MATERIAL: Row = {
    "name": "Mannequin",
    "pbrMetallicRoughness": {"baseColorFactor": [0.68, 0.62, 0.55, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8},
}


def dump(
    motion: Motion, *, mannequin: bool = True, name: str = "motion", extras: Mapping[str, Any] | None = None
) -> bytes:
    """Bytes of a ``.glb`` file; equal arguments give equal bytes.

    Parameters
    ----------
    motion : Motion
    mannequin : bool
        Whether to add a skinned body, so that a plain viewer shows the motion.
    name : str
        Name of the animation.
    extras : mapping, optional
        JSON values for ``asset.extras``; the rate is added as ``fps``.

    Raises
    ------
    MotionFileError
        A joint's name cannot stand in the file.
    """
    skeleton = motion.skeleton
    _check_names(skeleton)
    builder = GlbBuilder({**(extras or {}), "fps": motion.fps})
    places, tips = figure.rest_positions(skeleton)
    ground = np.array([0.0, -float(np.concatenate([places, tips])[:, 1].min()), 0.0])
    _add_nodes(builder, skeleton, ground)
    inverse = np.tile(np.eye(4), (len(skeleton), 1, 1))
    inverse[:, 3, :3] = -(places + ground)  # rows here are the columns of the format
    joints = list(range(len(skeleton)))
    skin: Row = {"inverseBindMatrices": builder.floats(inverse.reshape(-1, 16)), "joints": joints, "skeleton": 0}
    builder.add("skins", skin)
    roots = [0]
    if mannequin:
        mesh = _add_mesh(builder, figure.body(skeleton), ground)
        roots.append(builder.add("nodes", {"name": "Mannequin", "mesh": mesh, "skin": 0}))
    builder.add("scenes", {"nodes": roots})
    builder.table["scene"] = 0
    add_animation(builder, name, motion.fps, motion.root, motion.rotations)
    return builder.content()


def add_animation(
    builder: GlbBuilder, name: str, fps: float, root: F64, rotations: F64, nodes: Sequence[int] | None = None
) -> int:
    """Add an animation: the translation (F, 3) of the first node, and rotations (F, N, 4) of all.

    Quaternions are unit and change their sign between frames nowhere. ``nodes`` are 0, 1, … by default.
    """
    nodes = range(rotations.shape[1]) if nodes is None else nodes
    times = builder.floats(np.arange(len(root)) / fps, bounds=True)
    smooth = quat.unroll(quat.normalize(rotations))
    tracks = [(nodes[0], "translation", root)]
    tracks += [(node, "rotation", smooth[:, k]) for k, node in enumerate(nodes)]
    animation: Row = {"name": name, "channels": [], "samplers": []}
    for sampler, (node, path, values) in enumerate(tracks):
        output = builder.floats(values)
        animation["samplers"].append({"input": times, "interpolation": "LINEAR", "output": output})
        animation["channels"].append({"sampler": sampler, "target": {"node": node, "path": path}})
    return builder.add("animations", animation)


def _check_names(skeleton: Skeleton) -> None:
    for name in skeleton.names:
        try:
            name.encode()
        except UnicodeEncodeError as err:  # half a surrogate
            raise MotionFileError("<glb>", None, "a joint name of valid text", repr(name[:40])) from err


def _add_nodes(builder: GlbBuilder, skeleton: Skeleton, ground: F64) -> None:
    """One node for each joint in their order, then one for each tip."""
    count = len(skeleton)
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint, parent in enumerate(skeleton.parents.tolist()[1:], start=1):
        children[parent].append(joint)
    for tip, parent in enumerate(skeleton.tip_parents.tolist()):
        children[parent].append(count + tip)
    for joint, name in enumerate(skeleton.names):
        place = skeleton.offsets[joint] if joint else ground
        row: Row = {"name": name, "translation": place.tolist()}
        builder.add("nodes", row | ({"children": children[joint]} if children[joint] else {}))
    names = _tip_names(skeleton)
    for name, offset in zip(names, skeleton.tip_offsets, strict=True):
        builder.add("nodes", {"name": name, "translation": offset.tolist()})


def _tip_names(skeleton: Skeleton) -> list[str]:
    """Unique names of the tips: that of their joint and ``_end``, as Blender names them."""
    taken = set(skeleton.names)
    names = []
    for parent in skeleton.tip_parents.tolist():
        name = base = f"{skeleton.names[parent]}_end"
        number = 1
        while name in taken:
            number += 1
            name = f"{base}{number}"
        taken.add(name)
        names.append(name)
    return names


def _add_mesh(builder: GlbBuilder, mesh: figure.Mesh, ground: F64) -> int:
    """Add a mesh whose vertices follow one joint each; returns its index."""
    kind = "<u1" if int(mesh.joints.max()) < 256 else "<u2"
    joints = np.zeros((len(mesh.joints), 4), kind)
    joints[:, 0] = mesh.joints
    weights = np.zeros((len(mesh.joints), 4))
    weights[:, 0] = 1.0
    indices = mesh.triangles.reshape(-1)
    short = indices.astype("<u2" if len(mesh.joints) < 65_535 else "<u4")
    attributes = {
        "POSITION": builder.floats(mesh.positions + ground, target=VERTEX_ARRAY, bounds=True),
        "NORMAL": builder.floats(mesh.normals, target=VERTEX_ARRAY),
        "JOINTS_0": builder.accessor(joints, target=VERTEX_ARRAY),
        "WEIGHTS_0": builder.floats(weights, target=VERTEX_ARRAY),
    }
    primitive: Row = {
        "attributes": attributes,
        "indices": builder.accessor(short, target=ELEMENT_ARRAY),
        "material": builder.add("materials", _MATERIAL),
    }
    return builder.add("meshes", {"name": "Mannequin", "primitives": [primitive]})
