"""Modes of a foot of a moving character: it stands, swings, stays on its way, steps or leaves.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from verbs.conventions import F64
from verbs.kernels.compile import kernel
from verbs.kernels.foot_state import (
    LEAVE,
    STANCE,
    STAY,
    STEP,
    SWING,
    load_next,
    load_place,
    store_next,
    store_place,
    to_world,
)
from verbs.kernels.legs import REACH_M
from verbs.kernels.stances import (
    LONG_S,
    PLACE,
    RELEASE_S,
    Plants,
    between,
    contact_at,
    crossing,
    go_along,
    path_at,
    place_at,
    shift,
    smootherstep,
    stance,
)

__all__ = [
    "CHECKED",
    "FADE_S",
    "LATER",
    "LONGEST_S",
    "Step",
    "appear",
    "arrive",
    "compare",
    "depart",
    "giving",
    "stay",
    "step_on",
    "swing",
]


class Step(NamedTuple):
    """One step of a character.

    Parameters
    ----------
    step_s, moved_s : float
        Seconds that passed, and by which its motion moved.
    rate : float
        Seconds per unit of phase.
    way : int
        1 forwards, -1 backwards.
    before : float
        Sample position before the step; unwrapped, so that it is next to the one after.
    """

    step_s: float
    moved_s: float
    rate: float
    way: int
    before: float


STEP_S, STEP_SHARE, LANDING_S = 0.36, 0.5, 0.2
"""Time of a step, or its share of a longer transition; time in which a foot whose stance begins at once takes its
place."""

STEP_M, STEP_RAD, LEAP_M, STRIDE_M = 0.03, 0.2, 1.0, 0.2
"""A standing foot makes a step from the first distance and angle on; from the third one, and from the last one where
the root strides on, even while another foot does."""

CARRIED_M = 0.35
"""A foot that stands farther from its place in the next motion does not step: the transition takes it there."""

LANDED_M = 0.12
"""Distance from its place within which an approaching foot has landed."""

MOST_M_S2 = 60.0
"""Acceleration with which a foot moves from a place to another at most."""

STEP_RISE, MOST_RISE_M = 0.2, 0.08
"""Height of a step as a share of its length, and at most."""

CHECKED = 6
"""Frames between two comparisons of a standing foot with its motion."""

FADE_S = 0.3
"""Shortest time in which heights and places are taken over after a transition begins."""

STAY_M, STAY_RAD = 0.01, 0.1
"""A foot whose next place is within these distances of the one before stays on its way: one that a blend with a gait
lifts by a little, or not at all, does not creep between places that hardly differ."""

GIVE_M, GIVES_S, GIVEN_S = 0.03, 0.1, 0.4
"""How much sooner than else a leg gives way in a transition or a step, so that its knee stops in more time; the times
in which that begins and ends."""

LATER = 0.6
"""Share of a transition after which it takes over places and heights of a foot that did not stand."""

LONGEST_S = 0.5
"""Longest time in which a foot leaves its place."""

NEAR = 0.98
"""Share of the next place from which on a foot has arrived."""

FASTEST = 2.5
"""Largest change of that share in the time of a release; the smooth curve's is 1.875."""


@kernel
def appear(foot: Any, row: Any, plants: Plants, weights: F64, f: int, rate: float, place: F64, found: F64) -> None:
    """Set the state of a foot from the plan."""
    count = plants.contact.shape[1] - 1
    x = row["phase"] * count
    foot["near"], foot["fade"], foot["frames"], foot["since_s"], foot["give"] = 0.0, 1.0, 0, LONG_S, 2.0
    foot["mode"] = STANCE if contact_at(plants, f, weights, x) >= 0.5 else SWING
    if foot["mode"] == STANCE:
        stance(plants, weights, f, x, place)
        to_world(row, place)
        store_place(foot, place)
        return
    limit = RELEASE_S / max(rate, 1e-9) * count
    before = crossing(plants, f, weights, x, -1, limit)
    after = crossing(plants, f, weights, x, 1, limit)
    if not np.isnan(before):
        foot["since_s"] = (x - before) / count * rate
        stance(plants, weights, f, before - 1e-6, place)
        shift(plants, weights, before - 1e-6, x, place)
        path_at(plants, weights, f, x, x, found[0])
        path_at(plants, weights, f, before, x, found[1])
        go_along(found[0], found[1], place)
        to_world(row, place)
        store_place(foot, place)
    if not np.isnan(after):
        left = (after - x) / count * rate
        foot["near"] = 1.0 - smootherstep(left / max(min(RELEASE_S, foot["since_s"] + left), 1e-6))


@kernel
def _begin_step(foot: Any, held: float, length_s: float, rise: float) -> None:
    """Let a foot go from its place to the next one."""
    foot["mode"], foot["since_s"], foot["near"] = STEP, 0.0, held
    foot["length_s"], foot["rise"] = length_s, rise


