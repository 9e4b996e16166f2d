"""Idle heads and tails: time before and after the motion in which nothing moves."""

from __future__ import annotations

import numpy as np

from verbs.clips import paths, resample
from verbs.clips.reports import Mend, Report
from verbs.errors import OutOfRange
from verbs.motion import Motion

__all__ = ["KIND", "MARGIN_S", "SPEED_M_S", "find", "mend"]

KIND = "idle"

SPEED_M_S = 0.15
"""Default speed of the fastest joint below which a frame is idle."""

MARGIN_S = 0.25
"""Default time that is left before and after the motion."""

LEAST_S = 0.5
"""Least time at one end that is trimmed."""

WINDOW_S = 0.1
"""Time over which speeds are taken: noise of single frames does not count."""


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """The idle head and tail as one report, or none; a motion that is idle throughout is left."""
    del joints
    return mend(motion, Mend(KIND))[1]


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Trim the idle head and tail to a margin.

    The report's mend has the times, in seconds, between which the motion is kept. A mend with a start and an end keeps
    exactly that stretch.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        ``speed`` (m/s) and ``margin`` (s) replace the defaults.

    Raises
    ------
    OutOfRange
        A stretch outside the motion, or a negative parameter.
    """
    speed, margin = wanted.options.get("speed", SPEED_M_S), wanted.options.get("margin", MARGIN_S)
    if not (speed >= 0.0 and margin >= 0.0):
        raise OutOfRange(f"speed and margin of a mend of kind '{KIND}' must not be negative")
    if wanted.stretch is not None:
        start, end = wanted.stretch
    else:
        start, end = _moving(motion, speed, margin)
    if (start, end) == (0.0, motion.duration_s):
        return motion, []
    kept = resample.trim(motion, start, end)
    lost = motion.duration_s - kept.duration_s
    return kept, [
        Report(
            Mend(KIND, None, round(start, 7), round(end, 7)),
            f"nothing moves before {start:g} s or after {end:g} s",
            f"trimmed by {lost:.2f} s, to {kept.duration_s:.2f} s",
            lost,
            "s",
        )
    ]


def _moving(motion: Motion, speed: float, margin: float) -> tuple[float, float]:
    """Seconds between which the motion moves, with the margin; on frames."""
    places, end = paths.positions(motion), motion.duration_s
    lag = max(1, round(WINDOW_S * motion.fps))
    if len(places) <= lag:
        return 0.0, end
    fastest = np.linalg.norm(places[lag:] - places[:-lag], axis=-1).max(axis=1) * motion.fps / lag
    moving = np.flatnonzero(fastest > speed)
    if not len(moving):
        return 0.0, end
    room = int(np.ceil(margin * motion.fps))
    first, last = max(int(moving[0]) - room, 0), min(int(moving[-1]) + lag + room, len(motion) - 1)
    start = first / motion.fps if first / motion.fps >= LEAST_S else 0.0
    stop = last / motion.fps if end - last / motion.fps >= LEAST_S else end
    return start, stop
