"""Parts of :mod:`verbs.kernels.mapped_pose`: its arrays, and the steps that put limbs where they belong.

Source: ``docs/mapping.md``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel
from verbs.kernels.one_leg import bend_leg, find_leg, get, smoothstep
from verbs.kernels.polish import polish
from verbs.kernels.soft_limits import above_zero, limited
from verbs.kernels.vectors import arc, inverse, mul, rotate

__all__ = [
    "ARM",
    "CHAIN",
    "EASY",
    "EASY_LEG",
    "FOOT_COLUMNS",
    "FREE",
    "KNEE",
    "LEG",
    "MARGIN",
    "NO_EFFECTOR",
    "REACHED",
    "SINK_M",
    "STRAIGHT",
    "Driven",
    "Reach",
    "Soles",
    "bend",
    "carried",
    "forward",
    "heights",
    "lean",
    "lowest",
    "missing_m",
    "placed",
    "reach_chain",
    "shift",
    "sink",
    "span",
    "stretch_of",
    "within",
]  # fmt: skip

NO_EFFECTOR, ARM, LEG, CHAIN = range(4)
"""What carries the effector: nothing, a limb with a free end, a leg with a foot, or another chain."""

FOOT_COLUMNS = ("above", "height", "plan", "x", "z", "clearance")
"""Figures of a foot: height of the source's ball over its standing height; error of the height of the target's lowest
point, and of its ball's place over the ground, metres; that place; and height of the source's lowest point."""

STRAIGHT, EASY_LEG = 0.995, 0.985
"""Shares of its length up to which a leg stretches freely, and from which on the pelvis sinks for it."""

EASY, KNEE, REACHED = 0.95, 0.98, 0.9985
"""Shares of an arm's length from which on the trunk helps, beyond which the arm yields, and that it does not exceed."""

MARGIN = 0.01
"""Share of an arm's length by which it may stretch farther than that of the source before it yields."""

SOFT_M, SINK_M, LOWEST_M = 0.005, 0.003, 0.004
"""Distances within which help for an arm and for a leg begins; width of the smooth minimum of heights."""

LEAN_RAD, SHIFT, SINK = 0.6, 0.2, 0.3
"""Largest lean of the trunk, and largest shift and sinking of the pelvis per length of the legs."""

NEAR = 0.12
"""Height of a foot per length of the legs from which on the pelvis does not sink for it."""

FREE = 0.06
"""Height of a foot per length of the legs from which on it follows its goal as an effector."""

STEPS = 4
"""Steps of the lean, each of which corrects what the one before missed."""

MOST_RAD, DAMPING = 0.7, 1e-4
"""Bound of a joint and damping of a chain without an elbow."""


class Driven(NamedTuple):
    """The driven joints: K of them, of a target of J.

    Parameters
    ----------
    first, second : (K,) int64
        Joints of the source between which each lies.
    share : (K,) float64
        0 at the first, 1 at the second.
    back : (S, 4) float64
        Inverse global rotations of the source's joints in its standing pose.
    standing : (K, 4) float64
        Global rotations in the target's standing pose, in the directions of the source's.
    parents : (K,) int64
        Parents in this tree; -1 of the first, which is the pelvis.
    offsets : (K, 3) float64
        In the frames of these, metres.
    before : (K, 4) float64
        Inverse rotations of what lies between, from the joint's own parent's frame.
    joints : (K,) int64
        Indices in the target.
    rest : (J, 4) float64
        Local rotations of the others.
    root : (3,) float64
        From the root of the target to the first driven joint.
    hips : (2,) int64
        The source's joints whose middle is the middle of its hips; the root twice where it has no legs.
    middle : (3,) float64
        Middle of the target's hips in the frame of the pelvis.
    scale, goal_scale, center : (3,) float64
        Factors of lengths of the body and of the effector's place along x, y, z, about a point.
    leg : float
        Length of the target's legs, metres.
    """

    first: I64
    second: I64
    share: F64
    back: F64
    standing: F64
    parents: I64
    offsets: F64
    before: F64
    joints: I64
    rest: F64
    root: F64
    hips: I64
    middle: F64
    scale: F64
    goal_scale: F64
    center: F64
    leg: float


