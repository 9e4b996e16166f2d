"""Weights by ``corrected``, for goals of one verb: a kernel for single rows against tiles of many, in one run.

``python -m benchmarks.weights [VERB ...]`` takes built-in verbs by name and captured ones by folder; both kernels also
clamp goals and measure errors. Goals are random in the domain, or four times as far out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.timing import interleave
from verbs import Evaluator, library
from verbs.authoring.fit import build
from verbs.blend.corrected import Corrected
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Blended, PositionProblem, corrected_position
from verbs.kernels.position_batch import corrected_position_batch
from verbs.verb import Verb

SIZES = (1, 60, 250, 1_024, 10_000)
GOALS_A_RUN = 2_000
"""Small batches are repeated until so many goals are solved, as a clock does not resolve single calls."""

_single, _batch = direct(corrected_position), direct(corrected_position_batch)


def main(names: tuple[str, ...] = ("reach", "board", "arm3")) -> None:
    """Print one table."""
    print("\nweights by corrected, µs a goal: single rows / tiles = ratio; in the domain, and 4 times as far out")
    print(f"  {'goals':<14}" + "".join(f"{size:>24,}" for size in SIZES))
    for name in names:
        verb = library.load(name) if name in library.names() else build(Path(name)).verb
        evaluator = Evaluator(verb)
        method = evaluator.method("corrected")[1]
        assert isinstance(method, Corrected)
        for label, spread in ((verb.name, 1.0), (f"{verb.name}, far", 4.0)):
            found = [_ratio(verb, method.problem(), size, spread) for size in SIZES]
            texts = [f"{one:.2f} / {many:.2f} = {one / many:.2f}" for one, many in found]
            print(f"  {label:<14}" + "".join(f"{text:>24}" for text in texts))


def _ratio(verb: Verb, problem: PositionProblem, size: int, spread: float) -> tuple[float, float]:
    """Microseconds a goal, of single rows and of tiles."""
    rows = random_points(verb, np.random.default_rng(0), size)
    middle = verb.values.mean(axis=0)
    rows = middle + spread * (rows - middle)
    calls = max(1, GOALS_A_RUN // size)
    count, axes = len(verb.examples), len(verb.measure.axes)
    out = Blended(np.empty((size, count)), np.empty((size, axes)), np.empty(size), np.empty(size))
    best = interleave(
        {
            "single": _repeated(calls, lambda: _single(rows, problem, out)),
            "batch": _repeated(calls, lambda: _batch(rows, False, problem, out)),
        },
        rounds=60 if size < GOALS_A_RUN else 20,
    )
    return tuple(1e6 * best[kind] / (calls * size) for kind in ("single", "batch"))  # type: ignore[return-value]


def _repeated(calls: int, task: Callable[[], F64]) -> Callable[[], None]:
    def run() -> None:
        for _ in range(calls):
            task()

    return run


if __name__ == "__main__":
    main(tuple(sys.argv[1:]) or ("reach", "board", "arm3"))
