"""Stances of blends: when a foot stands, and where it is held, as functions of weights and phase.

A foot stands while the contact of one of its points in the blend, Σ wᵢ cᵢ over canonical time, is at least 1/2. During
a stance it is held at the place Σ wᵢ aᵢ where the examples' feet stand at its begin. Before a stance it approaches its
place, and after it leaves it, within :data:`RELEASE_S`.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F32, F64
from verbs.kernels.compile import kernel
from verbs.kernels.legs import GIVE, PELVIS, REACH_M
from verbs.kernels.pose import stride_to

__all__ = [
    "COLUMNS", "I8", "LONG_S", "PLACE", "RELEASE_S", "Plants", "between", "command", "contact_at", "crossing",
    "go_along", "move_place", "path_at", "place_at", "plan", "rotate_place", "shift", "smootherstep", "stance",
]  # fmt: skip

I8 = npt.NDArray[np.int8]

RELEASE_S = 0.25
"""Time in which a foot approaches and leaves its place; less where two stances are closer."""

LONG_S = 1e3
"""A time after which nothing is left."""

COLUMNS = 24
"""Of :class:`Plants`' track."""

PLACE = 8
"""Numbers of a place: x and z of heel, ball and tip, then the direction (unit x, z) of the foot."""

_PULLS, _HEIGHTS, _GROUND, _STAND, _PATH = 3, 6, 9, 10, 16


class Plants(NamedTuple):
    """Feet of a verb over canonical time: M intervals, N examples, F feet.

    Parameters
    ----------
    contact : (F, M + 1, 3, N) float32
        Contacts of heel, ball and tip; 0 of a point that a foot does not have.
    sure : (F, M + 1) int8
        1 where a point stands in all examples, -1 where none does in any, else 0.
    track : (F, M + 1, N, 24) float32
        Of heel, ball and tip: contacts, which fade in and out slowly; the same, which fade in slowly only; heights.
        Then, in the frame of the motion, of a striding root in that of its heading: the ground; where the foot is in
        the nearest stance (x and z of ball and tip, and direction); and where it is (x and z of heel, ball and tip, and
        direction).
    flat : (F, 2) float64
        Distances on the ground of a flat foot from heel to ball, and from ball to tip, metres.
    rises : (N, F, 2) float64
        Standing heights of heel and tip above that of the ball, metres.
    strides : (K, N, 4) float64
        Of the verb; (0, N, 4) where the root does not stride.
    looping : bool
    quiet : (3,) float64
        Phase of the effector's keytime, and the widths around it in which the pelvis stays, and in which a foot that
        carries the effector is free; 0 without.
    effector : int
        Foot that carries the effector, or -1; it is free at the keytime.
    """

    contact: F32
    sure: I8
    track: F32
    flat: F64
    rises: F64
    strides: F64
    looping: bool
    quiet: F64
    effector: int


@kernel
def smootherstep(u: float) -> float:
    """Quintic from 0 to 1 over [0, 1], constant outside."""
    u = min(max(u, 0.0), 1.0)
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


@kernel
def contact_at(plants: Plants, f: int, weights: F64, x: float) -> float:
    """Largest contact of the points of a foot in a blend, at sample position x, linear between samples."""
    contact, sure = plants.contact, plants.sure
    last = sure.shape[1] - 1
    k = int(np.floor(x))
    u = x - k
    a = k % last if plants.looping else min(max(k, 0), last)
    b = a if u == 0.0 else min(a + 1, last)
    if sure[f, a] == sure[f, b] and sure[f, a] != 0:
        return 1.0 if sure[f, a] > 0 else 0.0
    here, there = np.zeros(3), np.zeros(3)
    for i in range(weights.shape[0]):
        for point in range(3):
            here[point] += weights[i] * contact[f, a, point, i]
            there[point] += weights[i] * contact[f, b, point, i]
    return (1.0 - u) * max(here[0], here[1], here[2]) + u * max(there[0], there[1], there[2])


@kernel
def crossing(plants: Plants, f: int, weights: F64, x: float, way: int, limit: float) -> float:
    """Sample position, from x in direction ``way`` (±1), where the contact crosses 1/2; NaN beyond ``limit`` samples.

    A motion that does not loop has none beyond its ends.
    """
    contact, sure, looping = plants.contact, plants.sure, plants.looping
    old = contact_at(plants, f, weights, x)
    inside, before, last, c = old >= 0.5, x, sure.shape[1] - 1, 0.0
    k = int(np.floor(x)) + 1 if way > 0 else int(np.ceil(x)) - 1
    row = k % last if looping else k
    while abs(before - x) < limit and (looping or 0 <= k <= last):
        if sure[f, row] != 0:
            c = 1.0 if sure[f, row] > 0 else 0.0
        else:
            heel, ball, tip = 0.0, 0.0, 0.0
            for i in range(weights.shape[0]):
                heel += weights[i] * contact[f, row, 0, i]
                ball += weights[i] * contact[f, row, 1, i]
                tip += weights[i] * contact[f, row, 2, i]
            c = max(heel, ball, tip)
        if (c >= 0.5) != inside:
            return before + (k - before) * (0.5 - old) / (c - old)
        old, before, k, row = c, float(k), k + way, row + way
        if looping:
            row = 0 if row >= last else last - 1 if row < 0 else row
    return np.nan


