"""Feet before and after planting: ``python -m benchmarks.planting [FOLDER …]``.

Prints a table of the built-in verbs, and of the verb sources in FOLDER (``../shared/data/mocap``): slide of each stance
of heel, ball and tip, penetration, rms acceleration of the legs' joints, largest angular acceleration of a knee, and
the error of the effector, of whole motions at 60 Hz to random goals. ``main`` compares the cost of poses with and
without planting.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.timing import interleave
from verbs import Characters, Evaluator, Verb, library
from verbs.authoring.fit import build
from verbs.conventions import F64
from verbs.domain import random_points
from verbs.kernels import measure as measures
from verbs.quality import foot_contact
from verbs.runtime.evaluate import Blend
from verbs.runtime.whole_motion import RATE_HZ, examples, one_of, sampled

GOALS, SEED = 500, 3


@dataclass(frozen=True)
class Gait:
    """How legs move in a set of motions.

    Parameters
    ----------
    legs_m_s2 : float
        Root of the mean squared acceleration of the legs' joints.
    knee_rad_s2 : float
        Largest angular acceleration of a knee.
    """

    legs_m_s2: float
    knee_rad_s2: float

    @classmethod
    def of(cls, evaluator: Evaluator, blends: list[Blend], *, plant: bool) -> Gait:
        """Sample the motions of blends."""
        chains = evaluator.planting().legs.chains
        squares, knees = [], [0.0]
        for blend in blends:
            positions = sampled(evaluator, blend, plant=plant)[1]
            legs = np.diff(positions[:, np.unique(chains[:, -4:-1])], 2, axis=0) * RATE_HZ**2
            squares.append(float((legs**2).sum(axis=-1).mean()))
            knees += [np.abs(np.diff(_bend(positions, chain), 2) * RATE_HZ**2).max() for chain in chains]
        return cls(float(np.sqrt(np.mean(squares))), float(np.max(knees)))


def _bend(positions: F64, chain: F64) -> F64:
    """Angle (F,) of a knee, rad."""
    hip, knee, ankle = chain[-4:-1].astype(int)
    upper, lower = positions[:, hip] - positions[:, knee], positions[:, ankle] - positions[:, knee]
    cosine = (upper * lower).sum(axis=-1) / np.linalg.norm(upper, axis=-1) / np.linalg.norm(lower, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def error_m(evaluator: Evaluator, goals: F64) -> float:
    """Largest distance (m) of the planted effector from its goal; NaN where the measure is no position."""
    verb = evaluator.verb
    if verb.measure.kind != measures.POSITION:
        return float("nan")
    found = evaluator.pose(goals, phase=np.full(len(goals), verb.phases[verb.measure.keytime]))
    reached = evaluator.positions(found)[1][:, verb.measure.effector]
    return float(np.linalg.norm(reached - evaluator.goal.points(goals), axis=1).max())


def report(verb: Verb) -> list[str]:
    """Rows of one verb: as blended, and planted."""
    evaluator = Evaluator(verb)
    if not len(evaluator.planting().joints):
        return []
    goals = random_points(verb, np.random.default_rng(SEED), GOALS)
    blends = evaluator.blend(goals)
    motions = [one_of(blends, k) for k in range(GOALS)]
    hardest = Gait.of(evaluator, examples(evaluator), plant=False).knee_rad_s2
    contacts = foot_contact.contacts(evaluator)
    assert contacts is not None  # it has feet
    rows = []
    for plant in (False, True):
        slides = foot_contact.slides(evaluator, contacts, goals, plant=plant)
        gait = Gait.of(evaluator, motions, plant=plant)
        error = f"{error_m(evaluator, goals):.0e}" if plant else ""
        rows.append(
            f"| {'' if plant else verb.name} | {'planted' if plant else 'blended'} | {1e3 * slides.median_m:.1f} / "
            f"{1e3 * slides.p90_m:.1f} / {1e3 * slides.max_m:.0f} | {1e3 * slides.penetration_m:.0f} | "
            f"{gait.legs_m_s2:.1f} | {gait.knee_rad_s2:.0f} ({hardest:.0f}) | {error.replace('nan', '–')} |"
        )
    return rows


def tables(folders: list[Path]) -> None:
    """Print the table of all verbs."""
    print(
        "| verb | | slide p50 / p90 / max, mm | penetration, mm | legs rms, m/s² | knee (examples), rad/s² | error, m |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in library.names():
        for row in report(library.load(name)):
            print(row, flush=True)
    for folder in folders:
        for source in sorted(folder.glob("*/verb.toml")):
            verb = build(source.parent).verb
            for row in report(verb):
                print(row.replace(f"| {verb.name} |", f"| {verb.name} (captured) |"), flush=True)


def main() -> None:
    """Print what planting costs."""
    verb = library.load("reach")
    evaluator, rng = Evaluator(verb), np.random.default_rng(0)
    goals, phases = random_points(verb, rng, 1_000), rng.uniform(size=1_000)
    one, feet = goals[:1].copy(), len(evaluator.planting().joints)
    crowds = {}
    for plant in (True, False):
        people = Characters(evaluator)
        slots = np.array(
            [
                people.add(goal, phase=float(phase), looping=True, plant=plant)
                for goal, phase in zip(goals, phases, strict=True)
            ]
        )
        crowds[plant] = people, slots
    best = interleave(
        {
            ("pose, 100 single", True, 100): lambda: [evaluator.pose(one, phase=0.4) for _ in range(100)],
            ("pose, 100 single", False, 100): lambda: [evaluator.pose(one, phase=0.4, plant=False) for _ in range(100)],
            ("poses, batch of 1,000", True, 1_000): lambda: evaluator.pose(goals, phase=phases),
            ("poses, batch of 1,000", False, 1_000): lambda: evaluator.pose(goals, phase=phases, plant=False),
            ("step of 1,000 characters", True, 1_000): lambda: crowds[True][0].step(crowds[True][1], 1 / 60),
            ("step of 1,000 characters", False, 1_000): lambda: crowds[False][0].step(crowds[False][1], 1 / 60),
        }
    )
    print(f"planted feet, reach: {feet} feet")
    for name in dict.fromkeys(key[0] for key in best):
        (on, count), (off, _) = (
            next((best[key], key[2]) for key in best if key[:2] == (name, plant)) for plant in (True, False)
        )
        each = 1e6 * (on - off) / count / feet
        print(f"  {name:<28}{1e6 * on / count:>8.2f} µs each, {on / off:.2f} × without; {each:.2f} µs a leg")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, help="folders of verb sources")
    tables(parser.parse_args().folders)
