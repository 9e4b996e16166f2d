"""Mirror a motion left to right, so that joint positions are mirrored exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.clips.pairs import Pairs, find_pairs
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["KIND", "Mirrored", "find", "mend", "mirror"]

KIND = "mirror"

SIDES = np.array([-1.0, 1.0, 1.0])
"""The reflection in the plane x = 0, of positions."""

REFLECTED = np.array([1.0, -1.0, -1.0, 1.0])
"""The same reflection of rotations: M R M."""

BONE_M = 1e-4
"""Difference of paired bones from which on it is reported."""


@dataclass(frozen=True, slots=True, eq=False)
class Mirrored:
    """A mirrored motion with a report.

    Parameters
    ----------
    motion : Motion
        On the same skeleton.
    unmatched : tuple of str
        Joints that need a partner and have none; each keeps its local rotation.
    bones : tuple of (str, float)
        Joints whose bone differs from its partner's, and by how much, metres: positions below are off by that.
    """

    motion: Motion
    unmatched: tuple[str, ...]
    bones: tuple[tuple[str, float], ...]


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """Nothing: whether a clip should be mirrored is the author's decision."""
    del motion, joints
    return []


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Mirror a clip; pairs are those of the names.

    Raises
    ------
    OutOfRange
        Paired joints do not hang on paired parents.
    """
    done = mirror(motion)
    worst = max((length for _, length in done.bones), default=0.0)
    more = f"; joints without a partner: {', '.join(done.unmatched)}" if done.unmatched else ""
    bones = f"; paired bones differ by up to {1000.0 * worst:.1f} mm" if worst else ""
    return done.motion, [Report(wanted, "a mirrored clip is requested", f"mirrored{bones}{more}", 1000.0 * worst, "mm")]


def mirror(motion: Motion, table: Mapping[str, str] | None = None) -> Mirrored:
    """Mirror a motion in the plane x = 0, with left and right joints exchanged.

    The global rotation of a joint is the mirrored one of its partner, times a constant rotation that takes the joint's
    bones in the rest pose to the mirrored bones of its partner. That rotation is the identity where the skeleton's
    rest pose is symmetric. Mirroring twice gives the motion again.

    Parameters
    ----------
    motion : Motion
    table : mapping of str to str, optional
        Pairs of joints whose names do not show that they are one.

    Raises
    ------
    UnknownName, OutOfRange
        As :func:`verbs.clips.pairs.find_pairs`.
    """
    skeleton = motion.skeleton
    pairs = find_pairs(skeleton, table)
    rest = _corrections(skeleton, pairs)
    whole, _ = fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)
    whole = quat.mul(whole[:, pairs.partner] * REFLECTED, rest)
    local = whole.copy()
    local[:, 1:] = quat.mul(quat.conjugate(whole[:, skeleton.parents[1:]]), whole[:, 1:])
    loose = [skeleton.index(name) for name in pairs.unmatched]
    local[:, loose] = motion.rotations[:, loose]
    mirrored = Motion(skeleton, motion.fps, motion.root * SIDES, quat.normalize(local))
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    apart = np.abs(lengths - lengths[pairs.partner])
    bones = tuple((skeleton.names[joint], float(apart[joint])) for joint in np.flatnonzero(apart > BONE_M))
    return Mirrored(mirrored, pairs.unmatched, bones)


def _corrections(skeleton: Skeleton, pairs: Pairs) -> F64:
    """Rotations (J, 4) that take each joint's bones at rest to the mirrored bones of its partner."""
    out = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton), 1))
    for joint in range(len(skeleton)):
        mate = int(pairs.partner[joint])
        if mate < joint:  # the inverse, seen in the mirror: mirroring twice is the identity
            out[joint] = quat.conjugate(out[mate]) * REFLECTED
            continue
        start = out[skeleton.parents[joint]] if joint else out[0]
        own, other = _bones(skeleton, pairs, joint, mate)
        out[joint] = quat.normalize(_aligned(start, own, other * SIDES))
    return out


def _bones(skeleton: Skeleton, pairs: Pairs, joint: int, mate: int) -> tuple[F64, F64]:
    """Bones (B, 3) that a joint carries, children and tips, and those of its partner in the same order."""
    children = np.flatnonzero((skeleton.parents == joint) & (skeleton.parents[pairs.partner] == mate))
    own, other = skeleton.offsets[children], skeleton.offsets[pairs.partner[children]]
    tips = skeleton.tip_offsets[skeleton.tip_parents == joint]
    mates = skeleton.tip_offsets[skeleton.tip_parents == mate]
    if len(tips) == len(mates) and (mate != joint or len(tips) == 1):
        own, other = np.concatenate([own, tips]), np.concatenate([other, mates])
    long = (np.linalg.norm(own, axis=1) > 1e-9) & (np.linalg.norm(other, axis=1) > 1e-9)
    return own[long], other[long]


def _aligned(start: F64, own: F64, other: F64) -> F64:
    """The rotation (4,) nearest to ``start`` that takes directions of ``own`` (B, 3) to those of ``other`` best."""
    if not len(own):
        return start
    own = own / np.linalg.norm(own, axis=1, keepdims=True)
    other = other / np.linalg.norm(other, axis=1, keepdims=True)
    if np.linalg.matrix_rank(own, tol=1e-3) == 1:
        return quat.mul(quat.arc(quat.rotate(start, own[0]), other[0]), start)
    left, _, right = np.linalg.svd(other.T @ own)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return _of_matrix(left @ flip @ right)


def _of_matrix(matrix: F64) -> F64:
    """Unit quaternion (4,) of a rotation matrix (3, 3): the eigenvector of its largest eigenvalue."""
    m = matrix
    table = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    found: F64 = np.linalg.eigh(table)[1][:, -1]
    return found if found[3] >= 0 else -found
