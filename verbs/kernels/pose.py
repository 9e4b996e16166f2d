"""Parts of poses: curve sampling, rotations, forward kinematics, roots that stride; batches have a leading axis.

Curves are uniform cubic B-splines over canonical time, one row per coefficient and example:
``curves`` is (K + 3, N, 4 + 4·J) float32, where K is the number of intervals; a row contains the root position and a
zero, then one quaternion (or one rotation vector and a zero) per joint. Row k of the first axis weighs the phases
around (k - 1) / K.

Source: Rose, Sloan, Cohen 2001, equation 3; the rotation part as ``docs/math.md`` states it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels.compile import kernel

__all__ = [
    "ABSOLUTE",
    "NLERP",
    "ROTATION_VECTOR",
    "STRIDE",
    "forward",
    "global_rotations",
    "spline_taps",
    "stride_to",
    "travelled",
]

NLERP, ROTATION_VECTOR = range(2)
"""How rotations blend: normalised sums of quaternions, or exponentials of summed rotation vectors."""

ABSOLUTE, STRIDE = range(2)
"""How the root travels: as blended positions, or as blended steps in a turning frame."""

SHORTEST = 0.3
"""Length under which a sum of quaternions has lost its direction."""


@kernel
def spline_taps(phase: float, intervals: int, taps: F64) -> int:
    """Four B-spline weights at a phase in [0, 1], and the first coefficient row that they belong to."""
    x = phase * intervals
    k = int(np.floor(x))
    k = min(max(k, 0), intervals - 1)
    u = x - k
    v = 1.0 - u
    taps[0] = v * v * v / 6.0
    taps[1] = 2.0 / 3.0 - u * u + 0.5 * u * u * u
    taps[2] = 2.0 / 3.0 - v * v + 0.5 * v * v * v
    taps[3] = u * u * u / 6.0
    return k


@kernel
def multiply(a: F64, b: F64, out: F64) -> None:
    """Quaternion product of (4,) arrays; ``out`` may be neither of them."""
    out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1]
    out[1] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0]
    out[2] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3]
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]


@kernel
def add_rotated(q: F64, v: F64, out: F64) -> None:
    """Vector (3,) rotated by a unit quaternion (4,), added to ``out``."""
    x = 2.0 * (q[1] * v[2] - q[2] * v[1])
    y = 2.0 * (q[2] * v[0] - q[0] * v[2])
    z = 2.0 * (q[0] * v[1] - q[1] * v[0])
    out[0] += v[0] + q[3] * x + q[1] * z - q[2] * y
    out[1] += v[1] + q[3] * y + q[2] * x - q[0] * z
    out[2] += v[2] + q[3] * z + q[0] * y - q[1] * x


@kernel
def finish_rotation(mode: int, reference: F64, q: F64) -> float:
    """Convert a blended row (4,) into a unit quaternion, in place; return the length of the sum (1 for vectors).

    A sum shorter than 0.3 has lost its direction (examples cancel); its joint falls back to the reference.
    """
    if mode == ROTATION_VECTOR:
        angle = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
        scale = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        x, y, z, w = scale * q[0], scale * q[1], scale * q[2], np.cos(0.5 * angle)
        a, b, c, d = reference[0], reference[1], reference[2], reference[3]
        q[0] = d * x + a * w + b * z - c * y
        q[1] = d * y - a * z + b * w + c * x
        q[2] = d * z + a * y - b * x + c * w
        q[3] = d * w - a * x - b * y - c * z
        return 1.0
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if length < SHORTEST:
        q[:] = reference
    else:
        for a in range(4):
            q[a] /= length
    return length


@kernel
def forward(root: F64, rotations: F64, parents: I64, offsets: F64, global_rotations: F64, positions: F64) -> None:
    """Global rotations (B, J, 4) and positions (B, J, 3) of poses: root (B, 3), local rotations (B, J, 4)."""
    for b in range(root.shape[0]):
        global_rotations[b, 0] = rotations[b, 0]
        positions[b, 0] = root[b]
        for j in range(1, parents.shape[0]):
            parent = parents[j]
            multiply(global_rotations[b, parent], rotations[b, j], global_rotations[b, j])
            positions[b, j] = positions[b, parent]
            add_rotated(global_rotations[b, parent], offsets[j], positions[b, j])


@kernel
def global_rotations(rotations: Any, parents: I64, out: F64) -> None:
    """Global rotations (J, 4) of one pose's local ones (J, 4), of any precision."""
    for a in range(4):
        out[0, a] = rotations[0, a]
    for j in range(1, parents.shape[0]):
        multiply(out[parents[j]], rotations[j], out[j])


@kernel
def _step(weights: F64, strides: F64, k: int) -> tuple[float, float, float, float]:
    """Blended step of interval k, which wraps around: sideways, forward (m), turn (rad), rise (m)."""
    row = k % strides.shape[0]
    side, ahead, turn, rise = 0.0, 0.0, 0.0, 0.0
    for i in range(weights.shape[0]):
        side += weights[i] * strides[row, i, 0]
        ahead += weights[i] * strides[row, i, 1]
        turn += weights[i] * strides[row, i, 2]
        rise += weights[i] * strides[row, i, 3]
    return side, ahead, turn, rise


@kernel
def _part(u: float, step: float, before: float, after: float) -> float:
    """Part of a step covered at u in [0, 1], smooth across neighbours: a cubic through both ends."""
    v = 1.0 - u
    start, end = 0.5 * (before + step), 0.5 * (step + after)
    return u * u * (3.0 - 2.0 * u) * step + u * v * (v * start - u * end)


