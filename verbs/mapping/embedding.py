"""A motion added to the file of its target: the character itself performs, with its mesh and materials.

Source: Khronos, "glTF 2.0 Specification".
"""

from __future__ import annotations

import copy
from collections.abc import Mapping as Table
from typing import Any

import numpy as np

from verbs.io.glb import GlbBuilder
from verbs.io.gltf_document import Document, Row, open_document
from verbs.io.gltf_writer import add_animation
from verbs.kernels import quat
from verbs.mapping.rig import Rig
from verbs.motion import Motion

__all__ = ["embeddable", "embedded"]


def embeddable(rig: Rig) -> bool:
    """Whether the target is of a binary glTF file that can be written again: it holds its images and plain buffers."""
    if rig.path is None or not rig.nodes or rig.path.suffix.lower() not in (".glb", ".vrm"):
        return False
    document = open_document(rig.path)
    uris = [document.text(row, "uri", "images") for row in document.rows("images")]
    if any(uri and not uri.startswith("data:") for uri in uris):
        return False
    return _has_one_buffer(document) or not any("extensions" in row for row in document.rows("bufferViews"))


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
    builder = GlbBuilder.of(*_in_one_buffer(document))
    back = quat.conjugate(rig.root_rotation)
    root = quat.rotate(back, motion.root / rig.metres - rig.root_position) / rig.root_scale
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(back, rotations[:, 0])
    index = add_animation(builder, name, motion.fps, root, rotations, rig.nodes)
    clips = builder.table["animations"]
    clips[index]["extras"] = {**(extras or {}), "fps": motion.fps}
    builder.table["animations"] = [clips[index], *clips[:index]]
    for node in rig.nodes:
        _decompose(builder.table["nodes"][node])
    return builder.content()


def _has_one_buffer(document: Document) -> bool:
    """Whether the binary chunk is the only buffer."""
    buffers = document.rows("buffers")
    return len(buffers) == 0 or (len(buffers) == 1 and "uri" not in buffers[0])


def _in_one_buffer(document: Document) -> tuple[Row, bytes | None]:
    """A copy of the JSON of a document, and all its buffers in one."""
    table = copy.deepcopy(document.table)
    if _has_one_buffer(document):
        return table, document.binary
    content, starts = bytearray(), []
    for number in range(len(document.rows("buffers"))):
        content += bytes(-len(content) % 8)  # any component keeps its alignment
        starts.append(len(content))
        content += document.buffer(number, "buffers")
    for number, row in enumerate(table.get("bufferViews", [])):
        buffer = document.integer(row, "buffer", f"bufferViews[{number}]")
        row |= {"buffer": 0, "byteOffset": row.get("byteOffset", 0) + starts[buffer]}
    return table, bytes(content)


def _decompose(row: Row) -> None:
    """Replace the matrix of a node by its translation, rotation and scale: only these can be animated."""
    matrix = row.pop("matrix", None)
    if matrix is None:
        return
    columns = np.array(matrix, np.float64).reshape(4, 4)
    scale = np.linalg.norm(columns[:3, :3], axis=1)
    row["translation"] = columns[3, :3].tolist()
    row["rotation"] = quat.from_matrix(columns[:3, :3].T / scale).tolist()
    row["scale"] = scale.tolist()
