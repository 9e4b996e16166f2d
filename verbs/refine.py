"""Refinement: insert pseudo-examples where the error of a basis is largest, one step at a time.

A step finds the point p of largest error, searches the adverbs p' whose blend measures p, and inserts at p a
pseudo-example with the weights of p'. A step depends only on verb, basis and rules: a job may stop after any step
and resume.

Source: Rose, Sloan, Cohen 2001, section 4.3; ``docs/math.md``, section "Refinement".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.linalg import lapack
from scipy.spatial import cKDTree

from verbs.blend.cardinal import basis_weights
from verbs.blend.corrected import Corrected
from verbs.conventions import F64
from verbs.domain import accuracy_points, inside, random_points
from verbs.errors import OutOfRange, RequestError, UnknownName
from verbs.goal import Goal
from verbs.kernels import chart as charts
from verbs.kernels import radial_basis
from verbs.verb import Basis, Chart, Verb

__all__ = ["CHOICES", "Errors", "Mark", "PseudoExample", "Rules", "Step", "refine", "resume", "with_basis"]

CHOICES = {"radii": ("local", "global"), "planes": ("frozen", "refit"), "search": ("either", "adverbs", "weights")}
"""Variants of the paper, by the name of their rule, the default first.

A center keeps its first radius, or all follow their nearest neighbours; planes stay, or are fitted anew; weights come
from adverbs p', or from :mod:`verbs.blend.corrected` at p, or (either) from there where no p' near p meets the goal.
"""

MOST = {"target_error": 10, "max_pseudo": 2_000, "seed": 10**6, "samples": 10**6, "patience": 10**6}

FOUND, USABLE = 1e-9, 1e-6
"""Residuals as shares of the diagonal: where a search or a refinement ends; and the largest of a pseudo-example, which
becomes part of the basis."""

NEAR, LONGEST_STEP, FARTHEST = 1e-3, 0.2, 0.6
"""Least distance of a pseudo-example from all centers; longest step of p', and from p; 1 is the examples' range."""

TRIES, ITERATIONS, MAX_CONDITION = 32, 20, 1e8
"""Points that a step tries, from the largest error on; steps of a search; condition of a singular system."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Parameters of a refinement.

    Parameters
    ----------
    target_error : float
        Largest error on the search points at which to stop, as a share of the diagonal of the examples' goals.
    max_pseudo : int
        Number of pseudo-examples at which to stop.
    radii, planes, search : str
        See :data:`CHOICES`. As in the paper, radii and planes work best unchanged.
    samples, seed : int
        Number of random search points (three adverbs and more), and their seed.
    patience : int
        Steps without a new minimum of the largest error after which to stop; 0 disables this.
    """

    target_error: float = 0.01
    max_pseudo: int = 300
    seed: int = 1
    radii: str = "local"
    planes: str = "frozen"
    search: str = "either"
    samples: int = 4_000
    patience: int = 100

    def __post_init__(self) -> None:
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise UnknownName(name, getattr(self, name), known)
        for name, most in MOST.items():
            least = int(name == "samples")
            if not least <= getattr(self, name) <= most:  # NaN compares false
                raise OutOfRange(f"{name} is {getattr(self, name)}; it must lie between {least} and {most}")


@dataclass(frozen=True, slots=True)
class Errors:
    """Mean and largest error on the search points, as shares of the diagonal of the examples' goals."""

    mean: float
    largest: float


