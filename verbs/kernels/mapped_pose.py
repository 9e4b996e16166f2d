"""Poses of one skeleton on another: rotations by joint, then feet on the ground and the effector on its goal.

Joints of the target that a source joint moves form a tree of K joints, the *driven* ones; what lies between two of them
does not move and is part of their offset. Each gets the rotation that its source has made since the standing pose, and
its own standing rotation before that. Then, in closed form: the pelvis sinks where a leg is too short for the place of
its foot; trunk and pelvis lean where an arm is too short for its goal; two-bone inverse kinematics puts the feet and
the effector where they belong.

Source: ``docs/mapping.md``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.mapped_limbs import (
    ARM,
    CHAIN,
    EASY,
    EASY_LEG,
    FREE,
    KNEE,
    LEG,
    MARGIN,
    NO_EFFECTOR,
    REACHED,
    SINK_M,
    STRAIGHT,
    Driven,
    Reach,
    Soles,
    bend,
    carried,
    forward,
    heights,
    lean,
    lowest,
    missing_m,
    placed,
    reach_chain,
    shift,
    sink,
    span,
    stretch_of,
    within,
)  # fmt: skip
from verbs.kernels.one_leg import SCRATCH, get, smoothstep
from verbs.kernels.soft_limits import above_zero
from verbs.kernels.vectors import inverse, mul, rotate

__all__ = ["map_poses"]


@kernel
def _since(globals_: F64, back: F64, joint: int) -> Any:
    """Rotation of a source joint since its standing pose."""
    return mul(get(globals_, joint), get(back, joint))


@kernel
def _between(a: Any, b: Any, share: float) -> Any:
    """Rotation a share of the way from one to another, by the shorter way."""
    sign = -1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0.0 else 1.0
    u, v = 1.0 - share, sign * share
    x, y, z, w = u * a[0] + v * b[0], u * a[1] + v * b[1], u * a[2] + v * b[2], u * a[3] + v * b[3]
    size = max(np.sqrt(x * x + y * y + z * z + w * w), 1e-12)
    return (x / size, y / size, z / size, w / size)


@kernel
def _follow(globals_: F64, driven: Driven, own: F64, local: F64) -> None:
    """Global (K, 4) and local (K, 4) rotations of the driven joints by those of the source."""
    for k in range(driven.first.shape[0]):
        turn = _since(globals_, driven.back, driven.first[k])
        if driven.share[k] > 0.0:
            turn = _between(turn, _since(globals_, driven.back, driven.second[k]), driven.share[k])
        q = mul(turn, get(driven.standing, k))
        own[k, 0], own[k, 1], own[k, 2], own[k, 3] = q
        above = driven.parents[k]
        if above >= 0:
            q = mul(inverse(get(own, above)), q)
        local[k, 0], local[k, 1], local[k, 2], local[k, 3] = q


@kernel
def _pelvis(positions: F64, driven: Driven, own: F64, root: F64) -> None:
    """Position (3,) of the pelvis: the middle of the hips is where that of the source is, scaled."""
    a, b = driven.hips[0], driven.hips[1]
    point = (
        0.5 * (positions[a, 0] + positions[b, 0]),
        0.5 * (positions[a, 1] + positions[b, 1]),
        0.5 * (positions[a, 2] + positions[b, 2]),
    )
    point = placed(point, driven.scale, driven.center)
    off = rotate(get(own, 0), driven.middle[0], driven.middle[1], driven.middle[2])
    for a in range(3):
        root[a] = point[a] - off[a]


@kernel
def _foot_goal(
    globals_: F64, positions: F64, driven: Driven, soles: Soles, f: int, own: F64, scratch: F64, out: F64
) -> None:
    """Place of an ankle (3), clearance of a foot, place (3) of its ball, and height of the source's ball."""
    ankle, toe = soles.joints[f, 2], soles.joints[f, 3]
    last = soles.chains.shape[1]
    mine, my_toe = soles.chains[f, last - 2], soles.chains[f, last - 1]
    end = toe if toe >= 0 else ankle
    heights(
        positions[ankle, 1], get(globals_, ankle), get(globals_, end), positions[end, 1], soles.points[f],
        soles.levels[f], scratch,
    )  # fmt: skip
    clearance, out[7] = lowest(scratch, soles.known[f]), scratch[1]
    ball = placed(carried(positions, globals_, ankle, soles.points[f, 1]), driven.scale, driven.center)
    x, y, z = ball[0], ball[1] - driven.scale[1] * soles.levels[f, 1] + soles.own_levels[f, 1], ball[2]
    q = get(own, mine)
    b = rotate(q, soles.own_points[f, 1, 0], soles.own_points[f, 1, 1], soles.own_points[f, 1, 2])
    out[0], out[1], out[2] = x - b[0], y - b[1], z - b[2]
    base = out[1]
    if my_toe >= 0:
        base += rotate(q, driven.offsets[my_toe, 0], driven.offsets[my_toe, 1], driven.offsets[my_toe, 2])[1]
    heights(
        out[1], q, get(own, my_toe if my_toe >= 0 else mine), base, soles.own_points[f], soles.own_levels[f], scratch
    )
    rise = driven.scale[1] * clearance - lowest(scratch, soles.known[f])
    out[1] += rise
    out[3] = clearance
    out[4], out[5], out[6] = x, y + rise, z


