"""Legs in a transition: the offset of a leg's line and bend decays, so that feet and knees move gently.

Offsets of hip and knee alone would take the foot anywhere, and overstretch knees that have been stretching fast.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.legs import Legs
from verbs.kernels.one_leg import STRAIGHTEST, bend_leg, find_leg, lengths, smoothstep, triple
from verbs.kernels.vectors import cross, dot, rotate

__all__ = ["carry", "lines"]

STOPPED, OVERSTRETCHED, BENT_SHARE = 0.75, 0.035, 0.3
"""Bend of a knee from which on a transition stretches it less than its offset would, and by which it overstretches one
at most, radians; share of a transition in which the bend decides."""

NEAR_M = 0.03
"""Difference of both lengths of a leg, of its line and of its bend, from which on the shorter one counts."""

FULL_OFFSET_M, NO_OFFSET_M = 0.1, 1e-9
"""Offsets of an ankle from which on that applies in full, and below which a leg is that of its motion."""


@kernel
def lines(root: Any, rotations: Any, legs: Legs, pose: F64, out: F64) -> None:
    """Lines from hip to ankle (3, metres) and signed bends of the knees (radians) of one pose, (F, 4).

    Lines are in the frame of ``root``; a bend is below 0 where the knee is overstretched.
    """
    for f in range(legs.chains.shape[0]):
        at = pose[f]
        find_leg(root, rotations, legs.chains[f], legs.offsets, at)
        upper = (at[5] - at[2], at[6] - at[3], at[7] - at[4])
        lower = (at[8] - at[5], at[9] - at[6], at[10] - at[7])
        axis = rotate((at[15], at[16], at[17], at[18]), *triple(legs.hinges[f]))
        out[f, 0], out[f, 1], out[f, 2] = upper[0] + lower[0], upper[1] + lower[1], upper[2] + lower[2]
        out[f, 3] = np.arctan2(dot(cross(upper, lower), axis), dot(upper, lower))


@kernel
def _kept(value: float, limit: float, end: float) -> float:
    """A number that approaches ``end`` beyond a limit below it, with a continuous slope."""
    room = end - limit
    return value if value <= limit or room <= 0.0 else end - room * np.exp((limit - value) / room)


@kernel
def _span(thigh: float, shin: float, bend: float) -> float:
    """Distance from hip to ankle at a bend of the knee."""
    return float(np.sqrt(thigh * thigh + shin * shin + 2.0 * thigh * shin * np.cos(bend)))


@kernel
def carry(root: Any, rotations: Any, legs: Legs, to: F64, away: F64, share: float, pose: F64) -> None:
    """Move the legs of a pose in a transition to offsets from those of its motion, in place.

    Hips, knees and feet keep the rotations that their offsets give them as far as that allows; no knee overstretches.
    A leg has the length of its bend at first, since a straight one would start to bend at once, and then the shorter
    one of its bend and its line.

    Parameters
    ----------
    root : (3,) floating
    rotations : (J, 4) floating
        Local rotations, offsets included; those of hips, knees and ankles change.
    legs : Legs
    to : (F, 4) float64
        Legs of the motion without offsets; see :func:`lines`.
    away : (F, 5) float64
        Offsets from them; and the bends where the transition began.
    share : float
        Of the transition that has passed.
    pose : (F, SCRATCH) float64
        Scratch.
    """
    ended = smoothstep(share)
    by_bend = 1.0 - smoothstep(share / BENT_SHARE)
    for f in range(legs.chains.shape[0]):
        out = pose[f]
        offset = np.sqrt(away[f, 0] ** 2 + away[f, 1] ** 2 + away[f, 2] ** 2)
        if offset < NO_OFFSET_M:
            continue
        foot = find_leg(root, rotations, legs.chains[f], legs.offsets, out)
        thigh, shin, _ = lengths(out)
        first = STOPPED + ended * min(to[f, 3] - STOPPED, 0.0)
        first = min(first, away[f, 4])
        x, y, z = to[f, 0] + away[f, 0], to[f, 1] + away[f, 1], to[f, 2] + away[f, 2]
        size = max(np.sqrt(x * x + y * y + z * z), 1e-9)
        limit = _span(thigh, shin, first)
        kept = _kept(size, limit, max(STRAIGHTEST * (thigh + shin), limit))
        full = smoothstep(offset / FULL_OFFSET_M)
        length = size + full * (kept - size)  # the motion itself may stretch a leg
        bend = -_kept(-to[f, 3] - away[f, 3], -first, max(-first, 0.0) + OVERSTRETCHED)
        bent = _span(thigh, shin, bend)
        soft = full * NEAR_M * smoothstep(5.0 * share) * smoothstep(5.0 * (1.0 - share))
        shorter = 0.5 * (length + bent - np.sqrt((length - bent) ** 2 + soft * soft))
        length = shorter + by_bend * (bent - shorter)
        out[0], out[1] = 1.0, 1.0
        scale = length / size
        out[23], out[24], out[25] = out[2] + scale * x, out[3] + scale * y, out[4] + scale * z
        out[26], out[27], out[28], out[29] = foot
        bend_leg(rotations, legs.chains[f], legs.hinges[f], out, 0.0, thigh + shin)
