"""Figures of whole motions as the field reports them: feet, joints, balance, self-intersection, loops.

The motions of the examples are judged beside those of blends at random goals. Each figure is defined in
``docs/math.md``, section "Figures of motion".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.clips.feet import BALL, FOOT, point_positions
from verbs.contacts import Contacts
from verbs.conventions import F64, I64
from verbs.domain import random_points
from verbs.kernels import quat
from verbs.quality import foot_contact
from verbs.quality.balance import Balance
from verbs.quality.humanoid import Humanoid
from verbs.quality.joint_ranges import Ranges
from verbs.quality.samples import Sample, sample
from verbs.quality.self_intersection import Capsules
from verbs.runtime.evaluate import Blend, Evaluator
from verbs.runtime.whole_motion import RATE_HZ, examples, one_of
from verbs.verb import Verb

__all__ = ["FIGURES", "GOALS", "LOW_M", "SKATE_M_S", "Comparison", "Figure", "Figures", "compare"]

GOALS, GOALS_SEED = 60, 3
"""Number of random goals whose motions are judged, and their seed."""

LOW_M, SKATE_M_S = 0.05, 0.2
"""A toe is low under this height above its standing height; a low toe skates above this speed over the ground."""

SEAM_PHASE = 1e-4
"""Distance of the poses from which both sides of a seam are extrapolated."""

Flags = npt.NDArray[np.bool_]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure: its key in JSON, its name and unit in tables, and the factor from SI to that unit."""

    key: str
    name: str
    unit: str
    factor: float = 1.0


