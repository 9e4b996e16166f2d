"""Features of clips for their alignment: joint positions about the root, joint speeds, contacts of the feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.authoring.contact_detection import standing
from verbs.clips.feet import feet, leg_length
from verbs.conventions import F64
from verbs.kernels import dtw, fk
from verbs.kernels.compile import direct
from verbs.proposal.clips import Clip

__all__ = ["Features", "Path", "align", "distances", "features_of", "foot_joints", "stature"]

RATE_HZ, MOST_FRAMES = 30.0, 500
"""Rate of features; lower for clips that would have more frames than that."""

BAND_SHARE = 0.25
"""Half of the band of the alignment, as a share of the longer clip."""

PENALTY = 0.15
"""Cost of a step along one clip only, in median distances of frames."""

MOST_DIMENSIONS = 24
"""Principal components of the features that are kept."""

COARSE_HZ = 8.0
"""Rate at which clips are compared with each other."""

SPEED_WEIGHT, PLACE_WEIGHT, CONTACT_WEIGHT = 1.0, 0.6, 0.5

_warp = direct(dtw.warp)


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features (n, D) of one clip at times (n,) in seconds."""

    times: F64
    rows: F64


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """An alignment of two clips.

    Parameters
    ----------
    first, second : (P,) float64
        Seconds of frames that belong together, ascending.
    cost : float
        Mean distance of features along the path.
    """

    first: F64
    second: F64
    cost: float

    def mapped(self, time: float) -> tuple[float, float]:
        """Instant of the second clip that belongs to one of the first, and the path's slope about it."""
        to = float(np.interp(time, *self._function()))
        width = 0.1 * max(self.first[-1], 1e-9)
        ends = np.clip([time - width, time + width], 0.0, self.first[-1])
        there = np.interp(ends, *self._function())
        return to, float((there[1] - there[0]) / max(ends[1] - ends[0], 1e-9))

    def _function(self) -> tuple[F64, F64]:
        """The path as a function of the first clip: the mean where one frame has several partners."""
        times, index = np.unique(self.first, return_inverse=True)
        return times, np.bincount(index, self.second) / np.bincount(index)


def stature(clip: Clip) -> float:
    """Size of a body, metres: the median height of the bounding box of its joints."""
    return float(np.median(np.ptp(clip.positions[..., 1], axis=1)))