@dataclass(frozen=True, slots=True)
class Mark:
    """State of a refinement besides its basis: steps, least largest error, steps since then, and why it stopped."""

    number: int
    best: float
    idle: int
    stopped: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PseudoExample:
    """A pseudo-example: weights for some adverbs.

    Parameters
    ----------
    adverbs : (D,) float64
        Adverbs p.
    source : (D,) float64 or None
        Adverbs p'; None where weights were corrected instead.
    weights : (N,) float64
    residual : float
        Distance of their measured point from p, as a share of the diagonal.
    """

    adverbs: F64
    source: F64 | None
    weights: F64
    residual: float


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Result of one step.

    Parameters
    ----------
    mark : Mark
    drawn : PseudoExample or None
        None at the start, and where no point is usable.
    before, after : Errors
    pseudo : int
        Number of pseudo-examples.
    basis : Basis
        Its condition is an estimate in the 1-norm.
    """

    mark: Mark
    drawn: PseudoExample | None
    before: Errors
    after: Errors
    pseudo: int
    basis: Basis


def refine(verb: Verb, rules: Rules | None = None, *, points: F64 | None = None) -> Iterator[Step]:
    """Refine a verb's basis ``rbf``; the first step only evaluates the error.

    Parameters
    ----------
    verb : Verb
    rules : Rules, optional
    points : (B, D) float64, optional
        Search points. By default a 41-node grid up to two adverbs; above, random points of the domain; from
        the worst of them the error is climbed to a local maximum.

    Raises
    ------
    RequestError
        If the verb has style adverbs only, its radial functions are not compact, or there are no points.
    """
    return resume(verb, verb.bases["rbf"], Mark(-1, np.inf, 0), rules, points=points)


def resume(
    verb: Verb, basis: Basis, mark: Mark, rules: Rules | None = None, *, points: F64 | None = None
) -> Iterator[Step]:
    """Resume from the basis and mark of a step; the same steps follow as without the interruption."""
    # Read-only arrays of a file compile to kernels of their own, which may round differently: always start from copies.
    arrays = (basis.centers, basis.radii, basis.radial, basis.poly)
    centers, radii, radial, poly = (np.array(array, order="C") for array in arrays)
    basis = replace(basis, centers=centers, radii=radii, radial=radial, poly=poly)
    return _steps(_Ground.of_verb(verb, basis, rules or Rules(), points), basis, mark)


def with_basis(verb: Verb, basis: Basis, rules: Rules, mark: Mark) -> Verb:
    """The verb with a refined basis, its error at held-out points, and the rules in its provenance."""
    goal, rng = Goal.of_verb(verb), np.random.default_rng([rules.seed, 1])  # search points come from [seed, 0]
    adverbs = random_points(verb, rng, int(verb.quality.get("samples", 1_000)))
    weights = basis_weights(basis, adverbs)
    error = goal.compare(adverbs, goal.measured(weights))[1]
    figures = {"error_mean_m": float(error.mean()), "error_max_m": float(error.max())}
    figures["weight_sum_max"] = float(np.abs(weights).sum(axis=1).max())
    made = asdict(rules) | {"steps": mark.number, "pseudo_examples": len(basis.centers) - len(verb.values)}
    return replace(
        verb,
        bases={**verb.bases, "refined": replace(basis, condition=float(np.linalg.cond(_system(basis))))},
        quality={**verb.quality, "methods": {**verb.quality.get("methods", {}), "refined": figures}},
        provenance={**verb.provenance, "refinement": made},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """Constants of a refinement.

    Parameters
    ----------
    scale : (3,) float64
        |scale ∘ (measured - goal)| is the error as a share of the diagonal; speeds count in shares of their ranges.
    adverbs, points, goals : (B, D), (B, D), (B, 3) float64
        Search points: as adverbs, in the basis's normalised chart coordinates, and as goals.
    stride : float
        First step of the climb from the worst point; 0 disables it.
    """

    verb: Verb
    rules: Rules
    goal: Goal
    correction: Corrected
    scale: F64
    adverbs: F64
    points: F64
    goals: F64
    stride: float

    @classmethod
    def of_verb(cls, verb: Verb, basis: Basis, rules: Rules, points: F64 | None) -> _Ground:
        goal, dims, stride = Goal.of_verb(verb), len(verb.adverbs), 0.0
        if not goal.measurable:
            raise RequestError(f"'{verb.name}' has style adverbs only: there is no error to refine")
        if basis.radial_basis not in radial_basis.COMPACT:
            raise RequestError("refining needs a basis of compact radial functions")
        if points is None and dims > 2:
            points = random_points(verb, np.random.default_rng([rules.seed, 0]), rules.samples)
            stride = float(0.5 * len(points) ** (-1.0 / dims))
        adverbs = np.ascontiguousarray(accuracy_points(verb).adverbs if points is None else points, np.float64)
        if adverbs.ndim != 2 or adverbs.shape[1] != dims or not len(adverbs) or not np.isfinite(adverbs).all():
            raise OutOfRange(f"search points must be finite and of shape (number, {dims})")
        correction = Corrected.of_verb(verb, basis="rbf", steps=ITERATIONS)
        span = np.ptp(goal.points(verb.values), axis=0)
        units = correction.correction.scale
        scale = units / np.linalg.norm(units * span)
        goals, places = goal.points(adverbs), basis.chart.points(adverbs)
        return cls(verb, rules, goal, correction, scale, adverbs, places, goals, stride)

    def residuals(self, basis: Basis, points: F64, goals: F64) -> F64:
        """Scaled differences (B, 3) between measured points at normalised chart points (B, D) and goals (B, 3)."""
        return np.asarray(self.scale * (self.goal.measured(_weights_at(basis, points)) - goals))

    def errors(self, basis: Basis, points: F64, goals: F64) -> F64:
        """Error (B,) at normalised chart points (B, D), as a share of the diagonal."""
        return np.asarray(np.linalg.norm(self.residuals(basis, points, goals), axis=1))


def _steps(ground: _Ground, basis: Basis, mark: Mark) -> Iterator[Step]:
    errors = ground.errors(basis, ground.points, ground.goals)
    if mark.number < 0:
        step = _taken(ground, mark, basis, errors, errors, None)
        yield step
        mark = step.mark
    while not mark.stopped:
        basis, drawn = _insert_worst(ground, basis, errors)
        before, errors = errors, ground.errors(basis, ground.points, ground.goals)
        step = _taken(ground, mark, basis, before, errors, drawn)
        yield step
        mark = step.mark


def _taken(ground: _Ground, mark: Mark, basis: Basis, before: F64, after: F64, drawn: PseudoExample | None) -> Step:
    """The step that follows a mark."""
    rules, pseudo, largest = ground.rules, len(basis.centers) - len(ground.verb.values), float(after.max())
    idle = 0 if largest < mark.best else mark.idle + 1
    if largest <= max(rules.target_error, FOUND):
        stopped = "target met"
    elif pseudo >= rules.max_pseudo:
        stopped = "most pseudo-examples reached"
    elif drawn is None and mark.number >= 0:
        stopped = "no usable point left"
    else:
        stopped = "no progress" if 0 < rules.patience <= idle else ""
    was, now = (Errors(float(errors.mean()), float(errors.max())) for errors in (before, after))
    return Step(Mark(mark.number + 1, min(mark.best, largest), idle, stopped), drawn, was, now, pseudo, basis)


def _weights_at(basis: Basis, points: F64) -> F64:
    """Weights (B, N) at normalised chart points (B, D)."""
    dims = points.shape[1]
    plain = Chart(charts.IDENTITY, np.zeros(3, np.int64), np.zeros(4), np.zeros(dims), np.ones(dims))
    return basis_weights(replace(basis, chart=plain), np.ascontiguousarray(points))


def _nearest(basis: Basis, points: F64) -> F64:
    """Distance (B,) of normalised chart points (B, D) to the nearest center."""
    return np.asarray(cKDTree(basis.centers).query(points)[0])


def _insert_worst(ground: _Ground, basis: Basis, errors: F64) -> tuple[Basis, PseudoExample | None]:
    """Basis with a pseudo-example at the worst usable point, and that pseudo-example; None where there is none."""
    left = _nearest(basis, ground.points) >= NEAR
    for _ in range(TRIES):
        if not left.any():
            break
        index = int(np.argmax(np.where(left, errors, -1.0)))
        drawn = _drawn(ground, basis, _climb(ground, basis, index, errors[index]))
        larger = None if drawn is None else _insert(basis, drawn, ground.rules)
        if larger is not None:
            return larger, drawn
        # Neighbours of a point that fails fail too: try elsewhere; a later step may come back.
        apart = np.linalg.norm(ground.points - ground.points[index], axis=1)
        left &= apart > 0.25 * _nearest(basis, ground.points[index])
    return basis, None


def _climb(ground: _Ground, basis: Basis, index: int, error: float) -> F64:
    """Adverbs (D,) of a local maximum of the error near a search point, inside the domain and off the centers."""
    best, domain, stride = ground.adverbs[index], ground.verb.domain, ground.stride
    here, moves = domain.chart.points(best[None]), np.concatenate([np.eye(len(best)), -np.eye(len(best))])
    for _ in range(10 if stride else 0):
        around = here + stride * moves
        adverbs = domain.chart.adverbs(around)
        points = basis.chart.points(adverbs)
        fits = inside(domain, around) & (_nearest(basis, points) >= NEAR)
        values = np.where(fits, ground.errors(basis, points, ground.goal.points(adverbs)), -1.0)
        k = int(values.argmax())
        if values[k] > error:
            here, best, error = around[k : k + 1], adverbs[k], values[k]
        else:
            stride *= 0.5
    return np.array(best)


def _drawn(ground: _Ground, basis: Basis, adverbs: F64) -> PseudoExample | None:
    """A pseudo-example for adverbs (D,); None where no weights meet them."""
    start, goal = basis.chart.points(adverbs[None]), ground.goal.points(adverbs[None])
    if ground.rules.search != "weights":
        source, residual = _newton(ground, basis, start[0], goal[0])
        if residual <= USABLE:
            there = basis.chart.adverbs(source[None])[0]
            return PseudoExample(adverbs, there, _weights_at(basis, source[None])[0], residual)
        if ground.rules.search == "adverbs":
            return None
    weights = _weights_at(basis, start)
    ground.correction.correct(weights, goal)
    residual = float(np.linalg.norm(ground.scale * (ground.goal.measured(weights) - goal)))
    return PseudoExample(adverbs, None, weights[0], residual) if residual <= USABLE else None


def _newton(ground: _Ground, basis: Basis, start: F64, goal: F64) -> tuple[F64, float]:
    """Normalised chart point p' (D,) near ``start`` whose blend meets a goal (3,), and its residual.

    Newton's method on measured adverbs alone; each step is a line search, so that the error never grows.
    """
    free, point = ground.verb.measure.axes, start  # charts bend measured adverbs only: these are their chart axes too
    count, shares = len(free), 0.5 ** np.arange(8.0)[:, None]
    nudges = np.zeros((2 * count, len(point)))
    nudges[np.arange(count), free], nudges[count + np.arange(count), free] = 1e-6, -1e-6
    residual = ground.residuals(basis, point[None], goal)[0]
    for _ in range(ITERATIONS):
        error = np.linalg.norm(residual)
        if error <= FOUND:
            break
        around = ground.residuals(basis, point + nudges, goal)
        slopes = (around[:count] - around[count:]).T / 2e-6
        move = np.zeros(len(point))
        move[free] = np.linalg.lstsq(slopes, -residual, rcond=1e-6)[0]
        move *= min(1.0, LONGEST_STEP / max(float(np.linalg.norm(move)), 1e-12))
        tried = point + shares * move
        found = ground.residuals(basis, tried, goal)
        sizes = np.linalg.norm(found, axis=1)
        sizes[np.linalg.norm(tried - start, axis=1) > FARTHEST] = np.inf
        k = int(np.argmin(sizes))
        if not sizes[k] < error:
            break
        point, residual = tried[k], found[k]
    return point, float(np.linalg.norm(residual))


def _insert(basis: Basis, drawn: PseudoExample, rules: Rules) -> Basis | None:
    """Basis with one more pseudo-example, exact at all centers; None where its system is nearly singular."""
    centers = np.concatenate([basis.centers, basis.chart.points(drawn.adverbs[None])])
    # Older pseudo-examples keep the weights that they give now: the basis needs no record of its targets.
    targets = np.concatenate([_weights_at(basis, basis.centers), drawn.weights[None]])
    targets[: targets.shape[1]] = np.eye(targets.shape[1])
    radii = np.append(basis.radii, _nearest(basis, centers[-1]))
    if rules.radii == "global":
        radii = np.ascontiguousarray(cKDTree(centers).query(centers, 2)[0][:, 1])
    powers, poly = radial_basis.polynomial_matrix(centers, basis.degree), basis.poly
    if rules.planes == "refit":
        poly = np.ascontiguousarray(np.linalg.lstsq(powers, targets, rcond=None)[0])
    larger = replace(basis, centers=centers, radii=radii, poly=poly, radial=targets)
    system = _system(larger)
    factors, pivots, failed = lapack.dgetrf(system)
    share = lapack.dgecon(factors, np.abs(system).sum(axis=0).max())[0]
    if failed or share * MAX_CONDITION < 1.0:
        return None
    radial = lapack.dgetrs(factors, pivots, targets - powers @ poly)[0]
    return replace(larger, radial=np.ascontiguousarray(radial), condition=1.0 / share)


def _system(basis: Basis) -> F64:
    """Radial functions (C, C) of all centers (columns) at all centers: the matrix Q of section 3.1."""
    return radial_basis.radial_matrix(basis.radial_basis, basis.centers, basis.centers, basis.radii)
