"""Arrays of a mapping for :mod:`verbs.kernels.mapped_pose`: driven joints, scale, soles, and the effector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import quat
from verbs.kernels.mapped_limbs import ARM, CHAIN, LEG, NO_EFFECTOR, Driven, Reach, Soles
from verbs.mapping.alignment import alignment, driven_above, leg_height, leg_ratio
from verbs.mapping.mapping import Mapping
from verbs.mapping.plan import Row, plan
from verbs.mapping.rig import STILL, Rig
from verbs.mapping.soles import driven_chain, hinge_of, limb_of, soles_of
from verbs.mapping.source import Source

__all__ = ["Tables", "tables"]


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """A mapping, prepared.

    Parameters
    ----------
    rows : list of Row
        Driven joints in the order of the tables.
    driven, soles, reach
        Arrays for the kernel.
    scale : float
        Lengths of the target per length of the source.
    """

    rows: list[Row]
    driven: Driven
    soles: Soles
    reach: Reach
    scale: float


def tables(source: Source, mapping: Mapping) -> Tables:
    """Prepare a mapping.

    Raises
    ------
    RequestError, UnknownName
        See :func:`verbs.mapping.plan.plan`.
    """
    target = mapping.rig
    rows = _rooted(target, plan(source.rig, mapping))
    whole, _ = target.frames
    turns = alignment(source, target, rows)
    base = turns[-1]
    standing = quat.mul(turns[:-1], whole[[row.target for row in rows]])
    index = {row.target: k for k, row in enumerate(rows)}
    parents = np.array([driven_above(target, index, row.target) for row in rows], np.int64)
    before, offsets, root, rest = _links(target, rows, parents, base)
    size = mapping.scale or leg_ratio(source, target)
    travel = mapping.travel or size
    body = np.array([travel, size, travel])
    hips, middle = _hips(source, target, rows)
    driven = Driven(
        np.array([row.first for row in rows], np.int64), np.array([row.second for row in rows], np.int64),
        np.array([row.share for row in rows]), quat.conjugate(source.rig.frames[0]), standing, parents, offsets, before,
        np.array([row.target for row in rows], np.int64), rest, root, hips, middle, body,
        body if mapping.goal == "scaled" else np.ones(3), np.asarray(source.center, np.float64), leg_height(target),
    )  # fmt: skip
    soles = soles_of(source, target, rows, driven, base, size, use=mapping.feet)
    return Tables(rows, driven, soles, _reach(source, rows, driven, soles, size), size)


def _rooted(target: Rig, rows: list[Row]) -> list[Row]:
    """Rows with a driven joint above all others: the first of them, or what is above two of them."""
    chains = [target.skeleton.chain(row.target).tolist() for row in rows]
    shared = [joint for joint in chains[0] if all(joint in chain for chain in chains)]
    top = max((joint for joint in shared), default=0)
    driven = {row.target for row in rows}
    above = [joint for joint in shared if joint in driven]
    if above and above[0] == rows[0].target:
        return rows
    return sorted([Row(top, 0, 0, 0.0, ""), *rows], key=lambda row: row.target)


def _links(target: Rig, rows: list[Row], parents: I64, base: F64) -> tuple[F64, F64, F64, F64]:
    """What lies between driven joints (K, 4), their offsets (K, 3), the root's (3,), and rest rotations (J, 4)."""
    skeleton = target.skeleton
    rest = target.rest.copy()
    top = skeleton.chain(rows[0].target)
    rest[top] = target.reference[top]
    rest[0] = quat.mul(base, target.reference[0])
    before, offsets, root = np.tile(STILL, (len(rows), 1)), np.zeros((len(rows), 3)), np.zeros(3)
    for k, row in enumerate(rows):
        stop = rows[parents[k]].target if parents[k] >= 0 else -1
        between = [joint for joint in skeleton.chain(row.target).tolist() if joint > stop][:-1]
        between = [joint for joint in between if stop < 0 or stop in skeleton.chain(joint)]
        turn, place = STILL, np.zeros(3)
        for joint in between:
            place = place + quat.rotate(turn, skeleton.offsets[joint] if joint else np.zeros(3))
            turn = quat.mul(turn, rest[joint])
        place = place + quat.rotate(turn, skeleton.offsets[row.target] if row.target else np.zeros(3))
        before[k] = quat.conjugate(turn)
        if parents[k] >= 0:
            offsets[k] = place
        else:
            root = place
    return before, offsets, root, rest


