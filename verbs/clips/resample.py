"""Cut a motion to a stretch of time, and resample it at another rate, by the splines that curves are fitted with."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from verbs.conventions import F64, MAX_FRAMES
from verbs.errors import OutOfRange
from verbs.kernels import quat
from verbs.motion import Motion

__all__ = ["at_times", "resample", "trim"]

SLACK = 1e-4
"""Share of a frame by which times may miss a frame, or the end of the motion: seconds in files are rounded."""


def at_times(motion: Motion, times: F64, fps: float) -> Motion:
    """A motion at given times.

    Root positions and quaternions in one hemisphere are interpolated by cubic splines; quaternions are then scaled to
    unit length. A time on a frame gives that frame to the last bit.

    Parameters
    ----------
    motion : Motion
    times : (T,) float64
        Seconds, inside the motion.
    fps : float
        Rate of the result.
    """
    frames = times * motion.fps
    nearest = np.clip(np.round(frames).astype(np.int64), 0, len(motion) - 1)
    exact = np.abs(frames - nearest) <= SLACK
    root, rotations = motion.root[nearest], motion.rotations[nearest]
    if not exact.all():
        own = np.arange(len(motion), dtype=np.float64)
        between = frames[~exact]
        root[~exact] = _interpolated(own, motion.root, between)
        rotations[~exact] = quat.normalize(_interpolated(own, quat.unroll(motion.rotations), between))
    return Motion(motion.skeleton, fps, root, rotations)


def trim(motion: Motion, start_s: float, end_s: float) -> Motion:
    """The stretch of a motion between two times, at the same rate; its first frame is exactly at ``start_s``.

    The last frame is the last one that is not after ``end_s``.

    Raises
    ------
    OutOfRange
        The times are not inside the motion, or the end is before the start.
    """
    slack = SLACK / motion.fps
    if not -slack <= start_s <= end_s <= motion.duration_s + slack:  # NaN compares false
        raise OutOfRange(
            f"cannot trim to {start_s:g} to {end_s:g} s: give 0 ≤ from ≤ to ≤ {motion.duration_s:g} s, "
            "the length of the motion"
        )
    count = int(np.floor((end_s - start_s) * motion.fps + 2.0 * SLACK)) + 1
    return at_times(motion, start_s + np.arange(count) / motion.fps, motion.fps)


def resample(motion: Motion, fps: float) -> Motion:
    """The motion at another rate, from its first frame on; less than one new frame is lost at the end.

    Raises
    ------
    OutOfRange
        The rate is not above zero, or gives too many frames.
    """
    if not (np.isfinite(fps) and fps > 0.0):
        raise OutOfRange(f"fps must be above 0, not {fps}")
    last = motion.duration_s * fps + SLACK
    if last >= MAX_FRAMES:
        raise OutOfRange(f"{fps:g} fps give {last + 1:.0f} frames; a motion has at most {MAX_FRAMES}")
    return at_times(motion, np.arange(int(last) + 1) / fps, fps)


def _interpolated(frames: F64, values: F64, at: F64) -> F64:
    """Values (F, …) at places between frames: cubic, or linear of fewer than three frames."""
    if len(frames) < 3:
        share = np.clip(at, 0.0, 1.0).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[0] + share * (values[-1] - values[0]))
    return np.asarray(CubicSpline(frames, values)(np.clip(at, 0.0, frames[-1])))
