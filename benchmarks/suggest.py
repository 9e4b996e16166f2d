"""Whether the example that is suggested helps more than a random one.

    python -m benchmarks.suggest [--draws 100] [--share 0.4] [SET …]

A share of the clips is held out, at random. The held-out clip nearest to the first suggestion for the rest is added, a
random held-out clip instead, and the best one. What counts is the mean joint error of all clips of the set, each
predicted without itself: by leave-one-out where it is an example, directly where it is held out.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from verbs.authoring.fit import build
from verbs.conventions import F64, I64
from verbs.errors import VerbError
from verbs.kernels import measure as measures
from verbs.kernels import quat
from verbs.proposal.suggest import suggest
from verbs.quality.leave_one_out import subset
from verbs.runtime.evaluate import Evaluator
from verbs.verb import Verb

DATA = Path(os.environ.get("ADVERB_TEST_DATA", "../shared/data")) / "mocap"
SETS = ("reach", "punch", "kick", "jump", "locomotion")


def error_of(verb: Verb, members: I64, own: F64, phases: F64) -> float:
    """Mean joint error, degrees, of all clips, each predicted from the members without itself."""
    errors = []
    every = Evaluator(subset(verb, members))
    for i in range(len(verb.examples)):
        other = Evaluator(subset(verb, members[members != i])) if i in members else every
        weights = other.method("corrected")[1].weights(verb.values[i : i + 1].copy())
        blend = other.measure("corrected", weights, verb.values[i : i + 1], np.zeros(1, bool))
        shown = other.pose_of(blend, phase=phases, plant=False).rotations
        errors.append(np.linalg.norm(quat.log(quat.mul(quat.conjugate(own[i]), shown)), axis=-1).mean())
    return float(np.degrees(np.mean(errors)))


def spread(degrees: F64) -> str:
    """Mean, and 10th and 90th percentile."""
    low, high = np.percentile(degrees, [10, 90])
    return f"{degrees.mean():.3f}° ({low:.3f} to {high:.3f})"


def one(name: str, draws: int, share: float) -> None:
    """Print the figures of one set."""
    verb, rng = build(DATA / name).verb, np.random.default_rng(5)
    count = len(verb.examples)
    position = verb.measure.kind == measures.POSITION
    phases = verb.phases[[verb.measure.keytime]] if position else np.linspace(0.05, 0.95, 10)
    whole = Evaluator(verb)
    own = []
    for i in range(count):
        blend = whole.measure("example", np.eye(count)[i : i + 1], verb.values[i : i + 1], np.zeros(1, bool))
        own.append(whole.pose_of(blend, phase=phases, plant=False).rotations)
    rows = []
    while len(rows) < draws:
        order = rng.permutation(count)
        held, members = order[: int(share * count)], np.sort(order[int(share * count) :])
        try:
            base = subset(verb, members)
            before = error_of(verb, members, np.array(own), phases)
            points = base.domain.chart.points(verb.values[held])
            goal = base.domain.chart.points(suggest(base, 1)[0].adverbs[None])
            nearest = int(np.argmin(np.linalg.norm(points - goal, axis=1)))
            gains = [before - error_of(verb, np.sort(np.append(members, k)), np.array(own), phases)
                     for k in (held[nearest], rng.choice(held))]  # fmt: skip
        except VerbError:  # a draw whose rest does not determine a verb
            continue
        rows.append((before, *gains))
    before, chosen, random = np.array(rows).T
    paired = chosen - random
    middle = 1.96 * paired.std(ddof=1) / np.sqrt(len(paired))
    print(f"{name}: error {before.mean():.2f}°; lowered by the suggested clip {spread(chosen)}, by a random one "
          f"{spread(random)}; difference {paired.mean():+.3f} ± {middle:.3f}, better in "
          f"{100 * np.mean(paired > 0):.0f} %, equal in {100 * np.mean(paired == 0):.0f} %", flush=True)  # fmt: skip


def main() -> None:
    """Print the figures of the sets that are named, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", default=list(SETS))
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--share", type=float, default=0.4)
    arguments = parser.parse_args()
    for name in arguments.sets:
        one(name, arguments.draws, arguments.share)


if __name__ == "__main__":
    main()
