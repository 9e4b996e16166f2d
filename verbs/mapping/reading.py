"""Target skeletons of files: the hierarchy of a BVH file, and the nodes of a glTF or VRM file at rest.

Source: Khronos, "glTF 2.0 Specification"; VRM Consortium, "VRMC_vrm-1.0" and "VRM 0.0".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from verbs.conventions import F64, I64, METRES_PER_UNIT
from verbs.errors import MotionFileError, UnknownName
from verbs.io import motion_files
from verbs.io.gltf import unique_names
from verbs.io.gltf_accessors import Accessors
from verbs.io.gltf_document import Document, open_document
from verbs.io.gltf_nodes import Node, choose_joints, read_nodes
from verbs.io.gltf_scales import fixed_transform, inherited_scale, node_scale
from verbs.io.report import CHANGES, Note
from verbs.kernels import fk, quat
from verbs.mapping.names import roles_of
from verbs.mapping.rig import STILL, Rig, choose_reference, standing_score
from verbs.skeleton import Skeleton

__all__ = ["TARGETS", "read_rig"]

TARGETS = (".glb", ".gltf", ".vrm", ".bvh", ".npz")
"""Endings of files that have a target skeleton."""

TALL_M = 1.7
"""Height that decides the unit of a file: the unit in which its figure comes nearest."""

FRAMES = 200
"""Frames of a clip that are tried as the standing pose."""

SOLE_SHARE = 0.12
"""Share of a figure's height by which the file's zero may lie below its lowest joint and still be the ground."""


def read_rig(path: str | Path, *, unit: str | None = None, root: str | None = None) -> Rig:
    """Target skeleton of a file.

    Parameters
    ----------
    path : str or Path
        A file that ends as one of :data:`TARGETS`.
    unit : str, optional
        Unit of length, a key of ``conventions.METRES_PER_UNIT``. By default the one that gives a figure of human size.
    root : str, optional
        Joint of the hierarchy that is read, where the file has several. By default the one with the most joints.

    Raises
    ------
    MotionFileError
        The file is invalid, or has no skeleton, or no joint ``root``.
    UnknownName
        The unit is not known.
    """
    path = Path(path)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    ending = path.suffix.lower()
    if ending not in TARGETS:
        found = f"the ending '{path.suffix}'" if path.suffix else "no ending"
        raise MotionFileError(path, None, f"a file that ends in {', '.join(TARGETS)}", found, "convert it first")
    rig = _of_nodes(path, root) if ending in (".glb", ".gltf", ".vrm") else _of_motion(path, root)
    chosen = unit or _likely_unit(rig)
    return _scaled(rig, METRES_PER_UNIT[chosen], chosen)


def _of_motion(path: Path, root: str | None) -> Rig:
    file = motion_files.read(path, root=root, stretch_m=np.inf)  # the skeleton counts, not how it stretches
    motion = file.motion
    skeleton = motion.skeleton
    still = np.tile(STILL, (len(skeleton), 1))
    roles = roles_of(skeleton.names, skeleton.parents.tolist())
    frames = motion.rotations[:: max(1, len(motion) // FRAMES)]
    reference = choose_reference(skeleton, roles, [still, *frames])
    rest = still if reference is still else reference
    notes = _texts(file.report.notes)
    return Rig(path.name, skeleton, rest, reference, np.zeros(3), grounded_at_lowest=True, path=path, notes=notes)


def _texts(notes: Iterable[Note]) -> tuple[str, ...]:
    """Texts of the notes that change the skeleton or leave a part of it out."""
    return tuple(note.text for note in notes if note.kind in CHANGES and note.kind != "stretch")


def _of_nodes(path: Path, root: str | None) -> Rig:
    document = open_document(path)
    nodes = read_nodes(document)
    human = _human_bones(document, len(nodes))
    members = set(human.values()) or _animated(document, len(nodes))
    joints = choose_joints(document, nodes, members or _plain(nodes), root)
    if root is not None and root not in [nodes[node].name for node in joints.nodes]:
        document.fail("nodes", f"a joint '{root:.60}'", "none of that name")
    notes = list(joints.notes)
    scales = {node: node_scale(nodes[node], nodes[node].scale, notes) for node in (*joints.fixed, *joints.nodes)}
    place, turn, scale = fixed_transform(nodes, joints.fixed, scales, notes)
    index = {node: k for k, node in enumerate(joints.nodes)}
    parents = np.array([index.get(nodes[node].parent, -1) for node in joints.nodes], np.int64)
    parents[0] = -1
    below = np.empty((len(index), 3))  # scale of what hangs on each
    offsets, rest = np.empty((len(index), 3)), np.empty((len(index), 4))
    for node, k in index.items():
        inherited = scale if parents[k] < 0 else below[parents[k]]
        below[k] = inherited_scale(inherited, scales[node])
        offsets[k], rest[k] = inherited * nodes[node].translation, nodes[node].rotation
    origin = place + quat.rotate(turn, offsets[0])
    rest[0], offsets[0] = quat.mul(turn, rest[0]), 0.0
    tips = [nodes[tip] for tip in joints.tips]
    carriers = np.array([index[tip.parent] for tip in tips], np.int64)
    lengths = np.array([below[k] * tip.translation for k, tip in zip(carriers, tips, strict=True)]).reshape(-1, 3)
    skeleton = Skeleton(unique_names([nodes[node].name for node in joints.nodes]), parents, offsets, carriers, lengths)
    given = {bone: index[node] for bone, node in human.items() if node in index}
    roles = roles_of(skeleton.names, parents.tolist(), given)
    poses = (
        [rest] if standing_score(skeleton, roles, rest) >= 0.9 else [rest, *_bind_pose(document, index, parents, rest)]
    )
    reference = choose_reference(skeleton, roles, poses)
    rig = Rig(
        path.name, skeleton, rest, reference, origin, given=given, nodes=joints.nodes, path=path, root_position=place,
        root_rotation=turn, root_scale=scale, notes=_texts(notes),
    )  # fmt: skip
    return _grounded(rig)


def _human_bones(document: Document, count: int) -> dict[str, int]:
    """Node of each bone that a VRM file names; empty in other files."""
    table = document.table
    extensions = document.object(table, "extensions", "extensions")
    found: dict[str, int] = {}
    new = document.object(extensions, "VRMC_vrm", "VRMC_vrm")
    bones = document.object(document.object(new, "humanoid", "humanoid"), "humanBones", "humanBones")
    for bone, row in bones.items():
        if isinstance(row, dict):
            found[bone] = document.integer(row, "node", f"humanBones.{bone}")
    old = document.object(document.object(extensions, "VRM", "VRM"), "humanoid", "humanoid")
    for row in document.rows_of(old, "humanBones", "humanBones"):
        found[document.text(row, "bone", "humanBones")] = document.integer(row, "node", "humanBones")
    if old:  # VRM 0 numbers the thumb from the first joint that moves
        for side in ("left", "right"):
            parts = [found.pop(f"{side}Thumb{part}", -1) for part in ("Proximal", "Intermediate", "Distal")]
            names = [f"{side}Thumb{part}" for part in ("Metacarpal", "Proximal", "Distal")]
            found |= {name: node for name, node in zip(names, parts, strict=True) if node >= 0}
    for bone, node in found.items():
        if node >= count:
            document.fail(f"humanBones.{bone}", f"the index of one of {count} nodes", str(node))
    return found


def _animated(document: Document, count: int) -> set[int]:
    rows = [
        channel for clip in document.rows("animations") for channel in document.rows_of(clip, "channels", "channels")
    ]
    targets = [document.object(row, "target", "target").get("node") for row in rows]
    return {node for node in targets if type(node) is int and 0 <= node < count}


def _plain(nodes: list[Node]) -> set[int]:
    """Nodes that carry no mesh or camera."""
    return {k for k, node in enumerate(nodes) if not node.bulky and (node.children or node.parent >= 0)}


def _bind_pose(document: Document, index: dict[int, int], parents: I64, rest: F64) -> list[F64]:
    """Local rotations (J, 4) in which the skin was bound, where the file has inverse bind matrices."""
    whole = np.full((len(index), 4), np.nan)
    for number, skin in enumerate(document.rows("skins")):
        if "inverseBindMatrices" not in skin:
            continue
        accessor = document.integer(skin, "inverseBindMatrices", f"skins[{number}]")
        joints = document.indices(skin, "joints", f"skins[{number}]", len(document.rows("nodes")))
        matrices = Accessors(document).array(accessor, f"skins[{number}]", "MAT4", len(document.rows("nodes")))
        for node, matrix in zip(joints, matrices.reshape(-1, 4, 4), strict=False):
            if node in index:
                pure = matrix[:3, :3].T / np.linalg.norm(matrix[:3, :3], axis=1)
                whole[index[node]] = quat.conjugate(quat.from_matrix(pure))
    if np.isnan(whole).any(axis=1).all():
        return []
    pose, done = rest.copy(), np.empty_like(rest)
    for k, parent in enumerate(parents.tolist()):
        above = done[parent] if parent >= 0 else STILL
        done[k] = whole[k] if not np.isnan(whole[k]).any() else quat.mul(above, rest[k])
        pose[k] = quat.mul(quat.conjugate(above), done[k])
    return [pose]


def _grounded(rig: Rig) -> Rig:
    """The rig with the zero of its file as the ground, where its lowest joint is a little above."""
    _, places = rig.frames
    heights = np.concatenate([places, rig.tips()])[:, 1]
    low, size = float(heights.min()), float(np.ptp(heights))
    upright = np.array_equal(rig.reference, rig.rest)
    ground = 0.0 if upright and -0.02 * size <= low <= SOLE_SHARE * size else None
    return replace(rig, ground=ground)


def _likely_unit(rig: Rig) -> str:
    """The unit in which the figure has human size; metres where that is plausible."""
    _, places = fk.forward(np.zeros(3), rig.reference, rig.skeleton.parents, rig.skeleton.offsets)
    size = float(np.ptp(places, axis=0).max())
    if 0.4 <= size <= 4.0 or size <= 0.0:
        return "m"
    return min(METRES_PER_UNIT, key=lambda unit: abs(np.log(size * METRES_PER_UNIT[unit] / TALL_M)))


def _scaled(rig: Rig, factor: float, unit: str) -> Rig:
    own = rig.skeleton
    skeleton = Skeleton(own.names, own.parents, own.offsets * factor, own.tip_parents, own.tip_offsets * factor)
    ground = None if rig.ground is None else rig.ground * factor
    return replace(rig, skeleton=skeleton, origin=rig.origin * factor, ground=ground, unit=unit, metres=factor)
