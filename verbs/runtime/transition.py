"""Transitions between verbs: skeleton check, start phase, length, and root position of the next verb.

The offsets of joints are in :mod:`verbs.kernels.inertialization`.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np

from verbs.clips import orientation
from verbs.conventions import F64
from verbs.errors import SkeletonMismatch
from verbs.kernels import pose as poses
from verbs.kernels import quat
from verbs.runtime import whole_motion
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.skeleton import Skeleton
from verbs.verb import Verb

__all__ = ["CANDIDATES", "LONGEST_S", "SHORTEST_S", "aligned", "check_skeletons", "closest_phase",
           "corresponding_phase", "example_peaks", "heading", "length_s", "peak", "root_frame"]  # fmt: skip

SHORTEST_S, LONGEST_S = 0.3, 1.0
"""Lengths between which a transition's own length is chosen."""

EFFORT = 0.5
"""Share of the motions' own largest acceleration that the offset of a transition may add."""

FIRST_FACTOR, SECOND_FACTOR = 100.0 / 21.0, 2.5
"""Accelerations of an offset x₀ and of a velocity v₀ in a transition of T: factors of x₀/T² and v₀/T; see
:mod:`verbs.kernels.inertialization`."""

LEAST_M_S2 = 1.0
"""Acceleration that a motion may have in any case."""

_PEAKS: WeakKeyDictionary[Evaluator, F64] = WeakKeyDictionary()

_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])

_FRAMES: WeakKeyDictionary[Evaluator, F64] = WeakKeyDictionary()

CANDIDATES = 24
"""Phases of a loop that are compared to find where it begins."""


def check_skeletons(source: Verb, target: Verb) -> None:
    """Raise :class:`SkeletonMismatch` unless both verbs move the same joints; their lengths may differ."""
    problem = source.skeleton.difference(target.skeleton, tolerance_m=math.inf)
    if problem:
        raise SkeletonMismatch(
            f"verb '{target.name}' moves another skeleton than '{source.name}': it {problem}; "
            "open another channel for it"
        )


def corresponding_phase(source: Verb, phase: float, target: Verb) -> float | None:
    """Phase of a target that corresponds to a source's phase: left stance to left stance.

    Where both loop and name the same keytimes, phases between these correspond; otherwise there is none.
    """
    if not (source.looping and target.looping):
        return None
    ours, theirs = (dict(zip(verb.keytime_names[:-1], verb.phases.tolist(), strict=False)) for verb in (source, target))
    shared = [name for name in ours if name in theirs]
    return _corresponding(phase, np.array([(ours[name], theirs[name]) for name in shared])) if shared else None


def closest_phase(displayed: F64, step_s: float, evaluator: Evaluator, blend: Blend) -> float:
    """Phase of a loop at which its pose and velocity are closest to those that are displayed.

    The measure is the length of transition that :func:`length_s` would need. Roots are compared in their own frames.

    Parameters
    ----------
    displayed : (2, 3 + 4·J) float64
        The last two frames, latest last, ``step_s`` apart.
    evaluator, blend
        The loop, and its weights (one row).
    """
    starts, skeleton = np.arange(CANDIDATES) / CANDIDATES, evaluator.verb.skeleton
    first = evaluator.pose_of(blend, phase=starts, plant=False)
    second = evaluator.pose_of(blend, time_s=first.time_s + step_s, plant=False)
    frame = root_frame(evaluator)
    here = _in_frame(_positions(displayed, skeleton), displayed[1], frame)
    needed = []
    for k in range(CANDIDATES):
        ahead = np.stack([np.append(found.root[k], found.rotations[k]) for found in (first, second)])
        there = _in_frame(_positions(ahead, skeleton), ahead[0], frame)
        needed.append(_time(here, there, np.linalg.norm(here[1] - there[0], axis=-1), step_s, 1.0))
    return float(starts[int(np.argmin(needed))])


def length_s(displayed: F64, ahead: F64, step_s: float, verb: Verb, peak_m_s2: float) -> float:
    """Length of a transition that adds no more than a share of the motions' own acceleration to any joint.

    Parameters
    ----------
    displayed, ahead : (2, 3 + 4·J) float64
        The last two frames that were displayed, latest last, and the first two of the motion that follows.
    step_s : float
        Seconds between the two frames of each.
    verb : Verb
    peak_m_s2 : float
        Largest acceleration of a joint in the motions themselves, see :func:`peak`.

    Returns
    -------
    length : float
        Seconds, :data:`SHORTEST_S` to :data:`LONGEST_S`.
    """
    here, there = _positions(displayed, verb.skeleton), _positions(ahead, verb.skeleton)
    moved = np.maximum(np.linalg.norm(here[1] - there[0], axis=-1), _arcs(displayed[1], ahead[0], here[1], verb))
    return float(min(max(_time(here, there, moved, step_s, EFFORT * peak_m_s2), SHORTEST_S), LONGEST_S))


def peak(evaluator: Evaluator, blend: Blend) -> float:
    """Largest acceleration of a joint in a motion (one row), m/s²: as in its examples, by their weights."""
    weights = np.abs(blend.weights[0])
    return float(weights @ example_peaks(evaluator) / weights.sum())


