"""Write test vectors for evaluators in other languages: ``python -m tools.evaluator_vectors``.

``tests/golden/evaluator_vectors.v1.json`` has, for several verb files, weights or adverbs with an instant, and the
joint positions that this library gives for them. With ``--refined`` the file ``tests/golden/refined.v1.verb``, a
refinement of ``arm3``, is made again first.
"""

from __future__ import annotations

import hashlib
import json
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from verbs.conventions import F64
from verbs.domain import random_points
from verbs.io import artifact
from verbs.refine import Rules, refine, with_basis
from verbs.runtime.evaluate import Blend, Evaluator, Poses
from verbs.verb import Verb

__all__ = ["PATH", "vectors"]

ROOT = Path(__file__).parents[1]
PATH = ROOT / "tests" / "golden" / "evaluator_vectors.v1.json"
REFINED = ROOT / "tests" / "golden" / "refined.v1.verb"
FILES = (
    "tests/golden/arm.v1.verb",
    "tests/golden/jump.v2.verb",
    "tests/golden/refined.v1.verb",
    *(f"verbs/library/{name}.verb" for name in ("arm3", "reach", "kick", "jump", "locomotion", "walk", "mood")),
)
"""Quaternions and rotation vectors, all charts, roots that are blended, walk and climb, pseudo-examples."""

DIGITS = 8
"""Positions are rounded to 10 nm."""

Json = dict[str, Any]


def vectors() -> Json:
    """Content of the vector file."""
    return {
        "format": 1,
        "tolerance_m": 1e-5,
        "verbs": [_of_file(name, number) for number, name in enumerate(FILES)],
    }


def _of_file(name: str, number: int) -> Json:
    path = ROOT / name
    verb = artifact.load(path)
    evaluator, rng = Evaluator(verb), np.random.default_rng([7, number])
    return {
        "file": name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "weights": [_of_weights(evaluator, rng, k) for k in range(3)],
        "adverbs": [_of_adverbs(evaluator, rng, k) for k in range(5)],
    }


def _of_weights(evaluator: Evaluator, rng: np.random.Generator, k: int) -> Json:
    """A pose of random weights, some of them negative, at a phase."""
    count = len(evaluator.verb.examples)
    weights = rng.dirichlet(np.full(count, 0.4)) + 0.2 * rng.dirichlet(np.full(count, 0.4))
    weights -= 0.2 / count
    weights = np.round(weights, 6)
    phase = _phase(evaluator.verb, rng, k)
    none = np.zeros((1, 0))
    blend = Blend("weights", weights[None], none, np.full(1, np.nan), np.zeros(1, np.bool_))
    return {
        "weights": weights.tolist(),
        "phase": phase,
        **_found(evaluator, evaluator.pose_of(blend, phase=phase, plant=False)),
    }


def _of_adverbs(evaluator: Evaluator, rng: np.random.Generator, k: int) -> Json:
    """A pose at adverbs: inside the domain, and outside of it for odd numbers."""
    verb, method = evaluator.verb, "refined" if k in (1, 2) else "rbf"
    row: F64 = random_points(verb, rng, 1, gauge=(1.3, 1.8) if k % 2 else (0.0, 1.0))[0]
    row = np.round(row, 6)
    names = [adverb.name for adverb in verb.adverbs]
    instant = {"time": round(float(rng.uniform(0.0, 2.0)), 6)} if k >= 3 else {"phase": _phase(verb, rng, k)}
    at = {"time_s": instant["time"]} if "time" in instant else instant
    poses = evaluator.pose(row[None], method=method, plant=False, **at)
    return {
        "adverbs": dict(zip(names, row.tolist(), strict=True)),
        "method": method,
        **instant,
        "clamped": bool(poses.blend.clamped[0]),
        "weights": np.round(poses.blend.weights[0], 9).tolist(),
        **_found(evaluator, poses),
    }


def _phase(verb: Verb, rng: np.random.Generator, k: int) -> float:
    """A phase; in the third cycle of a loop for the last number."""
    return round(float(rng.uniform(0.0, 1.0)) + (2.0 if verb.looping and k == 2 else 0.0), 6)


def _found(evaluator: Evaluator, poses: Poses) -> Json:
    positions = evaluator.positions(poses)[1][0]
    return {
        "at": {
            "phase": round(float(poses.phase[0]), 9),
            "time": round(float(poses.time_s[0]), 9),
            "duration": round(float(poses.duration_s[0]), 9),
        },
        "positions": np.round(positions, DIGITS).tolist(),
    }


def _make_refined() -> None:
    """A verb with pseudo-examples."""
    verb, rules = artifact.load(ROOT / "verbs" / "library" / "arm3.verb"), Rules()
    *_, last = islice(refine(verb, rules), 9)
    artifact.save(with_basis(verb, last.basis, rules, last.mark), REFINED)


def _text(content: Json) -> str:
    """JSON with one line for each case."""
    head = json.dumps({key: value for key, value in content.items() if key != "verbs"})[1:-1]
    blocks = []
    for verb in content["verbs"]:
        cases = {kind: ",\n".join(json.dumps(case) for case in verb[kind]) for kind in ("weights", "adverbs")}
        start = json.dumps({key: verb[key] for key in ("file", "sha256")})[1:-1]
        blocks.append(f'{{{start},\n"weights": [\n{cases["weights"]}\n],\n"adverbs": [\n{cases["adverbs"]}\n]}}')
    return f'{{{head}, "verbs": [\n' + ",\n".join(blocks) + "\n]}\n"


if __name__ == "__main__":
    if "--refined" in sys.argv[1:]:
        _make_refined()
    PATH.write_text(_text(vectors()), encoding="utf-8")
