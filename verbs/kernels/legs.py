"""Put the feet of a pose where commands place them: foot, pelvis, knee and hip by closed forms.

A foot is a heel and a ball on the ankle's joint and a tip on the toe joint. A command holds the foot in plan (position
of the ball, direction from heel to ball) with a share, and its points at their standing heights with their contacts;
the rest of the pose stays. No point goes below the ground. The leg follows by two-bone inverse kinematics; where it
would be too short the pelvis sinks first, then the foot gives way.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel
from verbs.kernels.one_leg import (
    SCRATCH,
    STRAIGHT,
    STRAIGHTEST,
    bend_leg,
    clip,
    find_leg,
    get,
    lengths,
    put,
    smoothstep,
    triple,
)
from verbs.kernels.soft_limits import above_zero, limited
from verbs.kernels.vectors import about, inverse, mul, rotate

__all__ = [
    "COMMAND",
    "CONTACTS",
    "GIVE",
    "GROUNDS",
    "PELVIS",
    "REACH_M",
    "Legs",
    "plant",
    "plant_poses",
]

COMMAND = (
    "hold", "heel_x", "heel_z", "ball_x", "ball_z", "tip_x", "tip_z", "dx", "dz", "heel", "ball", "tip", "heel_y",
    "ball_y", "tip_y", "heel_ground", "ball_ground", "tip_ground", "heel_pull", "ball_pull", "tip_pull", "pelvis",
    "give",
)  # fmt: skip
"""Columns of a command: share that is held in plan; places of the three points, and direction (unit) of the foot; their
contacts, their heights by these contacts, and their least heights; their shares in the place of the foot; share of the
pelvis; distance around the reach of the leg within which the pelvis begins to sink, metres."""

PELVIS, GIVE = COMMAND.index("pelvis"), COMMAND.index("give")
CONTACTS, GROUNDS = (9, 10, 11), (15, 16, 17)

SOFT_M, REACH_M = 0.012, 0.004
"""Distances around the ground, and around the reach of a leg, within which limits begin to act."""

FAR_M = 1.2
"""Largest distance over which a foot is held; it is approached smoothly."""

MOST_YAW = 0.8
"""Largest angle (rad) by which a foot is turned; it is approached smoothly."""

AGREED = 0.5
"""Share of the ball in the place of a foot of which no point stands."""

LOWEST_M = 0.08
"""How far the pelvis sinks at most."""


class Legs(NamedTuple):
    """Legs of a skeleton: F feet.

    Parameters
    ----------
    chains : (F, L) int64
        Joints from the root to the ankle, then the toe joint or -1; padded with -1 in front of the root.
    points : (F, 3, 3) float64
        Heel and ball in the ankle's frame, and tip in that of the toe joint (of the ankle without one), metres.
    known : (F, 3) int64
        Whether the foot has a heel, a ball and a tip; every foot has a ball.
    sides : (F, 3) float64
        Unit axis to the left of the foot, in the ankle's frame: it stays level while the foot rolls.
    hinges : (F, 3) float64
        Unit axis about which the knee usually bends, in the frame of the hip.
    offsets : (J, 3) float64
        Of the skeleton, metres.
    """

    chains: I64
    points: F64
    known: I64
    sides: F64
    hinges: F64
    offsets: F64


@kernel
def plant(root: Any, rotations: Any, commands: F64, legs: Legs, pose: F64) -> None:
    """Put the feet of one pose, in place.

    Parameters
    ----------
    root : (3,) floating
        Position of the root; its height may change.
    rotations : (J, 4) floating
        Local rotations; those of hips, knees, ankles and toes change.
    commands : (F, 23) float64
        Columns of :data:`COMMAND`, in the frame of ``root``.
    legs : Legs
    pose : (F, SCRATCH) float64
        Scratch.
    """
    needed, total, shift, share = False, 0.0, 0.0, 0.0
    for f in range(commands.shape[0]):
        _foot(root, rotations, commands[f], legs, f, pose[f])
        if pose[f, 0] > 0.0:
            needed = True
            weight = commands[f, 0]
            total += weight
            shift += weight * _level(pose[f])
            share = max(share, commands[f, PELVIS])
    if not needed:
        return
    shift = share * limited(shift / max(total, 1.0), LOWEST_M)
    sink = 0.0
    for f in range(commands.shape[0]):
        if pose[f, 0] > 0.0:
            sink = max(sink, commands[f, 0] * _missing(pose[f], shift, commands[f, GIVE]))
    shift -= share * limited(sink, LOWEST_M)
    if shift != 0.0:
        root[1] += shift
    for f in range(commands.shape[0]):
        if pose[f, 0] > 0.0 or shift != 0.0:
            bend_leg(rotations, legs.chains[f], legs.hinges[f], pose[f], shift, _free(pose[f]))


@kernel
def plant_poses(root: F64, rotations: F64, commands: F64, legs: Legs) -> None:
    """:func:`plant` for poses (B, 3), (B, J, 4) by commands (B, F, 23)."""
    scratch = np.empty((commands.shape[1], SCRATCH))
    for b in range(root.shape[0]):
        plant(root[b], rotations[b], commands[b], legs, scratch)


@kernel
def _foot(root: Any, rotations: Any, command: F64, legs: Legs, f: int, out: F64) -> None:
    """Find where one foot goes.

    ``out`` is: whether it moves, its share that is held; then hip, knee, ankle (3 each), global rotations of parent,
    hip, knee (4 each); wanted ankle (3) and rotation of the foot (4).
    """
    points, known, toe = legs.points[f], legs.known[f], legs.chains[f, legs.chains.shape[1] - 1]
    foot = find_leg(root, rotations, legs.chains[f], legs.offsets, out)
    x, y, z, hold = out[8], out[9], out[10], command[0]
    tips = mul(foot, get(rotations, toe)) if toe >= 0 else foot
    angle, ex, ez = _turn(foot, legs.sides[f], command)
    if angle != 0.0:
        yaw = about(0.0, 1.0, 0.0, angle)
        foot, tips = mul(yaw, foot), mul(yaw, tips)
        ex, _, ez = rotate(yaw, ex, 0.0, ez)
    heel, ball = rotate(foot, *triple(points[0])), rotate(foot, *triple(points[1]))
    ball_to = _height(y + ball[1], command[13], command[16], command[10])
    pitched = y + ball[1] - ball_to
    if known[0] == 1:
        pitched += _height(y + heel[1], command[12], command[15], command[9]) - y - heel[1]
    else:
        pitched = 0.0
    if pitched != 0.0:
        forward = (ball[0] - heel[0], ball[1] - heel[1], ball[2] - heel[2])
        pitch = _pitch(forward, -pitched, ex, ez)
        foot = mul(pitch, foot)
        heel, ball = rotate(pitch, *heel), rotate(pitch, *ball)
    rise = ball_to - y - ball[1]
    tip = rotate(tips, *triple(points[2]))
    base = ball if toe >= 0 else (0.0, 0.0, 0.0)
    bent = angle != 0.0
    if known[2] == 1:
        higher = _height(y + rise + base[1] + tip[1], command[14], command[17], command[11])
        higher -= y + rise + base[1] + tip[1]
        if toe < 0:
            rise += higher
        else:
            bend, changed = _bend(tip, higher, command, ex, ez)
            tips, tip, bent = mul(bend, tips), rotate(bend, *tip), bent or changed
    px, pz = 0.0, 0.0
    if hold > 0.0:
        tip = (base[0] + tip[0], 0.0, base[2] + tip[2])
        px, pz = _pull(command, known, x, z, heel, ball, tip)
    if toe >= 0 and (bent or pitched != 0.0):
        put(rotations, toe, mul(inverse(foot), tips))
    out[0], out[1] = 0.0, hold
    if px == 0.0 and pz == 0.0 and rise == 0.0 and pitched == 0.0 and angle == 0.0:
        return
    out[0] = 1.0
    out[23], out[24], out[25] = x + px, y + rise, z + pz
    out[26], out[27], out[28], out[29] = foot


@kernel
def _turn(foot: Any, side: F64, command: F64) -> tuple[float, float, float]:
    """Angle about the vertical by which a foot turns into its direction, and the direction x, z that it has."""
    lx, _, lz = rotate(foot, *triple(side))
    size = np.sqrt(lx * lx + lz * lz)
    if size <= 1e-6:
        return 0.0, 0.0, 1.0
    ex, ez = -lz / size, lx / size
    if command[0] <= 0.0:
        return 0.0, ex, ez
    angle = np.arctan2(command[7] * ez - command[8] * ex, command[7] * ex + command[8] * ez)
    sure = min(2.0 * size, 1.0)  # a foot on its side has no direction
    return limited(angle, MOST_YAW) * command[0] * sure * sure, ex, ez


@kernel
def _pitch(vector: Any, higher: float, ex: float, ez: float) -> Any:
    """Rotation about a level axis that raises the end of a vector; e is its direction where it is steep."""
    size = np.sqrt(vector[0] * vector[0] + vector[2] * vector[2])
    if size > 0.01:
        ex, ez = vector[0] / size, vector[2] / size
    span = np.sqrt(size * size + vector[1] * vector[1])
    angle = np.arcsin(clip((vector[1] + higher) / span)) - np.arcsin(clip(vector[1] / span))
    return about(ez, 0.0, -ex, -angle)


@kernel
def _bend(tip: Any, higher: float, command: F64, ex: float, ez: float) -> Any:
    """Rotation of the toes that raises the tip and turns it into its place, and whether there is any."""
    bend, changed = (0.0, 0.0, 0.0, 1.0), False
    if higher != 0.0:
        bend, changed = _pitch(tip, higher, ex, ez), True
    if command[0] * command[11] > 0.0:
        tx, tz = command[5] - command[3], command[6] - command[4]
        angle = np.arctan2(tx * tip[2] - tz * tip[0], tx * tip[0] + tz * tip[2])
        turn = about(0.0, 1.0, 0.0, limited(angle, MOST_YAW) * command[0] * command[11])
        bend, changed = mul(turn, bend), True
    return bend, changed


@kernel
def _pull(command: F64, known: I64, x: float, z: float, heel: Any, ball: Any, tip: Any) -> tuple[float, float]:
    """How far a foot moves over the ground, so that the points that stand are in their places."""
    wh, wb, wt = command[18] * known[0], command[19], command[20] * known[2]
    wb += AGREED * (1.0 - max(wh, wb, wt)) ** 2
    px = wh * (command[1] - x - heel[0]) + wb * (command[3] - x - ball[0]) + wt * (command[5] - x - tip[0])
    pz = wh * (command[2] - z - heel[2]) + wb * (command[4] - z - ball[2]) + wt * (command[6] - z - tip[2])
    px, pz = px / (wh + wb + wt), pz / (wh + wb + wt)
    size = np.sqrt(px * px + pz * pz)
    scale = command[0] * (limited(size, FAR_M) / size if size > 1e-9 else 1.0)
    return scale * px, scale * pz


@kernel
def _height(y: float, wanted: float, ground: float, contact: float) -> float:
    """Height of a point: as wanted by its contact, and never below the ground."""
    above = y + contact * (wanted - y) - ground
    if above >= SOFT_M:
        return y if contact <= 0.0 else ground + above
    return ground + above_zero(above, SOFT_M)


@kernel
def _level(out: F64) -> float:
    """How far the pelvis has to rise for a leg to be as long as in the pose when its foot is as wanted."""
    now = lengths(out)[2]
    across = (out[23] - out[2]) ** 2 + (out[25] - out[4]) ** 2
    room = now * now - across
    steep = out[3] - out[24]
    if steep <= 0.0 or room <= 0.0:
        return 0.0
    upright = (steep / now - 0.5) / 0.3  # of a leg that is far from upright only in part
    return smoothstep(upright) * (np.sqrt(room) - steep)


@kernel
def _free(out: F64) -> float:
    """Length up to which a leg stretches freely."""
    thigh, shank, now = lengths(out)
    return float(max(STRAIGHT * (thigh + shank), min(now, (1.0 - out[1] * (1.0 - STRAIGHTEST)) * (thigh + shank))))


@kernel
def _missing(out: F64, shift: float, soft: float) -> float:
    """How far the pelvis has to sink for a foot to be within reach."""
    limit = _free(out)
    room = limit * limit - (out[23] - out[2]) ** 2 - (out[25] - out[4]) ** 2
    lowest = np.sqrt(room) if room > 0.01 * limit * limit else 0.1 * limit
    return above_zero(out[3] + shift - out[24] - lowest, soft)