FIGURES = (
    Figure("toe_speed_mean_m_s", "toe speed while low", "m/s"),
    Figure("skate_ratio", "skate ratio", "%", 100.0),
    Figure("slide_median_m", "slide, median", "mm", 1e3),
    Figure("slide_p90_m", "slide, p90", "mm", 1e3),
    Figure("slide_max_m", "slide, max", "mm", 1e3),
    Figure("penetration_m", "penetration", "mm", 1e3),
    Figure("range_p95_rad", "range excess, p95", "°", 180 / np.pi),
    Figure("range_max_rad", "range excess, max", "°", 180 / np.pi),
    Figure("intersecting_ratio", "self-intersection, frames", "%", 100.0),
    Figure("intersection_max_m", "self-intersection, deepest", "mm", 1e3),
    Figure("acceleration_median_m_s2", "peak acceleration, median", "m/s²"),
    Figure("acceleration_p95_m_s2", "peak acceleration, p95", "m/s²"),
    Figure("acceleration_max_m_s2", "peak acceleration, max", "m/s²"),
    Figure("leg_acceleration_rms_m_s2", "leg acceleration, rms", "m/s²"),
    Figure("knee_acceleration_max_rad_s2", "knee acceleration, max", "rad/s²"),
    Figure("effector_speed_median_m_s", "effector's peak speed, median", "m/s"),
    Figure("seam_position_m", "seam, position", "mm", 1e3),
    Figure("seam_velocity_m_s", "seam, velocity", "m/s"),
    Figure("balance_p95_m", "off balance, p95", "mm", 1e3),
    Figure("balance_max_m", "off balance, max", "mm", 1e3),
)
"""All figures, in the order of tables."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of a set of motions.

    Parameters
    ----------
    values : mapping of str to float or None
        By key of :data:`FIGURES`, in SI units; ratios are shares of frames.
    reasons : mapping of str to str
        Why a figure is None.
    """

    values: Mapping[str, float | None]
    reasons: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Figures of a verb's examples, and of blends by a method at so many goals in the domain.

    ``planted`` are those of the same blends with planted feet; None where a verb has no contacts to plant by.
    """

    verb: str
    method: str
    goals: int
    examples: Figures
    blends: Figures
    planted: Figures | None

    def as_dict(self) -> dict[str, object]:
        """JSON values."""
        sides: dict[str, object] = {"examples": dict(self.examples.values), "blends": dict(self.blends.values)}
        sides["planted"] = None if self.planted is None else dict(self.planted.values)
        planted = {} if self.planted is None else self.planted.reasons
        reasons = {**planted, **self.blends.reasons, **self.examples.reasons}
        return {"verb": self.verb, "method": self.method, "goals": self.goals, **sides, "reasons": reasons}


def compare(
    verb: Verb,
    *,
    method: str | None = None,
    goals: int = GOALS,
    seed: int = GOALS_SEED,
    progress: Progress | None = None,
) -> Comparison:
    """Judge the motions of a verb's examples, and those at random goals in its domain.

    Parameters
    ----------
    verb : Verb
    method : str, optional
        By default the verb's own.
    goals, seed : int
        Number of random goals, and their seed.
    progress : callable, optional
        Called with (stage, done, total).

    Raises
    ------
    UnknownName, RequestError
        There is no such method, or the verb lacks what it needs.
    """
    evaluator = Evaluator(verb)
    judge = _Judge.of_evaluator(evaluator)
    rows = random_points(verb, np.random.default_rng(seed), goals)
    blend = evaluator.blend(rows, method=method)
    own = judge.figures(judge.samples, examples(evaluator))
    blends = [one_of(blend, k) for k in range(len(rows))]
    sides: list[Figures | None] = []
    for plant in (False, True):
        if plant and verb.contacts is None:
            sides.append(None)
            continue
        samples = []
        for k, one in enumerate(blends):
            if progress is not None:
                progress(f"motions of {verb.name}{', planted' * plant}", k + 1, len(blends))
            samples.append(sample(evaluator, one, plant=plant))
        sides.append(judge.figures(samples, blends, plant=plant))
    unplanted, planted = sides
    assert unplanted is not None
    return Comparison(verb.name, blend.method, len(rows), own, unplanted, planted)


@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    """What is known of a verb before any blend is judged.

    Parameters
    ----------
    evaluator : Evaluator
    samples : list of Sample
        Motions of the examples.
    known : Contacts or None
    human : Humanoid or None
    ranges : Ranges
    capsules : Capsules or None
    legs, knees, toes : (L,), (K,), (T,) int64
        Joints of the legs; knees; contact points that are toes.
    """

    evaluator: Evaluator
    samples: list[Sample]
    known: Contacts | None
    human: Humanoid | None
    ranges: Ranges
    capsules: Capsules | None
    legs: I64
    knees: I64
    toes: I64

    @classmethod
    def of_evaluator(cls, evaluator: Evaluator) -> _Judge:
        verb, skeleton = evaluator.verb, evaluator.verb.skeleton
        samples = [sample(evaluator, blend) for blend in examples(evaluator)]
        known = foot_contact.contacts(evaluator)
        feet = [] if known is None else sorted(set(known.feet.tolist()))
        legs = sorted({int(j) for foot in feet for j in skeleton.chain(foot)[2:]} | set(feet))
        knees = sorted({int(skeleton.parents[foot]) for foot in feet})
        toes = [] if known is None else np.flatnonzero(np.isin(known.parts, (BALL, FOOT))).tolist()
        return cls(
            evaluator, samples, known, Humanoid.of_skeleton(skeleton), Ranges.of_samples(verb.references, samples),
            Capsules.of_skeleton(skeleton), *(np.array(found, np.int64) for found in (legs, knees, toes)),
        )  # fmt: skip

    def figures(self, samples: Sequence[Sample], blends: Sequence[Blend], *, plant: bool = False) -> Figures:
        """Figures of motions, sampled and as blends, with planted feet or not."""
        values: dict[str, float | None] = {figure.key: None for figure in FIGURES}
        reasons: dict[str, str] = {}
        for part in (self._feet, self._joints, self._bodies, self._balance):
            part(samples, values, reasons)
        if self.evaluator.verb.looping:
            seams = np.array([_seam(self.evaluator, blend, plant=plant) for blend in blends])
            values["seam_position_m"], values["seam_velocity_m_s"] = seams.max(axis=0).tolist()
        else:
            _note(reasons, "the verb does not loop", "seam_position_m", "seam_velocity_m_s")
        return Figures(values, {key: text for key, text in reasons.items() if values[key] is None})

    def _feet(self, samples: Sequence[Sample], values: dict[str, float | None], reasons: dict[str, str]) -> None:
        known, looping = self.known, self.evaluator.verb.looping
        keys = ("toe_speed_mean_m_s", "skate_ratio", "slide_median_m", "slide_p90_m", "slide_max_m", "penetration_m",
                "leg_acceleration_rms_m_s2", "knee_acceleration_max_rad_s2")  # fmt: skip
        if known is None:
            _note(reasons, "the skeleton has no feet", *keys)
            return
        low, skates, slides, depths = [], [], [], []
        for one in samples:
            heights = foot_contact.standing(known, one.weights, one.phases, looping=looping)[1]
            speeds, is_low = _toes(one, known, self.toes, heights)
            low.append(speeds[is_low])
            skates.append((is_low & (speeds > SKATE_M_S)).any(axis=1))
            found, depth = foot_contact.of_frames(
                known, one.weights, one.phases, one.global_rotations, one.positions, looping=looping
            )
            slides.append(found)
            depths.append(depth)
        summary = foot_contact.Slides.of(np.concatenate(slides), max(depths))
        values["toe_speed_mean_m_s"] = _mean(np.concatenate(low))
        values["skate_ratio"] = _mean(np.concatenate(skates).astype(np.float64))
        if summary.stances:
            values["slide_median_m"], values["slide_p90_m"] = summary.median_m, summary.p90_m
            values["slide_max_m"] = summary.max_m
        values["penetration_m"] = summary.penetration_m
        legs = np.concatenate([one.accelerations[:, self.legs].ravel() for one in samples])
        if len(legs):
            values["leg_acceleration_rms_m_s2"] = float(np.sqrt(np.mean(legs**2)))
        peaks = [_angular_accelerations(one, self.knees).max(initial=0.0) for one in samples]
        values["knee_acceleration_max_rad_s2"] = float(np.max(peaks))
        _note(reasons, "no foot stands", "slide_median_m", "slide_p90_m", "slide_max_m", "toe_speed_mean_m_s")

    def _joints(self, samples: Sequence[Sample], values: dict[str, float | None], reasons: dict[str, str]) -> None:
        peaks = np.array([one.accelerations.max(initial=0.0) for one in samples])
        keys = ("acceleration_median_m_s2", "acceleration_p95_m_s2", "acceleration_max_m_s2")
        values.update(zip(keys, np.percentile(peaks, (50, 95, 100)).tolist(), strict=True))
        beyond = np.array([self.ranges.excess(one.rotations[one.counted]).max(initial=0.0) for one in samples])
        limits = ("range_p95_rad", "range_max_rad")
        values.update(zip(limits, np.percentile(beyond, (95, 100)).tolist(), strict=True))
        effector = self.evaluator.verb.measure.effector
        speeds = [_speeds(one, effector).max(initial=0.0) for one in samples]
        values["effector_speed_median_m_s"] = float(np.median(speeds))

    def _bodies(self, samples: Sequence[Sample], values: dict[str, float | None], reasons: dict[str, str]) -> None:
        if self.capsules is None:
            _note(reasons, "all bones of the skeleton meet", "intersecting_ratio", "intersection_max_m")
            return
        depths = np.concatenate([self.capsules.depths(one) for one in samples])
        values["intersecting_ratio"] = float(np.mean(depths > 0.0))
        values["intersection_max_m"] = float(np.maximum(depths, 0.0).max())

    def _balance(self, samples: Sequence[Sample], values: dict[str, float | None], reasons: dict[str, str]) -> None:
        keys = ("balance_p95_m", "balance_max_m")
        if self.known is None or self.human is None:
            _note(reasons, "the skeleton has no feet, or no standard joint names", *keys)
            return
        balance, known, looping = Balance.of_humanoid(self.human), self.known, self.evaluator.verb.looping
        found = []
        for one in samples:
            contact = foot_contact.standing(known, one.weights, one.phases, looping=looping)[0]
            found.append(balance.distances(one, known, contact))
        distances = np.concatenate(found)
        if len(distances):
            values.update(zip(keys, np.percentile(distances, (95, 100)).tolist(), strict=True))
        _note(reasons, "the body never rests over its feet", *keys)


def _note(reasons: dict[str, str], text: str, *keys: str) -> None:
    for key in keys:
        reasons.setdefault(key, text)


def _mean(values: F64) -> float | None:
    return float(values.mean()) if len(values) else None


def _toes(one: Sample, known: Contacts, toes: I64, heights: F64) -> tuple[F64, Flags]:
    """Speeds (A, T) of toes over the ground in frames that count, m/s, and where they are low (A, T)."""
    paths = [point_positions(one.global_rotations, one.positions, int(known.joints[p]), known.offsets[p]) for p in toes]
    speeds = np.stack([one.over_ground(path) for path in paths], axis=1)[one.counted]
    above = np.stack([path[:, 1] - heights[p] for p, path in zip(toes, paths, strict=True)], axis=1)[one.counted]
    return speeds, above < LOW_M


def _speeds(one: Sample, joint: int) -> F64:
    """Speeds (A,) of a joint in frames that count, m/s."""
    moved = np.diff(one.positions[:, joint], axis=0)[one.counted[:-1]] * RATE_HZ
    return np.asarray(np.linalg.norm(moved, axis=1), np.float64)


def _angular_accelerations(one: Sample, joints: I64) -> F64:
    """Angular accelerations (A, K) of joints against their parents in frames that count, rad/s²."""
    local = one.rotations[:, joints]
    velocities = quat.log(quat.mul(quat.conjugate(local[:-1]), local[1:])) * RATE_HZ
    second = np.diff(velocities, axis=0)[one.counted[1:-1]] * RATE_HZ
    return np.asarray(np.linalg.norm(second, axis=-1), np.float64)


def _seam(evaluator: Evaluator, blend: Blend, *, plant: bool) -> tuple[float, float]:
    """Jump of position (m) and of velocity (m/s) at the seam of a loop, of the joint where it is largest.

    Both sides are extrapolated to the seam by the parabola through three poses.
    """
    steps = np.array([3.0, 2.0, 1.0]) * SEAM_PHASE
    poses = evaluator.pose_of(blend, phase=np.concatenate([1.0 - steps, 1.0 + steps[::-1]]), plant=plant)
    places, times = evaluator.positions(poses)[1], poses.time_s
    period = float(poses.duration_s[0])
    before, after = _at_end(times[:3], places[:3], period), _at_end(times[3:], places[3:], period)
    jumps = [np.linalg.norm(a - b, axis=-1).max() for a, b in zip(before, after, strict=True)]
    return float(jumps[0]), float(jumps[1])


def _at_end(times: F64, places: F64, at_s: float) -> tuple[F64, F64]:
    """Value and slope at a time of the parabola through places (3, J, 3) at times (3,)."""
    powers = np.vander(times - at_s, 3)
    solved = np.linalg.solve(powers / [SEAM_PHASE**2, SEAM_PHASE, 1.0], places.reshape(3, -1))
    return solved[2].reshape(places.shape[1:]), (solved[1] / SEAM_PHASE).reshape(places.shape[1:])
