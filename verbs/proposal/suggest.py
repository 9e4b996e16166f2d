"""Where the next example would help a verb most.

Each example is predicted from the others; an example at u would lower the error of that prediction, and the error to
expect elsewhere in the domain. The suggestion is the goal u that lowers both most; further ones count those before
them as made.

    gain(u) = (Σ_i e_i d_i(x_i, u) + ½ N mean_x e(x) d(x, u)) / (Σ_i e_i + ½ N mean_x e(x))
    d(x, u) = 1 − √(1 − C(x, u)² / (V(x) V(u))),   e(x) = r(x) √V(x)

e_i is the leave-one-out error of example i at x_i. V and C are variance and covariance of ordinary kriging with the
variogram of :mod:`verbs.kernels.support`; those of d_i are without example i. r_i is e_i / √V_i(x_i), and r(x) its mean
about x. ``benchmarks/suggest.py`` compares suggestions with random examples; it chose the factor ½.

Source: N. Cressie, "Statistics for Spatial Data", 1993, section 3.2, for the variance; the greedy choice of the point
that lowers it most is that of J. Sacks, W. J. Welch, T. J. Mitchell, H. P. Wynn, "Design and Analysis of Computer
Experiments", Statistical Science 4, 1989, section 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.domain import random_points
from verbs.errors import OutOfRange
from verbs.quality.leave_one_out import left_out_errors
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.support import RADIUS_SHARE, Support
from verbs.verb import Verb

__all__ = ["MOST", "Kriging", "Suggestion", "guess_phase", "suggest"]

MOST = 50
"""Largest number of suggestions."""

CANDIDATES, SAMPLES, SEED = 700, 800, 11

DOMAIN_SHARE = 0.5
"""Weight of the errors to expect over the domain, against those of the examples."""

APART = 0.5
"""Least distance of a suggestion from examples and from those before it, in median distances of nearest examples."""

MOST_COUNTED = 200
"""Examples whose errors count, those with the largest."""

SMOOTHING = 1.5
"""Width of the mean of r, in median distances of nearest examples."""

ROUGHNESS_PRIOR = 1.0
"""Examples that the mean of r over the whole verb counts for, beside those near a goal."""

NUGGET = 1e-9
"""Added to the diagonal of kriging systems."""

TINY = 1e-12

CLOSE = 1e-3
"""Factor of the gain of candidates that are not apart: they are chosen where there are no others."""


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
        Share of the errors, left out and expected, that the example removes.
    support : float
        Support of the goal now, 0 to 1.
    weight_sum : float
        Σ|w| of the goal's weights.
    helped : tuple of str
        Examples whose leave-one-out error it lowers most, at most three.
    helped_error : float
        Mean leave-one-out error of these now, radians.
    positions : (J, 3) float64
        Joint positions of the pose guessed there, at the phase of :func:`guess_phase`, metres.
    """

    adverbs: F64
    expected_error: float
    gain: float
    support: float
    weight_sum: float
    helped: tuple[str, ...]
    helped_error: float
    positions: F64


@dataclass(frozen=True, slots=True, eq=False)
class Kriging:
    """Ordinary kriging of points (N, D) with a multiquadric variogram.

    Parameters
    ----------
    centers : (N, D) float64
    radius : float
        Of the variogram.
    inverse : (N + 1, N + 1) float64
        Of the system.
    """

    centers: F64
    radius: float
    inverse: F64

    @classmethod
    def of_points(cls, centers: F64, radius: float) -> Kriging:
        """The system of some points, inverted."""
        count = len(centers)
        system = np.ones((count + 1, count + 1))
        system[:count, :count], system[count, count] = _kernel(centers, centers, radius), 0.0
        system[np.arange(count), np.arange(count)] += NUGGET
        return cls(centers, radius, np.asarray(np.linalg.inv(system), np.float64))

    def _rows(self, points: F64) -> F64:
        return np.concatenate([_kernel(points, self.centers, self.radius), np.ones((len(points), 1))], axis=1)

    def covariance(self, first: F64, second: F64) -> F64:
        """Covariance (A, B) of the errors of prediction at points (A, D) and (B, D)."""
        return np.asarray(_kernel(first, second, self.radius) - self._rows(first) @ self.inverse @ self._rows(second).T)

    def variance(self, points: F64) -> F64:
        """Variance (A,) of the prediction at points (A, D)."""
        rows = self._rows(points)
        return np.asarray(np.maximum(-np.sum((rows @ self.inverse) * rows, axis=1), TINY))

    def drop(self, points: F64, goals: F64) -> F64:
        """Share (A, B) by which an example at each of the goals (B, D) lowers the error at points (A, D)."""
        shares = self.covariance(points, goals) ** 2 / np.outer(self.variance(points), self.variance(goals))
        return np.asarray(1.0 - np.sqrt(1.0 - np.clip(shares, 0.0, 1.0)))


