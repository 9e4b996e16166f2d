"""Find the feet of a skeleton, and the points at which they touch the ground.

Feet are the ends of the limbs that are lowest in the examples and hang below the root. Names narrow the choice where
they are known; skeletons with other names are judged by geometry alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from verbs.contacts import PARTS
from verbs.conventions import F64, I64
from verbs.kernels import quat
from verbs.skeleton import Skeleton

__all__ = ["BALL", "FOOT", "HEEL", "TOE", "Point", "feet", "leg_length", "point_positions"]

HEEL, BALL, TOE, FOOT = range(len(PARTS))
"""Indices of :data:`verbs.contacts.PARTS`."""

_FOOT = re.compile(r"foot|ankle|toe|hoof|paw(?!n)|hock|heel", re.IGNORECASE)
_TOE = re.compile(r"toe|ball|digit|phalan", re.IGNORECASE)
_NO_FOOT = re.compile(r"hand|finger|thumb|wrist|arm(?!ature)|elbow|head|tail|wing|tentacle", re.IGNORECASE)

LOWEST_SHARE, LOWEST_BAND = 0.15, 0.12
"""A foot is among the lowest ends in this share of the frames, within this share of the skeleton's height."""

HANGING = 0.3
"""A foot is below the root by this share of the length of its limb, in half of the frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A point of a foot: the foot's joint, the part, the joint that carries it and its offset (3,) there, metres."""

    foot: int
    part: int
    joint: int
    offset: F64


def feet(skeleton: Skeleton, rotations: F64, positions: F64) -> list[list[Point]]:
    """Points of every foot without its heel: the ball and the tip of the toes, or one point without a toe joint.

    Parameters
    ----------
    skeleton : Skeleton
    rotations : (F, J, 4) float64
        Global rotations of frames of all examples.
    positions : (F, J, 3) float64

    Returns
    -------
    feet : list of list of Point
        In the order of their joints; empty in a skeleton without feet.
    """
    leaves = [joint for joint in range(len(skeleton)) if joint not in set(skeleton.parents.tolist())]
    ends = [(joint, _tip(skeleton, joint)) for joint in leaves]
    heights = np.stack([point_positions(rotations, positions, *end)[:, 1] for end in ends], axis=1)
    size = float(np.median(np.ptp(positions[..., 1], axis=1)))
    low = (heights <= heights.min(axis=1, keepdims=True) + LOWEST_BAND * size).mean(axis=0) >= LOWEST_SHARE
    chosen = []
    for k, (joint, offset) in enumerate(ends):
        chain = skeleton.chain(joint)
        length = float(np.linalg.norm(skeleton.offsets[chain[1:]], axis=1).sum() + np.linalg.norm(offset))
        hangs = np.median(positions[:, 0, 1] - heights[:, k]) >= HANGING * length > 0.0
        if low[k] and hangs:
            chosen.append((chain, offset))
    named = [one for one in chosen if _matches(_FOOT, skeleton, one[0])]
    if not named:
        named = [one for one in chosen if len(one[0]) > 3 and not _matches(_NO_FOOT, skeleton, one[0])]
        named = named if len(named) > 1 else []
    return _grouped(skeleton, named)


def point_positions(rotations: F64, positions: F64, joint: int, offset: F64) -> F64:
    """Positions (F, 3) of a point that a joint carries, from global rotations (F, J, 4) and positions (F, J, 3)."""
    return np.asarray(positions[:, joint] + quat.rotate(rotations[:, joint], offset), np.float64)


def leg_length(skeleton: Skeleton, foot: int) -> float:
    """Length of the limb from the hip, the root's child, to a foot, metres."""
    return float(np.linalg.norm(skeleton.offsets[skeleton.chain(foot)[2:]], axis=1).sum())


def _tip(skeleton: Skeleton, joint: int) -> F64:
    """Offset (3,) of the farthest tip of a joint; zero where it has none."""
    tips = skeleton.tip_offsets[skeleton.tip_parents == joint]
    return np.zeros(3) if not len(tips) else tips[np.argmax(np.linalg.norm(tips, axis=1))]


def _matches(pattern: re.Pattern[str], skeleton: Skeleton, chain: I64) -> bool:
    return any(pattern.search(skeleton.names[joint]) for joint in chain[1:][-3:])


def _grouped(skeleton: Skeleton, ends: list[tuple[I64, F64]]) -> list[list[Point]]:
    """Points of each foot: of several toes, those of the longest one."""
    found: dict[int, tuple[float, list[Point]]] = {}
    for chain, tip in ends:
        at = _ankle(skeleton, chain)
        foot, leaf = int(chain[at]), int(chain[-1])
        below = chain[at + 1 :]
        length = float(np.linalg.norm(skeleton.offsets[below], axis=1).sum() + np.linalg.norm(tip))
        if not len(below) or not _has_ball(skeleton, chain, at):
            points = [Point(foot, FOOT, leaf, tip)]
        else:
            points = [Point(foot, BALL, int(below[0]), np.zeros(3))]
            if leaf != below[0] or tip.any():
                points.append(Point(foot, TOE, leaf, tip))
        if foot not in found or length > found[foot][0]:
            found[foot] = (length, points)
    return [points for _, (_, points) in sorted(found.items())]


def _ankle(skeleton: Skeleton, chain: I64) -> int:
    """Place of the ankle in a chain from the root to the end of a leg."""
    names = [skeleton.names[joint] for joint in chain]
    toes = [k for k in range(2, len(chain)) if _TOE.search(names[k])]
    if toes:
        return toes[0] - 1
    named = [k for k in range(1, len(chain)) if _FOOT.search(names[k])]
    if named:
        return named[0]
    lengths = np.linalg.norm(skeleton.offsets[chain[2:]], axis=1)  # hip to knee, knee to ankle, …
    if len(lengths) < 2:
        return len(chain) - 1
    return int(np.argmax(lengths[1:] + lengths[:-1])) + 3


def _has_ball(skeleton: Skeleton, chain: I64, ankle: int) -> bool:
    """Whether the joint below the ankle is a toe joint, and not a joint that only marks the end of the foot."""
    if _TOE.search(skeleton.names[chain[ankle + 1]]):
        return True
    return not _FOOT.search(skeleton.names[chain[ankle]]) or len(chain) > ankle + 2
