"""State of moving characters, one record each: critically damped goals, advancing phases, positions.

``state`` is (C,) of :data:`CHARACTER`, one record per character; ``slots`` (B,) are the rows of a batch. ``progress``
(B,) of :data:`PROGRESS` is written for the caller of the batch.

Source: ``docs/math.md``, section "Live characters".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels import timewarp
from verbs.kernels.chart import ChartArrays, to_chart
from verbs.kernels.compile import kernel
from verbs.kernels.corrected_position import Blended
from verbs.kernels.pose import stride_to
from verbs.kernels.timewarp import Clock

__all__ = [
    "CHARACTER",
    "PROGRESS",
    "Advanced",
    "Crowd",
    "Records",
    "advance",
    "at_rest",
    "copy_rows",
    "displayed",
    "gather",
    "keep",
    "steer",
    "walk",
]

Records = npt.NDArray[np.void]
Flags = npt.NDArray[np.bool_]

SHOWN = (("weights", "i8"), ("phase", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("heading", "f8"))
"""What a frame without offsets is computed from: row of its weights, phase, position."""

CHARACTER = np.dtype(
    [
        ("phase", "f8"),  # canonical time
        ("seconds", "f8"),  # at the phase, by the keytimes of the weights; NaN where they have to be computed
        ("speed", "f8"),
        ("playing", "f8"),  # 0 or 1, like the other flags
        ("looping", "f8"),
        ("fresh", "f8"),  # 1 before the first frame, which is at the phase; 2 where it is a step on; else 0
        ("decay", "f8"),  # of the distance to the goal, 1/s; 0 follows at once
        ("following", "f8"),  # whether a paused pose follows its goal
        ("share", "f8"),  # how far it does, 0 to 1
        ("x", "f8"),  # position of the root on the ground, and height of the ground there, metres
        ("y", "f8"),
        ("z", "f8"),
        ("heading", "f8"),  # rad
        ("since_s", "f8"),  # since the transition began
        ("transition_s", "f8"),  # length of the transition; 0 without one
        ("step_s", "f8"),  # between the last two frames
        ("held", "i8"),  # row of its stored frames, -1 where they follow from the numbers below
        ("calm", "i8"),  # frames since a transition or the follow window changed one
        ("weights", "i8"),  # row of its current weights, 0 to 2
        ("planting", "f8"),  # whether its feet are planted
        ("footed", "f8"),  # whether ``feet`` and ``commands`` belong to its last frame
        *((f"{name}_{k}", kind) for k in (1, 2) for name, kind in SHOWN),
    ]
)
"""State of a character; the last numbers are those of its last frame (_1) and of the one before (_2)."""

PROGRESS = np.dtype(
    [
        ("phase", "f8"),
        ("time_s", "f8"),
        ("duration_s", "f8"),  # of the whole motion or cycle
        ("start", "f8"),  # unwrapped phases between which the step went
        ("stop", "f8"),
        ("passed", "f8"),  # whether keytimes passed
        ("ended", "f8"),  # whether an end was reached
        ("restarted", "f8"),  # whether an end was reached and the motion started over
    ]
)
"""What one step did to a character; see :func:`advance`."""

REACHED = 1e-8
"""Distance and velocity, in chart units, at which a goal counts as reached; far below what is visible."""


class Crowd(NamedTuple):
    """Characters of one verb as columns: C rows, D adverbs, N examples, M keytimes.

    Parameters
    ----------
    state : (C,) of :data:`CHARACTER`
    known : (C,) int64
        Whether a character has weights.
    goals, seen : (C, D) float64
        Adverbs that are aimed at; and those of the last step, to find which have changed.
    targets, shown, velocity : (C, D) float64
        Goal, displayed point and its velocity in normalised chart coordinates.
    weights : (C, 3, N) float64
        Current ones and those of the last two frames, in the rows that ``state`` names.
    keytimes, slopes : (C, M) float64
        Of the current weights, see :mod:`verbs.kernels.timewarp`.
    measured, error, clamped : (C, m), (C,), (C,) float64
        Of the current weights.
    feet : (C, F) of :data:`verbs.kernels.foot_state.FOOT`
    commands : (C, 2, F, 23) float64
        Where the feet are put in the last frame and in the one before, see :data:`verbs.kernels.legs.COMMAND`.
    """

    state: Records
    known: I64
    goals: F64
    seen: F64
    targets: F64
    shown: F64
    velocity: F64
    weights: F64
    keytimes: F64
    slopes: F64
    measured: F64
    error: F64
    clamped: F64
    feet: Records
    commands: F64


class Advanced(NamedTuple):
    """What one step did to B characters; written by :func:`advance`.

    Parameters
    ----------
    progress : (B,) of :data:`PROGRESS`
    error : (B,) float64
    clamped, in_transition : (B,) bool
    complete, rest : (B,) int64
        Numbers of those that are complete and of the others; only the first ones are written.
    """

    progress: Records
    error: F64
    clamped: Flags
    in_transition: Flags
    complete: I64
    rest: I64


@kernel
def copy_rows(slots: I64, rows: Any, out: F64) -> None:
    """Copy rows (n, D) of any precision to the rows ``slots`` (n,) of ``out`` (C, D)."""
    for b in range(slots.shape[0]):
        for a in range(out.shape[1]):
            out[slots[b], a] = rows[b, a]


@kernel
def steer(slots: I64, step_s: float, crowd: Crowd, chart: ChartArrays, moved: I64) -> int:
    """Move displayed points toward goals, critically damped and exact for any step.

    ``moved`` (B,) lists the numbers, in ``slots`` (B,), of those that differ from their last frame or are not known
    yet; their number is returned. Goals that changed since the last step are transformed by the chart.
    """
    state, known, goals, seen = crowd.state, crowd.known, crowd.goals, crowd.seen
    targets, shown, velocity = crowd.targets, crowd.shown, crowd.velocity
    kind, axes, bend, shift, scale = chart
    count, last, fall = 0, 0.0, 1.0
    for b in range(slots.shape[0]):
        s = slots[b]
        changed = False
        for a in range(goals.shape[1]):
            changed = changed or goals[s, a] != seen[s, a]
        if changed:
            to_chart(kind, axes, bend, goals[s], targets[s])
            for a in range(goals.shape[1]):
                targets[s, a] = (targets[s, a] - shift[a]) * scale[a]
                seen[s, a] = goals[s, a]
        rate = state[s]["decay"]
        if rate != last:
            last, fall = rate, np.exp(-rate * step_s)
        still = known[s] == 1
        for a in range(goals.shape[1]):
            away = shown[s, a] - targets[s, a]
            still = still and away == 0.0 and velocity[s, a] == 0.0
            pull = velocity[s, a] + rate * away
            if rate <= 0.0 or (abs(away) < REACHED and abs(velocity[s, a]) < REACHED):
                shown[s, a] = targets[s, a]
                velocity[s, a] = 0.0
            else:
                shown[s, a] = targets[s, a] + (away + pull * step_s) * fall
                velocity[s, a] = (velocity[s, a] - rate * pull * step_s) * fall
        if not still:
            moved[count] = b
            count += 1
    return count


@kernel
def at_rest(slots: I64, crowd: Crowd, looping: bool, window: tuple[float, float], still: Flags, paused: Flags) -> None:
    """Which characters (B,) a step of any length changes nothing of but phase, seconds and position.

    These have reached their goals, are in no transition, and are paused (``paused`` is written too) or in a cycle. In
    the follow ``window``, a paused one is at rest when it follows its goal fully.
    """
    state, known = crowd.state, crowd.known
    for b in range(slots.shape[0]):
        s = slots[b]
        row = state[s]
        paused[b] = row["playing"] * row["speed"] == 0.0
        still[b] = known[s] == 1 and row["fresh"] == 0.0 and row["transition_s"] == 0.0
        still[b] = still[b] and (paused[b] or (looping and row["looping"] > 0.0))
        inside = paused[b] and row["following"] > 0.0 and window[0] <= row["phase"] <= window[1]
        still[b] = still[b] and row["share"] == (1.0 if inside else 0.0)
        still[b] = still[b] and (inside or row["held"] < 0)
        for a in range(crowd.goals.shape[1]):
            reached = crowd.shown[s, a] == crowd.targets[s, a] and crowd.velocity[s, a] == 0.0
            still[b] = still[b] and reached and crowd.goals[s, a] == crowd.seen[s, a]


@kernel
def gather(slots: I64, chosen: I64, source: F64, out: F64) -> None:
    """Rows of ``source`` (C, D) of the characters ``slots[chosen]``, to ``out`` (n, D)."""
    for k in range(chosen.shape[0]):
        for a in range(out.shape[1]):
            out[k, a] = source[slots[chosen[k]], a]


@kernel
def keep(slots: I64, chosen: I64, blended: Blended, clock: Clock, crowd: Crowd) -> None:
    """Store new weights of the characters ``slots[chosen]`` in a row that neither of their last frames needs."""
    phases, log_lengths, looping = clock
    fresh, measured, error, clamped = blended
    state, known, weights = crowd.state, crowd.known, crowd.weights
    keytimes, slopes = crowd.keytimes, crowd.slopes
    for k in range(chosen.shape[0]):
        s = slots[chosen[k]]
        row = state[s]
        free = 0
        while free == row["weights_1"] or free == row["weights_2"]:
            free += 1
        row["weights"], row["seconds"], known[s] = free, np.nan, 1
        for i in range(fresh.shape[1]):
            weights[s, free, i] = fresh[k, i]
        timewarp.blend_keytimes(fresh[k], log_lengths, keytimes[s])
        timewarp.slopes(phases, keytimes[s], looping, slopes[s])
        for a in range(measured.shape[1]):
            crowd.measured[s, a] = measured[k, a]
        crowd.error[s], crowd.clamped[s] = error[k], clamped[k]


@kernel
def _passes(phases: F64, start: float, stop: float) -> float:
    """1 where a keytime lies between two unwrapped phases; right at the second counts, right at the first does not."""
    for phase in phases:
        if np.floor(stop - phase) > np.floor(start - phase) or np.ceil(stop - phase) < np.ceil(start - phase):
            return 1.0
    return 0.0


@kernel
def advance(
    slots: I64, step_s: float, crowd: Crowd, clock: Clock, strides: F64, window: tuple[float, float], frame: Advanced
) -> tuple[int, int, int]:
    """Advance phases by one step at the weights of this frame, and write ``frame``.

    Characters whose pose follows from weights, phase and position alone are complete after it: roots of a striding
    verb have moved. The others (stored frames, motions that start over, paused in the follow ``window``) are left to
    :func:`verbs.kernels.following.follow`, :func:`walk` and :func:`verbs.kernels.inertialization.apply`. Returns how
    many are complete, how many are not, and how many of these start over.
    """
    phases, looping = clock.phases, clock.looping
    state, weights, keytimes, slopes = crowd.state, crowd.weights, crowd.keytimes, crowd.slopes
    errors, clamps = crowd.error, crowd.clamped
    progress, error, clamped, in_transition, completes, rests = frame
    gone = np.empty(4)
    complete, rest, over = 0, 0, 0
    for b in range(slots.shape[0]):
        s = slots[b]
        row, end = state[s], progress[b]
        _advance(step_s, row, phases, keytimes[s], slopes[s], looping, end)
        error[b], clamped[b], in_transition[b] = errors[s], clamps[s] > 0.0, False
        paused = row["following"] > 0.0 and row["playing"] * row["speed"] == 0.0
        inside = paused and window[0] <= row["phase"] <= window[1]
        if row["held"] < 0 and not inside and row["share"] == 0.0 and end["restarted"] == 0.0:
            if strides.shape[0] > 0:
                _walk(row, weights[s, row["weights"]], strides, end["start"], end["stop"], gone)
            displayed(step_s, row)
            completes[complete] = b
            complete += 1
        else:
            rests[rest] = b
            rest += 1
            if end["restarted"] > 0.0:
                over += 1
    return complete, rest, over


@kernel
def displayed(step_s: float, row: Any) -> None:
    """Store what the frame of this step is computed from; a character that appears does not move."""
    row["weights_2"], row["phase_2"] = row["weights_1"], row["phase_1"]
    row["x_2"], row["y_2"], row["z_2"], row["heading_2"] = row["x_1"], row["y_1"], row["z_1"], row["heading_1"]
    row["weights_1"], row["phase_1"] = row["weights"], row["phase"]
    row["x_1"], row["y_1"], row["z_1"], row["heading_1"] = row["x"], row["y"], row["z"], row["heading"]
    if row["fresh"] == 1.0:
        row["weights_2"], row["phase_2"] = row["weights"], row["phase"]
        row["x_2"], row["y_2"], row["z_2"], row["heading_2"] = row["x"], row["y"], row["z"], row["heading"]
    row["step_s"], row["fresh"] = step_s, 0.0


@kernel
def _advance(step_s: float, row: Any, phases: F64, keytimes: F64, slopes: F64, looping: bool, end: Any) -> None:
    """Advance one character's phase, and write its progress."""
    duration = keytimes[phases.shape[0] - 1]
    start, seconds = row["phase"], row["seconds"]
    if np.isnan(seconds):
        seconds = timewarp.time_at(phases, keytimes, slopes, start)
    gone = 0.0 if row["fresh"] == 1.0 else row["playing"] * row["speed"] * step_s
    seconds += gone
    cycles, end["ended"], end["restarted"] = 0.0, 0.0, 0.0
    if row["looping"] > 0.0 and gone != 0.0:
        cycles = np.floor(seconds / duration)
        seconds -= cycles * duration
        end["restarted"] = 1.0 if cycles != 0.0 and not looping else 0.0
    elif (gone > 0.0 and seconds >= duration) or (gone < 0.0 and seconds <= 0.0):
        end["ended"] = 1.0
        row["playing"] = 0.0
    seconds = min(max(seconds, 0.0), duration)
    if gone != 0.0:
        near = start + gone / duration - cycles
        row["phase"] = timewarp.phase_near(phases, keytimes, slopes, seconds, near)
        if row["looping"] > 0.0 and looping and row["phase"] >= 1.0:
            row["phase"], seconds = 0.0, 0.0
            cycles += 1.0
    row["seconds"] = seconds
    end["phase"], end["time_s"], end["duration_s"] = row["phase"], seconds, duration
    # A keytime right where a character appears counts as passed.
    behind = 0.0
    if row["fresh"] > 0.0 and row["playing"] > 0.0:
        behind = 1e-9 if row["speed"] >= 0.0 else -1e-9
    end["start"], end["stop"] = start - behind, row["phase"] + cycles
    end["passed"] = 1.0 if behind != 0.0 else _passes(phases, end["start"], end["stop"])


