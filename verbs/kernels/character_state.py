"""Characters in motion, a row of state each: goals that are run after, phases that go on.

``state`` is (C, :data:`COLUMNS`) float64, one row per character; ``slots`` (B,) are the rows of a batch. Rows of
``ends`` are written for whoever asked for the batch.

Source: ``docs/math.md``, section "Live characters".
"""

from __future__ import annotations

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.kernels import correction, timewarp
from verbs.kernels.compile import kernel
from verbs.kernels.pose import spline_taps, stride_to

__all__ = [
    "COLUMNS",
    "DECAY",
    "ENDED",
    "FOLLOWS",
    "FRESH",
    "FROM",
    "HEADING",
    "LENGTH",
    "LOOP",
    "PASSED",
    "PHASE",
    "PLAYING",
    "REPORTS",
    "RESTARTED",
    "SHARE",
    "SINCE",
    "SPEED",
    "STEP",
    "TO",
    "X",
    "Z",
    "advance",
    "any_held",
    "goals_at",
    "hold",
    "steer",
    "walk",
]

(PHASE, SPEED, PLAYING, LOOP, FRESH, DECAY, FOLLOWS, SHARE, X, Z, HEADING, SINCE, LENGTH, STEP) = range(14)
"""Columns of ``state``: canonical time; speed; whether it plays; whether it loops; 1 before the first frame, which
shows it where it is, 2 where that frame is a step on already, 0 afterwards; the goal's decay (1/s, 0 follows at once);
whether a held pose follows its goal, and how far it does (0 to 1); the root's place (m, m, rad); seconds since a
transition began, and its length (0: none); seconds between the last two frames."""
COLUMNS = 14

(AT, TIME, DURATION, FROM, TO, PASSED, ENDED, RESTARTED) = range(8)
"""Columns of ``ends`` that :func:`advance` writes: phase, seconds, seconds of the whole; the phases between which it
went on, unwrapped; whether keytimes passed; whether an end was reached, or reached and started over."""
REPORTS = 8

FADE_S = 0.2
"""Seconds in which a held pose turns to its goal, or away from it."""

SETTLED = 1e-8
"""Distance and velocity, in chart units, at which a goal counts as reached: far below what anybody can see."""


@kernel
def steer(
    slots: I64, step_s: float, state: F64, goals: F64, shown: F64, velocities: F64, known: I64, out: F64, moved: I64
) -> int:
    """Move what is shown toward the goals, critically damped and exact for any step; ``out`` (B, D) is the result.

    ``goals`` are (B, D), ``shown`` and ``velocities`` (C, D), in coordinates in which the domain is convex. Return how
    many are written to ``moved`` (B,): those that are elsewhere than in their last frame, or whose ``known`` (C,) is 0;
    it becomes 1.
    """
    count = 0
    for b in range(slots.shape[0]):
        s = slots[b]
        rate = state[s, DECAY]
        fall = np.exp(-rate * step_s)
        still = known[s] == 1
        for a in range(goals.shape[1]):
            away = shown[s, a] - goals[b, a]
            still = still and away == 0.0 and velocities[s, a] == 0.0
            pull = velocities[s, a] + rate * away
            if rate <= 0.0 or (abs(away) < SETTLED and abs(velocities[s, a]) < SETTLED):
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
def advance(
    slots: I64, step_s: float, state: F64, weights: F64, log_lengths: F64, phases: F64, looping: bool, ends: F64
) -> None:
    """Let phases go on by one step at the weights (B, N) of this frame; write ``ends`` (B, REPORTS).

    Seconds per phase are those of ``timewarp``.
    """
    count = phases.shape[0]
    keytimes, tangents = np.empty(count), np.empty(count)
    for b in range(slots.shape[0]):
        row, end = state[slots[b]], ends[b]
        timewarp.blend_keytimes(weights[b], log_lengths, keytimes)
        timewarp.slopes(phases, keytimes, looping, tangents)
        duration = keytimes[count - 1]
        start = row[PHASE]
        gone = 0.0 if row[FRESH] == 1.0 else row[PLAYING] * row[SPEED] * step_s
        seconds = timewarp.time_at(phases, keytimes, tangents, start) + gone
        cycles, end[ENDED], end[RESTARTED] = 0.0, 0.0, 0.0
        if row[LOOP] > 0.0 and gone != 0.0:
            cycles = np.floor(seconds / duration)
            seconds -= cycles * duration
            end[RESTARTED] = 1.0 if cycles != 0.0 and not looping else 0.0
        elif (gone > 0.0 and seconds >= duration) or (gone < 0.0 and seconds <= 0.0):
            end[ENDED] = 1.0
            row[PLAYING] = 0.0
        seconds = min(max(seconds, 0.0), duration)
        if gone != 0.0:
            row[PHASE] = timewarp.phase_at(phases, keytimes, tangents, seconds)
            if row[LOOP] > 0.0 and looping and row[PHASE] >= 1.0:
                row[PHASE], seconds = 0.0, 0.0
                cycles += 1.0
        end[AT], end[TIME], end[DURATION] = row[PHASE], seconds, duration
        # A keytime right where a character appears counts as passed.
        behind = 0.0
        if row[FRESH] > 0.0 and row[PLAYING] > 0.0:
            behind = 1e-9 if row[SPEED] >= 0.0 else -1e-9
        end[FROM], end[TO] = start - behind, row[PHASE] + cycles
        end[PASSED] = 1.0 if behind != 0.0 else _passes(phases, end[FROM], end[TO])


