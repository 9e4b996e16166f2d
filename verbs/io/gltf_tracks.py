"""Animation channels of a glTF file, sampled at the frames of a motion.

Source: Khronos, "glTF 2.0 Specification", appendix C (interpolation modes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, MAX_FRAMES
from verbs.io.bvh_reader import frame_rate
from verbs.io.gltf_accessors import Accessors
from verbs.io.gltf_document import Document, Row, shown
from verbs.kernels import quat

__all__ = ["PATHS", "Track", "key_rate", "read_tracks", "sample"]

PATHS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
_MODES = ("LINEAR", "STEP", "CUBICSPLINE")

MAX_CLIP_KEYS = 60_000_000
"""Keys of all channels of a clip: channels may share one accessor, so that a small file could declare many."""

_STEP_S = 1e-5
"""A STEP key counts from so long before its time: frame times and stored times round differently."""

_USUAL = (24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 120.0, 240.0)
_OTHERWISE = 60.0
_FASTEST = 1000.0


@dataclass(frozen=True, slots=True)
class Track:
    """Keys of one channel.

    Parameters
    ----------
    times : (K,) float64
        Seconds, rising.
    values : (K, C) float64
        Or (K, 3, C) for ``CUBICSPLINE``: tangent in, value, tangent out.
    mode : str
        ``LINEAR``, ``STEP`` or ``CUBICSPLINE``.
    """

    times: F64
    values: F64
    mode: str

    @property
    def keys(self) -> F64:
        """Values (K, C) at the keys."""
        return self.values[:, 1] if self.mode == "CUBICSPLINE" else self.values


def read_tracks(document: Document, accessors: Accessors, animation: Row, place: str) -> dict[tuple[int, str], Track]:
    """Tracks of an animation by node and path; morph weights and targets of extensions are not motion of joints."""
    samplers = document.rows_of(animation, "samplers", f"{place}.samplers")
    nodes = len(document.rows("nodes"))
    tracks: dict[tuple[int, str], Track] = {}
    total = 0
    for k, channel in enumerate(document.rows_of(animation, "channels", f"{place}.channels")):
        where = f"{place}.channels[{k}]"
        target = document.object(channel, "target", where)
        path = document.text(target, "path", where)
        if path not in PATHS or "node" not in target:
            continue
        node, number = document.integer(target, "node", where), document.integer(channel, "sampler", where)
        if node >= nodes or number >= len(samplers):
            document.fail(where, f"one of {nodes} nodes and {len(samplers)} samplers", f"node {node}, sampler {number}")
        if (node, path) in tracks:
            document.fail(where, "one channel for each node and path", f"a second one for the {path} of node {node}")
        tracks[node, path] = _track(document, accessors, samplers[number], f"{place}.samplers[{number}]", path)
        total += len(tracks[node, path].times)
        if total > MAX_CLIP_KEYS:
            document.fail(place, f"at most {MAX_CLIP_KEYS} keys", "more")
    return tracks


def _track(document: Document, accessors: Accessors, sampler: Row, place: str, path: str) -> Track:
    mode = document.text(sampler, "interpolation", place, "LINEAR")
    if mode not in _MODES:
        document.fail(place, f"interpolation {', '.join(_MODES)}", shown(mode))
    first = document.integer(sampler, "input", place)
    times = accessors.array(first, place, "SCALAR", MAX_FRAMES)[:, 0]
    if (np.diff(times) <= 0).any() or abs(times[0]) > 1e6 or times[-1] > 1e6:
        document.fail(f"accessors[{first}]", "rising times in seconds", shown(times[:5].tolist()))
    number = document.integer(sampler, "output", place)
    values = accessors.array(number, place, PATHS[path], 3 * MAX_FRAMES)
    wanted = len(times) * (3 if mode == "CUBICSPLINE" else 1)
    if len(values) != wanted:
        document.fail(f"accessors[{number}]", f"{wanted} values for {len(times)} keys", str(len(values)))
    if np.abs(values).max() > 1e9:
        document.fail(f"accessors[{number}]", "numbers up to 1e9", f"{np.abs(values).max():.3g}")
    if mode == "CUBICSPLINE":
        values = values.reshape(len(times), 3, -1)
    if path == "rotation":
        lengths = np.linalg.norm(values[:, 1] if mode == "CUBICSPLINE" else values, axis=-1)
        if lengths.min() < 0.5 or lengths.max() > 2.0:
            worst = int(np.argmax(np.abs(lengths - 1.0)))
            document.fail(
                f"accessors[{number}]",
                "unit quaternions",
                f"length {lengths[worst]:.3g} at key {worst}",
                "export again",
            )
    return Track(times, values, mode)


def key_rate(tracks: list[Track]) -> float:
    """Frames per second of the grid on which all keys lie; 60 where there is no such grid.

    Candidates are the rates of the least and of the middle distance between keys, and the usual ones; the lowest
    that fits counts.
    """
    times = np.unique(np.concatenate([track.times for track in tracks]))
    gaps = np.diff(times)
    gaps = gaps[gaps > 1.0 / _FASTEST]
    if not len(gaps):
        return _OTHERWISE
    found = {frame_rate(float(np.median(gaps))), frame_rate(float(gaps.min()))}
    for rate in sorted(found | {usual for usual in _USUAL if usual >= min(found)}):
        at = (times - times[0]) * rate
        if np.abs(at - np.round(at)).max() < 0.02:
            return rate
    return _OTHERWISE


def sample(track: Track, times: F64) -> F64:
    """Values (F, C) of a track at times (F,), held before its first and after its last key; rotations are unit."""
    rotates = track.values.shape[-1] == 4
    if track.mode == "STEP":
        index = np.searchsorted(track.times, times + _STEP_S, side="right") - 1
        values = track.values[np.maximum(index, 0)]
        return quat.normalize(values) if rotates else values
    if len(track.times) == 1:
        return np.tile(quat.normalize(track.keys) if rotates else track.keys, (len(times), 1))
    left = np.clip(np.searchsorted(track.times, times, side="right") - 1, 0, len(track.times) - 2)
    step = track.times[left + 1] - track.times[left]
    u = np.clip((times - track.times[left]) / step, 0.0, 1.0)[:, None]
    if track.mode == "CUBICSPLINE":
        values = _hermite(track, left, step[:, None], u)
        return quat.normalize(values) if rotates else values
    first, second = track.values[left], track.values[left + 1]
    return _slerp(quat.normalize(first), quat.normalize(second), u) if rotates else first + u * (second - first)


def _hermite(track: Track, left: np.ndarray[tuple[int], np.dtype[np.intp]], step: F64, u: F64) -> F64:
    start, end = track.values[left], track.values[left + 1]
    squared, cubed = u * u, u * u * u
    return np.asarray(
        (2 * cubed - 3 * squared + 1) * start[:, 1]
        + (cubed - 2 * squared + u) * step * start[:, 2]
        + (3 * squared - 2 * cubed) * end[:, 1]
        + (cubed - squared) * step * end[:, 0]
    )


def _slerp(first: F64, second: F64, u: F64) -> F64:
    """Spherical interpolation of unit quaternions (F, 4) the shorter way."""
    between = quat.log(quat.mul(quat.conjugate(first), second))
    return quat.mul(first, quat.exp(u * between))
