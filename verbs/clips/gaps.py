"""Gaps: frames that repeat a value while the motion continues, and frames without a valid rotation.

A dropout holds the last value, or a constant such as zero, and ends in a jump. A held pose ends smoothly, so that it is
no gap.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from verbs.clips import paths, spikes
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.motion import Motion

__all__ = ["KIND", "LONGEST_S", "find", "mend"]

KIND = "gap"

LONGEST_S = 0.5
"""Longest gap that is interpolated; a longer one is only reported."""

STILL_RAD, STILL_M = 1e-6, 1e-6
"""Steps below which a frame repeats the one before."""

LEAST_RAD, LEAST_M = np.radians(1.0), 0.005
"""Least step out of a gap."""

RATIO, LONG_RATIO = 2.0, 1.5
"""Least ratio of the step out of a gap to the largest of the steps beside it; of a long gap, to their median."""

LONG = 4
"""Fewest repeated frames of a long gap: joints that stop at a limit for a moment repeat fewer."""

MOVING = 0.05
"""Least step into a long gap, as a share of the least step out of it: a joint that stands still may then jump."""

BESIDE = 3
"""Steps on each side of a gap with which the step out of it is compared."""

SHORTEST = 2
"""Fewest frames that repeat one before them."""

Flags = npt.NDArray[np.bool_]


def find(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """Gaps of all joints, or of some; one report for a gap that all moving joints share."""
    names = motion.skeleton.names
    chosen = list(range(len(names))) if joints is None else joints
    spans: dict[tuple[int, int], list[int]] = {}
    for joint in chosen:
        for span in _gaps_of(motion, joint):
            spans.setdefault(span, []).append(joint)
    reports = []
    for span, owners in sorted(spans.items()):
        still = paths.steps(motion.rotations[span[0] - 1 : span[1] + 1]).max(axis=0) < STILL_RAD
        shared = joints is None and len(owners) > 1 and bool(still.all())
        reports += [
            _report(motion, *span, None if shared else names[joint]) for joint in owners[: 1 if shared else None]
        ]
    return reports


def mend(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Interpolate gaps that are short enough.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        With a joint, only its gaps; with a start and an end, the frames between them, of any length.

    Raises
    ------
    UnknownName
        The skeleton has no joint of that name.
    """
    joints = None if wanted.joint is None else [motion.skeleton.index(wanted.joint)]
    if wanted.stretch is not None:
        reports = [_report(motion, *paths.frame_range(motion, *wanted.stretch), wanted.joint, forced=True)]
    else:
        reports = find(motion, joints)
    for report in (report for report in reports if report.proposed):
        first, last = paths.frame_range(motion, report.mend.start_s, report.mend.end_s)
        name = report.mend.joint
        for joint in range(len(motion.skeleton)) if name is None else [motion.skeleton.index(name)]:
            path = paths.replaced(motion.rotations[:, joint], first, last)
            root = paths.bridge(motion.root, first, last) if joint == 0 else None
            motion = paths.with_joint(motion, joint, path, root)
    return motion, reports


def _gaps_of(motion: Motion, joint: int) -> list[tuple[int, int]]:
    """First and last frames of the gaps of one joint, of the root's position too."""
    path = motion.rotations[:, joint]
    missing = np.linalg.norm(path, axis=1) < 0.5
    spans = {(int(first), int(last) - 1) for first, last in paths.runs(missing)}
    steps = np.where(missing[1:] | missing[:-1], 0.0, paths.steps(path))
    spans |= set(_held(steps, STILL_RAD, LEAST_RAD)) if not missing.any() else set()
    if joint == 0:
        moves = np.linalg.norm(np.diff(motion.root, axis=0), axis=1)
        spans |= set(_held(moves, STILL_M, LEAST_M))
    return sorted(spans)


def _held(steps: F64, still: float, least: float) -> list[tuple[int, int]]:
    """First and last frames of runs without steps (F - 1,) that end in a jump, not at the end of the motion."""
    found = []
    for first, after in paths.runs(steps < still):
        if after - first < SHORTEST or first == 0 or after == len(steps):
            continue
        into, out = steps[first - 1], steps[after]
        before, later = steps[max(first - 1 - BESIDE, 0) : first - 1], steps[after + 1 : after + 1 + BESIDE]
        usual = max([0.0, *before, *later])
        middle = float(np.median([*before, *later])) if len(before) + len(later) else 0.0
        is_long = after - first >= LONG and out >= max(least, LONG_RATIO * middle) and into >= MOVING * least
        if out < max(least, RATIO * usual) and not is_long:
            continue
        bogus = into >= max(least, RATIO * usual)  # the value that is held is wrong itself
        start = int(first) + (0 if bogus else 1)
        if not (bogus and after - start < spikes.LONGEST):  # else it is a spike
            found.append((start, int(after)))
    return found


def _report(motion: Motion, first: int, last: int, joint: str | None, *, forced: bool = False) -> Report:
    fps, count = motion.fps, last - first + 1
    start, end = round(first / fps, 4), round(last / fps, 4)
    length, index = count / fps, 0 if joint is None else motion.skeleton.index(joint)
    own = [index] if joint is not None else range(len(motion.skeleton))
    jump = max(_jump(motion.rotations[:, k], last) for k in own)
    short = forced or length <= LONGEST_S
    who = "every joint" if joint is None else f"joint '{joint}'"
    done = "interpolated from the frames around" if short else (
        f"left: longer than {LONGEST_S:g} s; a mend with start and end interpolates it"
    )  # fmt: skip
    return Report(
        Mend(KIND, joint, start, end),
        f"{who} has no new value from {start:g} to {end:g} s ({count} frames), then jumps by {jump:.1f}°",
        done,
        length,
        "s",
        proposed=short,
    )


def _jump(path: F64, last: int) -> float:
    pair = path[last : last + 2]
    return float(np.degrees(paths.steps(pair).max())) if len(pair) == 2 else 0.0
