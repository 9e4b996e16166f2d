"""Whole motions: poses at a fixed rate, at constant adverbs, or at adverbs that change during the motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64, MAX_FRAMES
from verbs.errors import OutOfRange, RequestError
from verbs.kernels import pose as kernels
from verbs.kernels import timewarp, timing
from verbs.kernels.character_state import CHARACTER
from verbs.kernels.compile import kernel
from verbs.kernels.feet import hold_track
from verbs.kernels.foot_state import FOOT
from verbs.kernels.legs import COMMAND, plant_poses
from verbs.kernels.timewarp import Clock
from verbs.motion import Motion
from verbs.runtime.evaluate import Blend, Evaluator, Poses, blend_poses
from verbs.skeleton import Skeleton

__all__ = ["MAX_CYCLES", "MAX_FPS", "Event", "events", "sequence", "to_motion", "tracked"]

MAX_FPS = 240.0
MAX_CYCLES = 100

_SLACK = 1e-6  # of a frame: a duration of 2 s ends on frame 60 at 30 fps however its sum was rounded
_CHUNK = 256  # frames of a track per step: its end is known only when it comes


@dataclass(frozen=True, slots=True)
class Event:
    """A keytime of a motion: name, phase (beyond 1 in further cycles) and time in seconds."""

    name: str
    phase: float
    time_s: float


def sequence(
    evaluator: Evaluator,
    adverbs: F64,
    fps: float,
    *,
    cycles: int = 1,
    method: str | None = None,
    max_frames: int = MAX_FRAMES,
    plant: bool = True,
) -> Poses:
    """A whole motion at constant adverbs (1, D): frames at 0, 1/fps, … up to the end.

    The last frame is at floor(duration · fps) / fps, the last one that is not past the end.

    Parameters
    ----------
    evaluator : Evaluator
    adverbs : (1, D) float64
    fps : float
        Frames per second, 1 to 240.
    cycles : int
        Cycles of a looping verb, 1 to 100.
    method : str, optional
    max_frames : int
        A longer motion is refused.
    plant : bool
        Whether standing feet stay where they landed.

    Returns
    -------
    poses : Poses
        Its blend has one row.

    Raises
    ------
    OutOfRange
        ``fps``, ``cycles`` or the number of frames is out of range.
    """
    _check_rate(evaluator, fps, cycles)
    blend = evaluator.blend(adverbs, method=method)
    if len(blend.weights) != 1:
        raise OutOfRange(f"a sequence has one set of adverbs, not {len(blend.weights)}; give a track instead")
    duration = float(evaluator.pose_of(blend, phase=0.0, plant=False).duration_s[0]) * cycles
    frames = math.floor(duration * fps + _SLACK) + 1
    if frames > max_frames:
        raise OutOfRange(f"{duration:.2f} s at {fps:g} fps are {frames} frames; at most {max_frames} are allowed")
    return evaluator.pose_of(blend, time_s=np.arange(frames) / fps, plant=plant)


def tracked(
    evaluator: Evaluator,
    times: F64,
    rows: F64,
    fps: float,
    *,
    cycles: int = 1,
    method: str | None = None,
    max_frames: int = MAX_FRAMES,
    plant: bool = True,
) -> Poses:
    """A whole motion whose adverbs change during it.

    Adverbs are linear between the track's times and constant before and after. Each frame has its own weights; phase
    advances by dσ/dt = 1 / t'(σ; w), integrated with the weights of each frame interval's middle, so that a track
    that does not change gives :func:`sequence`.

    Parameters
    ----------
    evaluator : Evaluator
    times : (T,) float64
        Seconds, rising.
    rows : (T, D) float64
        Adverbs at these times.
    fps, cycles, method, max_frames, plant
        As in :func:`sequence`.

    Returns
    -------
    poses : Poses
        ``time_s`` is the track's time.

    Raises
    ------
    OutOfRange
        A number is out of range, times do not rise, or the motion is too long.
    """
    _check_rate(evaluator, fps, cycles)
    rows = evaluator.check(rows)  # also widens float32
    if times.shape != (len(rows),) or not len(times):
        raise OutOfRange(f"a track needs a time for each of its {len(rows)} points, and at least one")
    if not (np.isfinite(times).all() and np.all(np.diff(times) > 0)):
        raise OutOfRange("a track's times must be finite and rise from point to point")
    phases = _phases(evaluator, times, rows, fps, cycles, method, max_frames)
    at = np.arange(len(phases)) / fps
    return _placed(evaluator, evaluator.blend(_along(times, rows, at), method=method), phases, at, plant=plant)


def events(evaluator: Evaluator, poses: Poses) -> list[Event]:
    """Keytimes within a sequence, in order.

    A motion's last keytime counts, although its last frame may be a little before it. Times are exact where
    adverbs are constant, and interpolated between frames where they change.
    """
    verb, last = evaluator.verb, float(poses.phase[-1])
    marks = [
        (name, cycle + phase)
        for cycle in range(math.floor(last) + 1 if verb.looping else 1)
        for name, phase in zip(verb.keytime_names, verb.phases.tolist(), strict=True)
        # A loop's last keytime is the first one of its next cycle, and is named there.
        if not (verb.looping and phase == 1.0)
    ]
    if verb.looping:
        marks = [(name, phase) for name, phase in marks if phase <= last + _SLACK]
    at = np.array([phase for _, phase in marks])
    if len(poses.blend.weights) == 1:
        found = timing.instants(len(at))
        weights = np.ascontiguousarray(np.broadcast_to(poses.blend.weights, (len(at), len(verb.examples))))
        timing.resolve(weights, evaluator.goal.clock, at, False, found)
        times = found.time_s
    else:
        times = np.interp(at, poses.phase, poses.time_s)
    return [Event(name, phase, time) for (name, phase), time in zip(marks, times.tolist(), strict=True)]


def to_motion(evaluator: Evaluator, poses: Poses, fps: float, *, skeleton: Skeleton | None = None) -> Motion:
    """A sequence as a motion, its root's travel included; ``skeleton`` is that of poses on another one."""
    return Motion(skeleton or evaluator.verb.skeleton, fps, poses.root, poses.rotations)


