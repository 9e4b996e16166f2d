"""Constant scales of glTF nodes, as one rule for motions and for skeletons at rest.

A scale along one axis reaches the joints that hang on its node directly; further down it counts as its geometric mean.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from verbs.conventions import F64
from verbs.io.gltf_nodes import Node
from verbs.io.report import Note
from verbs.kernels import quat

__all__ = ["SCALED", "fixed_transform", "inherited_scale", "node_scale"]

SCALED = 1e-3
"""Scales that differ by less from 1, or over time, are rounding."""


def node_scale(node: Node, scale: F64, notes: list[Note]) -> F64:
    """Scale (3,) of a node without rounding; one that differs between axes is noted."""
    if np.abs(scale - 1.0).max() <= SCALED:
        return np.ones(3)
    if np.ptp(scale) > SCALED * scale.max():
        text = (
            f"joint '{node.name}' has another scale along each axis, {np.round(scale, 4).tolist()}; joints below move"
        )
        notes.append(Note("scale", node.name, text))
    return scale


def inherited_scale(reached: F64, own: F64) -> F64:
    """Scale (3,) of what hangs on a node, from the scale (3,) that reaches the node and its own (3,)."""
    return np.asarray(np.cbrt(reached.prod()) * own)


def fixed_transform(
    nodes: list[Node], above: tuple[int, ...], scales: Mapping[int, F64], notes: list[Note]
) -> tuple[F64, F64, F64]:
    """Translation (3,), rotation (4,) and scale (3,) of the fixed nodes above the joints."""
    place, turn, scale = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.ones(3)
    for node in above:
        place = place + quat.rotate(turn, scale * nodes[node].translation)
        turn = quat.mul(turn, nodes[node].rotation)
        scale = inherited_scale(scale, scales[node])
    angle = float(np.degrees(np.linalg.norm(quat.log(turn))))
    if angle > 0.01 or np.abs(place).max() > 1e-6 or np.abs(scale - 1.0).max() > SCALED:
        names = ", ".join(f"'{nodes[node].name}'" for node in above)
        size = f", scale {np.cbrt(scale.prod()):.4g}" if np.abs(scale - 1.0).max() > SCALED else ""
        notes.append(Note("applied", names, f"the transform of {names} is applied: rotation {angle:.4g}°{size}"))
    return place, turn, scale
