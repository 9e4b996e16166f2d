"""The apex of a jump: a keytime that the build adds, which makes the height a smooth function of the weights.

Without it the height is a maximum over time, which has kinks where two instants compete; with it every example is at
its highest at one phase, and the height is the difference of two blended positions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from verbs.authoring.source import Source
from verbs.conventions import F64
from verbs.motion import Motion

__all__ = ["NAME", "mark"]

NAME = "apex"

MARGIN = 0.05
"""The apex keeps this share of its segment away from both neighbouring keytimes."""


def mark(source: Source, motions: list[Motion], keytimes: F64) -> tuple[Source, F64]:
    """Source and keytimes (N, M + 1) with the apex marked; unchanged for other verbs, or where it is marked already."""
    if source.measure != "jump" or NAME in source.keytime_names:
        return source, keytimes
    splines = [CubicSpline(np.arange(len(motion)) / motion.fps, motion.root[:, 1]) for motion in motions]
    tops = [_highest(spline, marks[0], marks[-1]) for spline, marks in zip(splines, keytimes, strict=True)]
    segments = [np.searchsorted(marks, top, side="right") - 1 for marks, top in zip(keytimes, tops, strict=True)]
    segment = int(np.bincount(np.clip(segments, 0, keytimes.shape[1] - 2)).argmax())
    added = np.empty(len(motions))
    for i, (spline, marks) in enumerate(zip(splines, keytimes, strict=True)):
        margin = MARGIN * (marks[segment + 1] - marks[segment])
        added[i] = _highest(spline, marks[segment] + margin, marks[segment + 1] - margin)
    names = list(source.keytime_names)
    names.insert(segment + 1, NAME)
    effector = source.effector_keytime + (source.effector_keytime > segment)
    marked = replace(source, keytime_names=tuple(names), effector_keytime=effector)
    return marked, np.insert(keytimes, segment + 1, added, axis=1)


def _highest(height: CubicSpline, start: float, end: float) -> float:
    """Time of the greatest height between two times, seconds."""
    extrema = [time for time in height.derivative().roots(extrapolate=False) if start < time < end]
    return float(max([start, end, *extrema], key=height))
