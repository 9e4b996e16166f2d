"""Limbs that inverse kinematics moves: feet that both skeletons have, and hinges of knees and elbows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import quat
from verbs.kernels.mapped_limbs import Driven, Soles
from verbs.mapping.alignment import UPRIGHT, flat_pitch, ground, level, sole_thickness, up_of
from verbs.mapping.plan import Row
from verbs.mapping.rig import Rig
from verbs.mapping.source import Source

__all__ = ["driven_chain", "hinge_of", "limb_of", "soles_of"]

LEAST_BONE = 1e-6
"""Length of a bone that has one, in lengths of the target's legs."""


def driven_chain(driven: Driven, k: int) -> list[int]:
    """Driven joints from the pelvis to one, both included."""
    chain = []
    while k >= 0:
        chain.append(k)
        k = int(driven.parents[k])
    return chain[::-1]


def limb_of(rows: list[Row], driven: Driven, joints: list[int]) -> list[int] | None:
    """Driven joints of three source joints in a row, each the parent of the next; None where they are not.

    Also None where a bone between them has no length: such a limb cannot bend.
    """
    found = []
    for joint in joints:
        mapped = [
            k for k, row in enumerate(rows) if row.share == 0.0 and row.first == joint and row.bone not in UPRIGHT
        ]
        if not mapped:
            return None
        found.append(mapped[0])
    linked = all(driven.parents[b] == a for a, b in pairwise(found)) and driven.parents[found[0]] >= 0
    shortest = float(np.linalg.norm(driven.offsets[found[1:]], axis=1).min())
    return found if linked and shortest > LEAST_BONE * driven.leg else None


def hinge_of(source: Source, driven: Driven, joints: list[int], upper: int) -> F64:
    """Axis (3,) about which the target's limb bends, in the frame of its upper joint."""
    axis = quat.rotate(source.rig.frames[0][joints[0]], source.hinge(*joints))
    return np.asarray(quat.rotate(quat.conjugate(driven.standing[upper]), axis))


def soles_of(
    source: Source, target: Rig, rows: list[Row], driven: Driven, base: F64, size: float, *, use: bool
) -> Soles:
    """Feet that both have."""
    found = []
    feet = source.feet
    for f, (hip, knee, ankle, toe) in enumerate(feet.joints.tolist() if use else []):
        limb = limb_of(rows, driven, [hip, knee, ankle])
        if limb is None:
            continue
        toes = [k for k, row in enumerate(rows) if row.first == toe >= 0 and driven.parents[k] == limb[2]]
        own, levels, known = _own_points(source, target, rows, f, limb[2], toes[0] if toes else -1, base, size)
        chain = [*driven_chain(driven, limb[2]), toes[0] if toes else -1]
        found.append((f, own, levels, known, chain, hinge_of(source, driven, [hip, knee, ankle], limb[0])))
    chosen = [row[0] for row in found]
    longest = max((len(row[4]) for row in found), default=4)
    chains = np.array([[-1] * (longest - len(row[4])) + row[4] for row in found], np.int64).reshape(-1, longest)
    joints = np.ascontiguousarray(feet.joints[chosen], np.int64).reshape(-1, 4)
    return Soles(
        joints, np.ascontiguousarray(feet.points[chosen]).reshape(-1, 3, 3),
        np.array([row[1] for row in found]).reshape(-1, 3, 3),
        np.array([row[3] for row in found], np.int64).reshape(-1, 3),
        np.ascontiguousarray(feet.levels[chosen]).reshape(-1, 3), np.array([row[2] for row in found]).reshape(-1, 3),
        chains, np.array([row[5] for row in found]).reshape(-1, 3),
    )  # fmt: skip


def _own_points(
    source: Source, target: Rig, rows: list[Row], f: int, ankle: int, toe: int, base: F64, size: float
) -> tuple[F64, F64, I64]:
    """Heel, ball and tip (3, 3) of the target's foot, their standing heights (3,), and which of them count (3,).

    The ball is the toe joint. The heel and the tip of the toes, and the ball of a foot without toes, are those of the
    source at its scaled height above the ground of the target, enlarged as its foot is.
    """
    feet, up = source.feet, up_of(target)
    whole, places = target.frames
    floor = ground(target, sole_thickness(source, target))
    mine, known = rows[ankle].target, feet.known[f].astype(np.int64)
    flat = flat_pitch(source, int(feet.joints[f, 2]), up_of(source.rig))
    side = quat.mul(quat.conjugate(base), flat)
    points = quat.rotate(side, quat.rotate(source.rig.frames[0][feet.joints[f, 2]], feet.points[f]))
    factor = size
    if toe >= 0:
        span = float(np.linalg.norm(level(places[rows[toe].target] - places[mine], up)))
        factor = span / max(float(np.linalg.norm(level(points[1], up))), 1e-6) if span > 1e-6 else size
    out, levels = np.zeros((3, 3)), np.zeros(3)
    for p in range(3):
        carrier = rows[toe].target if p == 2 and toe >= 0 else mine
        if p == 1 and toe >= 0:
            at = places[rows[toe].target]
        else:
            start = places[rows[toe].target] if p == 2 and toe >= 0 else places[mine]
            at = start + factor * level(_foot_vector(source, f, p, side), up)
            at = at + up * (floor + size * float(feet.levels[f, p]) - float(at @ up))
        tips = target.skeleton.tip_offsets[target.skeleton.tip_parents == carrier]
        if p == 2 and toe >= 0 and len(tips):
            at = places[carrier] + quat.rotate(whole[carrier], tips[np.argmax(np.linalg.norm(tips, axis=1))])
        levels[p] = float(at @ up) - floor
        out[p] = quat.rotate(quat.conjugate(whole[carrier]), at - places[carrier])
    return out, levels, known


def _foot_vector(source: Source, f: int, p: int, side: F64) -> F64:
    """From the joint that carries a point of the source's foot to it, in directions of the target's standing pose."""
    joint = source.feet.joints[f, 3] if p == 2 and source.feet.joints[f, 3] >= 0 else source.feet.joints[f, 2]
    return np.asarray(quat.rotate(side, quat.rotate(source.rig.frames[0][joint], source.feet.points[f, p])))
