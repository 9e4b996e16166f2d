"""Whether support predicts how far a motion is from the captured one: ``python -m benchmarks.support FOLDER``.

FOLDER has one verb source per folder (``../shared/data/mocap``). Examples are left out, one at a time and 30 % at a
time, and predicted from the others by the verb's default method. Spearman's rank correlation between a predictor and
the difference of the whole motion counts: the mean angle between joints (rad), and the mean distance of joints from
those of the captured motion (m), roots on top of each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from verbs import Evaluator, Verb
from verbs.authoring.fit import build
from verbs.blend.cardinal import basis_weights
from verbs.conventions import F64, I64
from verbs.errors import VerbError
from verbs.kernels import quat
from verbs.quality.leave_one_out import subset
from verbs.runtime.evaluate import Blend
from verbs.runtime.support import Support

PHASES = np.linspace(0.05, 0.95, 10)
SHARE, ROUNDS, SEED = 0.3, 20, 0
MIRRORED = "reach_left"
"""The mirror image of another verb: it would count twice."""

PREDICTORS = (
    "distance to the nearest example",
    "Σ|w|",
    "power function",
    "power function × Σ|w|",
    "V × Σ|w|",
    "support: V",
)


def splits(count: int, *, several: bool) -> Iterator[I64]:
    """Indices of the examples that are left out together."""
    if not several:
        yield from np.arange(count)[:, None]
        return
    rng = np.random.default_rng(SEED)
    for _ in range(ROUNDS):
        yield rng.choice(count, max(1, round(SHARE * count)), replace=False)


def motion(evaluator: Evaluator, blend: Blend) -> tuple[F64, F64]:
    """Rotations, and joint positions relative to the root, at ten phases."""
    poses = evaluator.pose_of(blend, phase=PHASES)
    positions = evaluator.positions(poses)[1]
    return poses.rotations, positions - positions[:, :1]


def predictors(verb: Verb, evaluator: Evaluator, blend: Blend) -> list[float]:
    """Values of :data:`PREDICTORS`, larger where the motion is less certain, for a blend of one row."""
    assert blend.adverbs is not None
    arrays = Support.of_verb(verb).arrays
    nearest = np.linalg.norm(arrays.centers - verb.domain.chart.points(blend.adverbs), axis=1).min()
    basis = verb.bases["smooth"] if "smooth" in verb.bases else verb.bases["rbf"]
    cardinal = Support(arrays).of(blend.adverbs, basis_weights(basis, blend.adverbs))[0]
    power, total = np.sqrt(1.0 / cardinal - 1.0), np.abs(blend.weights).sum()
    variance = 1.0 / evaluator.support(blend)[0] - 1.0  # in units of the variance at support one half
    return [nearest, total, power, power * total, variance * total, variance]


def left_out(verb: Verb, *, several: bool) -> F64:
    """Rows of predictors, angle (rad) and distance (m), one for each example that was left out."""
    whole, count, rows = Evaluator(verb), len(verb.examples), []
    for held in splits(count, several=several):
        fewer = subset(verb, np.setdiff1d(np.arange(count), held))
        evaluator = Evaluator(fewer)
        for k in held:
            goal = verb.values[k : k + 1].copy()
            true = motion(whole, whole.measure("example", np.eye(count)[k : k + 1], goal, np.zeros(1, bool)))
            blend = evaluator.blend(goal)
            found = motion(evaluator, blend)
            angles = np.linalg.norm(quat.log(quat.mul(quat.conjugate(true[0]), found[0])), axis=-1)
            distance = np.linalg.norm(true[1] - found[1], axis=-1).mean()
            rows.append([*predictors(fewer, evaluator, blend), float(angles.mean()), float(distance)])
    return np.array(rows)


def main() -> None:
    """Print one table for each way of leaving out."""
    parser = argparse.ArgumentParser(description="Rank correlation of support with leave-one-out differences.")
    parser.add_argument("folder", type=Path, help="folder of verb sources")
    folder, verbs = parser.parse_args().folder, {}
    for name in (path.parent.name for path in sorted(folder.glob("*/verb.toml"))):
        if name == MIRRORED:
            continue
        try:
            verbs[name] = build(folder / name).verb
        except VerbError as err:
            print(f"{name}: {err}")
    for several in (False, True):
        tables = [left_out(verb, several=several) for verb in verbs.values()]
        print(
            f"\n{'30 % left out, 20 rounds' if several else 'one left out'}: rank correlation with the angle of joints"
        )
        print(f"{'':<34}{''.join(f'{name:>12}' for name in verbs)}{'mean':>8}{'distance, mean':>16}")
        for k, predictor in enumerate(PREDICTORS):
            angle = [spearmanr(table[:, k], table[:, -2]).statistic for table in tables]
            place = [spearmanr(table[:, k], table[:, -1]).statistic for table in tables]
            cells = "".join(f"{value:>12.2f}" for value in angle)
            print(f"{predictor:<34}{cells}{np.mean(angle):>8.2f}{np.mean(place):>16.2f}")


if __name__ == "__main__":
    main()