@kernel
def walk(slots: I64, state: Records, weights: F64, strides: F64, progress: Records) -> None:
    """Move the roots of a striding verb as far as :func:`advance` went, backwards too, at weights (B, N)."""
    gone = np.empty(4)
    for b in range(slots.shape[0]):
        _walk(state[slots[b]], weights[b], strides, progress[b]["start"], progress[b]["stop"], gone)


@kernel
def _walk(row: Any, weights: F64, strides: F64, start: float, stop: float, gone: F64) -> None:
    """Move one root from a phase to another; ``gone`` (4,) is scratch."""
    if abs(stop - start) < 2e-9:
        return
    low, high = min(start, stop), max(start, stop)
    shift = 1.0 - np.floor(low)  # strides wrap round, but never below phase 0
    gone[:] = 0.0
    stride_to(weights, strides, low + shift, high + shift, True, gone)
    if stop < start:  # backwards: the inverse of the steps from there to here
        cosine, sine = np.cos(gone[2]), np.sin(gone[2])
        x, z = gone[0], gone[1]
        gone[0], gone[1] = -(x * cosine - z * sine), -(x * sine + z * cosine)
        gone[2], gone[3] = -gone[2], -gone[3]
    cosine, sine = np.cos(row["heading"]), np.sin(row["heading"])
    row["x"] += gone[0] * cosine + gone[1] * sine
    row["y"] += gone[3]
    row["z"] += -gone[0] * sine + gone[1] * cosine
    row["heading"] = (row["heading"] + gone[2] + np.pi) % (2.0 * np.pi) - np.pi
