"""Inertialization: the offset between two motions, which decays on top of the second one.

``state`` (C,) is of :data:`verbs.kernels.character_state.CHARACTER`.

Source: ``docs/math.md``, section "Live characters"; D. Bollo, "Inertialization", GDC 2018.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.kernels.character_state import Crowd, Records, displayed
from verbs.kernels.compile import kernel
from verbs.kernels.crowd_pose import Curves, blend_sorted, finish_double, share, sums
from verbs.kernels.leg_transition import carry, lines
from verbs.kernels.legs import Legs, plant
from verbs.kernels.one_leg import SCRATCH
from verbs.kernels.pose import multiply

__all__ = ["apply", "begin", "place", "place_row", "poses", "redisplay", "restart", "step_back"]


@kernel
def _log(q: F64, out: F64) -> None:
    """Rotation vector (3,) of a unit quaternion (4,), of the smaller angle."""
    sign = -1.0 if q[3] < 0.0 else 1.0
    sine = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    scale = sign * (2.0 * np.arctan2(sine, sign * q[3]) / sine if sine > 1e-9 else 2.0)
    for a in range(3):
        out[a] = scale * q[a]


@kernel
def _difference(to: F64, source: F64, out: F64) -> None:
    """The rotation (4,) that takes one unit quaternion (4,), ``source``, to another, in their parent's axes."""
    back = np.empty(4)
    for a in range(3):
        back[a] = -source[a]
    back[3] = source[3]
    multiply(to, back, out)


@kernel
def _between(to: F64, source: F64, out: F64) -> None:
    """Rotation vector (3,) from one unit quaternion (4,), ``source``, to another."""
    rotation = np.empty(4)
    _difference(to, source, rotation)
    _log(rotation, out)


@kernel
def _before(here: F64, after: F64, out: F64) -> None:
    """Rotation (4,) as far before ``here`` as ``after`` is after it."""
    rotation = np.empty(4)
    _difference(here, after, rotation)
    multiply(rotation, here, out)


@kernel
def step_back(frames: F64) -> None:
    """Replace two frames (2, 3 + 4·J) by the one before them, at constant velocity, and the first."""
    before, here = np.empty(4), np.empty(4)
    for a in range(3):
        first = frames[0, a]
        frames[0, a], frames[1, a] = 2.0 * first - frames[1, a], first
    for at in range(3, frames.shape[1], 4):
        here[:] = frames[0, at : at + 4]
        _before(here, frames[1, at : at + 4], before)
        frames[0, at : at + 4], frames[1, at : at + 4] = before, here


@kernel
def begin(step_s: float, last: F64, ahead: F64, legs: Legs, offsets: F64) -> None:
    """Start a transition: offsets, and their velocities, between the displayed pose and the motion that follows.

    Parameters
    ----------
    step_s : float
        Seconds between the two rows of each of the next two.
    last : (2, 3 + 4·J) float64
        The last two displayed frames, the latest one last. Root position, then rotations.
    ahead : (2, 3 + 4·J) float64
        The first two frames of the motion that follows.
    legs : Legs
    offsets : (2, 3 + 3·J + 5·F) float64
        Written: offsets at its start, and their velocities. Of the root (m), of rotations (rotation vectors), and of
        the legs: line from hip to ankle (m) and bend (radians), with the displayed bend.
    """
    joints = (last.shape[1] - 3) // 4
    before, early = np.empty(4), np.empty(3)
    for a in range(3):
        offsets[0, a] = last[1, a] - ahead[0, a]
        offsets[1, a] = (last[1, a] - last[0, a] - ahead[1, a] + ahead[0, a]) / step_s
    for j in range(joints):
        at, to = 3 + 4 * j, 3 + 3 * j
        here = ahead[0, at : at + 4]
        _between(last[1, at : at + 4], here, offsets[0, to : to + 3])
        # One frame before its start, the motion is taken to have rotated as in its first frame.
        _before(here, ahead[1, at : at + 4], before)
        _between(last[0, at : at + 4], before, early)
        _unwrap(early, offsets[0, to : to + 3])
        for a in range(3):
            offsets[1, to + a] = (offsets[0, to + a] - early[a]) / step_s
    _begin_legs(step_s, last, ahead, legs, offsets[:, 3 + 3 * joints :])


