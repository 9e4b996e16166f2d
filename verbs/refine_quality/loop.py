"""Refinement for quality: pseudo-examples whose motion is better where that of the smooth basis is worst.

Exact weights are not unique: N examples and a goal in space leave N − 4 directions free. An attempt takes the costliest
goal that no attempt has taken, finds weights there that are exact and move better, and inserts them as a pseudo-example
into the smooth basis. The correction on top keeps every answer exact. An attempt depends on verb, basis, mark and rules
only: a job may stop after any of them and resume.

Source: the loop of Rose, Sloan, Cohen 2001, section 4.3, with motion in place of error; ``docs/math.md``, section
"Refinement for quality".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from verbs.authoring.basis import solve_smooth
from verbs.blend.cardinal import basis_weights
from verbs.blend.corrected import Corrected
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.errors import OutOfRange, RequestError
from verbs.kernels import measure as measures
from verbs.refine_quality.cost import MotionCost
from verbs.refine_quality.guards import Guards, evaluator_with, plain_basis
from verbs.refine_quality.solve import better_weights
from verbs.verb import Basis, Verb

__all__ = ["START", "Costs", "Mark", "Rules", "Step", "check", "refine", "resume", "with_basis"]

MOST = {"max_pseudo": 64, "seed": 10**6, "samples": 10**5, "patience": 10**6}

SPACING_SHARE = 0.6
"""Least distance of a pseudo-example from all centers, in median nearest-neighbour distances of the examples."""

LEAST_GAIN, MOST_P95 = 0.005, 1.02
"""A pseudo-example stays if the mean cost falls by this share and the 95th percentile stays below this ratio."""

SHARES = (1.0, 0.5, 0.25)
"""Shares of the way to the better weights that an attempt tries."""

SEED_STREAM = 4


@dataclass(frozen=True, slots=True)
class Rules:
    """Parameters of a refinement for quality.

    Parameters
    ----------
    max_pseudo : int
        Number of pseudo-examples in the smooth basis at which to stop.
    seed, samples : int
        Seed and number of the search goals.
    patience : int
        Attempts in a row without a gain after which to stop.
    """

    max_pseudo: int = 8
    seed: int = 1
    samples: int = 150
    patience: int = 6

    def __post_init__(self) -> None:
        for name, most in MOST.items():
            least = int(name in ("samples", "patience"))
            if not least <= getattr(self, name) <= most:
                raise OutOfRange(f"{name} is {getattr(self, name)}; it must lie between {least} and {most}")


@dataclass(frozen=True, slots=True)
class Mark:
    """State of a refinement besides its basis.

    Parameters
    ----------
    number : int
        Attempts so far; -1 before the first evaluation.
    tried : tuple of int
        Search goals that attempts have taken.
    failed : int
        Attempts without a gain since the last gain.
    stopped : str
        Why it ended; empty while it has not.
    """

    number: int = -1
    tried: tuple[int, ...] = ()
    failed: int = 0
    stopped: str = ""


START = Mark()


@dataclass(frozen=True, slots=True)
class Costs:
    """Mean, 95th percentile and largest cost of the motions at the search goals."""

    mean: float
    p95: float
    largest: float

    @classmethod
    def of(cls, values: F64) -> Costs:
        """Summary of costs (B,)."""
        return cls(float(values.mean()), float(np.percentile(values, 95)), float(values.max()))


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Result of one attempt.

    Parameters
    ----------
    mark : Mark
    adverbs : (D,) float64 or None
        Goal of the attempt; None at the start, and where no goal is left.
    problem : str
        Why its pseudo-example was not kept; empty if it was.
    before, after : Costs
    pseudo : int
        Number of pseudo-examples.
    basis : Basis
    """

    mark: Mark
    adverbs: F64 | None
    problem: str
    before: Costs
    after: Costs
    pseudo: int
    basis: Basis


