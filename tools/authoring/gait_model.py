"""Parameters of a walk or a run of the humanoid, and the timeline of a cycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tools.authoring.steps import Path
from verbs.conventions import F64

__all__ = ["GRAVITY", "KEYTIME_NAMES", "SIDES", "STRIDES", "Contacts", "Gait", "Timeline", "lean_of"]

GRAVITY = 9.81
STRIDES = 2
"""Strides of a cycle; they differ a little."""

KEYTIME_NAMES = ["left strike 1", "right strike 1", "left strike 2", "right strike 2", "end of cycle"]

SIDES = (("Left", 1.0), ("Right", -1.0))
"""Names of the sides, and the sign of their X."""

Contacts = dict[tuple[str, str], list[tuple[float, float]]]
"""Intervals, s, in which a part of a foot stands, by foot joint and part."""


class Timeline(NamedTuple):
    """Frames of a cycle.

    Parameters
    ----------
    times : (F,) float64
        Seconds.
    phase : (F,) float64
        Unwrapped phase of the pelvis: whole where the left foot strikes.
    strikes : (2, 2) float64
        When each foot strikes, by stride and side.
    length : float
        Of the cycle, s.
    drift : (6, F) float64
        Slow factors about 1, by which amplitudes differ from stride to stride.
    """

    times: F64
    phase: F64
    strikes: F64
    length: float
    drift: F64


@dataclass(frozen=True, slots=True)
class Gait:
    """One manner of walking or running; lengths in metres, angles in degrees, phases as shares of a stride.

    Phases count from the strike of the left foot.

    Parameters
    ----------
    stride_s, duty : float
        Time from strike to strike of one foot, and its share in which the foot stands.
    width, turn_out : float
        Distance of the feet, and how far they point outward.
    ahead : float
        How far before the hip a foot stands in the middle of its stance.
    strike, flat, heel_off, push, trail, fold, swing, late : float
        Pitch of the foot when it strikes; phases between which it is flat; pitch when it leaves the ground, just
        after it, twice in the swing, and shortly before the strike. Toes up is positive.
    early_lift, late_lift, early_ahead, late_ahead : float
        See :class:`tools.authoring.steps.Swing`.
    out : float
        How far a foot swings outward, past the other leg.
    knee, dip : float
        Bend of the straightest knee; how deep the pelvis of a walk dips for it.
    rise, rise_at : float
        Half the vertical range of the pelvis, and the phase of its greatest height; for walks.
    flight : bool
        Whether the height is that of a run.
    surge, surge_at, sway, sway_at : float
        The same forward and to the side of the left foot.
    tilt, list, list_at, yaw, yaw_at : float
        Pelvis: forward tilt; how far the standing side rises; how far the leading side turns forward, and phases.
    lean, chest_yaw, chest_at : float
        Trunk: forward lean; how far the chest turns against the pelvis.
    arm, arm_mean, arm_at, elbow, elbow_swing, abduct, twist : float
        Arms: half their arc, its middle, and the phase at which the right arm is foremost; bend of the elbow, how
        much more it bends in front; distance from the body; how far the forearm points inward.
    shrug, head, look : float
        Height of the shoulders, pitch of the head (down is positive), and how far ahead of a turn it looks, s.
    curl : float
        How far the fingers are closed, 0 to 1.
    wave : float
        Size of the wave after a landing.
    lift_chest : float
        How far the chest is held up between lean of the hips and that of the shoulders; negative slumps.
    """

    stride_s: float
    duty: float
    width: float = 0.10
    turn_out: float = 5.0
    ahead: float = 0.0
    strike: float = 17.0
    flat: float = 0.09
    heel_off: float = 0.32
    push: float = -50.0
    trail: float = -58.0
    fold: float = -35.0
    swing: float = 0.0
    late: float = 14.0
    early_lift: float = 0.06
    late_lift: float = 0.0
    early_ahead: float = 0.0
    late_ahead: float = 0.0
    out: float = 0.0
    knee: float = 4.0
    dip: float = 0.012
    rise: float = 0.022
    rise_at: float = 0.30
    flight: bool = False
    surge: float = 0.01
    surge_at: float = 0.12
    sway: float = 0.022
    sway_at: float = 0.30
    tilt: float = 5.0
    list: float = 4.0
    list_at: float = 0.16
    yaw: float = 4.5
    yaw_at: float = 0.0
    lean: float = 3.0
    chest_yaw: float = 5.0
    chest_at: float = 0.03
    arm: float = 16.0
    arm_mean: float = 2.0
    arm_at: float = 0.05
    elbow: float = 18.0
    elbow_swing: float = 8.0
    abduct: float = 9.0
    twist: float = 14.0
    shrug: float = 0.0
    head: float = 0.0
    look: float = 0.35
    curl: float = 0.0
    wave: float = 0.5
    lift_chest: float = 0.0


def lean_of(path: Path) -> float:
    """Inward lean of a body on a curve, rad, positive to the left: atan(v ω / g)."""
    return float(np.arctan(path.forward * path.turn / GRAVITY))
