"""Random switches with planted feet: ``python -m benchmarks.switches VERB …``.

A VERB is a built-in name or the folder of a verb source. For each ordered pair with one skeleton: 40 switches from a
random goal and phase to a random goal, with the default transition. Prints the largest acceleration of a joint around
the switch, divided by that of the examples of both verbs; and the slide of every point of a foot that stands after it,
from the mean of its stance.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np

from verbs import Characters, Evaluator, Verb, library
from verbs.authoring.fit import build
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.kernels import fk, quat
from verbs.kernels.foot_state import STANCE
from verbs.kernels.legs import COMMAND
from verbs.runtime.whole_motion import examples, sampled
from verbs.skeleton import Skeleton

FPS, SWITCHES, SEED = 60, 40, 1
BEFORE, AFTER = (6, 40), 70
"""Frames that are played before a switch, at random, and after it."""

AROUND = 40
"""Frames after a switch that count."""

PULLS = [COMMAND.index(name) for name in ("heel_pull", "ball_pull", "tip_pull")]
"""Columns of the share that each point has in the place of its foot."""


class Recording:
    """Frames of one character on a skeleton: joint positions, foot points and which of these stand."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.joints: list[F64] = []
        self.points: list[F64] = []
        self.stands: list[F64] = []

    def play(self, people: Characters, slot: int, frames: int) -> None:
        """Append frames."""
        legs, skeleton = people.evaluator.planting().legs, self.skeleton
        ankles, toes = legs.chains[:, -2], np.where(legs.chains[:, -1] >= 0, legs.chains[:, -1], legs.chains[:, -2])
        of = np.stack([ankles, ankles, toes], axis=1)
        for _ in range(frames):
            shown = people.step(np.array([slot]), 1 / FPS)
            turned, joints = fk.forward(shown.root, shown.rotations, skeleton.parents, skeleton.offsets)
            self.joints.append(joints[0])
            self.points.append(joints[0, of] + quat.rotate(turned[0, of], legs.points))
            modes = people.crowd.feet[slot]["mode"][:, None]
            self.stands.append((modes == STANCE) & (people.crowd.commands[slot, 0][:, PULLS] > 0.97))

    def peak(self, first: int, end: int) -> float:
        """Largest acceleration of a joint, m/s²."""
        return float(np.linalg.norm(np.diff(self.joints[first:end], 2, axis=0), axis=-1).max() * FPS**2)

    def slides(self, first: int, end: int) -> list[float]:
        """Slide of every stance of a point that overlaps frames, m, from the first of them on.

        Earlier frames are of another verb, whose bones may have other lengths than this skeleton.
        """
        points, stands, found = np.array(self.points)[..., [0, 2]], np.array(self.stands), []
        for f, p in np.ndindex(stands.shape[1:]):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], stands[:, f, p].astype(int), [0]])))
            for begin, stop in edges.reshape(-1, 2):
                if begin < end and stop > first:
                    way = points[max(begin, first) : stop, f, p]
                    found.append(float(np.linalg.norm(way - way.mean(axis=0), axis=1).max()))
        return found


def own_peak(evaluator: Evaluator) -> float:
    """Largest acceleration of a joint in the examples, m/s²."""
    motions = [sampled(evaluator, one)[1] for one in examples(evaluator)]
    return max(float(np.linalg.norm(np.diff(one, 2, axis=0), axis=-1).max() * FPS**2) for one in motions)


def switches(one: Characters, other: Characters, rng: np.random.Generator) -> tuple[F64, list[float]]:
    """Peaks (n,) m/s² and slides, m, of random switches from one verb to another."""
    peaks: list[float] = []
    slides: list[float] = []
    for _ in range(SWITCHES):
        row, goal = (random_points(people.verb, rng, 1)[0] for people in (one, other))
        before, recording = int(rng.integers(*BEFORE)), Recording(other.verb.skeleton)
        slot = one.add(row, phase=float(rng.random()), looping=True)
        recording.play(one, slot, before)
        new = other.go_on(one, slot, goal)
        one.remove(slot)
        recording.play(other, new, AFTER)
        other.remove(new)
        peaks.append(recording.peak(before - 3, before + AROUND))
        slides += recording.slides(before, before + AROUND)
    return np.array(peaks), slides


def loaded(name: str) -> Verb:
    """A built-in verb, or one that is built from its source."""
    return library.load(name) if name in library.names() else build(Path(name)).verb


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verbs", nargs="+", metavar="VERB", help="built-in name or folder of a source")
    verbs = {Path(name).name: loaded(name) for name in parser.parse_args().verbs}
    cast = {name: Characters(Evaluator(verb)) for name, verb in verbs.items()}
    own = {name: own_peak(people.evaluator) for name, people in cast.items()}
    rng, over, pairs = np.random.default_rng(SEED), 0, 0
    print("| from → to | peak ÷ the verbs' own, median / largest | slide p50 / p90 / max, mm |")
    print("| --- | --- | --- |")
    for first, second in itertools.permutations(cast, 2):
        if verbs[first].skeleton.names != verbs[second].skeleton.names:
            continue
        peaks, slides = switches(cast[first], cast[second], rng)
        ratio = peaks / max(own[first], own[second])
        pairs, over = pairs + 1, over + int(ratio.max() > 1.2)
        slide = (
            " / ".join(f"{1e3 * value:.1f}" for value in np.percentile(slides, [50, 90, 100])) if len(slides) else "–"
        )
        print(f"| {first} → {second} | {np.median(ratio):.2f} / {ratio.max():.2f} | {slide} |", flush=True)
    print(f"{over} of {pairs} pairs have a switch over 1.2")


if __name__ == "__main__":
    main()