@kernel
def _begin_legs(step_s: float, last: F64, ahead: F64, legs: Legs, offsets: F64) -> None:
    """Offsets (2, 5·F) of the legs at the start of a transition, and their velocities; see :func:`begin`."""
    feet, joints = legs.chains.shape[0], (last.shape[1] - 3) // 4
    pose, here, there = np.empty((feet, SCRATCH)), np.empty((2, feet, 4)), np.empty((2, feet, 4))
    back = ahead.copy()
    step_back(back)  # one frame before its start, the motion is taken to have moved as in its first frame
    for k in range(2):
        lines(last[k, :3], last[k, 3:].reshape(joints, 4), legs, pose, here[k])
        lines(back[k, :3], back[k, 3:].reshape(joints, 4), legs, pose, there[k])
    for f in range(feet):
        for a in range(4):
            offsets[0, 5 * f + a] = here[1, f, a] - there[1, f, a]
            offsets[1, 5 * f + a] = (offsets[0, 5 * f + a] - here[0, f, a] + there[0, f, a]) / step_s
        offsets[0, 5 * f + 4], offsets[1, 5 * f + 4] = here[1, f, 3], 0.0


@kernel
def restart(slots: I64, state: Records, frames: F64, offsets: F64, ahead: F64, legs: Legs, transition_s: float) -> None:
    """Start the transitions of motions that start over, from their stored frames.

    Parameters
    ----------
    slots : (B,) int64
    state : (C,) of :data:`verbs.kernels.character_state.CHARACTER`
    frames, offsets : (S, 2, 3 + 4·J), (S, 2, 3 + 3·J + 5·F) float64
        Stored frames; the offsets are written.
    ahead : (B, 2, 3 + 4·J) float64
        The first two frames of each motion; overwritten.
    legs : Legs
    transition_s : float
    """
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        row["since_s"], row["transition_s"], row["calm"] = 0.0, transition_s, 0
        step_back(ahead[b])  # the motion is already less than a step further
        begin(row["step_s"], frames[row["held"]], ahead[b], legs, offsets[row["held"]])


@kernel
def _unwrap(vector: F64, near: F64) -> None:
    """Replace a rotation vector (3,) by the other one of the same rotation where that is nearer to ``near`` (3,)."""
    angle = np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    dot = vector[0] * near[0] + vector[1] * near[1] + vector[2] * near[2]
    if dot < 0.0 and angle > 0.5 * np.pi:
        for a in range(3):
            vector[a] *= 1.0 - 2.0 * np.pi / angle


@kernel
def place(
    at: tuple[float, float, float], heading: float, striding: bool, root: F64, rotation: F64, scratch: tuple[F64, F64]
) -> None:
    """Move a root (3,), (4,) to a position in the world, which is all of its travel where it strides.

    ``at`` is x, y (the height of the ground) and z. ``scratch`` are two arrays (4,).
    """
    turn, local = scratch
    cosine, sine = np.cos(heading), np.sin(heading)
    across, along = (0.0, 0.0) if striding else (root[0], root[2])
    root[0], root[2] = at[0] + across * cosine + along * sine, at[2] - across * sine + along * cosine
    root[1] += at[1]
    turn[0], turn[1], turn[2], turn[3] = 0.0, np.sin(0.5 * heading), 0.0, np.cos(0.5 * heading)
    local[:] = rotation
    multiply(turn, local, rotation)


@kernel
def place_row(state: Any, striding: bool, row: F32) -> None:
    """:func:`place` for the root and first rotation of a row (4 + 4·J,) in single precision, by one ``state``."""
    x, z = (0.0, 0.0) if striding else (np.float64(row[0]), np.float64(row[2]))
    if state["heading"] != 0.0:
        sine, cosine = np.sin(0.5 * state["heading"]), np.cos(0.5 * state["heading"])
        over, whole = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
        x, z = x * whole + z * over, z * whole - x * over
        a, b, c, d = np.float64(row[4]), np.float64(row[5]), np.float64(row[6]), np.float64(row[7])
        row[4], row[5] = cosine * a + sine * c, cosine * b + sine * d
        row[6], row[7] = cosine * c - sine * a, cosine * d - sine * b
    row[0], row[1], row[2] = state["x"] + x, state["y"] + row[1], state["z"] + z