@kernel
def _track(plants: Plants, f: int, weights: F64, x: float, first: int, out: F64) -> None:
    """Values of the track of one foot from column ``first`` on, at sample position x: cubics through the samples."""
    track, size, looping = plants.track, out.shape[0], plants.looping
    last = track.shape[1] - 1
    k = int(np.floor(x))
    u = x - k
    v = 1.0 - u
    ta, tb = -0.5 * u * v * v, 1.0 + u * u * (1.5 * u - 2.5)
    tc, td = 1.0 + v * v * (1.5 * v - 2.5), -0.5 * v * u * u
    a, b = _sample(k - 1, last, looping), _sample(k, last, looping)
    c, d = _sample(k + 1, last, looping), _sample(k + 2, last, looping)
    for j in range(size):
        out[j] = 0.0
    for i in range(weights.shape[0]):
        wa, wb, wc, wd = ta * weights[i], tb * weights[i], tc * weights[i], td * weights[i]
        for j in range(size):
            at = first + j
            out[j] += (
                wa * track[f, a, i, at] + wb * track[f, b, i, at] + wc * track[f, c, i, at] + wd * track[f, d, i, at]
            )


@kernel
def _sample(k: int, last: int, looping: bool) -> int:
    """Sample k of 0 … ``last``: of a loop, in its cycle; otherwise the nearest."""
    return k % last if looping else min(max(k, 0), last)


@kernel
def place_at(plants: Plants, weights: F64, f: int, x: float, now: float, out: F64) -> None:
    """Place (8,) of a foot that stands at sample position x, in the frame of the root at position ``now``.

    The frames are one where the root does not stride.
    """
    row = np.empty(_PATH - _STAND)
    _track(plants, f, weights, x, _STAND, row)
    size = max(np.sqrt(row[4] ** 2 + row[5] ** 2), 1e-9)
    dx, dz = row[4] / size, row[5] / size
    tx, tz = row[2] - row[0], row[3] - row[1]
    size = np.sqrt(tx * tx + tz * tz)
    tx, tz = (tx / size, tz / size) if size > 1e-3 else (dx, dz)
    back, ahead = plants.flat[f, 0], plants.flat[f, 1]
    out[0], out[1] = row[0] - back * dx, row[1] - back * dz
    out[2], out[3] = row[0], row[1]
    out[4], out[5] = row[0] + ahead * tx, row[1] + ahead * tz
    out[6], out[7] = dx, dz
    shift(plants, weights, x, now, out)


@kernel
def path_at(plants: Plants, weights: F64, f: int, x: float, now: float, out: F64) -> None:
    """Where the examples have a foot at sample position x, standing or not; otherwise as :func:`place_at`."""
    _track(plants, f, weights, x, _PATH, out)
    size = max(np.sqrt(out[6] ** 2 + out[7] ** 2), 1e-9)
    out[6], out[7] = out[6] / size, out[7] / size
    shift(plants, weights, x, now, out)


@kernel
def go_along(here: F64, there: F64, place: F64) -> None:
    """Move a place as a path goes from the place ``there`` to the place ``here``."""
    for a in range(6):
        place[a] += here[a] - there[a]
    cosine, sine = here[6] * there[6] + here[7] * there[7], here[6] * there[7] - here[7] * there[6]
    dx, dz = place[6], place[7]
    place[6], place[7] = dx * cosine + dz * sine, -dx * sine + dz * cosine


@kernel
def rotate_place(place: F64, cosine: float, sine: float) -> None:
    """Turn a place about the origin, by an angle about +Y."""
    for a in range(0, PLACE, 2):
        x, z = place[a], place[a + 1]
        place[a], place[a + 1] = x * cosine + z * sine, z * cosine - x * sine


@kernel
def move_place(place: F64, x: float, z: float) -> None:
    """Move the points of a place."""
    for a in range(0, 6, 2):
        place[a] += x
        place[a + 1] += z


@kernel
def shift(plants: Plants, weights: F64, x: float, now: float, place: F64) -> None:
    """Take a place (8,) from the frame of a striding root at sample position x to that at ``now``."""
    strides = plants.strides
    if strides.shape[0] == 0 or x == now:
        return
    count = plants.contact.shape[1] - 1
    low, high = min(x, now) / count, max(x, now) / count
    whole = 1.0 - np.floor(low)
    gone = np.zeros(4)
    stride_to(weights, strides, low + whole, high + whole, True, gone)
    cosine, sine = np.cos(gone[2]), np.sin(gone[2])
    if x > now:
        rotate_place(place, cosine, sine)
        move_place(place, gone[0], gone[1])
    else:
        move_place(place, -gone[0], -gone[1])
        rotate_place(place, cosine, -sine)


@kernel
def stance(plants: Plants, weights: F64, f: int, x: float, out: F64) -> None:
    """Place (8,) of the stance that sample position x is in, in the frame of the root there."""
    looping, count = plants.looping, plants.contact.shape[1] - 1
    begin = crossing(plants, f, weights, x, -1, float(count))
    if np.isnan(begin):
        begin = 0.0 if not looping else float(count * np.floor(x / count))
    place_at(plants, weights, f, begin, x, out)


