"""Self-intersection: how deep limbs and trunk enter each other, as capsules.

Radii are shares of the bones' lengths. For standard names they are those of :data:`SHARES`, a rough fit to an adult
body; bones of any other skeleton have a radius of :data:`OTHER_SHARE` of their length. Parts that meet at a joint are
never compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import capsules as kernels
from verbs.kernels import quat
from verbs.kernels.compile import direct
from verbs.quality.humanoid import SIDES, Humanoid
from verbs.quality.samples import Sample
from verbs.skeleton import Skeleton

__all__ = ["OTHER_SHARE", "SHARES", "Capsules"]

SHARES = {"trunk": 0.20, "head": 0.40, "upper arm": 0.15, "forearm": 0.14, "hand": 0.20, "thigh": 0.16, "shin": 0.12,
          "foot": 0.20}  # fmt: skip
"""Radius of each part as a share of the length of its bone; of the trunk, of the distance from the hips to the neck
along the spine."""

OTHER_SHARE, SHORTEST_SHARE = 0.12, 0.1
"""Radius of a bone without a standard name, as a share of its length; bones shorter than the second share of the
longest are left out."""

_LIMBS = (("upper arm", "arm", "forearm"), ("forearm", "forearm", "hand"), ("thigh", "upleg", "leg"),
          ("shin", "leg", "foot"))  # fmt: skip

_MEET = {("trunk", "head"), ("trunk", "upper arm"), ("trunk", "thigh"), ("upper arm", "forearm"), ("forearm", "hand"),
         ("thigh", "shin"), ("shin", "foot")}  # fmt: skip

_depths = direct(kernels.depths)


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """Capsules of a skeleton, and the pairs that are compared.

    Parameters
    ----------
    names : tuple of str, length C
        Part that each capsule belongs to, with its side.
    joints : (C,) int64
        Joint at which each begins.
    offsets : (C, 3) float64
        Its end in the frame of that joint, metres.
    radii : (C,) float64
    pairs : (P, 2) int64
    """

    names: tuple[str, ...]
    joints: I64
    offsets: F64
    radii: F64
    pairs: I64

    @classmethod
    def of_skeleton(cls, skeleton: Skeleton) -> Capsules | None:
        """Capsules of a skeleton; None where no two of them are apart."""
        human = Humanoid.of_skeleton(skeleton)
        found = _other(skeleton) if human is None else _humanoid(human)
        return found if len(found.pairs) else None

    def depths(self, one: Sample) -> F64:
        """Deepest overlap (A,) in each frame that counts, metres; negative is a gap."""
        turned, positions = one.global_rotations[one.counted], one.positions[one.counted]
        starts = positions[:, self.joints]
        ends = np.stack([starts, starts + quat.rotate(turned[:, self.joints], self.offsets)], axis=2)
        out = np.empty(len(ends))
        _depths(np.ascontiguousarray(ends), self.radii, self.pairs, out)
        return out


def _humanoid(human: Humanoid) -> Capsules:
    """Trunk, head, arms and legs."""
    offsets, joints = human.skeleton.offsets, human.joints
    spine = human.trunk()
    length = float(np.linalg.norm(offsets[spine[1:]], axis=1).sum())
    rows = [("trunk", "", joint, offsets[child], SHARES["trunk"] * length)
            for joint, child in pairwise(spine)]  # fmt: skip
    top = human.tip(joints["head"])
    if top is not None:
        rows.append(("head", "", joints["head"], top, SHARES["head"] * float(np.linalg.norm(top))))
    for side in SIDES:
        bones = [(part, joints[side + start], offsets[joints[side + end]]) for part, start, end in _LIMBS]
        for part in ("hand", "foot"):
            end = human.tip(joints[side + part])
            bones += [] if end is None else [(part, joints[side + part], end)]
        rows += [(part, side, joint, end, SHARES[part] * float(np.linalg.norm(end))) for part, joint, end in bones]
    pairs = [
        (a, b)
        for a, b in combinations(range(len(rows)), 2)
        if not _meet(rows[a][0], rows[b][0], same_side=rows[a][1] == rows[b][1])
    ]
    return _assembled(rows, pairs)


def _meet(one: str, other: str, *, same_side: bool) -> bool:
    """Whether two parts are one or meet at a joint."""
    if one == other:
        return same_side
    return (same_side or "trunk" in (one, other)) and bool({(one, other), (other, one)} & _MEET)


def _other(skeleton: Skeleton) -> Capsules:
    """All bones that are not much shorter than the longest."""
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    lengths[0] = 0.0
    bones = np.flatnonzero(lengths >= max(SHORTEST_SHARE * lengths.max(), 1e-9))
    rows = [(skeleton.names[b], "", int(skeleton.parents[b]), skeleton.offsets[b], OTHER_SHARE * lengths[b])
            for b in bones]  # fmt: skip
    place = list(range(len(skeleton)))  # joints between which no capsule lies have one place
    for joint in range(1, len(place)):
        place[joint] = joint if joint in bones else place[int(skeleton.parents[joint])]
    ends = [{place[b], place[int(skeleton.parents[b])]} for b in bones]
    pairs = [(a, b) for a, b in combinations(range(len(rows)), 2) if not ends[a] & ends[b]]
    return _assembled(rows, pairs)


def _assembled(rows: list[tuple[str, str, int, F64, float]], pairs: list[tuple[int, int]]) -> Capsules:
    names = tuple(f"{side} {part}".strip() for part, side, *_ in rows)
    joints = np.array([row[2] for row in rows], np.int64)
    offsets = np.array([row[3] for row in rows]).reshape(-1, 3)
    radii = np.array([float(row[4]) for row in rows])
    return Capsules(names, joints, offsets, radii, np.array(pairs, np.int64).reshape(-1, 2))