def foot_joints(clip: Clip) -> list[int]:
    """Ankles of the feet; empty where the skeleton has none that the clip shows."""
    step = max(1, len(clip.motion) // 200)
    part = slice(None, None, step)
    skeleton = clip.motion.skeleton
    rotations, positions = fk.forward(
        clip.motion.root[part], clip.motion.rotations[part], skeleton.parents, skeleton.offsets
    )
    return [points[0].foot for points in feet(skeleton, rotations, positions)]


def contact_flags(clip: Clip, joint: int, times: F64) -> F64:
    """Whether a foot stands, 0 or 1, (n,) at times of 60 Hz."""
    path = clip.path_of(joint, times)
    rate = (len(times) - 1) / max(times[-1], 1e-9)
    speeds = np.linalg.norm(np.gradient(path, 1.0 / rate, axis=0), axis=1)
    root = clip.path_of(0, times) * np.array([1.0, 0.0, 1.0])
    travel = np.linalg.norm(np.gradient(root, 1.0 / rate, axis=0), axis=1)
    window = max(1, int(0.5 * rate))
    travel = np.convolve(np.pad(travel, window // 2, mode="edge"), np.ones(window) / window, "same")[
        window // 2 : window // 2 + len(times)
    ]
    level = np.percentile(path[:, 1], 15.0)
    scale = leg_length(clip.motion.skeleton, joint) / 0.85
    return standing(speeds, path[:, 1] - level, travel, scale or 1.0).astype(np.float64)


def features_of(clips: list[Clip]) -> list[Features]:
    """Features of clips of one skeleton, scaled by what is usual among them."""
    raw = [_raw(clip) for clip in clips]
    speeds = np.concatenate([one[1] for one in raw])
    places = np.concatenate([one[2] for one in raw])
    speed_scale = np.sqrt(np.mean((speeds - speeds.mean(axis=0)) ** 2) + 1e-12)
    place_scale = np.sqrt(np.mean((places - places.mean(axis=0)) ** 2) + 1e-12)
    found = []
    for _, own_speeds, own_places, contacts in raw:
        blocks = (
            SPEED_WEIGHT * own_speeds / (speed_scale * np.sqrt(own_speeds.shape[1])),
            PLACE_WEIGHT * own_places / (place_scale * np.sqrt(own_places.shape[1])),
            CONTACT_WEIGHT * contacts,
        )
        found.append(np.concatenate(blocks, axis=1))
    axes = _principal(found)
    return [Features(one[0], np.ascontiguousarray(rows @ axes)) for one, rows in zip(raw, found, strict=True)]


def _principal(rows: list[F64]) -> F64:
    """Axes (D, MOST_DIMENSIONS at most) along which the rows of all clips vary most."""
    every = np.concatenate(rows)
    every = every - every.mean(axis=0)
    _, axes = np.linalg.eigh(every.T @ every)
    return np.asarray(axes[:, ::-1][:, :MOST_DIMENSIONS])


def distances(features: list[Features]) -> F64:
    """Distances (N, N) of clips: mean distance of features along their alignment, at a low rate."""
    count = len(features)
    coarse = []
    for one in features:
        rate = (len(one.times) - 1) / max(one.times[-1], 1e-9)
        step = max(1, int(rate / COARSE_HZ))
        coarse.append(Features(one.times[::step], np.ascontiguousarray(one.rows[::step])))
    found = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            found[i, j] = found[j, i] = align(coarse[i], coarse[j]).cost
    return found


def _raw(clip: Clip) -> tuple[F64, F64, F64, F64]:
    """Times, speeds (n, J), places (n, 3·J) and contacts (n, feet) of a clip."""
    times = clip.times(min(RATE_HZ, MOST_FRAMES / max(clip.duration_s, 1e-9)))
    size = stature(clip) or 1.0
    places = clip.at(clip.positions, times) / size
    angles = clip.at(clip.headings, times)
    ground = places[:, :1] * np.array([1.0, 0.0, 1.0])
    about = places - ground
    sine, cosine = np.sin(angles)[:, None], np.cos(angles)[:, None]
    x = about[..., 0] * cosine - about[..., 2] * sine
    z = about[..., 0] * sine + about[..., 2] * cosine
    local = np.stack([x, about[..., 1], z], axis=-1)
    step = times[1] - times[0]
    speeds = np.linalg.norm(np.gradient(local, step, axis=0), axis=-1)
    contacts = np.zeros((len(times), 0))
    joints = foot_joints(clip)
    if joints:
        fine = clip.times(60.0)
        contacts = np.stack([np.interp(times, fine, contact_flags(clip, joint, fine)) for joint in joints], axis=1)
    return times, np.log1p(3.0 * speeds), local.reshape(len(times), -1), contacts


def align(first: Features, second: Features) -> Path:
    """Dynamic time warping of two clips; costs are comparable within one set of features."""
    a, b = first.rows, second.rows
    half = max(int(BAND_SHARE * max(len(a), len(b))), int(np.ceil(len(b) / len(a))) + 1, 2)
    sample = np.linalg.norm(a[:, None][:: max(1, len(a) // 40)] - b[None][:, :: max(1, len(b) // 40)], axis=-1)
    penalty = PENALTY * float(np.median(sample))
    path = np.empty((len(a) + len(b), 2), np.int64)
    cost, length = _warp(a, b, half, penalty, path)
    pairs = path[:length][::-1]
    return Path(first.times[pairs[:, 0]], second.times[pairs[:, 1]], float(cost) / max(length, 1))