def refine(verb: Verb, rules: Rules | None = None) -> Iterator[Step]:
    """Refine a verb's smooth basis; the first step only evaluates the cost.

    Raises
    ------
    RequestError
        See :func:`check`.
    """
    check(verb)
    return resume(verb, verb.bases["smooth"], START, rules)


def check(verb: Verb) -> None:
    """Raise :class:`RequestError` where a verb cannot be refined for quality."""
    if "smooth" not in verb.bases or verb.measure.kind == measures.NOTHING:
        raise RequestError(f"'{verb.name}' cannot be refined for quality: it has no method 'corrected'")


def resume(verb: Verb, basis: Basis, mark: Mark, rules: Rules | None = None) -> Iterator[Step]:
    """Resume from the basis and mark of a step; the same steps follow as without the interruption."""
    # Read-only arrays of a file compile to kernels of their own, which may round differently: always start from copies.
    arrays = (basis.centers, basis.radii, basis.radial, basis.poly)
    centers, radii, radial, poly = (np.array(array, order="C") for array in arrays)
    basis = replace(basis, centers=centers, radii=radii, radial=radial, poly=poly)
    return _steps(_Ground.of_verb(verb, rules or Rules()), basis, mark)


def with_basis(verb: Verb, basis: Basis, rules: Rules, mark: Mark) -> Verb:
    """The verb with a refined smooth basis, its error and weights at held-out points, and the rules."""
    made = asdict(rules) | {"steps": mark.number, "pseudo_examples": len(basis.centers) - len(verb.examples)}
    adverbs = random_points(verb, np.random.default_rng(7), int(verb.quality.get("samples", 1_000)))
    blend = evaluator_with(verb, basis).blend(adverbs, method="corrected")
    figures = {"error_mean_m": float(blend.error.mean()), "error_max_m": float(blend.error.max())}
    figures["weight_sum_max"] = float(np.abs(blend.weights).sum(axis=1).max())
    return replace(
        verb,
        bases={**verb.bases, "smooth": basis},
        quality={**verb.quality, "methods": {**verb.quality.get("methods", {}), "corrected": figures}},
        provenance={**verb.provenance, "quality_refinement": made},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """Constants of a refinement.

    Parameters
    ----------
    corrected : Corrected
        With the plain basis.
    cost : MotionCost
    guards : Guards
        That of the plain basis.
    adverbs, points, goals : (B, D), (B, D), (B, 3) float64
        Search goals: as adverbs, as normalised chart points of the basis, and as goals.
    spacing : float
        Least distance of a pseudo-example from all centers.
    """

    verb: Verb
    rules: Rules
    corrected: Corrected
    cost: MotionCost
    guards: Guards
    adverbs: F64
    points: F64
    goals: F64
    spacing: float

    @classmethod
    def of_verb(cls, verb: Verb, rules: Rules) -> _Ground:
        check(verb)
        plain = plain_basis(verb)
        corrected = replace(Corrected.of_verb(verb), basis=plain)
        adverbs = random_points(verb, np.random.default_rng([rules.seed, SEED_STREAM]), rules.samples)
        goals, points = corrected.goal.points(adverbs), plain.chart.points(adverbs)
        cost = MotionCost.of_verb(verb, corrected.weights(adverbs))
        guards = Guards.of_evaluator(evaluator_with(verb, plain), rules.seed, adverbs)
        between = np.linalg.norm(plain.centers[:, None] - plain.centers[None], axis=-1)
        nearest = np.where(np.eye(len(between), dtype=bool), np.inf, between).min(axis=1)
        spacing = SPACING_SHARE * float(np.median(nearest))
        return cls(verb, rules, corrected, cost, guards, adverbs, points, goals, spacing)

    def weights(self, basis: Basis) -> F64:
        """Corrected weights (B, N) at the search goals."""
        return replace(self.corrected, basis=basis).weights(self.adverbs)

    def costliest(self, basis: Basis, costs: F64, mark: Mark) -> int | None:
        """Number of the costliest search goal that was not tried and is far enough from all centers."""
        far = np.linalg.norm(self.points[:, None] - basis.centers[None], axis=-1).min(axis=1) >= self.spacing
        far[list(mark.tried)] = False
        return int(np.argmax(np.where(far, costs, -np.inf))) if far.any() else None

    def accepted(self, basis: Basis, before: Costs) -> tuple[F64 | None, str]:
        """Costs (B,) with a larger basis, or None and the reason why it is worse."""
        costs = self.cost.costs(self.weights(basis))
        after = Costs.of(costs)
        if not after.mean <= (1.0 - LEAST_GAIN) * before.mean:
            return None, "the mean cost does not fall"
        if not after.p95 <= MOST_P95 * before.p95:
            return None, "the 95th percentile of the cost rises"
        guards = Guards.of_evaluator(evaluator_with(self.verb, basis), self.rules.seed, self.adverbs)
        exceeded = guards.exceeded(self.guards)
        return (None, f"limit exceeded: {exceeded}") if exceeded else (costs, "")


def _steps(ground: _Ground, basis: Basis, mark: Mark) -> Iterator[Step]:
    costs = ground.cost.costs(ground.weights(basis))
    count, rules = len(ground.verb.examples), ground.rules
    if mark.number < 0:
        mark = _stopped(replace(mark, number=0), len(basis.centers) - count, rules)
        yield Step(mark, None, "", Costs.of(costs), Costs.of(costs), len(basis.centers) - count, basis)
    while not mark.stopped:
        before, chosen = Costs.of(costs), ground.costliest(basis, costs, mark)
        if chosen is None:
            mark = replace(mark, stopped="no goal is left")
            yield Step(mark, None, "", before, before, len(basis.centers) - count, basis)
            return
        larger, found, problem = _attempt(ground, basis, before, chosen)
        basis, costs = (larger, found) if found is not None else (basis, costs)
        failed = 0 if found is not None else mark.failed + 1
        mark = Mark(mark.number + 1, (*mark.tried, chosen), failed)
        mark = _stopped(mark, len(basis.centers) - count, rules)
        yield Step(mark, ground.adverbs[chosen], problem, before, Costs.of(costs), len(basis.centers) - count, basis)


def _stopped(mark: Mark, pseudo: int, rules: Rules) -> Mark:
    if pseudo >= rules.max_pseudo:
        return replace(mark, stopped="most pseudo-examples reached")
    if mark.failed >= rules.patience:
        return replace(mark, stopped=f"{mark.failed} attempts without a gain")
    return mark


def _attempt(ground: _Ground, basis: Basis, before: Costs, chosen: int) -> tuple[Basis, F64 | None, str]:
    """The larger basis and its costs (B,) at the search goals, or the basis, None and the last problem."""
    goal = ground.goals[chosen]
    start = replace(ground.corrected, basis=basis).weights(ground.adverbs[chosen : chosen + 1])[0]
    move = better_weights(ground.cost, ground.corrected, start, goal) - start
    problem = "no better weights were found"
    for share in SHARES:
        row = (start + share * move)[None].copy()
        ground.corrected.correct(row, goal[None])
        larger = _insert(basis, ground.points[chosen], row[0])
        if larger is None:
            return basis, None, "the system is singular"
        costs, problem = ground.accepted(larger, before)
        if costs is not None:
            return larger, costs, ""
    return basis, None, problem


def _insert(basis: Basis, point: F64, weights: F64) -> Basis | None:
    """Basis with one more center; earlier pseudo-examples keep their weights, since the basis interpolates them."""
    centers = np.concatenate([basis.centers, point[None]])
    targets = np.concatenate([basis_weights(basis, basis.chart.adverbs(basis.centers)), weights[None]])
    targets[: targets.shape[1]] = np.eye(targets.shape[1])
    try:
        return solve_smooth(basis.chart, centers, targets, radius=float(basis.radii[0]), degree=basis.degree)
    except np.linalg.LinAlgError:
        return None