@kernel
def _advance(location: F64, side: float, ahead: float, turn: float, rise: float) -> None:
    """Move a location (x, z, heading, height) by a step in the frame of its heading half way."""
    middle = location[2] + 0.5 * turn
    cosine, sine = np.cos(middle), np.sin(middle)
    location[0] += side * cosine + ahead * sine
    location[1] += ahead * cosine - side * sine
    location[2] += turn
    location[3] += rise


@kernel
def stride_to(weights: F64, strides: F64, start: float, end: float, looping: bool, location: F64) -> None:
    """Walk one character from phase ``start`` to phase ``end`` ≥ start (both unwrapped: 1.5 is mid second cycle).

    ``strides`` (K, N, 4) are the examples' steps per interval in the frame of their own heading: sideways, forward,
    turn, rise. ``location`` (4,) is x, z, heading and height, and is moved. Steps are joined by a cubic whose ends
    share their neighbours' mean speed, so that position and velocity are continuous, across the seam of a loop too.
    """
    intervals = strides.shape[0]
    at, stop = start * intervals, end * intervals
    if at >= stop - 1e-12:
        return
    k = int(np.floor(at + 1e-12))
    step = _step(weights, strides, k)
    before = _step(weights, strides, k - 1) if looping or k > 0 else step
    while at < stop - 1e-12:
        upto = min(float(k + 1), stop)
        after = _step(weights, strides, k + 1) if looping or k < intervals - 1 else step
        u, v = min(max(at - k, 0.0), 1.0), min(max(upto - k, 0.0), 1.0)
        _advance(
            location,
            _part(v, step[0], before[0], after[0]) - _part(u, step[0], before[0], after[0]),
            _part(v, step[1], before[1], after[1]) - _part(u, step[1], before[1], after[1]),
            _part(v, step[2], before[2], after[2]) - _part(u, step[2], before[2], after[2]),
            _part(v, step[3], before[3], after[3]) - _part(u, step[3], before[3], after[3]),
        )
        before, step = step, after
        at = upto
        k += 1


@kernel
def _walk_cycles(weights: F64, strides: F64, cycles: int, once: F64, location: F64) -> None:
    """Walk whole cycles from the origin; all have the displacement of the first, ``once`` (4,), which is scratch."""
    once[:] = 0.0
    stride_to(weights, strides, 0.0, 1.0, True, once)
    for _ in range(cycles):
        cosine, sine = np.cos(location[2]), np.sin(location[2])
        location[0] += once[0] * cosine + once[1] * sine
        location[1] += -once[0] * sine + once[1] * cosine
        location[2] += once[2]
        location[3] += once[3]


@kernel
def travel(weights: F64, strides: F64, phases: F64, looping: bool, one_walk: bool, root: F64, rotations: F64) -> None:
    """Move poses of a striding verb in the world: each from phase 0, or, in ``one_walk``, from the previous one.

    ``phases`` (B,) are unwrapped, and rise in one walk. ``root`` (B, 3) has heights above the ground, to which the
    rise is added; x and z are written. ``rotations`` (B, J, 4) have root rotations without heading; the heading is
    multiplied from the left.
    """
    location, once, heading, local = np.empty(4), np.empty(4), np.zeros(4), np.empty(4)
    for b in range(weights.shape[0]):
        start = 0.0
        if one_walk and b > 0:
            start = phases[b - 1]
        else:
            location[:] = 0.0
            if looping and phases[b] >= 2.0:
                start = np.floor(phases[b])
                _walk_cycles(weights[b], strides, int(start), once, location)
        stride_to(weights[b], strides, start, phases[b], looping, location)
        root[b, 0], root[b, 2] = location[0], location[1]
        root[b, 1] += location[3]
        heading[1], heading[3] = np.sin(0.5 * location[2]), np.cos(0.5 * location[2])
        local[:] = rotations[b, 0]
        multiply(heading, local, rotations[b, 0])


def travelled(weights: F64, strides: F64, phases: F64, *, looping: bool) -> F64:
    """Places (B, 4) of a striding root's frame along one walk: x, z (m), heading (rad, unwrapped), height (m)."""
    size = len(phases)
    root, rotations = np.zeros((size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (size, 1, 1))
    travel(weights, strides, phases, looping, True, root, rotations)
    heading = np.unwrap(2.0 * np.arctan2(rotations[:, 0, 1], rotations[:, 0, 3]))
    return np.stack([root[:, 0], root[:, 2], heading, root[:, 1]], axis=-1)


@kernel
def velocity(weights: F64, strides: F64, phase: float, rate: float, looping: bool, out: F64) -> None:
    """Velocity (3,) of a striding root in its heading frame: sideways, forward (m/s), turn (rad/s).

    ``rate`` is seconds per unit of phase there.
    """
    intervals = strides.shape[0]
    x = phase * intervals
    k = min(max(int(np.floor(x)), 0), intervals - 1)
    u = x - k
    step = _step(weights, strides, k)
    before = _step(weights, strides, k - 1) if looping or k > 0 else step
    after = _step(weights, strides, k + 1) if looping or k < intervals - 1 else step
    for a in range(3):
        start, end = 0.5 * (before[a] + step[a]), 0.5 * (step[a] + after[a])
        slope = 6.0 * u * (1.0 - u) * step[a] + (1.0 - u) * (1.0 - 3.0 * u) * start + u * (3.0 * u - 2.0) * end
        out[a] = slope * intervals / rate