@kernel
def _ends_within(plants: Plants, f: int, weights: F64, x: float, step: Step, seconds: float) -> bool:
    """Whether the stance at a sample position ends within a time."""
    limit = seconds / max(step.rate, 1e-9) * (plants.contact.shape[1] - 1)
    return step.moved_s > 0.0 and not np.isnan(crossing(plants, f, weights, x, step.way, limit))


@kernel
def compare(feet: Any, f: int, row: Any, plants: Plants, weights: F64, x: float, step: Step, place: F64) -> None:
    """Begin a step where a standing foot is too far from the place that its motion has for it."""
    foot, begins = feet[f], feet[f]["frames"] > CHECKED
    foot["frames"] = 0
    stance(plants, weights, f, x, place)
    to_world(row, place)
    away = np.sqrt((place[2] - foot["ball_x"]) ** 2 + (place[3] - foot["ball_z"]) ** 2)
    sine, cosine = place[6] * foot["dz"] - place[7] * foot["dx"], place[6] * foot["dx"] + place[7] * foot["dz"]
    turned = abs(np.arctan2(sine, cosine))
    if away < STEP_M and turned < STEP_RAD:
        return
    if begins and away > CARRIED_M:
        foot["mode"], foot["since_s"], foot["near"], foot["fade"] = SWING, LONG_S, 0.0, -LATER
        return
    leap = STRIDE_M if plants.strides.shape[0] > 0 else LEAP_M
    for other in range(feet.shape[0]):
        if other != f and feet[other]["mode"] != STANCE and away < leap:
            return
    length_s = max(STEP_S, STEP_SHARE * row["transition_s"])
    if _ends_within(plants, f, weights, x, step, length_s):
        foot["mode"], foot["since_s"], foot["near"] = LEAVE, 0.0, 0.0  # its stance ends before a step would
        return
    store_next(foot, place)
    _begin_step(foot, 1.0, length_s, min(MOST_RISE_M, STEP_M + STEP_RISE * (away + 0.1 * turned)))


@kernel
def _needed_s(here: F64, there: F64) -> float:
    """Time in which a foot moves between two places."""
    away = np.sqrt((here[2] - there[2]) ** 2 + (here[3] - there[3]) ** 2)
    return min(LONGEST_S, np.sqrt(5.8 * away / MOST_M_S2))


@kernel
def swing(
    foot: Any,
    row: Any,
    plants: Plants,
    weights: F64,
    f: int,
    x: float,
    origin: float,
    step: Step,
    place: F64,
    found: F64,
) -> float:
    """Move a foot that does not stand from a sample position, ``origin``, to x.

    Returns the share to which it is held at ``place`` (8,).
    """
    count = plants.contact.shape[1] - 1
    foot["since_s"] += step.moved_s
    after = np.nan
    if foot["mode"] == SWING:
        after = crossing(plants, f, weights, x, step.way, RELEASE_S / max(step.rate, 1e-9) * count)
    left = LONG_S if np.isnan(after) else abs(after - x) / count * step.rate
    gap = max(min(RELEASE_S, foot["since_s"] + left), 1e-6)
    path_at(plants, weights, f, x, x, found[2])
    if left < RELEASE_S:
        place_at(plants, weights, f, after, x, found[1])
        path_at(plants, weights, f, after, x, found[3])
        go_along(found[2], found[3], found[1])
        to_world(row, found[1])
        store_next(foot, found[1])
    leaving = 0.0
    if foot["since_s"] < LONGEST_S:
        path_at(plants, weights, f, origin, x, found[3])
        to_world(row, found[2])
        to_world(row, found[3])
        load_place(foot, found[0])
        go_along(found[2], found[3], found[0])
        store_place(foot, found[0])
        leaving = 1.0 - smootherstep(foot["since_s"] / max(gap, _needed_s(found[0], found[2])))
    load_next(foot, found[1])
    fastest = FASTEST * step.moved_s / max(gap, leaving * _needed_s(found[0], found[1]))
    coming = smootherstep(foot["fade"]) * (1.0 - smootherstep(left / gap)) if left < RELEASE_S else 0.0
    coming = min(max(coming, foot["near"] - fastest), foot["near"] + fastest)
    foot["near"] = coming
    if coming <= 0.0:
        place[:] = found[0]
    elif leaving <= 0.0:
        place[:] = found[1]
    else:
        between(found[0], found[1], coming / (leaving + coming), place)
    return min(leaving + coming, 1.0)


@kernel
def _stays(plants: Plants, weights: F64, f: int, ended: float, way: int, found: F64) -> bool:
    """Whether a foot whose stance ended at a sample position stands next where it stood."""
    if f == plants.effector:
        return False
    after = crossing(plants, f, weights, ended + way * 1e-3, way, plants.contact.shape[1] - 1.0)
    if np.isnan(after):
        return False
    stance(plants, weights, f, ended - way * 1e-3, found[0])
    place_at(plants, weights, f, after, ended, found[1])
    away = np.sqrt((found[0, 2] - found[1, 2]) ** 2 + (found[0, 3] - found[1, 3]) ** 2)
    sine = found[0, 6] * found[1, 7] - found[0, 7] * found[1, 6]
    return away < STAY_M and abs(sine) < STAY_RAD and found[0, 6] * found[1, 6] + found[0, 7] * found[1, 7] > 0.0