@kernel
def _effector_goal(positions: F64, driven: Driven, reach: Reach, weight: float, own: F64, places: F64) -> Any:
    """Where the effector goes, and where its goal is: where it is already, towards the goal by its weight."""
    p = reach.source
    goal = placed((positions[p, 0], positions[p, 1], positions[p, 2]), driven.goal_scale, driven.center)
    now = carried(places, own, reach.joint, reach.offset)
    aim = (
        now[0] + weight * (goal[0] - now[0]),
        now[1] + weight * (goal[1] - now[1]),
        now[2] + weight * (goal[2] - now[2]),
    )
    return aim, goal


@kernel
def _aim_foot(
    positions: F64, weight: float, goal: Any, driven: Driven, soles: Soles, reach: Reach, root: F64, local: F64,
    own: F64, places: F64, goals: F64,
) -> None:  # fmt: skip
    """Take the place of a foot that carries the effector towards its goal; the pelvis follows a leg that is short."""
    last = soles.chains.shape[1]
    chain, ball = soles.chains[reach.foot], goals[reach.foot]
    hip, knee, foot = chain[last - 4], chain[last - 3], chain[last - 2]
    now = carried(places, own, reach.joint, reach.offset)
    free = smoothstep(max(driven.scale[1] * ball[3], 0.0) / (FREE * driven.leg))
    share = weight * (free + (1.0 - free) * weight**8)  # a foot that still stands stays
    ball[0] += share * (goal[0] - now[0] + places[foot, 0] - ball[0])
    ball[1] += share * (goal[1] - now[1] + places[foot, 1] - ball[1])
    ball[2] += share * (goal[2] - now[2] + places[foot, 2] - ball[2])
    joints = soles.joints[reach.foot]
    stretch = min(stretch_of(positions, joints[0], joints[1], joints[2]), REACHED)
    whole = span(places, hip, knee) + span(places, knee, foot)
    aim = (ball[0], ball[1], ball[2])
    missing = missing_m(places, hip, aim, whole * max(EASY_LEG, stretch))
    if missing > 0.0:
        shift(root, places, hip, aim, share * missing, driven.leg)
        forward(root, local, driven, own, places)
    ball[0], ball[1], ball[2] = within(places, hip, aim, whole, max(EASY_LEG, stretch))