@kernel
def walk(slots: I64, state: F64, weights: F64, strides: F64, ends: F64) -> None:
    """Move the roots of a striding verb as far as :func:`advance` went, backwards too."""
    gone = np.empty(3)
    for b in range(slots.shape[0]):
        row, start, stop = state[slots[b]], ends[b, FROM], ends[b, TO]
        if abs(stop - start) < 2e-9:
            continue
        low, high = min(start, stop), max(start, stop)
        shift = 1.0 - np.floor(low)  # strides wrap round, but never below phase 0
        gone[:] = 0.0
        stride_to(weights[b], strides, low + shift, high + shift, True, gone)
        if stop < start:  # the way back: what leads from there to here, undone
            cosine, sine = np.cos(gone[2]), np.sin(gone[2])
            x, z = gone[0], gone[1]
            gone[0], gone[1], gone[2] = -(x * cosine - z * sine), -(x * sine + z * cosine), -gone[2]
        cosine, sine = np.cos(row[HEADING]), np.sin(row[HEADING])
        row[X] += gone[0] * cosine + gone[1] * sine
        row[Z] += -gone[0] * sine + gone[1] * cosine
        row[HEADING] = (row[HEADING] + gone[2] + np.pi) % (2.0 * np.pi) - np.pi


@kernel
def any_held(slots: I64, state: F64) -> bool:
    """Whether :func:`hold` has anything to do."""
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        if row[SHARE] > 0.0 or (row[FOLLOWS] > 0.0 and row[PLAYING] * row[SPEED] == 0.0):
            return True
    return False


@kernel
def goals_at(phase: float, curves: F32, chain: I64, starts: F64, rows: F64) -> None:
    """Every example's root (3, N) and chain of rotation rows (4·L, N) at any phase, as correction wants them."""
    taps = np.empty(4)
    first = spline_taps(phase, curves.shape[0] - 3, taps)
    starts[:] = 0.0
    rows[:] = 0.0
    for tap in range(4):
        for i in range(curves.shape[1]):
            source = curves[first + tap, i]
            for a in range(3):
                starts[a, i] += taps[tap] * source[a]
            for link in range(chain.shape[0]):
                for a in range(4):
                    rows[4 * link + a, i] += taps[tap] * source[4 + 4 * chain[link] + a]


@kernel
def hold(
    slots: I64,
    step_s: float,
    state: F64,
    window: F64,
    goals: F64,
    asked: F64,
    weights: F64,
    error: F64,
    curves: F32,
    chain: I64,
    held: F64,
    units: F64,
    rules: F64,
    mode: int,
    references: F64,
    offsets: F64,
) -> None:
    """Where a character is held within the follow window, correct its weights at that very phase.

    ``goals`` (B, 3) are effector positions inside the domain, ``asked`` (B, 3) those that were asked for; the
    distance to these becomes the error (B,). Elsewhere weights and errors stay, after a fade; what plays on out of the
    window fades from its edge, as weights beyond it would be huge.
    """
    count = weights.shape[1]
    starts, rows = np.empty((3, count)), np.empty((4 * chain.shape[0], count))
    turned, place = np.empty((1, count)), np.empty((1, 3))
    for b in range(slots.shape[0]):
        row = state[slots[b]]
        still = row[PLAYING] * row[SPEED] == 0.0
        inside = row[FOLLOWS] > 0.0 and still and window[0] <= row[PHASE] <= window[1]
        move = 1.0 if row[FRESH] > 0.0 else step_s / FADE_S
        row[SHARE] = min(row[SHARE] + move, 1.0) if inside else max(row[SHARE] - move, 0.0)
        if row[SHARE] == 0.0:
            continue
        u = row[SHARE]
        share = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        goals_at(min(max(row[PHASE], window[0]), window[1]), curves, chain, starts, rows)
        turned[0] = weights[b]
        correction.correct_positions(
            turned, goals[b : b + 1], held, units, rules, mode, starts, rows, references, offsets
        )
        for i in range(count):
            weights[b, i] += share * (turned[0, i] - weights[b, i])
        if inside:
            correction.reach_positions(weights[b : b + 1], mode, starts, rows, references, offsets, place)
            x, y, z = place[0, 0] - asked[b, 0], place[0, 1] - asked[b, 1], place[0, 2] - asked[b, 2]
            error[b] = np.sqrt(x * x + y * y + z * z)