@kernel
def stay(
    foot: Any, row: Any, plants: Plants, weights: F64, f: int, x: float, origin: float, place: F64, found: F64
) -> None:
    """Move a foot and its place along the path of its motion; one that its motion has elsewhere by now swings."""
    path_at(plants, weights, f, x, x, found[2])
    path_at(plants, weights, f, origin, x, found[3])
    to_world(row, found[2])
    to_world(row, found[3])
    load_place(foot, place)
    go_along(found[2], found[3], place)
    store_place(foot, place)
    if np.sqrt((place[2] - found[2, 2]) ** 2 + (place[3] - found[2, 3]) ** 2) > 2.0 * STEP_M:
        foot["mode"], foot["since_s"], foot["near"] = SWING, 0.0, 0.0


@kernel
def step_on(foot: Any, step_s: float, place: F64, found: F64) -> tuple[float, float]:
    """Move a foot along its step; return the share to which it is held at ``place`` (5,), and how high it is."""
    foot["since_s"] += step_s
    u = min(max(foot["since_s"] / foot["length_s"], 0.0), 1.0)
    share = smootherstep(u)
    load_place(foot, found[0])
    load_next(foot, found[1])
    between(found[0], found[1], share, place)
    held = foot["near"] + (1.0 - foot["near"]) * share
    if u >= 1.0:
        foot["mode"], foot["frames"] = STANCE, 0
        store_place(foot, found[1])
    return held, foot["rise"] * 16.0 * (u * (1.0 - u)) ** 2


@kernel
def giving(foot: Any, steps: bool, passes: bool, step_s: float) -> float:
    """Distance from its reach at which a leg begins to give way: none where a transition begins, then more.

    ``give`` goes from 0 at the begin of a transition to 1, stays there while that passes or the character makes a step,
    and then to 2.
    """
    at = foot["give"]
    if at < 1.0:
        foot["give"] = min(at + step_s / GIVES_S, 1.0)
        return (REACH_M + GIVE_M) * smootherstep(foot["give"])
    more = steps or (passes and at == 1.0)
    foot["give"] = max(at - step_s / GIVES_S, 1.0) if more else min(at + step_s / GIVEN_S, 2.0)
    return REACH_M + GIVE_M * (1.0 - smootherstep(foot["give"] - 1.0))


@kernel
def depart(foot: Any, plants: Plants, weights: F64, f: int, x: float, step: Step, found: F64) -> float:
    """End the stance of a foot; return the sample position at which it ended."""
    count = plants.contact.shape[1] - 1
    if foot["frames"] >= CHECKED:  # a transition begins: its offset takes the foot from its place to its motion
        foot["mode"], foot["since_s"], foot["near"] = SWING, LONG_S, 0.0
        return step.before
    foot["mode"], foot["since_s"], foot["near"] = SWING, 0.0, 0.0
    ended = crossing(plants, f, weights, x, -step.way, abs(x - step.before) + 1.0)
    if np.isnan(ended) or (ended - step.before) * step.way < 0.0:  # its weights changed, or its verb
        return step.before
    if _stays(plants, weights, f, ended, step.way, found):
        foot["mode"] = STAY
    foot["since_s"] = abs(x - ended) / count * step.rate - step.moved_s  # the step is still to be added
    return ended


@kernel
def arrive(
    foot: Any, row: Any, plants: Plants, weights: F64, f: int, x: float, step: Step, last: F64, place: F64
) -> None:
    """Begin the stance of a foot: at once where it is in its place, or else within a while."""
    stance(plants, weights, f, x, place)
    to_world(row, place)
    away = np.sqrt((place[2] - last[3]) ** 2 + (place[3] - last[4]) ** 2)
    held = last[0] if foot["fade"] > 0.0 else 0.0  # a transition has begun at the displayed pose
    store_next(foot, place)
    if held >= NEAR and away < LANDED_M:
        foot["mode"], foot["frames"] = STANCE, 0
        store_place(foot, place)
        return
    store_place(foot, place)
    length_s = LANDING_S
    if held > 0.0:
        length_s = max(length_s, held * _needed_s(place, last[1 : 1 + PLACE]))
        store_place(foot, last[1 : 1 + PLACE])
    _begin_step(foot, held, length_s, 0.0)
    if foot["fade"] < 0.0:  # the transition brings it there
        foot["since_s"], foot["length_s"] = foot["fade"] * row["transition_s"], max(row["transition_s"], LANDING_S)
    if _ends_within(plants, f, weights, x, step, foot["length_s"] - foot["since_s"]):
        store_next(foot, last[1 : 1 + PLACE])  # it leaves the place where it is displayed
        foot["mode"], foot["since_s"], foot["near"] = LEAVE, LONG_S, held