def _kernel(first: F64, second: F64, radius: float) -> F64:
    """Negative variogram (A, B) between points (A, D) and (B, D)."""
    squared = np.sum((first[:, None] - second[None]) ** 2, axis=-1)
    return np.asarray(1.0 - np.sqrt(1.0 + squared / radius**2))


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
    arrays = Support.of_verb(verb).arrays
    centers, radius = np.array(arrays.centers), float(arrays.radius)
    rng, to_points = np.random.default_rng(SEED), verb.domain.chart.points
    goals, samples = random_points(verb, rng, CANDIDATES), to_points(random_points(verb, rng, SAMPLES))
    points = to_points(goals)
    chosen, drops, gains = _greedy(centers, radius, errors, points, samples, count)
    expected = _expected(Kriging.of_points(centers, radius), errors, points[chosen])
    return _described(verb, goals[chosen], expected, gains, drops, errors)


def guess_phase(verb: Verb) -> float:
    """Phase of the pose that is guessed: that of the measured keytime, the start of a cycle, or halfway."""
    if verb.measure.keytime >= 0:
        return float(verb.phases[verb.measure.keytime])
    return 0.0 if verb.looping else 0.5


def _greedy(
    centers: F64, radius: float, errors: F64, points: F64, samples: F64, count: int
) -> tuple[list[int], F64, list[float]]:
    """Candidates (A, D) chosen one after the other: indices, drops (count, N) of the examples' errors, and gains."""
    counted = np.argsort(-errors)[:MOST_COUNTED]
    left, made = errors.copy(), np.zeros((0, centers.shape[1]))
    everywhere = _expected(Kriging.of_points(centers, radius), errors, samples)
    weight = DOMAIN_SHARE * len(errors) / len(samples)
    whole = float(errors.sum() + weight * everywhere.sum())
    near = np.linalg.norm(points[:, None] - centers[None], axis=-1).min(axis=1)
    chosen: list[int] = []
    gains: list[float] = []
    drops = np.zeros((count, len(errors)))
    for k in range(count):
        own = np.zeros((len(counted), len(points)))
        for row, i in enumerate(counted):
            model = Kriging.of_points(np.concatenate([np.delete(centers, i, axis=0), made]), radius)
            own[row] = left[i] * model.drop(centers[i : i + 1], points)[0]
        model = Kriging.of_points(np.concatenate([centers, made]), radius)
        fall = model.drop(samples, points)
        gain = own.sum(axis=0) + weight * (everywhere @ fall)
        gain[near < APART * radius / RADIUS_SHARE] *= CLOSE
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        drops[k, counted] = own[:, best]
        gains.append(float(own[:, best].sum() + weight * (everywhere @ fall[:, best])) / max(whole, TINY))
        left, everywhere = left - drops[k], everywhere * (1.0 - fall[:, best])
        made = np.concatenate([made, points[best : best + 1]])
        near = np.minimum(near, np.linalg.norm(points - points[best], axis=1))
    return chosen, drops, gains


def _expected(model: Kriging, errors: F64, points: F64) -> F64:
    """Error (A,) to expect at points (A, D), from the leave-one-out errors (N,) of the model's centers."""
    variances = np.maximum(1.0 / np.diag(model.inverse)[:-1], TINY)  # of each without itself: Dubrule 1983
    roughness = errors / np.sqrt(variances)
    gaps = np.linalg.norm(points[:, None] - model.centers[None], axis=-1)
    weights = np.exp(-0.5 * (gaps * RADIUS_SHARE / (SMOOTHING * model.radius)) ** 2)
    mean = (weights @ roughness + ROUGHNESS_PRIOR * roughness.mean()) / (weights.sum(axis=1) + ROUGHNESS_PRIOR)
    return np.asarray(mean * np.sqrt(model.variance(points)))


def _described(verb: Verb, goals: F64, expected: F64, gains: list[float], drops: F64, errors: F64) -> list[Suggestion]:
    """Suggestions with what the verb answers there now."""
    evaluator = Evaluator(verb)
    blend = evaluator.blend(goals)
    support = evaluator.support(blend)
    _, positions = evaluator.positions(evaluator.pose_of(blend, phase=guess_phase(verb), plant=False))
    found = []
    for k, goal in enumerate(goals):
        helped = np.argsort(-drops[k])[:3]
        found.append(
            Suggestion(
                adverbs=goal,
                expected_error=float(expected[k]),
                gain=gains[k],
                support=float(support[k]),
                weight_sum=float(np.abs(blend.weights[k]).sum()),
                helped=tuple(verb.examples[i] for i in helped),
                helped_error=float(errors[helped].mean()),
                positions=positions[k].reshape(-1, 3),
            )
        )
    return found