def _hips(source: Source, target: Rig, rows: list[Row]) -> tuple[I64, F64]:
    """Source joints whose middle is that of the hips, and that of the target in the pelvis's frame (3,)."""
    names = ("leftUpperLeg", "rightUpperLeg")
    pelvis = rows[0].target
    if not all(name in source.roles.bones and name in target.roles.bones for name in names):
        first = rows[0].first
        return np.array([first, first], np.int64), np.zeros(3)
    hips = np.array([source.roles.bones[name] for name in names], np.int64)
    places = target.frames[1]
    middle = np.mean([places[target.roles.bones[name]] for name in names], axis=0) - places[pelvis]
    return hips, np.asarray(quat.rotate(quat.conjugate(target.frames[0][pelvis]), middle))


def _reach(source: Source, rows: list[Row], driven: Driven, soles: Soles, size: float) -> Reach:
    """The effector: which limb carries it, and where it lies there."""
    spine = np.array([k for k, row in enumerate(rows) if row.bone == "spine"], np.int64)
    nothing = Reach(NO_EFFECTOR, 0, np.zeros(3, np.int64), 0, np.zeros(3), 0, np.zeros(0, np.int64), np.zeros(3), spine)
    found = None if source.effector is None else _carrier(source, rows, driven, source.effector.joint, size)
    if source.effector is None or found is None:
        return nothing
    joint = source.effector.joint
    carrier, nearest, offset = found
    for f in range(len(soles.joints)):
        if nearest in soles.joints[f, 2:].tolist():
            return nothing._replace(kind=LEG, source=joint, joint=carrier, offset=offset, foot=f)
    arm = _arm(source, rows, driven, source.rig.skeleton.chain(joint).tolist())
    if arm is not None:
        bones, limb = arm
        chain = np.array([*driven_chain(driven, limb[2]), -1], np.int64)
        hinge = hinge_of(source, driven, bones, limb[0])
        own = np.array([k for k in spine if k in chain], np.int64)
        return Reach(ARM, joint, np.array(bones, np.int64), carrier, offset, 0, chain, hinge, own)
    links = driven_chain(driven, carrier)
    if not offset.any():  # the joint is the end of the chain: those above it rotate
        offset, links = driven.offsets[carrier], links[:-1]
    if not links:
        return nothing
    return nothing._replace(
        kind=CHAIN, source=joint, joint=links[-1], offset=np.ascontiguousarray(offset), chain=np.array(links, np.int64)
    )


def _carrier(source: Source, rows: list[Row], driven: Driven, joint: int, size: float) -> tuple[int, int, F64] | None:
    """Driven joint that carries a joint of the source, the source's joint of it, and the place (3,) in its frame."""
    chain = source.rig.skeleton.chain(joint).tolist()
    carried = [
        (n, k) for n, each in enumerate(chain) for k, row in enumerate(rows) if row.first == each and row.share == 0.0
    ]
    if not carried:
        return None
    at, carrier = max(carried)
    offset = np.zeros(3)
    if chain[at] != joint:  # a part of the source that the target lacks
        places = source.rig.frames[1]
        back = quat.conjugate(driven.standing[carrier])
        offset = np.asarray(size * quat.rotate(back, places[joint] - places[chain[at]]))
    return carrier, chain[at], offset


def _arm(source: Source, rows: list[Row], driven: Driven, chain: list[int]) -> tuple[list[int], list[int]] | None:
    """Shoulder, elbow and wrist of the source, and the driven joints, of the arm whose hand is in a chain."""
    for side in ("left", "right"):
        bones = [source.roles.bones.get(f"{side}{part}", -1) for part in ("UpperArm", "LowerArm", "Hand")]
        limb = limb_of(rows, driven, bones) if min(bones) >= 0 and bones[2] in chain else None
        if limb is not None:
            return bones, limb
    return None