class Soles(NamedTuple):
    """Feet that both skeletons have: F of them.

    Parameters
    ----------
    joints : (F, 4) int64
        The source's hip, knee, ankle, and toe joint or -1.
    points, own_points : (F, 3, 3) float64
        Heel and ball in the ankle's frame and tip in that of the toe joint: the source's, and the target's.
    known : (F, 3) int64
        Which of them both have.
    levels, own_levels : (F, 3) float64
        Their heights while they stand, metres.
    chains : (F, L) int64
        Driven joints from the pelvis to the ankle, then the toe joint or -1; padded with -1 in front.
    hinges : (F, 3) float64
        Axes about which the target's knees bend, in the frames of its hips.
    """

    joints: I64
    points: F64
    own_points: F64
    known: I64
    levels: F64
    own_levels: F64
    chains: I64
    hinges: F64


class Reach(NamedTuple):
    """The effector.

    Parameters
    ----------
    kind : int
        :data:`NO_EFFECTOR`, :data:`ARM`, :data:`LEG` or :data:`CHAIN`.
    source : int
        Its joint in the source.
    limb : (3,) int64
        The source's shoulder, elbow and wrist, of an arm.
    joint : int
        Driven joint that carries the effector.
    offset : (3,) float64
        Its place in that joint's frame, metres.
    foot : int
        Number of the foot, of a leg.
    chain : (L,) int64
        Driven joints from the pelvis to the wrist and -1, of an arm; those from the pelvis to the joint, of a chain.
    hinge : (3,) float64
        As of the knees.
    spine : (n,) int64
        Driven joints that lean, from the pelvis up.
    """

    kind: int
    source: int
    limb: I64
    joint: int
    offset: F64
    foot: int
    chain: I64
    hinge: F64
    spine: I64


@kernel
def placed(point: Any, scale: F64, center: F64) -> Any:
    """A point, scaled about a center."""
    return (
        center[0] + scale[0] * (point[0] - center[0]),
        center[1] + scale[1] * (point[1] - center[1]),
        center[2] + scale[2] * (point[2] - center[2]),
    )


@kernel
def carried(positions: F64, rotations: F64, joint: int, offset: F64) -> Any:
    """Position of a point that a joint carries."""
    p = rotate(get(rotations, joint), offset[0], offset[1], offset[2])
    return positions[joint, 0] + p[0], positions[joint, 1] + p[1], positions[joint, 2] + p[2]


@kernel
def forward(root: F64, local: F64, driven: Driven, own: F64, places: F64) -> None:
    """Global rotations (K, 4) and positions (K, 3) of the driven joints."""
    for k in range(local.shape[0]):
        above = driven.parents[k]
        if above < 0:
            own[k] = local[k]
            places[k] = root
            continue
        q = get(own, above)
        p = rotate(q, driven.offsets[k, 0], driven.offsets[k, 1], driven.offsets[k, 2])
        places[k, 0], places[k, 1], places[k, 2] = (
            places[above, 0] + p[0],
            places[above, 1] + p[1],
            places[above, 2] + p[2],
        )
        own[k, 0], own[k, 1], own[k, 2], own[k, 3] = mul(q, get(local, k))


@kernel
def lowest(heights: F64, known: I64) -> float:
    """Least of the known heights (3,), smooth, and exact where they are equal."""
    least = np.inf
    for p in range(3):
        if known[p] == 1:
            least = min(least, heights[p])
    total, weights = 0.0, 0.0
    for p in range(3):
        if known[p] == 1:
            weight = np.exp((least - heights[p]) / LOWEST_M)
            total += weight * heights[p]
            weights += weight
    return total / weights


