"""Landmarks of a clip: instants that its own curves mark, such as the farthest reach or the lowest crouch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks, peak_prominences

from verbs.conventions import F64
from verbs.proposal.clips import Clip

__all__ = ["FARTHEST", "HIGHEST", "LOWEST", "RATE_HZ", "Landmark", "landmarks", "peaks"]

RATE_HZ = 120.0
"""Rate at which curves are searched."""

DWELL = 0.10
"""A peak lasts while the curve is within this share of its prominence; its instant is the middle."""

LEAST_PROMINENCE = 0.08
"""Least prominence of a landmark, as a share of the curve's range."""

LEAST_RANGE_M = 0.02

FARTHEST, SLOWEST, FASTEST, HIGHEST, LOWEST = "farthest", "slowest", "fastest", "highest", "lowest"


@dataclass(frozen=True, slots=True)
class Landmark:
    """One instant.

    Parameters
    ----------
    kind : str
        Which curve and extreme: ``farthest`` (effector from its start), ``slowest``, ``fastest`` (effector),
        ``highest``, ``lowest`` (root).
    time : float
        Seconds.
    share : float
        Prominence as a share of the curve's range, 0 to 1.
    """

    kind: str
    time: float
    share: float


def peaks(times: F64, curve: F64, kind: str) -> list[Landmark]:
    """Maxima of a curve (n,) with their prominences, in time order; the ends do not count."""
    extent = float(np.ptp(curve))
    if extent < 1e-9:
        return []
    found, _ = find_peaks(curve, prominence=LEAST_PROMINENCE * extent)
    sizes = peak_prominences(curve, found)[0]
    marks = []
    for k, size in zip(found, sizes, strict=True):
        high = curve >= curve[k] - DWELL * size
        first = k - int(np.argmin(high[k::-1])) + 1 if not high[: k + 1].all() else 0
        last = k + int(np.argmin(high[k:])) - 1 if not high[k:].all() else len(curve) - 1
        marks.append(Landmark(kind, float(0.5 * (times[first] + times[last])), float(size / extent)))
    return marks


def landmarks(clip: Clip, effector: int) -> list[Landmark]:
    """All landmarks of a clip, for the effector and the root."""
    times = clip.times(RATE_HZ)
    path, height = clip.path_of(effector, times), clip.path_of(0, times)[:, 1]
    found: list[Landmark] = []
    if effector:
        away = np.linalg.norm(path - path[0], axis=1)
        speed = np.linalg.norm(np.gradient(path, times[1] - times[0], axis=0), axis=1)
        for curve, kind in ((away, FARTHEST), (-speed, SLOWEST), (speed, FASTEST)):
            found += peaks(times, curve, kind)
    if np.ptp(height) > LEAST_RANGE_M:
        found += peaks(times, height, HIGHEST) + peaks(times, -height, LOWEST)
    return found