def _check_rate(evaluator: Evaluator, fps: float, cycles: int) -> None:
    if not 1.0 <= fps <= MAX_FPS:
        raise OutOfRange(f"fps is {fps}; it must lie between 1 and {MAX_FPS:g}")
    if not 1 <= cycles <= MAX_CYCLES:
        raise OutOfRange(f"cycles is {cycles}; it must lie between 1 and {MAX_CYCLES}")
    if cycles > 1 and not evaluator.verb.looping:
        raise RequestError(f"verb '{evaluator.verb.name}' does not loop; cycles must be 1")


def _along(times: F64, rows: F64, at: F64) -> F64:
    """Adverbs (B, D) of a track at times (B,)."""
    return np.ascontiguousarray(np.stack([np.interp(at, times, column) for column in rows.T], axis=-1), np.float64)


def _phases(
    evaluator: Evaluator, times: F64, rows: F64, fps: float, cycles: int, method: str | None, max_frames: int
) -> F64:
    """Phases (F,) of a tracked motion's frames, up to the last one that is not past the end."""
    step = 1.0 / fps
    pieces, frames, phase = [np.zeros(1)], 1, 0.0
    while True:
        middles = np.asarray((frames - 0.5 + np.arange(_CHUNK)) * step, np.float64)
        blend = evaluator.blend(_along(times, rows, middles), method=method)
        piece = np.empty(_CHUNK)
        count = _advance(blend.weights, evaluator.goal.clock, step, phase, float(cycles), piece)
        pieces.append(piece[:count])
        frames += count
        if frames > max_frames:
            raise OutOfRange(f"the motion is longer than {max_frames} frames at {fps:g} fps, which are allowed at most")
        if count < _CHUNK:
            return np.concatenate(pieces)
        phase = float(piece[-1])


def _placed(evaluator: Evaluator, blend: Blend, phases: F64, at: F64, *, plant: bool) -> Poses:
    """Poses of one blend per frame; a striding root walks on from frame to frame."""
    verb, size = evaluator.verb, len(phases)
    local = phases % 1.0 if verb.looping else phases
    found = timing.instants(size)
    timing.resolve(blend.weights, evaluator.goal.clock, phases, False, found)
    root, rotations = np.empty((size, 3)), np.empty((size, len(verb.skeleton), 4))
    blend_poses(blend.weights, local, evaluator.curves, root, rotations)
    velocity = None
    if verb.root_motion == kernels.STRIDE:
        velocity = np.empty((size, 3))
        timing.velocities(blend.weights, verb.strides, phases, found.rate, verb.looping, velocity)
        kernels.travel(blend.weights, verb.strides, phases, verb.looping, True, root, rotations)
    if plant:
        _plant(evaluator, blend, phases, at, found.rate, root, rotations)
    return Poses(blend, phases, at, found.duration_s, root, rotations, velocity)


def _plant(evaluator: Evaluator, blend: Blend, phases: F64, at: F64, rates: F64, root: F64, rotations: F64) -> None:
    """Plant the feet of the frames of a motion whose weights change; poses are in the world."""
    planting, verb, size = evaluator.planting(), evaluator.verb, len(phases)
    feet = len(planting.joints)
    if not feet:
        return
    places = np.zeros((size, 4))
    if verb.root_motion == kernels.STRIDE:
        places = kernels.travelled(blend.weights, verb.strides, phases, looping=verb.looping)
    commands = np.empty((size, feet, len(COMMAND)))
    step_s = float(at[1] - at[0]) if size > 1 else 1.0
    hold_track(
        blend.weights, phases, rates, places, step_s, planting.plants, np.zeros(1, CHARACTER), np.zeros(feet, FOOT),
        commands,
    )  # fmt: skip
    plant_poses(root, rotations, commands, planting.legs)


@kernel
def _advance(weights: F64, clock: Clock, step_s: float, start: float, end: float, out: F64) -> int:
    """Phases (B,) after each of B steps, each at its own weights (B, N); return how many do not pass ``end``."""
    phases, log_lengths, looping = clock
    keytimes, tangents = np.empty(phases.shape[0]), np.empty(phases.shape[0])
    at = start
    for b in range(weights.shape[0]):
        timewarp.blend_keytimes(weights[b], log_lengths, keytimes)
        timewarp.slopes(phases, keytimes, looping, tangents)
        duration = keytimes[phases.shape[0] - 1]
        cycle = np.floor(at) if looping else 0.0
        seconds = timewarp.time_at(phases, keytimes, tangents, at - cycle) + step_s
        if looping:
            cycle += np.floor(seconds / duration)
            seconds -= np.floor(seconds / duration) * duration
        past = 0.0 if looping else seconds - duration
        if past > _SLACK * step_s:
            return b
        at = cycle + timewarp.phase_at(phases, keytimes, tangents, min(seconds, duration))
        if at > end + _SLACK * step_s / duration:
            return b
        out[b] = at
    return len(weights)