@kernel
def _quiet(plants: Plants, x: float, width: float) -> float:
    """1 at the effector's keytime, 0 farther than a width from it."""
    if width <= 0.0:
        return 0.0
    away = x / (plants.contact.shape[1] - 1) - plants.quiet[0]
    if plants.looping:
        away -= np.round(away)
    return 1.0 - smootherstep(abs(away) / width)


@kernel
def command(
    plants: Plants, weights: F64, f: int, x: float, hold: float, fade: float, y: float, place: F64, out: F64
) -> None:
    """Write a command (23,) to hold a foot at a place (8,); ``y`` is the height of the ground below the root."""
    row = np.empty(_STAND)
    free = 1.0 - _quiet(plants, x, plants.quiet[2]) if f == plants.effector else 1.0
    _track(plants, f, weights, x, 0, row)
    heel, tip = 0.0, 0.0
    for i in range(weights.shape[0]):
        heel += weights[i] * plants.rises[i, f, 0]
        tip += weights[i] * plants.rises[i, f, 1]
    out[0] = hold * free
    out[1 : 1 + PLACE] = place
    ground = row[_GROUND] + y
    out[15], out[16], out[17] = ground + heel, ground, ground + tip
    for a in range(3):
        out[9 + a] = smootherstep(2.0 * row[a]) * free * fade
        out[12 + a] = row[_HEIGHTS + a] + y
        out[18 + a] = smootherstep(2.0 * row[_PULLS + a] - 0.5) * (1.0 if a == 1 else fade)
    out[PELVIS], out[GIVE] = 1.0 - _quiet(plants, x, plants.quiet[1]), REACH_M


@kernel
def between(a: F64, b: F64, share: float, out: F64) -> None:
    """A place (8,) between two others."""
    for k in range(PLACE):
        out[k] = (1.0 - share) * a[k] + share * b[k]
    size = np.sqrt(out[6] ** 2 + out[7] ** 2)
    if size < 1e-3:
        out[6], out[7] = b[6], b[7]
    else:
        out[6], out[7] = out[6] / size, out[7] / size


@kernel
def _look(plants: Plants, weights: F64, f: int, x: float, rate: float, place: F64, found: F64) -> float:
    """Plan one foot at sample position x from weights alone: its place (8,), and the share to which it is held.

    ``found`` (4, 8) is scratch. Returns the share; ``place`` is written even where it
    is 0.
    """
    count = plants.contact.shape[1] - 1
    if contact_at(plants, f, weights, x) >= 0.5:
        stance(plants, weights, f, x, place)
        return 1.0
    limit = RELEASE_S / max(rate, 1e-9) * count
    after = crossing(plants, f, weights, x, 1, limit)
    before = crossing(plants, f, weights, x, -1, limit)
    since = LONG_S if np.isnan(before) else (x - before) / count * rate
    left = LONG_S if np.isnan(after) else (after - x) / count * rate
    if since >= RELEASE_S and left >= RELEASE_S:
        place_at(plants, weights, f, x, x, place)
        return 0.0
    gap = max(min(RELEASE_S, since + left), 1e-6)
    leaving, coming = 1.0 - smootherstep(since / gap), 1.0 - smootherstep(left / gap)
    path_at(plants, weights, f, x, x, found[2])
    if since < RELEASE_S:
        stance(plants, weights, f, before - 1e-6, found[0])
        shift(plants, weights, before - 1e-6, x, found[0])
        path_at(plants, weights, f, before, x, found[3])
        go_along(found[2], found[3], found[0])
    if left < RELEASE_S:
        place_at(plants, weights, f, after, x, found[1])
        path_at(plants, weights, f, after, x, found[3])
        go_along(found[2], found[3], found[1])
    if since >= RELEASE_S:
        place[:] = found[1]
        return coming
    if left >= RELEASE_S:
        place[:] = found[0]
        return leaving
    total = max(leaving + coming, 1e-12)
    between(found[0], found[1], coming / total, place)
    return min(leaving + coming, 1.0)


@kernel
def plan(weights: F64, phases: F64, rates: F64, plants: Plants, commands: F64) -> None:
    """Commands of poses whose weights do not change during the motion.

    Parameters
    ----------
    weights : (B, N) float64
    phases : (B,) float64
        Of a loop also beyond 1.
    rates : (B,) float64
        Seconds per unit of phase there.
    plants : Plants
    commands : (B, F, 23) float64
        Written, see :data:`verbs.kernels.legs.COMMAND`; in the frame of the motion, of a striding root in that of its
        heading.
    """
    count = plants.contact.shape[1] - 1
    place, found = np.empty(PLACE), np.empty((4, PLACE))
    for b in range(weights.shape[0]):
        x = phases[b] * count
        for f in range(plants.contact.shape[0]):
            hold = _look(plants, weights[b], f, x, rates[b], place, found)
            command(plants, weights[b], f, x, hold, 1.0, 0.0, place, commands[b, f])
