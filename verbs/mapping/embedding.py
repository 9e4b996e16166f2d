"""A motion added to the file of its target: the character itself performs, with its mesh and materials.

Source: Khronos, "glTF 2.0 Specification".
"""

from __future__ import annotations

import copy
from collections.abc import Mapping as Table
from typing import Any

import numpy as np

from verbs.io.glb import GlbBuilder
from verbs.io.gltf_document import open_document
from verbs.io.gltf_writer import add_animation
from verbs.kernels import quat
from verbs.mapping.rig import Rig
from verbs.motion import Motion

__all__ = ["embeddable", "embedded"]


def embeddable(rig: Rig) -> bool:
    """Whether the target is of a binary glTF file that still exists."""
    return rig.path is not None and bool(rig.nodes) and rig.path.suffix.lower() in (".glb", ".vrm")


def embedded(rig: Rig, motion: Motion, *, name: str = "motion", extras: Table[str, Any] | None = None) -> bytes:
    """Bytes of the target's file with a motion as its first animation.

    Parameters
    ----------
    rig : Rig
        Of a file; see :func:`embeddable`.
    motion : Motion
        On the target's skeleton.
    name : str
        Name of the animation.
    extras : mapping, optional
        JSON values for ``extras`` of the animation; the rate is added as ``fps``.

    Raises
    ------
    MotionFileError
        The file is invalid by now.
    """
    assert rig.path is not None
    document = open_document(rig.path)
    builder = GlbBuilder.of(copy.deepcopy(document.table), document.binary)
    back = quat.conjugate(rig.turn)
    root = quat.rotate(back, motion.root / rig.metres - rig.place) / rig.size
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(back, rotations[:, 0])
    index = add_animation(builder, name, motion.fps, root, rotations, rig.nodes)
    clips = builder.table["animations"]
    clips[index]["extras"] = {**(extras or {}), "fps": motion.fps}
    builder.table["animations"] = [clips[index], *clips[:index]]
    for node in rig.nodes:
        _decompose(builder.table["nodes"][node])
    return builder.content()


def _decompose(row: dict[str, Any]) -> None:
    """Replace the matrix of a node by its translation, rotation and scale: only these can be animated."""
    matrix = row.pop("matrix", None)
    if matrix is None:
        return
    columns = np.array(matrix, np.float64).reshape(4, 4)
    scale = np.linalg.norm(columns[:3, :3], axis=1)
    row["translation"] = columns[3, :3].tolist()
    row["rotation"] = quat.from_matrix(columns[:3, :3].T / scale).tolist()
    row["scale"] = scale.tolist()