@kernel
def heights(ankle_y: float, foot: Any, toe: Any, base_y: float, points: F64, levels: F64, out: F64) -> None:
    """Heights (3,) of heel, ball and tip over their standing heights; ``base_y`` is the height of the toe joint."""
    for p in range(2):
        out[p] = ankle_y + rotate(foot, points[p, 0], points[p, 1], points[p, 2])[1] - levels[p]
    out[2] = base_y + rotate(toe, points[2, 0], points[2, 1], points[2, 2])[1] - levels[2]


@kernel
def span(positions: F64, a: int, b: int) -> float:
    """Distance between two joints."""
    x, y, z = positions[a, 0] - positions[b, 0], positions[a, 1] - positions[b, 1], positions[a, 2] - positions[b, 2]
    return np.sqrt(x * x + y * y + z * z)


@kernel
def stretch_of(positions: F64, upper: int, lower: int, end: int) -> float:
    """Share of its length to which a limb is stretched."""
    return span(positions, upper, end) / max(span(positions, upper, lower) + span(positions, lower, end), 1e-9)


@kernel
def sink(positions: F64, driven: Driven, soles: Soles, goals: F64, places: F64) -> float:
    """How far the pelvis sinks so that feet near the ground are within reach, metres."""
    total, last = 0.0, soles.chains.shape[1]
    for f in range(soles.joints.shape[0]):
        hip, knee, ankle = soles.chains[f, last - 4], soles.chains[f, last - 3], soles.chains[f, last - 2]
        length = span(places, hip, knee) + span(places, knee, ankle)
        share = max(EASY_LEG, stretch_of(positions, soles.joints[f, 0], soles.joints[f, 1], soles.joints[f, 2]))
        limit = share * length
        flat = (places[hip, 0] - goals[f, 0]) ** 2 + (places[hip, 2] - goals[f, 2]) ** 2
        room = limit * limit - flat
        lowest = np.sqrt(room) if room > 0.01 * limit * limit else 0.1 * limit
        need = above_zero(places[hip, 1] - goals[f, 1] - lowest - SINK_M, SINK_M)
        near = 1.0 - smoothstep(max(driven.scale[1] * goals[f, 3], 0.0) / (NEAR * driven.leg))
        total += (near * need) ** 4
    return limited(np.sqrt(np.sqrt(total)), SINK * driven.leg)


@kernel
def missing_m(places: F64, joint: int, goal: Any, limit: float) -> float:
    """How far a goal is out of a limb's reach, metres."""
    dx, dy, dz = goal[0] - places[joint, 0], goal[1] - places[joint, 1], goal[2] - places[joint, 2]
    return above_zero(np.sqrt(dx * dx + dy * dy + dz * dz) - limit - SOFT_M, SOFT_M)


@kernel
def lean(root: F64, local: F64, driven: Driven, reach: Reach, goal: Any, limit: float, own: F64, places: F64) -> float:
    """Lean the trunk towards a goal of the wrist that is out of the arm's reach; what is still missing, metres."""
    last = reach.chain.shape[0]
    shoulder = reach.chain[last - 4]
    count, left = reach.spine.shape[0], LEAN_RAD
    for step in range(STEPS + 1):
        forward(root, local, driven, own, places)
        dx, dy, dz = goal[0] - places[shoulder, 0], goal[1] - places[shoulder, 1], goal[2] - places[shoulder, 2]
        size = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        missing = above_zero(size - limit - SOFT_M, SOFT_M)
        if step == STEPS or count == 0 or missing <= 0.0:
            return missing
        base = reach.spine[0]
        arm = (
            places[shoulder, 0] - places[base, 0],
            places[shoulder, 1] - places[base, 1],
            places[shoulder, 2] - places[base, 2],
        )
        share = missing / size
        turn = arc(arm, (arm[0] + share * dx, arm[1] + share * dy, arm[2] + share * dz))
        sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
        if sine < 1e-12:
            return missing
        angle = limited(2.0 * np.arctan2(sine, turn[3]), left)
        left -= angle
        angle /= count
        s = np.sin(0.5 * angle) / sine
        part = (s * turn[0], s * turn[1], s * turn[2], np.cos(0.5 * angle))
        for n in range(count):
            k = reach.spine[n]
            above = get(own, driven.parents[k])
            q = mul(mul(inverse(above), part), mul(above, get(local, k)))
            local[k, 0], local[k, 1], local[k, 2], local[k, 3] = q
    return 0.0