def example_peaks(evaluator: Evaluator) -> F64:
    """Largest acceleration (N,) of any joint in each example, m/s²; sampled once for each evaluator."""
    found = _PEAKS.get(evaluator)
    if found is None:
        clips = [whole_motion.sampled(evaluator, blend)[1] for blend in whole_motion.examples(evaluator)]
        steps = [np.diff(clip, 2, axis=0) * whole_motion.RATE_HZ**2 for clip in clips]
        peaks = [np.linalg.norm(step, axis=-1).max() if len(step) else 0.0 for step in steps]
        found = _PEAKS[evaluator] = np.maximum(peaks, LEAST_M_S2)
    return found


def _positions(frames: F64, skeleton: Skeleton) -> F64:
    """Positions (n, J, 3) of the joints in frames (n, 3 + 4·J)."""
    size, joints = len(frames), len(skeleton)
    rotations = np.ascontiguousarray(frames[:, 3:].reshape(size, joints, 4))
    turned, positions = np.empty_like(rotations), np.empty((size, joints, 3))
    poses.forward(np.ascontiguousarray(frames[:, :3]), rotations, skeleton.parents, skeleton.offsets, turned, positions)
    return positions


def _in_frame(positions: F64, frame: F64, upright: F64) -> F64:
    """Positions (n, J, 3) in the frame of a root: its place on the ground, and its heading."""
    turn = -heading(frame[3:7], upright)
    moved = positions - frame[:3] * np.array([1.0, 0.0, 1.0])
    return np.asarray(quat.rotate(np.array([0.0, math.sin(0.5 * turn), 0.0, math.cos(0.5 * turn)]), moved))


def _arcs(displayed: F64, ahead: F64, positions: F64, verb: Verb) -> F64:
    """Length (J,) of the longest arc on which a joint is moved by one joint above it, between two frames."""
    before, after = (frame[3:].reshape(-1, 4) for frame in (displayed, ahead))
    angles = 2.0 * np.arccos(np.clip(np.abs((before * after).sum(axis=-1)), 0.0, 1.0))
    out = np.zeros(len(positions))
    for joint in range(len(positions)):
        above = verb.skeleton.chain(joint)[1:-1]  # the root turns with the character
        if len(above):
            out[joint] = (angles[above] * np.linalg.norm(positions[joint] - positions[above], axis=-1)).max()
    return out


def _time(here: F64, there: F64, moved: F64, step_s: float, most: float) -> float:
    """Time in which joints move by ``moved`` (J,) and between velocities, with an acceleration of at most ``most``.

    The velocities are those between two positions (2, J, 3), ``step_s`` apart.
    """
    faster = np.linalg.norm(here[1] - here[0] - there[1] + there[0], axis=-1) / step_s
    linear = SECOND_FACTOR * faster
    return float(((linear + np.sqrt(linear**2 + 4.0 * most * FIRST_FACTOR * moved)) / (2.0 * most)).max())


def _corresponding(phase: float, pairs: F64) -> float:
    """Phase (0 to 1) that corresponds on the second circle, given pairs (P, 2) that rise on the first."""
    steps = np.diff(np.append(pairs[:, 1], pairs[0, 1])) % 1.0
    steps[steps == 0.0] = 1.0  # one pair alone is a whole cycle away from itself
    if steps.sum() > 1.5:  # their order differs: only the first one counts
        pairs, steps = pairs[:1], np.ones(1)
    firsts = np.append(pairs[:, 0], pairs[0, 0] + 1.0)
    seconds = pairs[0, 1] + np.append(0.0, np.cumsum(steps))
    at = phase if phase >= firsts[0] else phase + 1.0
    return float(np.interp(at, firsts, seconds)) % 1.0


def heading(rotation: F64, upright: F64 = _IDENTITY) -> float:
    """Heading (rad), about +Y, of a root rotation (4,); ``upright`` (4,) is that of :func:`root_frame`."""
    (x, y, z, w), (a, b, c, d) = rotation, upright
    return 2.0 * math.atan2(float(y * d - w * b + x * c - z * a), float(w * d + x * a + y * b + z * c))


def root_frame(evaluator: Evaluator) -> F64:
    """Rotation (4,) of the root where the body is upright and faces +Z; found once for each evaluator."""
    found = _FRAMES.get(evaluator)
    if found is None:
        verb = evaluator.verb
        found = _FRAMES[evaluator] = orientation.root_frame(verb.skeleton, verb.references)
    return found


def aligned(at: tuple[float, float, float], frame: F64) -> tuple[float, float, float]:
    """Position (x, z, heading) of a motion whose first frame, root (x, z, heading), is to be at ``at``."""
    turn = at[2] - frame[2]
    cosine, sine = math.cos(turn), math.sin(turn)
    return (
        at[0] - (frame[0] * cosine + frame[1] * sine),
        at[1] - (-frame[0] * sine + frame[1] * cosine),
        math.remainder(turn, 2.0 * math.pi),
    )
