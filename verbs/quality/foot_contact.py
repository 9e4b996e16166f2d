"""Foot contact and foot slide: when toes stand in the examples, and how far they slide in blends.

Contact in a blend is the contact of the examples, blended like the pose: c(σ) = Σ w_i c_i(σ) over canonical
time σ, where c_i is 1 while the toe stands in example i and 0 while it does not; it stands where c > 1/2. A detector
run on the blend itself would miss a foot that slides fast.

Runs, whose feet hardly slow down, have fewer stances than steps: slide is counted in detected stances only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.domain import random_points
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.skeleton import Skeleton
from verbs.verb import Verb

__all__ = ["GOALS", "GOALS_SEED", "NONE", "RATE_HZ", "Contacts", "Slides", "contacts", "detect", "example_slides",
           "examples", "goals", "sampled", "slides", "toes"]  # fmt: skip

Flags = npt.NDArray[np.bool_]

RATE_HZ = 60.0
"""Frames per second at which motions are sampled."""

FLOOR_PERCENTILE = 5.0
"""The floor is at this percentile of the heights of all toes in all frames of all examples."""

ON_M_S, ON_M = 0.15, 0.05
"""A stance has a frame in which the toe is slower than this, and less than this above the floor."""

OFF_M_S, OFF_M = 0.30, 0.07
"""A contact extends, forwards and backwards, while the toe is slower than this and less than this above the floor."""

SHORTEST_GAP_S, SHORTEST_S = 0.060, 0.100
"""Gaps shorter than the first are closed, then stances shorter than the second dropped."""

GOALS, GOALS_SEED = 60, 3
"""Number of random goals in the domain whose motions are evaluated, and their seed."""

_CYCLES, _MIDDLE = 3, 1
"""Cycles of a loop that are sampled, and the one that counts, in which no stance is cut off."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """When the toes of a verb's examples stand.

    Parameters
    ----------
    toes : (T,) int64
        Joints.
    floor_m : float
        Height of the floor.
    looping : bool
        Whether canonical time wraps around.
    phases : tuple of (F_i,) float64
        Canonical time of the frames of each example; a loop's run from 0 through three cycles.
    standing : tuple of (F_i, T) bool
        Whether each toe stands in each frame.
    """

    toes: I64
    floor_m: float
    looping: bool
    phases: tuple[F64, ...]
    standing: tuple[Flags, ...]

    def share(self, weights: F64, phases: F64) -> F64:
        """Contact c (F, T) of a blend of weights (N,) at canonical times (F,): Σ w_i c_i, of the nearest frames."""
        total = np.zeros((len(phases), len(self.toes)))
        if self.looping:
            phases = _MIDDLE + phases % 1.0
        for weight, own, standing in zip(weights, self.phases, self.standing, strict=True):
            nearest = np.searchsorted(0.5 * (own[1:] + own[:-1]), phases)
            total += weight * standing[nearest]
        return total


@dataclass(frozen=True, slots=True)
class Slides:
    """How far toes slide while they stand.

    The slide of a stance is the largest distance over the ground of the toe from its mean position in that stance.

    Parameters
    ----------
    stances : int
        Number of stances; the rest is NaN where there are none.
    median_m, p90_m, max_m : float
        Median, 90th percentile and largest slide of all stances, metres.
    """

    stances: int
    median_m: float
    p90_m: float
    max_m: float

    @classmethod
    def of(cls, found: F64) -> Slides:
        """Summary of the slides (S,) of all stances, metres."""
        if not len(found):
            return NONE
        median, high, largest = np.percentile(found, (50.0, 90.0, 100.0))
        return cls(len(found), float(median), float(high), float(largest))


NONE = Slides(0, np.nan, np.nan, np.nan)
"""No stance, or not evaluated."""


def toes(skeleton: Skeleton) -> I64:
    """Joints (T,) whose names end in ToeBase; none in a skeleton without feet."""
    return np.array([k for k, name in enumerate(skeleton.names) if name.endswith("ToeBase")], np.int64)


def detect(positions: F64, floor_m: float) -> Flags:
    """Detect when toes stand, from their positions.

    Parameters
    ----------
    positions : (F, T, 3) float64
        Positions at 60 Hz, metres, +Y up.
    floor_m : float
        Height of the floor.

    Returns
    -------
    standing : (F, T) bool
    """
    speeds = np.linalg.norm(np.gradient(positions, 1.0 / RATE_HZ, axis=0), axis=-1)
    heights = positions[..., 1] - floor_m
    sure, perhaps = (speeds < ON_M_S) & (heights < ON_M), (speeds < OFF_M_S) & (heights < OFF_M)
    out = np.zeros(speeds.shape, np.bool_)
    for toe in range(out.shape[1]):
        for first, last in _runs(perhaps[:, toe]):
            out[first:last, toe] = sure[first:last, toe].any()
    return _tidied(out)


def _tidied(standing: Flags) -> Flags:
    """Contact (F, T) at 60 Hz with short gaps closed, then short stances dropped."""
    out = standing.copy()
    for toe in range(out.shape[1]):
        for first, last in _runs(~out[:, toe]):
            if first > 0 and last < len(out) and last - first < SHORTEST_GAP_S * RATE_HZ:
                out[first:last, toe] = True
        for first, last in _runs(out[:, toe]):
            if last - first < SHORTEST_S * RATE_HZ:
                out[first:last, toe] = False
    return out


def _runs(flags: Flags) -> I64:
    """First frames, and frames after the last, (R, 2) of the runs in which flags (F,) are set."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int64), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def contacts(evaluator: Evaluator) -> Contacts | None:
    """Detect when the toes of a verb's examples stand; None where its skeleton has no toes."""
    joints = toes(evaluator.verb.skeleton)
    if not len(joints):
        return None
    phases, positions = zip(*(sampled(evaluator, blend) for blend in examples(evaluator)), strict=True)
    paths = [one[:, joints] for one in positions]
    floor = float(np.percentile(np.concatenate([path[..., 1].ravel() for path in paths]), FLOOR_PERCENTILE))
    standing = tuple(detect(path, floor) for path in paths)
    return Contacts(joints, floor, evaluator.verb.looping, phases, standing)


