"""Where the next example would help a verb most.

The error expected at a goal is that of the examples left out near it, scaled by how much farther the goal is from the
examples than they are from each other. The suggestion is the goal whose example lowers that error most, summed over
the domain; further ones count those before them as made.

    e(u) = r(u) √V(u),   gain(u) = Σ_x r(x) (√V(x) − √(V(x) − C(x, u)² / V(u)))

V and C are variance and covariance of ordinary kriging with the variogram of :mod:`verbs.kernels.support`; r_i is the
leave-one-out error of example i over √V_i, the variance there without it, and r(u) its mean about u.

Source: J. Sacks, W. J. Welch, T. J. Mitchell, H. P. Wynn, "Design and Analysis of Computer Experiments", Statistical
Science 4, 1989, section 5: the design that lowers the integrated error. V_i is Dubrule's, 1983.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.domain import random_points
from verbs.errors import OutOfRange
from verbs.quality.leave_one_out import left_out_errors
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.support import Support
from verbs.verb import Verb

__all__ = ["MOST", "Suggestion", "suggest"]

MOST = 50
"""Largest number of suggestions."""

SAMPLES, CANDIDATES, SEED = 1_200, 400, 11

SMOOTHING = 1.5
"""Width of the mean of r, in median distances of nearest examples."""

ROUGHNESS_PRIOR = 1.0
"""Examples that the mean of r over the whole verb counts for, beside those near a goal."""

NUGGET = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """One suggestion.

    Parameters
    ----------
    adverbs : (D,) float64
        Goal of the example to make, in the adverbs' units.
    expected_error : float
        Error expected there now, mean joint angle, radians.
    gain : float
        Share of the expected error of the whole domain that the example removes.
    support : float
        Support of the goal now, 0 to 1.
    weight_sum : float
        Σ|w| of the goal's weights.
    nearest : tuple of str
        The nearest examples, at most three, the nearest first.
    nearest_error : float
        Mean leave-one-out error of these, radians.
    positions : (J, 3) float64
        Joint positions of the pose guessed there, at the effector's keytime or halfway, metres.
    """

    adverbs: F64
    expected_error: float
    gain: float
    support: float
    weight_sum: float
    nearest: tuple[str, ...]
    nearest_error: float
    positions: F64


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Model of the error of a verb over its domain, in normalised chart coordinates.

    Parameters
    ----------
    centers : (N, D) float64
    radius : float
    inverse : (N + 1, N + 1) float64
        Of the kriging system.
    roughness : (N,) float64
        Leave-one-out error over the square root of the variance, of each example.
    width : float
        Of the mean of the roughness.
    """

    centers: F64
    radius: float
    inverse: F64
    roughness: F64
    width: float

    @classmethod
    def of_verb(cls, verb: Verb, errors: F64) -> Expected:
        """The model of a verb's leave-one-out errors (N,)."""
        arrays = Support.of_verb(verb).arrays
        centers, radius, count = arrays.centers, arrays.radius, len(arrays.centers)
        system = np.ones((count + 1, count + 1))
        system[:count, :count], system[count, count] = -arrays.between, 0.0
        system[np.arange(count), np.arange(count)] += NUGGET
        inverse = np.asarray(np.linalg.inv(system), np.float64)
        variances = np.maximum(1.0 / np.diag(inverse)[:count], 1e-12)
        gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1) + np.diag(np.full(count, np.inf))
        width = SMOOTHING * float(np.median(gaps.min(axis=1)))
        return cls(centers, radius, inverse, np.asarray(errors / np.sqrt(variances), np.float64), width)

    def _kernel(self, first: F64, second: F64) -> F64:
        """Negative variogram (A, B)."""
        squared = np.sum((first[:, None] - second[None]) ** 2, axis=-1)
        return np.asarray(1.0 - np.sqrt(1.0 + squared / self.radius**2))

    def covariance(self, first: F64, second: F64) -> F64:
        """Covariance (A, B) of the errors of prediction at points (A, D) and (B, D)."""
        rows, columns = (np.concatenate([self._kernel(points, self.centers), np.ones((len(points), 1))], axis=1)
                         for points in (first, second))  # fmt: skip
        return np.asarray(self._kernel(first, second) - rows @ self.inverse @ columns.T)

    def rough(self, points: F64) -> F64:
        """Mean roughness (A,) about points (A, D)."""
        squared = np.sum((points[:, None] - self.centers[None]) ** 2, axis=-1)
        weights = np.exp(-0.5 * squared / self.width**2)
        total = weights @ self.roughness + ROUGHNESS_PRIOR * self.roughness.mean()
        return np.asarray(total / (weights.sum(axis=1) + ROUGHNESS_PRIOR))


