"""Cycles: strides counted, files that are one cycle recognised, a cycle cut from a longer clip and closed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.proposal.clips import Clip, Refused, clip_of
from verbs.proposal.features import foot_joints, stature

__all__ = ["CUT", "Cut", "Seam", "cut_cycle", "is_cycle", "one_each", "period", "seam", "strides"]

CUT = "_cycle"
"""Added to the name of a file for the cycle that is cut from it."""

RATE_HZ = 60.0

PERIOD_S = (0.5, 3.0)
"""Shortest and longest stride."""

MOST_STRIDES = 6

CLOSED_SHARE, CLOSED_M = 0.25, 0.02
"""A clip is a cycle if its ends differ less than this share of what its poses differ, or less than this (RMS)."""

POOR_DIP = 0.5
"""A stride repeats if poses one stride apart differ less than this share of the median over all lags."""


@dataclass(frozen=True, slots=True)
class Seam:
    """Gap between the last frame and the first, moved and turned: RMS and greatest over joints, metres; share."""

    rms_m: float
    most_m: float
    share: float

    @property
    def closed(self) -> bool:
        """Whether the clip is a cycle."""
        return self.share < CLOSED_SHARE or self.rms_m < CLOSED_M


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A cycle that was cut from a clip: the closed cycle, its first and last frame in the clip, and its seam."""

    clip: Clip
    first: int
    last: int
    seam: Seam


def local_poses(clip: Clip, times: F64) -> F64:
    """Joint positions (n, J, 3) about the root's ground point, without the change of heading; heights from the root."""
    places, angles = clip.at(clip.positions, times), clip.at(clip.headings, times)
    about = places - places[:, :1]
    sine, cosine = np.sin(angles)[:, None], np.cos(angles)[:, None]
    x, z = about[..., 0] * cosine - about[..., 2] * sine, about[..., 0] * sine + about[..., 2] * cosine
    return np.stack([x, about[..., 1], z], axis=-1)


def seam(clip: Clip, first: int = 0, last: int = -1) -> Seam:
    """The seam of a clip between two of its frames."""
    frames = np.arange(len(clip.motion))[[first, last]] / clip.motion.fps
    ends = local_poses(clip, frames)
    gaps = np.linalg.norm(ends[1] - ends[0], axis=-1)
    usual = local_poses(clip, np.linspace(frames[0], frames[1], 60))
    spread = np.sqrt(np.mean(np.sum((usual - usual.mean(axis=0)) ** 2, axis=-1))) * np.sqrt(2.0)
    rms = float(np.sqrt(np.mean(gaps**2)))
    return Seam(rms, float(gaps.max()), rms / max(float(spread), 1e-9))


def is_cycle(clip: Clip) -> bool:
    """Whether a file is one cycle already: its last pose is its first, and it moves at both ends alike."""
    return seam(clip).closed


def _feet_signal(clip: Clip, times: F64) -> F64 | None:
    """Speed of the right foot less the left one's (n,), m/s: greatest where the left stands; None without feet."""
    joints = foot_joints(clip)
    if len(joints) < 2:
        return None
    names = [clip.motion.skeleton.names[joint].lower() for joint in joints]
    left = next((joint for joint, name in zip(joints, names, strict=True) if "left" in name or name[:1] == "l"), None)
    joints = sorted(joints[:2], key=lambda joint: joint != left)
    step = times[1] - times[0]
    speeds = [np.linalg.norm(np.gradient(clip.path_of(joint, times), step, axis=0), axis=1) for joint in joints]
    return np.asarray(speeds[1] - speeds[0])


def strides(clip: Clip) -> tuple[int, float, float]:
    """Strides of a cycle, the share of a stride at which the left foot stands first, and how clear that is, 0 to 1.

    The dominant harmonic of the difference of the feet's speeds; 0 strides where the feet rest.
    """
    times = np.linspace(0.0, clip.duration_s, 257)
    signal = _feet_signal(clip, times)
    if signal is None or np.sqrt(np.mean(signal**2)) < 0.05 * stature(clip):
        return 0, 0.0, 0.0
    spectrum = np.fft.rfft(signal[:-1] - signal[:-1].mean())
    power = np.abs(spectrum[1 : MOST_STRIDES + 1]) ** 2
    count = 1 + int(np.argmax(power))
    share = float((-np.angle(spectrum[count]) / (2.0 * np.pi)) % 1.0)
    return count, share, float(power.max() / max(np.sum(np.abs(spectrum[1:]) ** 2), 1e-12))


def _with_speeds(poses: F64, step_s: float) -> F64:
    """Poses (n, D) with their speeds beside them, which weigh as much as 0.1 s of motion."""
    return np.concatenate([poses, 0.1 * np.asarray(np.gradient(poses, step_s, axis=0))], axis=1)


