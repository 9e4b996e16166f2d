"""Jitter: noise above a cut-off frequency in rotations and in the root's position, removed by a low-pass filter.

The filter is a second-order Butterworth low-pass that runs forward and backward: fourth order, without a shift in time.
It filters the root's position, and quaternions in one hemisphere that are then scaled to unit length.

Source: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 2009, section 3.4.4.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from verbs.clips import paths
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.errors import OutOfRange
from verbs.kernels import quat
from verbs.motion import Motion

__all__ = ["CUTOFF_HZ", "KIND", "find", "mend"]

KIND = "jitter"

CUTOFF_HZ = 8.0
"""Default cut-off frequency; human motion lies below, except for impacts."""

LEVEL_RAD, LEVEL_M = np.radians(0.3), 0.0015
"""Robust levels of what lies above the cut-off from which on jitter is reported: of a rotation, and of the root."""

SHARE = 0.3
"""Least ratio of the robust level to the median step between frames: below, it is fast motion."""

ALIKE = 0.2
"""Most correlation of what lies above the cut-off between successive frames: noise has none or less."""

FEWEST = 24
"""Fewest frames of a clip that is filtered."""


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """Joints with jitter, in their order; the root's position counts with its joint."""
    chosen = list(range(len(motion.skeleton))) if joints is None else joints
    if not _possible(motion, CUTOFF_HZ):
        return []
    reports = []
    for joint in chosen:
        path = motion.rotations[:, joint]
        smooth = _smooth_rotations(path, motion.fps, CUTOFF_HZ)
        removed = quat.log(quat.mul(quat.conjugate(smooth), path))
        if _is_noise(removed, paths.steps(path), LEVEL_RAD):
            reports.append(_report(motion, joint, np.degrees(_rms(removed)), "deg", CUTOFF_HZ))
        if joint == 0:
            away = motion.root - _filtered(motion.root, motion.fps, CUTOFF_HZ)
            if _is_noise(away, np.linalg.norm(np.diff(motion.root, axis=0), axis=1), LEVEL_M):
                reports.append(_report(motion, 0, 1000.0 * _rms(away), "mm", CUTOFF_HZ))
    return reports


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Filter the joints that have jitter, or one joint.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        With a joint, that joint is filtered whether it has jitter or not. ``cutoff_hz`` is the cut-off frequency.

    Raises
    ------
    OutOfRange
        The cut-off is not between 0 and half the frame rate, or the clip is too short to be filtered.
    UnknownName
        The skeleton has no joint of that name.
    """
    cutoff = wanted.options.get("cutoff_hz", CUTOFF_HZ)
    if "cutoff_hz" in wanted.options or wanted.joint is not None:
        _check(motion, cutoff)
    if wanted.joint is not None:
        joints = [motion.skeleton.index(wanted.joint)]
    else:
        joints = sorted({motion.skeleton.index(str(report.mend.joint)) for report in find(motion)})
    reports = []
    for joint in joints:
        smooth = _smooth_rotations(motion.rotations[:, joint], motion.fps, cutoff)
        removed = np.degrees(_rms(quat.log(quat.mul(quat.conjugate(smooth), motion.rotations[:, joint]))))
        reports.append(_report(motion, joint, removed, "deg", cutoff))
        root = None
        if joint == 0:
            root = _filtered(motion.root, motion.fps, cutoff)
            away = 1000.0 * _rms(motion.root - root)
            reports.append(_report(motion, 0, away, "mm", cutoff))
        motion = paths.with_joint(motion, joint, smooth, root)
    return motion, reports


def _possible(motion: Motion, cutoff: float) -> bool:
    return len(motion) >= FEWEST and 0.0 < cutoff < 0.5 * motion.fps


def _check(motion: Motion, cutoff: float) -> None:
    if not _possible(motion, cutoff):
        raise OutOfRange(
            f"cutoff_hz is {cutoff:g}; a clip of {len(motion)} frames at {motion.fps:g} fps needs one above 0 and "
            f"below {0.5 * motion.fps:g} Hz, and at least {FEWEST} frames"
        )


def _filtered(values: F64, fps: float, cutoff: float) -> F64:
    return np.asarray(sosfiltfilt(butter(2, cutoff, fs=fps, output="sos"), values, axis=0))


def _smooth_rotations(rotations: F64, fps: float, cutoff: float) -> F64:
    return quat.normalize(_filtered(quat.unroll(rotations), fps, cutoff))


def _rms(vectors: F64) -> float:
    """Root mean square length of vectors (F, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _is_noise(removed: F64, steps: F64, least: float) -> bool:
    """Whether what lies above the cut-off (F, 3) is noise, given the steps (F - 1,) between frames.

    Levels are medians: fast motion of a few frames does not count.
    """
    level = 1.4826 * float(np.median(np.linalg.norm(removed, axis=1)))
    if level <= least or level <= 1.4826 * SHARE * float(np.median(steps)):
        return False
    return float(np.sum(removed[1:] * removed[:-1])) < ALIKE * float(np.sum(removed**2))


def _report(motion: Motion, joint: int, figure: float, unit: str, cutoff: float) -> Report:
    name = motion.skeleton.names[joint]
    what, shown = ("joint", f"{figure:.2f}°") if unit == "deg" else ("the position of the root", f"{figure:.2f} mm")
    return Report(
        Mend(KIND, name, options={"cutoff_hz": cutoff}),
        f"{what} '{name}' shakes by {shown} rms above {cutoff:g} Hz",
        f"low-pass filtered (Butterworth, zero phase, fourth order) at {cutoff:g} Hz",
        figure,
        unit,
    )
