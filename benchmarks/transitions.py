"""Ways from one verb to another, compared: ``python -m benchmarks.transitions FOLDER``.

FOLDER has verb sources of one skeleton's joints (``../shared/data/mocap``). From the middle of each verb to the start
and the middle of each other one, on the skeleton of the second: the largest acceleration of a joint around the switch,
divided by the larger of both motions' own, by

- inertialization over 0.3 s, as :mod:`verbs.kernels.inertialization` has it;
- dead blending over 0.3 s (D. Holden, "Dead Blending", 2023): the first motion is extrapolated with velocities that
  decay by half in 0.1 s, and cross-fades into the second;
- inertialization over the length that the distance of poses and velocities asks for (0.3 to 1 s).

Feet are not planted.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np

from verbs import Characters, Evaluator, Verb
from verbs.authoring.fit import build
from verbs.conventions import F64
from verbs.kernels import fk, quat
from verbs.runtime.sequence import sequence

FPS, LENGTH_S, HALF_LIFE_S = 60, 0.3, 0.1
STARTS, ENDS = (0.3, 0.5, 0.7), (0.0, 0.3, 0.5)
FRAMES = 66
MIRRORED = "reach_left"

Frames = tuple[F64, F64]
"""Root (F, 3) and local rotations (F, J, 4) of frames."""


def play(people: Characters, slot: int, frames: int) -> Frames:
    """Frames of one character."""
    shown = [people.step(np.array([slot]), 1 / FPS) for _ in range(frames)]
    return np.array([one.root[0] for one in shown]), np.array([one.rotations[0] for one in shown])


def dead_blending(before: Frames, after: Frames) -> Frames:
    """Cross-fade from the extrapolation of two frames into the motion that follows."""
    (root, rotations), (next_root, next_rotations) = before, after
    seconds = np.arange(1, len(next_root) + 1) / FPS
    decay = np.log(2.0) / HALF_LIFE_S
    gone = (1.0 - np.exp(-decay * seconds)) / decay
    velocity = (root[-1] - root[-2]) * FPS
    turn = quat.log(quat.mul(rotations[-1], quat.conjugate(quat.align(rotations[-2], rotations[-1])))) * FPS
    ahead = quat.mul(quat.exp(gone[:, None, None] * turn), rotations[-1])
    u = np.clip(seconds / LENGTH_S, 0.0, 1.0)
    share = u * u * (3.0 - 2.0 * u)
    way = quat.log(quat.mul(quat.align(next_rotations, ahead), quat.conjugate(ahead)))
    mixed = quat.mul(quat.exp(share[:, None, None] * way), ahead)
    place = root[-1] + gone[:, None] * velocity
    return place + share[:, None] * (next_root - place), mixed


def hardest(verb: Verb, *pieces: Frames) -> float:
    """Largest acceleration of a joint in frames one after the other, m/s²."""
    root, rotations = (np.concatenate(part) for part in zip(*pieces, strict=True))
    positions = fk.forward(root, rotations, verb.skeleton.parents, verb.skeleton.offsets)[1]
    return float(np.linalg.norm(np.diff(positions, 2, axis=0) * FPS**2, axis=-1).max())


def own(people: Characters, row: F64, verb: Verb) -> float:
    """Largest acceleration of a joint in a whole motion, on another verb's skeleton."""
    cycles = 2 if people.verb.looping else 1
    found = sequence(people.evaluator, row[None], FPS, cycles=cycles, plant=False)
    return hardest(verb, (found.root, found.rotations))


def ratios(one: Characters, other: Characters) -> F64:
    """Ratios (n, 3) of the three ways from one verb to another."""
    found = []
    ends: tuple[float | None, ...] = (None,) if other.verb.looping else ENDS
    for which, start, end in itertools.product((0, len(one.verb.values) // 2), STARTS, ends):
        row, goal = one.verb.values[which], other.verb.values[min(which, len(other.verb.values) - 1)]
        slot = one.add(row, phase=start, plant=False)
        before = play(one, slot, 4)
        ways = []
        for length_s in (LENGTH_S, 0.0, None):
            new = other.go_on(one, slot, goal, phase=end, transition_s=length_s)
            ways.append(play(other, new, FRAMES))
            other.remove(new)
        ways[1] = dead_blending(before, ways[1])
        one.remove(slot)
        peak = max(own(one, row, other.verb), own(other, goal, other.verb))
        found.append([hardest(other.verb, before, way) / peak for way in ways])
    return np.array(found)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of verb sources")
    sources = [path.parent for path in sorted(parser.parse_args().folder.glob("*/verb.toml"))]
    cast = {path.name: Characters(Evaluator(build(path).verb)) for path in sources if path.name != MIRRORED}
    print("| from → to | inertialization, 0.3 s | dead blending, 0.3 s | inertialization, chosen length |")
    print("| --- | --- | --- | --- |")
    every = []
    for first, second in itertools.permutations(cast, 2):
        got = ratios(cast[first], cast[second])
        every.append(got)
        cells = " | ".join(
            f"{median:.2f} / {worst:.2f}" for median, worst in zip(np.median(got, 0), got.max(0), strict=True)
        )
        print(f"| {first} → {second} | {cells} |", flush=True)
    got = np.concatenate(every)
    over = " | ".join(
        f"{m:.2f} / {w:.2f}, {100 * s:.0f} % over 1.2"
        for m, w, s in zip(np.median(got, 0), got.max(0), (got > 1.2).mean(0), strict=True)
    )
    print(f"| all | {over} |")


if __name__ == "__main__":
    main()