def period(clip: Clip) -> tuple[float, float]:
    """Length of a stride, seconds, and how clearly it repeats, 0 to 1; by the lag at which poses recur.

    Source: the self-similarity of motion, as in L. Kovar, M. Gleicher, F. Pighin, "Motion Graphs", 2002, section 3.1.
    """
    rate = min(RATE_HZ, 2_000 / max(clip.duration_s, 1e-9))
    times = clip.times(rate)
    poses = local_poses(clip, times).reshape(len(times), -1)
    step = times[1] - times[0]
    poses = _with_speeds(poses, step)
    low, high = int(PERIOD_S[0] / step), min(int(PERIOD_S[1] / step), len(times) * 2 // 3)
    if high <= low + 2:
        return 0.0, 0.0
    lags = np.arange(low, high)
    gaps = np.array([np.sqrt(np.mean((poses[lag:] - poses[:-lag]) ** 2)) for lag in lags])
    usual, least = float(np.median(gaps)), float(gaps.min())
    limit = least + 0.35 * (usual - least)
    dips = [k for k in range(1, len(lags) - 1) if gaps[k] <= limit and gaps[k - 1] >= gaps[k] <= gaps[k + 1]]
    if not dips:
        return 0.0, 0.0
    return float(lags[dips[0]] * step), float(np.clip(1.0 - gaps[dips[0]] / max(usual, 1e-12), 0.0, 1.0))


def cut_cycle(clip: Clip, count: int = 1) -> Cut | None:
    """A cycle of ``count`` strides cut from a longer clip where it closes best, from the left foot's stance on.

    Returns
    -------
    cut : Cut or None
        None where no stride repeats.
    """
    stride, clear = period(clip)
    if clear < 1.0 - POOR_DIP or clip.duration_s < stride * count:
        return None
    fps = clip.motion.fps
    frames = np.arange(len(clip.motion)) / fps
    poses = local_poses(clip, frames).reshape(len(frames), -1)
    poses = _with_speeds(poses, 1.0 / fps)
    starts = _stances(clip, frames)
    best: tuple[float, int, int] | None = None
    for first in starts:
        aim = first + count * stride * fps
        for last in range(int(aim - 0.1 * stride * fps), int(aim + 0.1 * stride * fps) + 2):
            if first + 2 < last < len(frames):
                gap = float(np.sqrt(np.mean((poses[last] - poses[first]) ** 2)))
                if best is None or gap < best[0]:
                    best = (gap, int(first), last)
    if best is None:
        return None
    _, first, last = best
    part = slice(first, last + 1)
    cycle = closed(Motion(clip.motion.skeleton, fps, clip.motion.root[part], clip.motion.rotations[part]))
    found = seam(clip, first, last)
    return Cut(clip_of(clip.path.with_name(f"{clip.path.stem}{CUT}.bvh"), cycle), first, last, found)


def _stances(clip: Clip, frames: F64) -> list[int]:
    """Frames at which a cycle may begin: the middle of each stance of the left foot; every frame without feet."""
    signal = _feet_signal(clip, frames)
    if signal is None:
        return list(range(len(frames)))
    width = max(1, int(0.15 * clip.motion.fps))
    smooth = np.convolve(np.pad(signal, width, mode="edge"), np.ones(width) / width, "same")[width:-width]
    inner = (smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:]) & (smooth[1:-1] > 0.3 * smooth.max())
    return [int(k) + 1 for k in np.flatnonzero(inner)] or list(range(len(frames)))


def closed(motion: Motion) -> Motion:
    """A cycle whose last frame is its first, moved and turned; the gap is spread over the cycle.

    The root starts at x = z = 0.
    """
    share = np.linspace(0.0, 1.0, len(motion))
    rotations = quat.unroll(motion.rotations)
    since = quat.unroll(quat.mul(rotations[:, 0], quat.conjugate(rotations[0, 0])))
    yaw = 2.0 * np.unwrap(np.arctan2(since[:, 1], since[:, 3]))[-1]
    last = rotations[0].copy()
    last[0] = quat.mul(np.array([0.0, np.sin(0.5 * yaw), 0.0, np.cos(0.5 * yaw)]), last[0])
    gaps = quat.log(quat.mul(quat.conjugate(rotations[-1]), last))
    rotations = quat.mul(rotations, quat.exp(share[:, None, None] * gaps))
    root = motion.root - motion.root[:1] * np.array([1.0, 0.0, 1.0])
    root[:, 1] += share * (root[0, 1] - root[-1, 1])
    return Motion(motion.skeleton, motion.fps, root, quat.normalize(rotations))


def one_each(clips: list[Clip]) -> tuple[list[Clip], list[Refused], dict[str, Cut], int]:
    """Clips that are one cycle each, cut where they are longer; the others; the cuts; and the strides of a cycle."""
    closed = [is_cycle(clip) for clip in clips]
    own = [strides(clip) if whole else (0, 0.0, 0.0) for clip, whole in zip(clips, closed, strict=True)]
    steps = Counter(count for count, _, _ in own if count)
    count = steps.most_common(1)[0][0] if steps else 1
    stems = {clip.path.stem for clip in clips}
    middle = np.angle(sum(np.exp(2j * np.pi * share) for n, share, _ in own if n == count))
    kept, refused, cuts = [], [], {}
    for clip, whole, (n, share, _) in zip(clips, closed, own, strict=True):
        if not whole:
            if f"{clip.path.stem}{CUT}" in stems:
                continue  # its cycle is there already
            cut = cut_cycle(clip, count)
            if cut is None:
                refused.append(
                    Refused(clip.name, "is not one cycle, and no stride of it repeats", "cut it to one cycle")
                )
                continue
            kept.append(cut.clip)
            cuts[cut.clip.name] = cut
        elif n not in (0, count):
            refused.append(Refused(clip.name, f"has {n} strides, the others {count}", f"cut it to {count}"))
        elif n and abs(np.angle(np.exp(1j * (2 * np.pi * share - middle)))) > 0.6 * np.pi:
            refused.append(Refused(clip.name, "starts on the other foot", "start its cycle half a stride later"))
        else:
            kept.append(clip)
    return kept, refused, cuts, count