@kernel
def apply(
    slots: I64, step_s: float, crowd: Crowd, offsets: F64, frames: F64, striding: bool, legs: Legs, root: F64,
    rotations: F64,
) -> None:  # fmt: skip
    """Move poses (B, 3), (B, J, 4) into the world, add the offsets of transitions, plant, and store what is displayed.

    A transition's offset goes from x₀ and v₀ to rest as :func:`_factors` states.

    Parameters
    ----------
    slots : (B,) int64
    step_s : float
    crowd : Crowd
    offsets : (S, 2, 3 + 3·J + 5·F) float64
        See :func:`begin`; in the row that ``state`` names as ``held``.
    frames : (S, 2, 3 + 4·J) float64
        The last two frames of each character, in the same row; moved on by one. Where a character appears, both are
        that frame.
    striding : bool
        Whether the character's position is all of the root's travel.
    legs : Legs
        Feet of characters whose commands are those of this frame.
    """
    joints, state = rotations.shape[1], crowd.state
    rotation, local, scratch = np.zeros(4), np.empty(4), np.empty((legs.chains.shape[0], SCRATCH))
    to, away = np.empty((legs.chains.shape[0], 4)), np.empty((legs.chains.shape[0], 5))
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        s = row["held"]
        row["calm"] = row["calm"] + 1 if row["share"] == 0.0 else 0
        place((row["x"], row["y"], row["z"]), row["heading"], striding, root[b], rotations[b, 0], (rotation, local))
        if row["transition_s"] > 0.0:
            if row["footed"] > 0.0:
                lines(root[b], rotations[b], legs, scratch, to)
            _decay(step_s, row, offsets[s], rotation, local, root[b], rotations[b])
            if row["transition_s"] > 0.0:
                row["calm"] = 0
                if row["footed"] > 0.0:
                    _decay_legs(row, offsets[s], joints, away)
                    carry(root[b], rotations[b], legs, to, away, row["since_s"] / row["transition_s"], scratch)
        if row["footed"] > 0.0:
            plant(root[b], rotations[b], crowd.commands[slots[b], 0], legs, scratch)
        frames[s, 0] = frames[s, 1]
        frames[s, 1, :3] = root[b]
        for j in range(joints):
            frames[s, 1, 3 + 4 * j : 7 + 4 * j] = rotations[b, j]
        if row["fresh"] == 1.0:  # its appearance is no movement
            frames[s, 0] = frames[s, 1]
        displayed(step_s, row)


@kernel
def poses(
    slots: I64, chosen: I64, crowd: Crowd, curves: Curves, striding: bool, legs: Legs, root: F64, rotations: F64
) -> None:
    """Poses in the world of the characters ``slots[chosen]``, to rows ``chosen`` of ``root`` and ``rotations``.

    For characters without offsets: their poses follow from weights, phase and position. ``root`` is (B, 3),
    ``rotations`` (B, J, 4), both float64.
    """
    state, weights = crowd.state, crowd.weights
    size = chosen.shape[0]
    own, phases = np.empty((size, weights.shape[2])), np.empty(size)
    roots, turns = np.empty((size, 3)), np.empty((size, rotations.shape[1], 4))
    for c in range(size):
        row = state[slots[chosen[c]]]
        own[c], phases[c] = weights[slots[chosen[c]], row["weights"]], row["phase"]
    blend_sorted(own, phases, curves, roots, turns)
    scratch, feet = (np.zeros(4), np.empty(4)), np.empty((legs.chains.shape[0], SCRATCH))
    for c in range(size):
        row, b = state[slots[chosen[c]]], chosen[c]
        place((row["x"], row["y"], row["z"]), row["heading"], striding, roots[c], turns[c, 0], scratch)
        if row["footed"] > 0.0:
            plant(roots[c], turns[c], crowd.commands[slots[b], 0], legs, feet)
        root[b], rotations[b] = roots[c], turns[c]


