"""State of moving characters, one record each: critically damped goals, advancing phases, the follow window.

``state`` is (C,) of :data:`CHARACTER`, one record per character; ``slots`` (B,) are the rows of a batch. ``progress``
(B,) of :data:`PROGRESS` is written for the caller of the batch.

Source: ``docs/math.md``, section "Live characters".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F32, F64, I64
from verbs.kernels import timewarp
from verbs.kernels.compile import kernel
from verbs.kernels.corrected_position import Chain, correct_positions, effector_positions
from verbs.kernels.correction import Correction
from verbs.kernels.pose import spline_taps, stride_to
from verbs.kernels.timewarp import Clock

__all__ = [
    "CHARACTER",
    "PROGRESS",
    "FollowProblem",
    "Records",
    "advance",
    "any_following",
    "chain_at",
    "follow",
    "steer",
    "walk",
]

Records = npt.NDArray[np.void]

CHARACTER = np.dtype(
    [
        ("phase", "f8"),  # canonical time
        ("speed", "f8"),
        ("playing", "f8"),  # 0 or 1, like the other flags
        ("looping", "f8"),
        ("fresh", "f8"),  # 1 before the first frame, which is at the phase; 2 where it is a step on; else 0
        ("decay", "f8"),  # of the distance to the goal, 1/s; 0 follows at once
        ("following", "f8"),  # whether a paused pose follows its goal
        ("share", "f8"),  # how far it does, 0 to 1
        ("x", "f8"),  # position of the root on the ground, metres
        ("z", "f8"),
        ("heading", "f8"),  # rad
        ("since_s", "f8"),  # since the transition began
        ("transition_s", "f8"),  # length of the transition; 0 without one
        ("step_s", "f8"),  # between the last two frames
    ]
)
"""State of a character."""

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

FADE_S = 0.2
"""Seconds in which a paused pose moves to its goal, or away from it."""

REACHED = 1e-8
"""Distance and velocity, in chart units, at which a goal counts as reached; far below what is visible."""


class FollowProblem(NamedTuple):
    """What following a goal in the follow window needs; the chain is that of the phase.

    Parameters
    ----------
    start, stop : float
        Phases of the window.
    curves : (K + 3, N, 4 + 4·J) float32
    joints : (L,) int64
        Joints of the chain.
    correction : Correction
    mode : int
    references, offsets : (L, 4), (L, 3) float64
    """

    start: float
    stop: float
    curves: F32
    joints: I64
    correction: Correction
    mode: int
    references: F64
    offsets: F64


@kernel
def steer(
    slots: I64, step_s: float, state: Records, goals: F64, shown: F64, velocities: F64, known: I64, out: F64, moved: I64
) -> int:
    """Move displayed points toward goals, critically damped and exact for any step; ``out`` (B, D) is the result.

    ``goals`` are (B, D), ``shown`` and ``velocities`` (C, D), in coordinates in which the domain is convex. ``moved``
    (B,) lists the rows that differ from their last frame, and those whose ``known`` (C,) is 0, which becomes 1; their
    number is returned.
    """
    count = 0
    for b in range(slots.shape[0]):
        s = slots[b]
        rate = state[s]["decay"]
        fall = np.exp(-rate * step_s)
        still = known[s] == 1
        for a in range(goals.shape[1]):
            away = shown[s, a] - goals[b, a]
            still = still and away == 0.0 and velocities[s, a] == 0.0
            pull = velocities[s, a] + rate * away
            if rate <= 0.0 or (abs(away) < REACHED and abs(velocities[s, a]) < REACHED):
                shown[s, a] = goals[b, a]
                velocities[s, a] = 0.0
            else:
                shown[s, a] = goals[b, a] + (away + pull * step_s) * fall
                velocities[s, a] = (velocities[s, a] - rate * pull * step_s) * fall
            out[b, a] = shown[s, a]
        if not still:
            known[s] = 1
            moved[count] = b
            count += 1
    return count


@kernel
def _passes(phases: F64, start: float, stop: float) -> float:
    """1 where a keytime lies between two unwrapped phases; right at the second counts, right at the first does not."""
    for phase in phases:
        if np.floor(stop - phase) > np.floor(start - phase) or np.ceil(stop - phase) < np.ceil(start - phase):
            return 1.0
    return 0.0


@kernel
def advance(slots: I64, step_s: float, state: Records, weights: F64, clock: Clock, progress: Records) -> None:
    """Advance phases by one step at the weights (B, N) of this frame, and write ``progress`` (B,)."""
    phases, log_lengths, looping = clock
    keytimes, tangents = np.empty(phases.shape[0]), np.empty(phases.shape[0])
    for b in range(slots.shape[0]):
        row, end = state[slots[b]], progress[b]
        timewarp.blend_keytimes(weights[b], log_lengths, keytimes)
        timewarp.slopes(phases, keytimes, looping, tangents)
        duration = keytimes[phases.shape[0] - 1]
        start = row["phase"]
        gone = 0.0 if row["fresh"] == 1.0 else row["playing"] * row["speed"] * step_s
        seconds = timewarp.time_at(phases, keytimes, tangents, start) + gone
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
            row["phase"] = timewarp.phase_at(phases, keytimes, tangents, seconds)
            if row["looping"] > 0.0 and looping and row["phase"] >= 1.0:
                row["phase"], seconds = 0.0, 0.0
                cycles += 1.0
        end["phase"], end["time_s"], end["duration_s"] = row["phase"], seconds, duration
        # A keytime right where a character appears counts as passed.
        behind = 0.0
        if row["fresh"] > 0.0 and row["playing"] > 0.0:
            behind = 1e-9 if row["speed"] >= 0.0 else -1e-9
        end["start"], end["stop"] = start - behind, row["phase"] + cycles
        end["passed"] = 1.0 if behind != 0.0 else _passes(phases, end["start"], end["stop"])


@kernel
def walk(slots: I64, state: Records, weights: F64, strides: F64, progress: Records) -> None:
    """Move the roots of a striding verb as far as :func:`advance` went, backwards too."""
    gone = np.empty(3)
    for b in range(slots.shape[0]):
        row, start, stop = state[slots[b]], progress[b]["start"], progress[b]["stop"]
        if abs(stop - start) < 2e-9:
            continue
        low, high = min(start, stop), max(start, stop)
        shift = 1.0 - np.floor(low)  # strides wrap round, but never below phase 0
        gone[:] = 0.0
        stride_to(weights[b], strides, low + shift, high + shift, True, gone)
        if stop < start:  # backwards: the inverse of the steps from there to here
            cosine, sine = np.cos(gone[2]), np.sin(gone[2])
            x, z = gone[0], gone[1]
            gone[0], gone[1], gone[2] = -(x * cosine - z * sine), -(x * sine + z * cosine), -gone[2]
        cosine, sine = np.cos(row["heading"]), np.sin(row["heading"])
        row["x"] += gone[0] * cosine + gone[1] * sine
        row["z"] += -gone[0] * sine + gone[1] * cosine
        row["heading"] = (row["heading"] + gone[2] + np.pi) % (2.0 * np.pi) - np.pi


@kernel
def any_following(slots: I64, state: Records) -> bool:
    """Whether :func:`follow` has any work."""
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        if row["share"] > 0.0 or (row["following"] > 0.0 and row["playing"] * row["speed"] == 0.0):
            return True
    return False


@kernel
def chain_at(phase: float, curves: F32, joints: I64, roots: F64, rows: F64) -> None:
    """Every example's root (3, N) and rotation rows (4·L, N) of a chain of joints (L,) at any phase."""
    taps = np.empty(4)
    first = spline_taps(phase, curves.shape[0] - 3, taps)
    roots[:] = 0.0
    rows[:] = 0.0
    for tap in range(4):
        for i in range(curves.shape[1]):
            source = curves[first + tap, i]
            for a in range(3):
                roots[a, i] += taps[tap] * source[a]
            for link in range(joints.shape[0]):
                for a in range(4):
                    rows[4 * link + a, i] += taps[tap] * source[4 + 4 * joints[link] + a]


