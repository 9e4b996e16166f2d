"""Spikes and flips of one to three frames, against the frames around them.

A spike enters and leaves by steps that are large beside all other steps nearby, and the frames on both sides of it
agree. A fast punch has several large steps in a row, so none of them is large beside its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from verbs.clips import paths
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.motion import Motion

__all__ = ["KIND", "find", "mend"]

KIND = "spike"

LONGEST = 3
"""Most frames of a spike."""

LEAST_RAD, LEAST_M = np.radians([6.0, 10.0, 15.0]), np.array([0.02, 0.03, 0.05])
"""Least size of a spike of 1, 2 and 3 frames: of a rotation, and of the root's position."""

RATIO = 5.0
"""Least ratio of the steps into and out of a spike to the robust step of the frames around it."""

BRIDGE = 0.25
"""Most distance of the frames on both sides of a spike, as a share of the step into it, beyond usual steps."""

WINDOW = 8
"""Frames on each side of a spike from which the robust step is taken."""

Steps = Callable[[F64, int], F64]
"""Distances (F - lag,) of frames that lie some frames apart."""


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """Spikes of all joints, or of some, in the order of joints and time; the root's position counts with its joint."""
    chosen = range(len(motion.skeleton)) if joints is None else joints
    reports = []
    for joint in chosen:
        spans = _spikes(motion.rotations[:, joint], _turned, LEAST_RAD)
        reports += [_report(motion, joint, *span, "deg") for span in spans]
        if joint == 0:
            spans = _spikes(motion.root, _moved, LEAST_M)
            reports += [_report(motion, 0, *span, "mm") for span in spans]
    return reports


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Replace spikes by interpolation of the frames around them.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        With a joint, only its spikes; with a joint, a start and an end, the frames between them. Both the rotation
        and the position of the root are interpolated.

    Raises
    ------
    UnknownName
        The skeleton has no joint of that name.
    """
    joints = None if wanted.joint is None else [motion.skeleton.index(wanted.joint)]
    if joints is not None and wanted.stretch is not None:
        first, last = paths.frame_range(motion, *wanted.stretch)
        reports = [_report(motion, joints[0], first, last, "deg")]
    else:
        reports = find(motion, joints)
    for report in reports:
        joint = motion.skeleton.index(str(report.mend.joint))
        first, last = paths.frame_range(motion, report.mend.start_s, report.mend.end_s)
        path = paths.replaced(motion.rotations[:, joint], first, last)
        motion = paths.with_joint(motion, joint, path, paths.bridge(motion.root, first, last) if joint == 0 else None)
    return motion, reports


def _turned(path: F64, lag: int) -> F64:
    return paths.angles(path[:-lag], path[lag:])


def _moved(path: F64, lag: int) -> F64:
    return np.asarray(np.linalg.norm(path[lag:] - path[:-lag], axis=1))


def _spikes(path: F64, distance: Steps, least: F64) -> list[tuple[int, int]]:
    """First and last frames of the spikes of a path; shorter ones are taken first."""
    found: list[tuple[int, int]] = []
    if len(path) < 2 * LONGEST + 2:
        return found
    single = distance(path, 1)
    taken = np.zeros(len(path), np.bool_)
    for length in range(1, LONGEST + 1):
        across = distance(path, length + 1)
        enter, leave = single[: len(across)], single[length : length + len(across)]
        small = np.minimum(enter, leave)
        inner = [single[k : k + len(across)] for k in range(1, length)]
        quiet = np.all([step < small for step in inner], axis=0) if inner else True
        for before in np.flatnonzero((small > least[length - 1]) & (across < small) & quiet):
            first, last = int(before) + 1, int(before) + length
            usual = _usual(single, first, last)
            agree = across[before] < BRIDGE * small[before] + (length + 1) * usual
            if taken[first - 1 : last + 2].any() or small[before] < RATIO * usual or not agree:
                continue
            taken[first : last + 1] = True
            found.append((first, last))
    return sorted(found)


def _usual(single: F64, first: int, last: int) -> float:
    """Robust step (median and median absolute deviation) around frames ``first`` to ``last``, without theirs."""
    around = np.concatenate([single[max(first - 1 - WINDOW, 0) : first - 1], single[last + 1 : last + 1 + WINDOW]])
    middle = float(np.median(around))
    return middle + 1.4826 * float(np.median(np.abs(around - middle)))


def _report(motion: Motion, joint: int, first: int, last: int, unit: str) -> Report:
    name, fps = motion.skeleton.names[joint], motion.fps
    start, end = round(first / fps, 4), round(last / fps, 4)
    smooth = paths.replaced(motion.rotations[:, joint], first, last)[first : last + 1]
    if unit == "deg":
        size = float(np.degrees(paths.angles(smooth, motion.rotations[first : last + 1, joint]).max()))
    else:
        path = paths.bridge(motion.root, first, last)[first : last + 1]
        size = float(1000.0 * np.linalg.norm(path - motion.root[first : last + 1], axis=1).max())
    frames = f"frame {first}" if first == last else f"frames {first} to {last}"
    of, shown = ("joint", f"{size:.0f}°") if unit == "deg" else ("the position of the root", f"{size:.0f} mm")
    return Report(
        Mend(KIND, name, start, end),
        f"{of} '{name}' jumps by {shown} at {start:g} s ({frames}) and back",
        "interpolated from the frames around",
        size,
        unit,
    )
