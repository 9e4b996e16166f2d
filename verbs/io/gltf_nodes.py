"""The node hierarchy of a glTF file, and the nodes of it that are the joints of a skeleton."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, MAX_JOINTS
from verbs.errors import MotionFileError
from verbs.io.gltf_document import Document, Row, shown
from verbs.io.report import Note
from verbs.kernels import quat

__all__ = ["Joints", "Node", "choose_joints", "depth_first", "read_nodes"]

_BULKY = ("mesh", "camera", "skin")
_SHEAR = 1e-4
_STILL = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(slots=True)
class Node:
    """One node: its transform as translation (3,), rotation (4,) and scale (3,); children; -1 for no parent.

    ``problem`` is the error of a transform that no joint can have; props and hidden meshes may.
    """

    name: str
    translation: F64
    rotation: F64
    scale: F64
    children: list[int]
    bulky: bool
    parent: int = -1
    problem: MotionFileError | None = None


@dataclass(frozen=True, slots=True)
class Joints:
    """Nodes that are joints, in depth-first order; the first ``above`` of them only carry the body.

    ``fixed`` are the nodes above the first joint, outermost first; ``tips`` are nodes without rotation of their own.
    """

    nodes: tuple[int, ...]
    above: int
    fixed: tuple[int, ...]
    tips: tuple[int, ...]
    notes: tuple[Note, ...]


def read_nodes(document: Document) -> list[Node]:
    """All nodes, checked to be trees.

    Raises
    ------
    MotionFileError
        A node has two parents, or is below itself.
    """
    rows = document.rows("nodes")
    nodes = [_node(document, row, f"nodes[{index}]", len(rows)) for index, row in enumerate(rows)]
    for index, node in enumerate(nodes):
        for child in node.children:
            if nodes[child].parent >= 0 or child == index:
                document.fail(f"nodes[{child}]", "one parent", f"nodes {nodes[child].parent} and {index}")
            nodes[child].parent = index
    reached = _forest(nodes)
    if len(reached) < len(nodes):
        index = min(set(range(len(nodes))) - set(reached))
        document.fail(f"nodes[{index}]", "a tree", "a node that is below itself")
    return nodes


def _node(document: Document, row: Row, place: str, count: int) -> Node:
    translation = np.array(document.numbers(row, "translation", place, (0.0, 0.0, 0.0)))
    rotation = np.array(document.numbers(row, "rotation", place, (0.0, 0.0, 0.0, 1.0)))
    scale = np.array(document.numbers(row, "scale", place, (1.0, 1.0, 1.0)))
    problem = None
    if "matrix" in row:
        columns = np.array(document.numbers(row, "matrix", place, tuple(np.eye(4).ravel()))).reshape(4, 4)
        translation, matrix = columns[3, :3], columns[:3, :3].T
        scale = np.linalg.norm(matrix, axis=0)
        problem = _matrix_problem(document, matrix, scale, place)
        rotation = _STILL if problem else quat.from_matrix(matrix / scale)
    problem = problem or _transform_problem(document, translation, rotation, scale, place)
    if problem:
        translation, rotation, scale = np.zeros(3), _STILL, np.ones(3)
    children = document.indices(row, "children", place, count)
    name = (" ".join(document.text(row, "name", place).split()) or place)[:200]
    unit, bulky = rotation / np.linalg.norm(rotation), any(key in row for key in _BULKY)
    return Node(name, translation, unit, scale, children, bulky, problem=problem)


def _transform_problem(
    document: Document, translation: F64, rotation: F64, scale: F64, place: str
) -> MotionFileError | None:
    """Why a joint cannot have a translation (3,), rotation (4,) and scale (3,); None where it can."""
    if not 0.5 <= float(np.linalg.norm(rotation)) <= 2.0:
        return MotionFileError(document.path, place, "a unit quaternion as rotation", shown(rotation.tolist()))
    if not np.all((scale > 1e-9) & (scale < 1e9)):
        advice = "apply the scale where the file was made, and export it again"
        return MotionFileError(document.path, place, "a positive scale", shown(scale.tolist()), advice)
    if np.abs(translation).max() > 1e9:
        return MotionFileError(document.path, place, "a translation up to 1e9", shown(translation.tolist()))
    return None


def _matrix_problem(document: Document, matrix: F64, scale: F64, place: str) -> MotionFileError | None:
    """Why a joint cannot have a matrix (3, 3) with columns of these lengths (3,); None where it can."""
    if not (scale > 1e-9).all() or np.linalg.det(matrix / scale) < 0.5:
        expected = "a matrix of rotation and positive scale"
        return MotionFileError(document.path, place, expected, shown(matrix.tolist()))
    pure = matrix / scale
    if np.abs(pure.T @ pure - np.eye(3)).max() > _SHEAR:
        advice = "apply the transform where the file was made, and export it again"
        return MotionFileError(document.path, place, "a matrix without shear", shown(matrix.tolist()), advice)
    return None


def depth_first(nodes: list[Node], root: int, within: set[int]) -> list[int]:
    """Nodes of a set from a root down, parents before children."""
    found, waiting = [], [root]
    while waiting:
        index = waiting.pop()
        found.append(index)
        waiting += [child for child in reversed(nodes[index].children) if child in within]
    return found


def choose_joints(document: Document, nodes: list[Node], animated: set[int], root: str | None) -> Joints:
    """The joints: those of the skins, or, without a skin, the animated nodes and what hangs on them.

    Of several trees of joints the one with a node ``root``, or with the most joints, counts. Animated nodes above it
    come first; fixed ones give its transform.

    Raises
    ------
    MotionFileError
        There are no joints, too many, or two trees are equally large; or a joint, a node above the joints or a tip has
        a transform that no joint can have.
    """
    skinned = _skinned(document, len(nodes))
    members = skinned or _moving(nodes, animated)
    if not members:
        document.fail("skins", "a skin, or an animation of nodes", "neither", "export the animated skeleton")
    members = _closed(nodes, members)
    tops = [index for index in sorted(members) if nodes[index].parent not in members]
    trees = {top: depth_first(nodes, top, members) for top in tops}
    named = [top for top in tops if any(nodes[index].name == root for index in trees[top])]
    among = named or tops
    top = max(among, key=lambda index: len(trees[index]))
    alike = [nodes[index].name for index in among if len(trees[index]) == len(trees[top])]
    if len(alike) > 1:
        found = f"{len(alike)} trees of {len(trees[top])} joints: {', '.join(alike[:5])}"
        advice = "name the root to read (root, in a mapping.toml [root] joint)"
        document.fail("nodes", "one tree of joints larger than the others", found, advice)
    chain = _chain(nodes, top)
    first = next((k for k, index in enumerate(chain) if index in animated), len(chain))
    joints = (*chain[first:], *trees[top])
    if len(joints) > MAX_JOINTS:
        document.fail("nodes", f"at most {MAX_JOINTS} joints", str(len(joints)))
    notes = tuple(
        Note(
            "ignored_root",
            nodes[index].name,
            f"joints from '{nodes[index].name}' down ({len(trees[index])}) are ignored; '{nodes[top].name}' is read",
            float(len(trees[index])),
        )
        for index in tops
        if index != top
    )
    result = Joints(joints, len(chain) - first, tuple(chain[:first]), _tips(nodes, trees[top]), notes)
    for index in (*result.fixed, *result.nodes, *result.tips):
        if (problem := nodes[index].problem) is not None:
            raise problem
    return result


def _skinned(document: Document, count: int) -> set[int]:
    members: set[int] = set()
    for index, skin in enumerate(document.rows("skins")):
        members.update(document.indices(skin, "joints", f"skins[{index}]", count))
    return members


def _forest(nodes: list[Node]) -> list[int]:
    """Nodes of all trees, parents before children."""
    everything = set(range(len(nodes)))
    return [k for root, node in enumerate(nodes) if node.parent < 0 for k in depth_first(nodes, root, everything)]


def _moving(nodes: list[Node], animated: set[int]) -> set[int]:
    """Animated nodes and all below them, but for meshes and cameras that stay at the end of a branch."""
    below: set[int] = set()
    for index in _forest(nodes):
        if index in animated or nodes[index].parent in below:
            below.add(index)
    return {k for k in below if k in animated or nodes[k].children or not nodes[k].bulky}


def _closed(nodes: list[Node], members: set[int]) -> set[int]:
    """Members and all nodes between two of them on one branch."""
    order = _forest(nodes)
    under: set[int] = set()
    over: set[int] = set()
    for index in order:
        if index in members or nodes[index].parent in under:
            under.add(index)
    for index in reversed(order):
        if index in members or index in over:
            over.update({index, nodes[index].parent} - {-1})
    return under & over


def _chain(nodes: list[Node], index: int) -> list[int]:
    """Nodes above one, the outermost first."""
    chain = []
    while (index := nodes[index].parent) >= 0:
        chain.append(index)
    return chain[::-1]


def _tips(nodes: list[Node], joints: list[int]) -> tuple[int, ...]:
    """Plain nodes that end a branch: they hang on a joint without children that are joints."""
    members = set(joints)
    ends = [index for index in joints if not members & set(nodes[index].children)]
    return tuple(
        child
        for index in ends
        for child in nodes[index].children
        if not nodes[child].bulky and not nodes[child].children
    )