@kernel
def shift(root: F64, places: F64, shoulder: int, goal: Any, missing: float, leg: float) -> None:
    """Move the pelvis towards a goal, down freely and up not at all."""
    dx, dy, dz = goal[0] - places[shoulder, 0], goal[1] - places[shoulder, 1], goal[2] - places[shoulder, 2]
    size = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    share = limited(missing, SHIFT * leg) / size
    root[0] += share * dx
    root[2] += share * dz
    root[1] -= above_zero(-share * dy - SINK_M, SINK_M)


@kernel
def within(places: F64, shoulder: int, goal: Any, whole: float, knee: float) -> Any:
    """A goal of the wrist within reach: one beyond a share of the arm's length, ``knee``, is approached smoothly."""
    dx, dy, dz = goal[0] - places[shoulder, 0], goal[1] - places[shoulder, 1], goal[2] - places[shoulder, 2]
    size = np.sqrt(dx * dx + dy * dy + dz * dz)
    beyond = size / whole - knee
    if beyond <= 0.0:
        return goal
    give = max(REACHED - knee, 5e-4)
    factor = whole * (knee + give * (1.0 - np.exp(-beyond / give))) / size
    return places[shoulder, 0] + factor * dx, places[shoulder, 1] + factor * dy, places[shoulder, 2] + factor * dz


@kernel
def bend(
    local: F64, chain: I64, hinge: F64, root: F64, offsets: F64, goal: Any, end: Any, most: float, pose: F64
) -> None:
    """Put the end of a limb to a goal, with a global rotation of its own, by two-bone inverse kinematics."""
    find_leg(root, local, chain, offsets, pose)
    pose[0], pose[1] = 1.0, 0.0  # nothing of a straight knee changes where the leg does not
    pose[23], pose[24], pose[25] = goal[0], goal[1], goal[2]
    pose[26], pose[27], pose[28], pose[29] = end
    first = np.sqrt((pose[5] - pose[2]) ** 2 + (pose[6] - pose[3]) ** 2 + (pose[7] - pose[4]) ** 2)
    second = np.sqrt((pose[8] - pose[5]) ** 2 + (pose[9] - pose[6]) ** 2 + (pose[10] - pose[7]) ** 2)
    now = np.sqrt((pose[8] - pose[2]) ** 2 + (pose[9] - pose[3]) ** 2 + (pose[10] - pose[4]) ** 2)
    bend_leg(local, chain, hinge, pose, 0.0, max(most * (first + second), min(now, 0.9999 * (first + second))))


@kernel
def reach_chain(root: F64, local: F64, driven: Driven, reach: Reach, goal: Any) -> None:
    """Rotate the joints of a chain until the effector is at its goal."""
    links = reach.chain.shape[0]
    locals_, offsets, vectors, target = np.empty((links, 4)), np.empty((links, 3)), np.empty((links, 3)), np.empty(3)
    for n in range(links):
        locals_[n] = local[reach.chain[n]]
        offsets[n] = driven.offsets[reach.chain[n + 1]] if n + 1 < links else reach.offset
    for a in range(3):
        target[a] = goal[a]
    polish(root, locals_, offsets, target, MOST_RAD, DAMPING, vectors)
    for n in range(1, links):
        x, y, z = vectors[n, 0], vectors[n, 1], vectors[n, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        s = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        q = mul(get(local, reach.chain[n]), (s * x, s * y, s * z, np.cos(0.5 * angle)))
        for a in range(4):
            local[reach.chain[n], a] = q[a]
