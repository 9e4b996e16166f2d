"""Where a clip lies: the ground at y = 0, the root's start at x = z = 0, the start facing +Z."""

from __future__ import annotations

import numpy as np

from verbs.clips import feet
from verbs.clips.orientation import heading
from verbs.clips.reports import Mend, Report
from verbs.conventions import F64
from verbs.errors import OutOfRange
from verbs.kernels import fk, quat
from verbs.motion import Motion

__all__ = ["find_ground", "find_heading", "find_start", "ground_level", "mend_ground", "mend_heading", "mend_start"]

GROUND_M, START_M, HEADING_RAD = 0.08, 0.05, np.radians(45.0)
"""Least height of the ground, distance of the start and angle of the heading that are reported."""

SLOW_M_S, SLOW_PERCENT, LOW_PERCENT = 0.15, 30.0, 20.0
"""A foot is slow below this speed, or in this share of its frames; it stands where it is low among slow frames."""


def ground_level(motion: Motion) -> tuple[float, bool]:
    """Height of the ground, metres, and whether it is that of feet; that of the lowest joint in a clip without feet."""
    tracks, is_feet = _lowest(motion)
    return min(_level(track, motion.fps) for track in tracks), is_feet


def find_ground(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """The ground where it is not at y = 0; only that of feet is reported, and not of a clip that climbs."""
    del joints
    tracks, is_feet = _lowest(motion)
    if not is_feet:
        return []
    half = len(motion) // 2
    parts = [min(_level(track[part], motion.fps) for track in tracks) for part in (slice(half + 1), slice(half, None))]
    level = min(_level(track, motion.fps) for track in tracks)
    is_level = abs(parts[1] - parts[0]) < GROUND_M
    return [_ground_report(level)] if is_level and abs(level) > GROUND_M else []


def _lowest(motion: Motion) -> tuple[list[F64], bool]:
    """Paths (F, 3) of the feet's lowest points, or without feet of the lowest joint, and whether there are feet."""
    skeleton = motion.skeleton
    rotations, positions = fk.forward(motion.root, motion.rotations, skeleton.parents, skeleton.offsets)
    ends = [foot[-1] for foot in feet.feet(skeleton, rotations, positions)]
    if ends:
        return [feet.point_positions(rotations, positions, end.joint, end.offset) for end in ends], True
    lowest = int(np.argmin(np.percentile(positions[..., 1], LOW_PERCENT, axis=0)))
    return [positions[:, lowest]], False


def mend_ground(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Shift the clip so that the ground, or the given ``height`` (m), is at y = 0."""
    level = wanted.options.get("height", None)
    level = ground_level(motion)[0] if level is None else level
    root = motion.root - np.array([0.0, level, 0.0])
    return Motion(motion.skeleton, motion.fps, root, motion.rotations), [_ground_report(level)]


def find_start(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """The start of the root where it is not at x = z = 0."""
    del joints
    away = float(np.hypot(motion.root[0, 0], motion.root[0, 2]))
    return mend_start(motion, Mend("start"))[1] if away > START_M else []


def mend_start(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Shift the clip so that its root starts at x = z = 0."""
    x, _, z = (float(value) for value in motion.root[0])
    root = motion.root - np.array([x, 0.0, z])
    report = Report(
        Mend("start", options=wanted.options),
        f"the root starts at x = {x:.3f}, z = {z:.3f} m",
        "moved to x = z = 0",
        1000.0 * float(np.hypot(x, z)),
        "mm",
    )
    return Motion(motion.skeleton, motion.fps, root, motion.rotations), [report]


def find_heading(motion: Motion, joints: list[int] | None = None) -> list[Report]:
    """The heading of the first frame where it is far from +Z."""
    del joints
    angle = heading(motion)
    return [_heading_report(angle)] if angle is not None and abs(angle) > HEADING_RAD else []


def mend_heading(motion: Motion, wanted: Mend) -> tuple[Motion, list[Report]]:
    """Rotate the clip about +Y, at the root's start, so that it starts facing +Z.

    Parameters
    ----------
    motion : Motion
    wanted : Mend
        ``degrees`` is the heading that becomes +Z; by default that of hips and shoulders at the first frame.

    Raises
    ------
    OutOfRange
        The heading is not given, and the skeleton has no paired joints that would show it.
    """
    degrees = wanted.options.get("degrees")
    angle = heading(motion) if degrees is None else float(np.radians(degrees))
    if angle is None:
        raise OutOfRange("no left and right joints show the heading; give degrees")
    turn = quat.exp(np.array([0.0, -angle, 0.0]))
    pivot = motion.root[0] * np.array([1.0, 0.0, 1.0])
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    root = quat.rotate(turn, motion.root - pivot) + pivot
    return Motion(motion.skeleton, motion.fps, root, rotations), [_heading_report(angle)]


def _level(path: F64, fps: float) -> float:
    """Height at which a point (F, 3) stands: low among its slow frames."""
    lag = max(1, round(fps / 30.0))
    if len(path) <= lag:
        return float(path[:, 1].min())
    speeds = np.linalg.norm(path[lag:] - path[:-lag], axis=1) * fps / lag
    slow = path[:-lag][speeds <= max(SLOW_M_S, float(np.percentile(speeds, SLOW_PERCENT))), 1]
    return float(np.percentile(slow, LOW_PERCENT))


def _ground_report(level: float) -> Report:
    return Report(
        Mend("ground", options={"height": round(level, 4)}),
        f"the ground is at y = {level:.3f} m",
        "moved to y = 0",
        1000.0 * abs(level),
        "mm",
    )


def _heading_report(angle: float) -> Report:
    degrees = float(np.degrees(angle))
    return Report(
        Mend("heading", options={"degrees": round(degrees, 2)}),
        f"the clip starts facing {degrees:.0f}° from +Z",
        "rotated about +Y to face +Z",
        abs(degrees),
        "deg",
    )
