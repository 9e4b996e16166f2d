"""Cuts near an end of a clip: the whole body jumps from one frame to the next, as after a calibration pose.

A fast motion has several large steps in a row, and moves some joints; a cut is one large step of most joints.
"""

from __future__ import annotations

import numpy as np

from verbs.clips import paths, resample
from verbs.clips.reports import Mend, Report
from verbs.errors import OutOfRange
from verbs.motion import Motion

__all__ = ["KIND", "find", "mend"]

KIND = "cut"

LEAST_RAD = np.radians(6.0)
"""Least mean step of the joints."""

RATIO = 6.0
"""Least ratio of that step to the largest of the frames around it."""

MOST_JOINTS = 0.3
"""Least share of the joints that move by a third of that step or more."""

WINDOW = 6
"""Frames on each side of a cut with which its step is compared."""

LONGEST_S, LONGEST_SHARE = 3.0, 0.3
"""Longest part beside a cut that is trimmed, in seconds and as a share of the clip."""


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """What stands before a cut near the start and after one near the end, as one report, or none."""
    del joints
    return mend(motion, Mend(KIND))[1]


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Trim what stands before a cut near the start, and after one near the end.

    The report's mend has the times, in seconds, between which the motion is kept. A mend with a start and an end keeps
    exactly that stretch.

    Parameters
    ----------
    motion : Motion
    wanted : Mend

    Raises
    ------
    OutOfRange
        A stretch outside the motion.
    """
    if wanted.options:
        raise OutOfRange(f"a mend of kind '{KIND}' has no parameters but start and end")
    first, last = _kept(motion)
    start, end = (first / motion.fps, last / motion.fps) if wanted.stretch is None else wanted.stretch
    if (start, end) == (0.0, motion.duration_s) or ((first, last) == (0, len(motion) - 1) and wanted.stretch is None):
        return motion, []
    kept = resample.trim(motion, start, end)
    lost = motion.duration_s - kept.duration_s
    parts = [f"the {first} frame{'s' * (first > 1)} before {start:g} s"] * (first > 0)
    tail = len(motion) - 1 - last
    parts += [f"the {tail} frame{'s' * (tail > 1)} after {end:g} s"] * (tail > 0)
    found = f"the whole body jumps: {' and '.join(parts)} belong to something else" if parts else "a stretch is kept"
    done = f"trimmed by {lost:.3f} s, to {kept.duration_s:.2f} s"
    return kept, [Report(Mend(KIND, None, round(start, 7), round(end, 7)), found, done, lost, "s")]


def _kept(motion: Motion) -> tuple[int, int]:
    """First and last frame between the cuts near the ends."""
    last = len(motion) - 1
    if last < 2 * WINDOW:
        return 0, last
    steps = paths.steps(motion.rotations)
    whole = steps.mean(axis=1)
    first, end = 0, last
    most = min(LONGEST_S * motion.fps, LONGEST_SHARE * last)
    for k in np.flatnonzero(whole > LEAST_RAD):
        around = np.concatenate([whole[max(k - WINDOW, 0) : k], whole[k + 1 : k + 1 + WINDOW]])
        together = (steps[k] >= whole[k] / 3.0).mean()
        if whole[k] < RATIO * around.max() or together < MOST_JOINTS:
            continue
        if k + 1 <= most:
            first = int(k) + 1
        elif last - k <= most:
            end = min(end, int(k))
    return first, end