@kernel
def follow(
    slots: I64,
    step_s: float,
    state: Records,
    targets: tuple[F64, F64],
    weights: F64,
    error: F64,
    problem: FollowProblem,
) -> None:
    """Where a character is paused within the follow window, correct its weights (B, N) at that phase.

    ``targets`` are effector positions (B, 3) inside the domain, and as requested; the distance to the latter becomes
    the error (B,). Elsewhere weights and errors stay, after a fade. A motion that plays on past the window fades from
    its edge, as weights beyond it would be huge.
    """
    goals, requested = targets
    count = weights.shape[1]
    roots, rows = np.empty((3, count)), np.empty((4 * problem.joints.shape[0], count))
    chain = Chain(problem.mode, roots, rows, problem.references, problem.offsets)
    corrected, point = np.empty((1, count)), np.empty((1, 3))
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        paused = row["playing"] * row["speed"] == 0.0
        inside = row["following"] > 0.0 and paused and problem.start <= row["phase"] <= problem.stop
        move = 1.0 if row["fresh"] > 0.0 else step_s / FADE_S
        row["share"] = min(row["share"] + move, 1.0) if inside else max(row["share"] - move, 0.0)
        if row["share"] == 0.0:
            continue
        u = row["share"]
        share = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        chain_at(min(max(row["phase"], problem.start), problem.stop), problem.curves, problem.joints, roots, rows)
        corrected[0] = weights[b]
        correct_positions(corrected, goals[b : b + 1], problem.correction, chain)
        for i in range(count):
            weights[b, i] += share * (corrected[0, i] - weights[b, i])
        if inside:
            effector_positions(weights[b : b + 1], chain, point)
            x, y, z = point[0, 0] - requested[b, 0], point[0, 1] - requested[b, 1], point[0, 2] - requested[b, 2]
            error[b] = np.sqrt(x * x + y * y + z * z)