@kernel
def redisplay(slots: I64, crowd: Crowd, curves: Curves, striding: bool, legs: Legs, frames: F64) -> None:
    """The last two frames (n, 2, 3 + 4·J), latest last, of characters that show weights, phase and position alone."""
    state, weights = crowd.state, crowd.weights
    rows, intervals, mode, references = curves
    shares, row, taps = np.empty((1, 4 * weights.shape[2])), np.empty((1, rows.shape[1])), np.empty(4)
    root, rotations, scratch = np.empty(3), np.empty((references.shape[0], 4)), (np.zeros(4), np.empty(4))
    where, feet = np.empty(1, np.int64), np.empty((legs.chains.shape[0], SCRATCH))
    for b in range(slots.shape[0]):
        s = slots[b]
        one = state[s]
        for k in range(2):
            if k == 1:
                which, phase = one["weights_1"], one["phase_1"]
                at, heading = (one["x_1"], one["y_1"], one["z_1"]), one["heading_1"]
            else:
                which, phase = one["weights_2"], one["phase_2"]
                at, heading = (one["x_2"], one["y_2"], one["z_2"]), one["heading_2"]
            where[0] = share(weights[s, which], phase, intervals, taps, shares[0])
            sums(shares, where, rows, row)
            finish_double(row[0], mode, references, root, rotations)
            place(at, heading, striding, root, rotations[0], scratch)
            if one["footed"] > 0.0:
                plant(root, rotations, crowd.commands[s, 1 - k], legs, feet)
            frames[b, k, :3] = root
            frames[b, k, 3:] = rotations.reshape(rotations.size)


@kernel
def _factors(u: float) -> tuple[float, float]:
    """Remaining share of an offset, and of a velocity times its duration, at a share (0 to 1) of a transition.

    Both start with the slopes 0 and 1, end at rest, and are parabolas and lines: the offset accelerates in the first
    0.3, decelerates in the last 0.3 and has constant speed between; the velocity is reversed to a half until 0.6,
    constant until 0.8, and decelerates. So accelerations stay within 100/21 x₀/T² and 5/2 v₀/T, speeds within
    10/7 x₀/T.
    """
    v = 1.0 - u
    if u < 0.3:
        keep = 1.0 - u * u / 0.42
    elif v > 0.3:
        keep = 1.0 - (u - 0.15) / 0.7
    else:
        keep = v * v / 0.42
    if u < 0.6:
        carry = u - 1.25 * u * u
    elif u < 0.8:
        carry = 0.45 - 0.5 * u
    else:
        carry = 1.25 * v * v
    return keep, carry


@kernel
def _decay(step_s: float, row: Any, offset: F64, rotation: F64, local: F64, root: F64, rotations: F64) -> None:
    """Add the offset of one character's transition to its pose; ``rotation`` and ``local`` (4,) are scratch."""
    row["since_s"] += step_s
    length = row["transition_s"]
    u = row["since_s"] / length
    if u >= 1.0 - 1e-9:
        row["transition_s"] = 0.0
        return
    keep, carry = _factors(u)
    carry *= length
    for a in range(3):
        root[a] += keep * offset[0, a] + carry * offset[1, a]
    for j in range(rotations.shape[0]):
        at = 3 + 3 * j
        vx = keep * offset[0, at] + carry * offset[1, at]
        vy = keep * offset[0, at + 1] + carry * offset[1, at + 1]
        vz = keep * offset[0, at + 2] + carry * offset[1, at + 2]
        angle = np.sqrt(vx * vx + vy * vy + vz * vz)
        scale = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        rotation[0], rotation[1], rotation[2] = scale * vx, scale * vy, scale * vz
        rotation[3] = np.cos(0.5 * angle)
        local[:] = rotations[j]
        multiply(rotation, local, rotations[j])


@kernel
def _decay_legs(row: Any, offset: F64, joints: int, away: F64) -> None:
    """Offsets (F, 5) of the legs of one character in a transition, with the bends where it began."""
    keep, passed = _factors(row["since_s"] / row["transition_s"])
    passed *= row["transition_s"]
    for f in range(away.shape[0]):
        at = 3 + 3 * joints + 5 * f
        for a in range(4):
            away[f, a] = keep * offset[0, at + a] + passed * offset[1, at + a]
        away[f, 4] = offset[0, at + 4]
