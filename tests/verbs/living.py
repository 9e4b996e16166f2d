"""Helpers for tests of characters that live: play them, see where their joints are, and how hard these move."""

from __future__ import annotations

import numpy as np

from verbs.kernels import fk
from verbs.runtime.characters import Characters
from verbs.runtime.sequence import sequence
from verbs.verb import Verb

FPS = 60
STEP_S = 1 / FPS


def play(people: Characters, slots, frames: int, *, step_s: float = STEP_S):
    """Roots (F, B, 3) and rotations (F, B, J, 4) of the next frames, and the frames themselves."""
    slots = np.atleast_1d(slots)
    shown = [people.step(slots, step_s) for _ in range(frames)]
    return np.array([one.root for one in shown]), np.array([one.rotations for one in shown]), shown


def joints(verb: Verb, roots, rotations) -> np.ndarray:
    """Places (..., J, 3) of all joints on a verb's skeleton."""
    return fk.forward(roots, rotations, verb.skeleton.parents, verb.skeleton.offsets)[1]


def accelerations(places: np.ndarray) -> np.ndarray:
    """Accelerations (F - 2, ..., J), m/s², of places (F, ..., J, 3); row k is that of frame k + 1."""
    return np.linalg.norm(np.diff(places, 2, axis=0) * FPS**2, axis=-1)


def own_peak(people: Characters, row, skeleton: Verb) -> float:
    """Largest acceleration of any joint over a whole motion, on another verb's skeleton."""
    poses = sequence(people.evaluator, np.atleast_2d(row), FPS, cycles=2 if people.verb.looping else 1)
    return float(accelerations(joints(skeleton, poses.root, poses.rotations)).max())


def unsigned(rotations: np.ndarray) -> np.ndarray:
    """Rotations of which each has its largest number above 0: q and -q are one rotation."""
    largest = np.take_along_axis(rotations, np.abs(rotations).argmax(-1)[..., None], -1)
    return rotations * np.sign(largest)
