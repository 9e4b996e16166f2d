"""Keytimes without any annotation, by what is measured: apex of the effector, phases of a jump, stances of a cycle."""

from __future__ import annotations

import numpy as np

from verbs.conventions import F64
from verbs.proposal.clips import Clip
from verbs.proposal.cycles import strides
from verbs.proposal.features import stature
from verbs.proposal.keytimes import Keytimes, in_order
from verbs.proposal.landmarks import FARTHEST, LOWEST, RATE_HZ, peaks

__all__ = ["of_cycle", "of_jump", "of_position", "stance_names"]

POSITION_NAMES = ("start", "apex", "end")
JUMP_NAMES = ("start", "crouch", "apex", "landing", "end")

FLAT_M, FLAT_S = 0.02, 0.6
"""A low instant is uncertain by the time that the height stays this near to it; confidence falls to 1/e over this."""


def of_position(clip: Clip, effector: int) -> Keytimes:
    """Start, apex and end: the effector dwells farthest from where it starts.

    Confidence is how far the peak stands out: the second peak lowers it, and so does a fast effector.
    """
    times = clip.times(RATE_HZ)
    path = clip.path_of(effector, times)
    away = np.linalg.norm(path - path[0], axis=1)
    speed = np.linalg.norm(np.gradient(path, times[1] - times[0], axis=0), axis=1)
    found = sorted(peaks(times, away, FARTHEST), key=lambda mark: -float(np.interp(mark.time, times, away)))
    if not found:
        top = float(times[int(np.argmax(away))])
        return _three(clip, top, 0.2, "farthest from its start, without a clear peak")
    apex = found[0]
    heights = [float(np.interp(mark.time, times, away)) for mark in found[:2]]
    alone = 1.0 if len(heights) < 2 else 1.0 - 0.6 * (heights[1] / max(heights[0], 1e-9)) ** 2
    slow = 1.0 - min(1.0, float(np.interp(apex.time, times, speed)) / max(float(speed.max()), 1e-9))
    sure = (0.5 + 0.5 * apex.share) * alone * (0.5 + 0.5 * slow)
    return _three(clip, apex.time, sure, f"farthest from its start, {heights[0]:.2f} m")


def _three(clip: Clip, apex: float, sure: float, why: str) -> Keytimes:
    times = in_order((0.0, apex, clip.duration_s), clip.duration_s)
    return Keytimes(times, (1.0, float(sure), 1.0), ("start of the clip", why, "end of the clip"))


def of_jump(clip: Clip) -> Keytimes:
    """Start, crouch, apex, landing and end, from the height of the root."""
    times = clip.times(RATE_HZ)
    height = clip.path_of(0, times)[:, 1]
    top = int(np.argmax(height))
    rise = float(height[top] - height[0])
    crouch = _lowest(times[: top + 1], height[: top + 1])
    landing = top + _lowest(times[top:] - times[top], height[top:])
    sizes = (float(height[0] - height[crouch]), rise, float(height[-1] - height[landing]))
    scale = 0.05 * stature(clip)
    sharp = [1.0 if k == top else float(np.exp(-_dwell(height, k) * (times[1] - times[0]) / FLAT_S))
             for k in (crouch, top, landing)]  # fmt: skip
    sure = [edge * float(np.clip(size / scale, 0.0, 1.0)) ** 0.5 for edge, size in zip(sharp, sizes, strict=True)]
    marks = in_order((0.0, times[crouch], times[top], times[landing], clip.duration_s), clip.duration_s)
    why = (f"root lowest before take-off, {1000 * sizes[0]:.0f} mm down", f"root highest, {1000 * rise:.0f} mm up",
           f"root lowest after the apex, {1000 * sizes[2]:.0f} mm below the end")  # fmt: skip
    return Keytimes(marks, (1.0, *sure, 1.0), ("start of the clip", *why, "end of the clip"))


def _lowest(times: F64, height: F64) -> int:
    """Index of the middle of the deepest dip of a height (n,); of the lowest instant where there is no dip."""
    dips = peaks(times, -height, LOWEST)
    if not dips:
        return int(np.argmin(height))
    deepest = min(dips, key=lambda mark: float(np.interp(mark.time, times, height)))
    return int(np.argmin(np.abs(times - deepest.time)))


def _dwell(height: F64, lowest: int) -> int:
    """Number of samples about a low instant within FLAT_M of it: the longer, the less certain the instant."""
    near = height <= height[lowest] + FLAT_M
    before, after = near[: lowest + 1][::-1], near[lowest:]
    return int(np.argmin(before) or len(before)) + int(np.argmin(after) or len(after))


def stance_names(count: int) -> tuple[str, ...]:
    """Names of the keytimes of a cycle of some strides; of one without steps its start and end."""
    if not count:
        return ("start of cycle", "end of cycle")
    inner = [f"{side} stance {k + 1}" for k in range(count) for side in ("left", "right")]
    return (*inner, "end of cycle")


def of_cycle(clip: Clip, count: int) -> Keytimes:
    """Stances of the feet in a cycle of ``count`` strides: the start, then half a stride each."""
    own, _, clear = strides(clip)
    even = np.linspace(0.0, clip.duration_s, 2 * max(count, 1) + 1 if count else 2)
    sure = clear if own == count else 0.3
    why = f"{count} strides in the speeds of the feet" if own == count else "even shares of the cycle"
    ends = len(even) - 2
    return Keytimes(
        tuple(map(float, even)), (1.0, *(sure,) * ends, 1.0), ("start of the cycle", *(why,) * ends, "end of the cycle")
    )