@kernel
def _one_pose(
    globals_: F64, positions: F64, weight: float, driven: Driven, soles: Soles, reach: Reach, root: F64, local: F64,
    own: F64, places: F64, goals: F64, pose: F64, figures: F64,
) -> float:  # fmt: skip
    """One pose; ``root`` (3,) and ``local`` (K, 4) are written. The result is the effector's distance from its goal."""
    count, last = soles.joints.shape[0], soles.chains.shape[1]
    _follow(globals_, driven, own, local)
    _pelvis(positions, driven, own, root)
    forward(root, local, driven, own, places)
    for f in range(count):
        _foot_goal(globals_, positions, driven, soles, f, own, pose, goals[f])
    aim, goal = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if reach.kind != NO_EFFECTOR:
        aim, goal = _effector_goal(positions, driven, reach, weight, own, places)
    active = weight > 0.0
    if reach.kind == LEG and active:
        _aim_foot(positions, weight, goal, driven, soles, reach, root, local, own, places, goals)
    root[1] -= sink(positions, driven, soles, goals, places)
    forward(root, local, driven, own, places)
    wrist, end = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if reach.kind == ARM and active:
        length = reach.chain.shape[0]
        shoulder, hand = reach.chain[length - 4], reach.chain[length - 2]
        end = get(own, hand)
        now = carried(places, own, reach.joint, reach.offset)
        wrist = (
            aim[0] - now[0] + places[hand, 0],
            aim[1] - now[1] + places[hand, 1],
            aim[2] - now[2] + places[hand, 2],
        )
        whole = span(places, shoulder, reach.chain[length - 3]) + span(places, reach.chain[length - 3], hand)
        share = min(stretch_of(positions, reach.limb[0], reach.limb[1], reach.limb[2]), REACHED)
        limit = whole * max(EASY, share)
        sunk = sink(positions, driven, soles, goals, places)
        missing = lean(root, local, driven, reach, wrist, limit, own, places)
        if missing > 0.0:
            shift(root, places, shoulder, wrist, missing, driven.leg)
            forward(root, local, driven, own, places)
            root[1] -= above_zero(sink(positions, driven, soles, goals, places) - sunk - SINK_M, SINK_M)
            forward(root, local, driven, own, places)
        wrist = within(places, shoulder, wrist, whole, max(KNEE, min(share + MARGIN, REACHED - 1e-3), share))
    for f in range(count):
        foot = get(own, soles.chains[f, last - 2])
        bend(local, soles.chains[f], soles.hinges[f], root, driven.offsets, goals[f], foot, STRAIGHT, pose)
    if reach.kind == ARM and active:
        bend(local, reach.chain, reach.hinge, root, driven.offsets, wrist, end, 0.9999, pose)
    if reach.kind == CHAIN and active:
        reach_chain(root, local, driven, reach, aim)
    forward(root, local, driven, own, places)
    for f in range(count):
        _foot_figures(soles, f, own, places, driven, goals[f], pose, figures[f])
    if reach.kind == NO_EFFECTOR:
        return np.nan
    now = carried(places, own, reach.joint, reach.offset)
    return np.sqrt((now[0] - goal[0]) ** 2 + (now[1] - goal[1]) ** 2 + (now[2] - goal[2]) ** 2)


@kernel
def _foot_figures(
    soles: Soles, f: int, own: F64, places: F64, driven: Driven, goal: F64, scratch: F64, out: F64
) -> None:
    """Figures of a foot, see :data:`FOOT_COLUMNS`."""
    last = soles.chains.shape[1]
    mine, toe = soles.chains[f, last - 2], soles.chains[f, last - 1]
    end = toe if toe >= 0 else mine
    heights(
        places[mine, 1],
        get(own, mine),
        get(own, end),
        places[end, 1],
        soles.own_points[f],
        soles.own_levels[f],
        scratch,
    )
    ball = carried(places, own, mine, soles.own_points[f, 1])
    out[0], out[5] = goal[7], goal[3]
    out[1] = lowest(scratch, soles.known[f]) - driven.scale[1] * goal[3]
    out[2] = np.sqrt((ball[0] - goal[4]) ** 2 + (ball[2] - goal[6]) ** 2)
    out[3], out[4] = ball[0], ball[2]


@kernel
def map_poses(
    globals_: F64, positions: F64, weights: F64, driven: Driven, soles: Soles, reach: Reach, root: F64, rotations: F64,
    effector: F64, figures: F64,
) -> None:  # fmt: skip
    """Poses of a target by poses of a source.

    Parameters
    ----------
    globals_, positions : (B, S, 4), (B, S, 3) float64
        Global rotations and positions of the source.
    weights : (B,) float64
        How much the effector's goal counts.
    driven : Driven
    soles : Soles
    reach : Reach
    root : (B, 3) float64
        Written: position of the target's root, metres.
    rotations : (B, J, 4) float64
        Written: its local rotations.
    effector : (B,) float64
        Written: distance of the effector from its goal, metres; NaN without one.
    figures : (B, F, 6) float64
        Written: columns of :data:`FOOT_COLUMNS`.
    """
    count, feet = driven.first.shape[0], soles.joints.shape[0]
    local, own, places = np.empty((count, 4)), np.empty((count, 4)), np.empty((count, 3))
    goals, pose = np.empty((feet, 8)), np.empty(SCRATCH)
    for b in range(globals_.shape[0]):
        effector[b] = _one_pose(
            globals_[b], positions[b], weights[b], driven, soles, reach, root[b], local, own, places, goals, pose,
            figures[b],
        )  # fmt: skip
        rotations[b] = driven.rest
        for k in range(count):
            q = mul(get(driven.before, k), get(local, k))
            joint = driven.joints[k]
            rotations[b, joint, 0], rotations[b, joint, 1], rotations[b, joint, 2], rotations[b, joint, 3] = q
        for a in range(3):
            root[b, a] -= driven.root[a]
