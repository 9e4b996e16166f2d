"""Time of one pose in Node beside the library's kernel: ``python -m tools.evaluator_bench``; build the package first.

Rounds alternate, and the minimum counts, as the machine is shared. The kernel blends a batch of 500 poses in one call,
as for a crowd; a single call of the library includes Python's share.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from verbs import Evaluator, library

__all__ = ["compare", "kernel_us"]

SCRIPT = Path(__file__).parents[1] / "clients" / "typescript" / "bench" / "poses.js"
VERBS, ROUNDS, POSES = ("reach", "locomotion", "arm3"), 5, 500


def least_us(run: Callable[[], object], poses: int) -> float:
    """Microseconds for each pose, the minimum of several runs."""
    best = float("inf")
    for _ in range(20):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return 1e6 * best / poses


def kernel_us(name: str) -> tuple[float, float]:
    """Batch and single pose of weights at phases in the library."""
    verb = library.load(name)
    evaluator = Evaluator(verb)
    middle = verb.values.mean(axis=0)[None]
    blend = evaluator.blend(middle, method="rbf")
    phases = np.linspace(0.0, 0.999, POSES)
    rng = np.random.default_rng(1)
    rows = np.repeat(middle, POSES, axis=0)
    batch = evaluator.blend(rows, method="rbf")
    shuffled = rng.permutation(phases)

    def single() -> None:
        for phase in shuffled[:100]:
            evaluator.pose_of(blend, phase=float(phase), plant=False)

    return (
        least_us(lambda: evaluator.pose_of(batch, phase=shuffled, plant=False), POSES),
        least_us(single, 100),
    )


def compare() -> str:
    """Rows of a table, one for each verb."""
    best: dict[str, list[float]] = {}
    for _ in range(ROUNDS):
        node = json.loads(
            subprocess.run(["node", str(SCRIPT), *VERBS], capture_output=True, text=True, check=True).stdout
        )
        for name in VERBS:
            batch, single = kernel_us(name)
            row = [node[name]["weights_us"], node[name]["pose_us"], node[name]["positions_us"], batch, single]
            best[name] = [min(pair) for pair in zip(best.get(name, row), row, strict=True)]
    heads = ("verb", "weights", "pose", "joint positions", "pose, kernel in a batch", "pose, library call", "ratio")
    rows: list[tuple[str, ...]] = [heads, ("---",) + ("---:",) * 6]
    for name, numbers in best.items():
        rows.append((name, *(f"{value:.1f}" for value in numbers), f"{numbers[1] / numbers[3]:.1f}"))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


if __name__ == "__main__":
    print(compare())
