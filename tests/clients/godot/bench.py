"""Microseconds per pose of weights, with joint positions, in Godot: ``python -m tests.clients.godot.bench``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.clients.godot.godot import PROJECT, make_project, run

VERBS, ROUNDS, POSES = ("reach", "locomotion", "arm3"), 5, 50


def main() -> None:
    """Print a row for each verb: the minimum of several rounds counts."""
    with tempfile.TemporaryDirectory() as name:
        project = make_project(Path(name))
        for verb in VERBS:
            path = str(PROJECT / "verbs" / "library" / f"{verb}.verb")
            best_us = min(run(project, "vectors", "bench", path, POSES) for _ in range(ROUNDS))
            print(f"{verb} {best_us:.0f} µs")  # noqa: T201


if __name__ == "__main__":
    main()