def suggest(verb: Verb, count: int = 5) -> list[Suggestion]:
    """Goals of the examples that would help most, the best first.

    Raises
    ------
    OutOfRange
        If ``count`` is not 1 to MOST.
    IllPosedVerb
        If the verb has too few examples to leave one out.
    """
    if not 1 <= count <= MOST:
        raise OutOfRange(f"the number of suggestions must be 1 to {MOST}, not {count}")
    method = "corrected" if "smooth" in verb.bases else "rbf"
    errors = left_out_errors(verb, (method,))[0][0]
    model = Expected.of_verb(verb, errors)
    rng = np.random.default_rng(SEED)
    samples = verb.domain.chart.points(random_points(verb, rng, SAMPLES))
    goals = random_points(verb, rng, CANDIDATES)
    points = verb.domain.chart.points(goals)
    chosen, expected, gains = _greedy(model, samples, points, count)
    return _described(verb, goals[chosen], points[chosen], expected, gains, model, errors)


def _greedy(model: Expected, samples: F64, points: F64, count: int) -> tuple[list[int], list[float], list[float]]:
    """Candidates (A, D) chosen one after the other: their indices, the error expected there, their gains."""
    rough = model.rough(samples)
    own = np.maximum(np.diag(model.covariance(samples, samples)).copy(), 0.0)
    there = np.maximum(np.diag(model.covariance(points, points)).copy(), 1e-12)
    cross, among = model.covariance(samples, points), model.covariance(points, points)
    whole = float(np.sum(rough * np.sqrt(own)))
    at = model.rough(points) * np.sqrt(there)
    chosen: list[int] = []
    gains: list[float] = []
    for _ in range(count):
        left = np.sqrt(np.maximum(own[:, None] - cross**2 / there, 0.0))
        gain = rough @ (np.sqrt(own)[:, None] - left)
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        gains.append(float(gain[best]) / max(whole, 1e-12))
        row, column, pivot = among[best].copy(), cross[:, best].copy(), there[best]
        own = np.maximum(own - column**2 / pivot, 0.0)
        cross = cross - np.outer(column, row) / pivot
        among = among - np.outer(row, row) / pivot
        there = np.maximum(np.diag(among).copy(), 1e-12)
    return chosen, [float(at[k]) for k in chosen], gains


def _described(
    verb: Verb, goals: F64, points: F64, expected: list[float], gains: list[float], model: Expected, errors: F64
) -> list[Suggestion]:
    """Suggestions with what the verb answers there now."""
    evaluator = Evaluator(verb)
    blend = evaluator.blend(goals)
    support = evaluator.support(blend)
    phase = float(verb.phases[verb.measure.keytime]) if verb.measure.keytime >= 0 else 0.5
    _, positions = evaluator.positions(evaluator.pose_of(blend, phase=phase, plant=False))
    found = []
    for k, (goal, point) in enumerate(zip(goals, points, strict=True)):
        near = np.argsort(np.linalg.norm(model.centers - point, axis=1))[:3]
        found.append(
            Suggestion(
                adverbs=goal,
                expected_error=expected[k],
                gain=gains[k],
                support=float(support[k]),
                weight_sum=float(np.abs(blend.weights[k]).sum()),
                nearest=tuple(verb.examples[i] for i in near),
                nearest_error=float(errors[near].mean()),
                positions=positions[k].reshape(-1, 3),
            )
        )
    return found
