"""Microseconds per pose of the C# client beside the library: ``python -m tests.clients.csharp.bench``.

Rounds of both alternate; the minimum counts.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from tests.clients.csharp.mono import CLIENT, PROGRAMS, PROJECT, compile_cs, run
from verbs import library
from verbs.runtime.evaluate import Evaluator

VERBS = ("reach", "locomotion", "arm3")
ROUNDS, BATCH = 4, 500


def of_library(evaluator: Evaluator, rows: int) -> float:
    """Microseconds per pose of calls with a number of rows."""
    domain = evaluator.verb.domain
    adverbs = np.repeat(domain.chart.adverbs(domain.middle[None]), rows, axis=0)
    phases, calls, best = np.linspace(0.0, 0.99, rows), max(1, 100 // rows), np.inf
    for _ in range(20):
        start_s = time.perf_counter()
        for _ in range(calls):
            evaluator.pose(adverbs, method="rbf", phase=phases, plant=False)
        best = min(best, (time.perf_counter() - start_s) / (calls * rows) * 1e6)
    return float(best)


def main() -> None:
    """Print a table."""
    evaluators = {name: Evaluator(library.load(name)) for name in VERBS}
    best: dict[tuple[str, str], float] = {}
    with tempfile.TemporaryDirectory() as folder:
        client, program = Path(folder) / "Adverb.dll", Path(folder) / "tests.exe"
        compile_cs(client, [CLIENT / "Adverb.cs"], "System.Net.Http.dll", library=True)
        compile_cs(program, sorted(PROGRAMS.glob("*.cs")), str(client))
        for _ in range(ROUNDS):
            found = run(program, "bench", str(PROJECT / "verbs" / "library"), ",".join(VERBS))
            for name, evaluator in evaluators.items():
                row = {**found[name], "call": of_library(evaluator, 1), "batch": of_library(evaluator, BATCH)}
                for column, time_us in row.items():
                    best[name, column] = min(best.get((name, column), np.inf), time_us)
    columns = ("adverbs_us", "weights_us", "positions_us", "call", "batch")
    print("verb", *columns)  # noqa: T201
    for name in VERBS:
        print(name, *(f"{best[name, column]:.2f}" for column in columns))  # noqa: T201


if __name__ == "__main__":
    main()