def example_slides(evaluator: Evaluator, found: Contacts) -> Slides:
    """Slides of the examples themselves."""
    distances = []
    for blend, standing in zip(examples(evaluator), found.standing, strict=True):
        phases, positions = sampled(evaluator, blend)
        distances.append(_distances(found, phases, positions, standing))
    return Slides.of(np.concatenate(distances))


def slides(evaluator: Evaluator, found: Contacts, adverbs: F64, *, method: str | None = None) -> Slides:
    """Slides of the whole motions at adverbs (B, D), by a method."""
    distances = []
    blends = evaluator.blend(adverbs, method=method)
    for k in range(len(adverbs)):
        at = slice(k, k + 1)
        blend = Blend(blends.method, blends.weights[at], blends.measured[at], blends.error[at], blends.clamped[at])
        phases, positions = sampled(evaluator, blend)
        distances.append(_distances(found, phases, positions, found.share(blend.weights[0], phases) > 0.5))
    return Slides.of(np.concatenate(distances))


def goals(verb: Verb) -> F64:
    """Adverbs (60, D) of random goals in the domain, the same every time."""
    return random_points(verb, np.random.default_rng(GOALS_SEED), GOALS)


def examples(evaluator: Evaluator) -> list[Blend]:
    """Every example as a blend of itself alone."""
    verb, unmoved = evaluator.verb, np.zeros(1, np.bool_)
    units = np.eye(len(verb.examples))
    return [evaluator.measure("example", units[k : k + 1], verb.values[k : k + 1], unmoved) for k in range(len(units))]


def sampled(evaluator: Evaluator, blend: Blend) -> tuple[F64, F64]:
    """Canonical time (F,) and joint positions (F, J, 3), metres, of a whole motion, or three cycles, at 60 Hz."""
    length = float(evaluator.pose_of(blend, phase=0.0).duration_s[0]) * (_CYCLES if evaluator.verb.looping else 1)
    poses = evaluator.pose_of(blend, time_s=np.arange(max(1, int(length * RATE_HZ + 1e-6)) + 1) / RATE_HZ)
    return poses.phase, evaluator.positions(poses)[1]


def _distances(contact: Contacts, phases: F64, positions: F64, standing: Flags) -> F64:
    """Slide (S,) of every stance in a motion, metres; of a loop, of those that begin in its middle cycle."""
    found = []
    for toe, joint in enumerate(contact.toes):
        for first, last in _runs(standing[:, toe]):
            frames = np.arange(first, last)
            if contact.looping:
                frames = _of_middle_cycle(phases, frames)
            if len(frames):
                path = positions[frames, joint][:, [0, 2]]
                found.append(float(np.linalg.norm(path - path.mean(axis=0), axis=1).max()))
    return np.array(found)


def _of_middle_cycle(phases: F64, frames: I64) -> I64:
    """Frames of a stance, if it begins in the middle cycle; a whole cycle of one that never ends; else none."""
    cycles = phases[frames] // 1.0
    endless = frames[0] == 0 and cycles[-1] > _MIDDLE
    kept = cycles == _MIDDLE if endless else np.full(len(frames), cycles[0] == _MIDDLE)
    return np.asarray(frames[kept], np.int64)
