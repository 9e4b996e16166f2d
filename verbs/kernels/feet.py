"""Feet of moving characters: places that are kept while goals, verbs and versions change, and steps.

A standing foot stays in the world until its stance ends. One that stands too far from where its motion has it makes a
step. :mod:`verbs.kernels.stances` plans where feet stand.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from verbs.conventions import F64, I64
from verbs.kernels import timewarp
from verbs.kernels.character_state import Crowd, Records
from verbs.kernels.compile import kernel
from verbs.kernels.foot_modes import (
    CHECKED,
    FADE_S,
    LATER,
    LONGEST_S,
    Step,
    appear,
    arrive,
    compare,
    depart,
    giving,
    stay,
    step_on,
    swing,
)
from verbs.kernels.foot_state import LEAVE, STANCE, STAY, STEP, SWING, load_place, store_place
from verbs.kernels.legs import CONTACTS, GIVE, GROUNDS, PELVIS
from verbs.kernels.stances import LONG_S, PLACE, Plants, command, contact_at, smootherstep
from verbs.kernels.timewarp import Clock

__all__ = ["hold", "hold_feet", "hold_track", "release"]


@kernel
def hold(slots: I64, chosen: I64, step_s: float, crowd: Crowd, clock: Clock, plants: Plants, progress: Records) -> None:
    """Hold the feet of the characters ``slots[chosen]``, which have advanced by one step, and write their commands.

    Places are in the world. Characters that do not plant are left out.

    Parameters
    ----------
    slots, chosen : (B,), (C,) int64
    step_s : float
    crowd : Crowd
        ``feet`` and ``commands`` change.
    clock : Clock
    plants : Plants
    progress : (B,) of :data:`verbs.kernels.character_state.PROGRESS`
    """
    state = crowd.state
    count = plants.contact.shape[1] - 1
    place, found = np.empty(PLACE), np.empty((4, PLACE))
    for c in range(chosen.shape[0]):
        s, end = slots[chosen[c]], progress[chosen[c]]
        row = state[s]
        if row["planting"] == 0.0:
            continue
        rate = timewarp.rate_at(clock.phases, crowd.keytimes[s], crowd.slopes[s], row["phase"])
        turns = np.floor(end["stop"])  # a loop's phase begins again at 0
        step = Step(
            step_s, abs(end["stop"] - end["start"]) * rate, rate, 1 if end["stop"] >= end["start"] else -1,
            (end["start"] - (turns if plants.looping else 0.0)) * count,
        )  # fmt: skip
        hold_feet(row, crowd.feet[s], crowd.weights[s, row["weights"]], step, plants, crowd.commands[s], place, found)


@kernel
def hold_feet(
    row: Any, feet: Records, weights: F64, step: Step, plants: Plants, commands: F64, place: F64, found: F64
) -> None:
    """Hold the feet (F,) of one character; ``commands`` (2, F, 23) are those of this frame and of the one before.

    ``place`` (8,) and ``found`` (4, 8) are scratch.
    """
    x = row["phase"] * (plants.contact.shape[1] - 1)
    if step.moved_s > LONGEST_S:  # stances were left out
        row["footed"] = 0.0
    steps = False
    for f in range(feet.shape[0]):
        steps = steps or feet[f]["mode"] == STEP
    for f in range(feet.shape[0]):
        foot, rise, held = feet[f], 0.0, 1.0
        if row["footed"] == 0.0:
            appear(foot, row, plants, weights, f, step.rate, place, found)
        foot["fade"] = min(1.0, foot["fade"] + step.step_s / max(row["transition_s"], FADE_S))
        origin = _change(feet, f, row, plants, weights, x, step, commands[0, f], place, found)
        if foot["mode"] == STANCE:
            load_place(foot, place)
        elif foot["mode"] == STAY:
            stay(foot, row, plants, weights, f, x, origin, place, found)
        elif foot["mode"] == STEP:
            held, rise = step_on(foot, step.step_s, place, found)
        else:
            held = swing(foot, row, plants, weights, f, x, origin, step, place, found)
        commands[1, f] = commands[0, f]
        fade = smootherstep(foot["fade"])
        command(plants, weights, f, x, held, fade, row["y"] + rise, place, commands[0, f])
        commands[0, f, GIVE] = giving(foot, steps, row["transition_s"] > 0.0, step.step_s)
        if fade < 1.0:
            commands[0, f, GROUNDS[0]] -= (1.0 - fade) * foot["sunk_heel"]
            commands[0, f, GROUNDS[1]] -= (1.0 - fade) * foot["sunk_ball"]
            commands[0, f, GROUNDS[2]] -= (1.0 - fade) * foot["sunk_tip"]
        if row["share"] > 0.0:
            _set_free(plants, f, 1.0 - row["share"], commands[0, f])
        if row["footed"] == 0.0:
            commands[1, f] = commands[0, f]
    row["footed"] = 1.0


@kernel
def _change(
    feet: Records,
    f: int,
    row: Any,
    plants: Plants,
    weights: F64,
    x: float,
    step: Step,
    last: F64,
    place: F64,
    found: F64,
) -> float:
    """Change the mode of a foot where a stance begins or ends, or it has to step; return where its swing comes from.

    ``last`` (23,) is its command of the frame before.
    """
    foot, origin = feet[f], step.before
    if contact_at(plants, f, weights, x) < 0.5:
        if foot["mode"] == STANCE:
            return depart(foot, plants, weights, f, x, step, found)
        if foot["mode"] == LEAVE:
            foot["mode"] = SWING
        return origin
    if foot["mode"] == STAY:
        foot["mode"], foot["frames"] = STANCE, 0
    elif foot["mode"] == SWING:
        arrive(foot, row, plants, weights, f, x, step, last, place)
    if foot["mode"] == STANCE:
        foot["frames"] += 1
        if foot["frames"] >= CHECKED:
            compare(feet, f, row, plants, weights, x, step, place)
    return origin


@kernel
def _set_free(plants: Plants, f: int, share: float, command: F64) -> None:
    """Plant a paused pose, which is on its goal without its feet, in part only."""
    command[PELVIS] *= share
    if f == plants.effector:
        command[0] *= share
        for a in CONTACTS:
            command[a] *= share


@kernel
def hold_track(
    weights: F64, phases: F64, rates: F64, places: F64, step_s: float, plants: Plants, state: Records, feet: Records,
    commands: F64,
) -> None:  # fmt: skip
    """Commands of the frames of one motion whose weights change.

    Parameters
    ----------
    weights : (B, N) float64
    phases : (B,) float64
        Of a loop also beyond 1; rising.
    rates : (B,) float64
        Seconds per unit of phase there.
    places : (B, 4) float64
        Of the root's frame in the world: x, z (m), heading (rad), height (m).
    step_s : float
        Seconds between two frames.
    plants : Plants
    state : (1,) of :data:`verbs.kernels.character_state.CHARACTER`
    feet : (F,) of :data:`FOOT`
        Scratch, like ``state``; both zero.
    commands : (B, F, 23) float64
        Written, in the world.
    """
    count = plants.contact.shape[1] - 1
    place, found, last = np.empty(PLACE), np.empty((4, PLACE)), np.zeros((2, *commands.shape[1:]))
    row, before = state[0], phases[0]
    for b in range(weights.shape[0]):
        turns = np.floor(phases[b]) if plants.looping else 0.0
        row["phase"], row["x"], row["z"] = phases[b] - turns, places[b, 0], places[b, 1]
        row["heading"], row["y"] = places[b, 2], places[b, 3]
        step = Step(step_s, abs(phases[b] - before) * rates[b], rates[b], 1, (before - turns) * count)
        hold_feet(row, feet, weights[b], step, plants, last, place, found)
        commands[b] = last[0]
        before = phases[b]


@kernel
def release(feet: Records, points: F64, levels: F64, flat: F64) -> None:
    """Prepare the feet (F,) of a character for a transition: what stands stays where it is displayed, the rest is free.

    Parameters
    ----------
    feet : (F,) of :data:`FOOT`
    points : (F, 3, 3) float64
        Displayed heel, ball and tip, in the world.
    levels : (F, 3) float64
        Heights at which they stand in the next motion.
    flat : (F, 2) float64
        Of :class:`verbs.kernels.stances.Plants`.
    """
    place = np.empty(PLACE)
    for f in range(feet.shape[0]):
        foot = feet[f]
        foot["fade"], foot["give"] = 0.0, 0.0
        foot["sunk_heel"] = max(0.0, levels[f, 0] - points[f, 0, 1])
        foot["sunk_ball"] = max(0.0, levels[f, 1] - points[f, 1, 1])
        foot["sunk_tip"] = max(0.0, levels[f, 2] - points[f, 2, 1])
        if foot["mode"] != STANCE:
            foot["mode"], foot["since_s"], foot["near"], foot["fade"] = SWING, LONG_S, 0.0, -LATER
            continue
        foot["frames"] = CHECKED
        load_place(foot, place)
        dx, dz, x, z = place[6], place[7], points[f, 1, 0], points[f, 1, 2]
        tx, tz = place[4] - place[2], place[5] - place[3]
        size = np.sqrt(tx * tx + tz * tz)
        tx, tz = (tx / size, tz / size) if size > 1e-3 else (dx, dz)
        place[0], place[1], place[2], place[3] = x - flat[f, 0] * dx, z - flat[f, 0] * dz, x, z
        place[4], place[5] = x + flat[f, 1] * tx, z + flat[f, 1] * tz
        store_place(foot, place)
