"""Joints that spin a whole turn within a clip: found, and unwound the shorter way over a short stretch.

A path of rotations that returns to its start on the other side of the unit quaternions has gone round by a whole turn.
Markerless capture does this to wrists. The root may turn; every other joint has bones in its way.
"""

from __future__ import annotations

import numpy as np

from verbs.clips import paths
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.kernels import quat
from verbs.motion import Motion

__all__ = ["KIND", "find", "mend"]

KIND = "spin"

CLOSED_RAD = np.radians(90.0)
"""A whole turn leaves at most this angle between the rotations before and after it."""

LONGEST_S = 5.0
"""Longest turn that is looked for."""

RATE_HZ = 60.0
"""Rate of the frames between which turns are looked for; they are mended at every frame."""

EDGE = 0.18
"""The stretch is extended while the joint rotates faster than this share of its mean speed within the turn."""

MOST = 32
"""Most turns of one joint."""


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """Whole turns of all joints but the root, or of some joints, in the order of joints and time."""
    chosen = range(1, len(motion.skeleton)) if joints is None else joints
    return [report for joint in chosen for report in _unwound(motion, joint)[1]]


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Unwind whole turns the shorter way.

    Rotations outside each stretch stay as they are; inside, the joint takes the shorter way between the two ends.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        With a joint, only its turns; with a joint, a start and an end, the stretch between them.

    Raises
    ------
    UnknownName
        The skeleton has no joint of that name.
    """
    joints = list(range(1, len(motion.skeleton))) if wanted.joint is None else [motion.skeleton.index(wanted.joint)]
    reports: list[Report] = []
    for joint in joints:
        if wanted.joint is not None and wanted.stretch is not None:
            first, last = paths.frame_range(motion, *wanted.stretch)
            path, found = motion.rotations[:, joint], [_report(motion, joint, first, last)]
            path = _shorter(path, first, last)
        else:
            path, found = _unwound(motion, joint)
        if found:
            motion = paths.with_joint(motion, joint, path)
            reports += found
    return motion, reports


def _unwound(motion: Motion, joint: int) -> tuple[F64, list[Report]]:
    """Rotations (F, 4) of a joint without its whole turns, and a report on each."""
    path = motion.rotations[:, joint]
    reports: list[Report] = []
    while len(reports) < MOST and (found := _turn(path, motion.fps)):
        reports.append(_report(paths.with_joint(motion, joint, path), joint, *found))
        path = _shorter(path, *found)
    return path, sorted(reports, key=lambda report: report.mend.start_s or 0.0)


def _report(motion: Motion, joint: int, first: int, last: int) -> Report:
    name, fps = motion.skeleton.names[joint], motion.fps
    own = motion.rotations[first : last + 1, joint]
    turned = np.degrees(paths.steps(own).sum())
    rest = np.degrees(paths.angles(own[0], own[-1]))
    start, end = round(first / fps, 4), round(last / fps, 4)
    return Report(
        Mend(KIND, name, start, end),
        f"joint '{name}' spins {turned:.0f}° from {start:g} to {end:g} s (frames {first} to {last}); "
        f"the shorter way is {rest:.0f}°",
        "unwound the shorter way",
        float(turned - rest),
        "deg",
    )


def _turn(path: F64, fps: float) -> tuple[int, int] | None:
    """First and last frame of the shortest whole turn of a path (F, 4), extended to where it fades, or None."""
    path = quat.unroll(path)
    middle = quat.principal(path)
    if np.abs(path @ middle).min() > np.sqrt(0.5):  # all within 90° of their mean: no two are 180° apart
        return None
    stride = max(1, round(fps / RATE_HZ))
    coarse = path[::stride]
    closed = -np.cos(0.5 * CLOSED_RAD)
    for lag in range(2, min(len(coarse), int(LONGEST_S * fps / stride) + 1)):
        dots = np.sum(coarse[:-lag] * coarse[lag:], axis=1)
        at = int(np.argmin(dots))
        if dots[at] <= closed:
            return _extended(path, at * stride, (at + lag) * stride)
    return None


def _extended(path: F64, first: int, last: int) -> tuple[int, int]:
    """The stretch, longer while the joint still spins at a share of its mean speed."""
    speeds = paths.steps(path)
    enough = EDGE * speeds[first:last].mean()
    while first > 0 and speeds[first - 1] > enough:
        first -= 1
    while last < len(path) - 1 and speeds[last] > enough:
        last += 1
    return first, last


def _shorter(path: F64, first: int, last: int) -> F64:
    """Rotations (F, 4) that take the shorter way from one frame to another."""
    out = path.copy()
    shares = np.linspace(0.0, 1.0, last - first + 1)[1:-1]
    out[first + 1 : last] = paths.slerp(path[first], path[last], shares)
    return out
