"""Sources of a body that travels, turns and swings two arms in space, each example by other amounts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.verbs.sources import example_row, write_source
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

SIDES = ("Left", "Right")
KEYTIMES = ("start", "reach", "back", "end")
SHARES = (0.0, 0.35, 0.7, 1.0)
"""Where the keytimes are in each example, as shares of its duration, before a shift of the middle two."""


def skeleton() -> Skeleton:
    """Hips, a chest, and two arms of three joints."""
    names = ("Hips", "Chest", *(side + part for side in SIDES for part in ("Arm", "ForeArm", "Hand")))
    offsets = [[0, 0, 0], [0.0, 0.4, 0.02]]
    for sign in (1.0, -1.0):
        offsets += [[sign * 0.2, 0.1, 0.0], [sign * 0.28, 0.0, 0.03], [sign * 0.24, -0.05, 0.02]]
    return Skeleton(
        names, np.array([-1, 0, 1, 2, 3, 1, 5, 6]), np.array(offsets, float), np.array([4, 7], np.int64),
        np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]),
    )  # fmt: skip


def swing(amounts, duration_s: float, *, fps: float = 60.0, home: bool = True) -> Motion:
    """A motion of seven amounts between -1 and 1: travel forward and sideways, rise, turn, and the arms' swings.

    Where the body comes ``home``, pose and height are the same at both ends, as in a cycle.
    """
    body = skeleton()
    share = np.linspace(0.0, 1.0, round(duration_s * fps) + 1)
    bell, late = np.sin(np.pi * share) ** 2, np.sin(np.pi * share**1.3) ** 2
    ease = share * share * (3.0 - 2.0 * share)
    ahead, aside, rise, turn, left, right, bend = amounts
    root = np.stack([
        (0.15 + 0.1 * aside) * ease, 1.0 + (0.1 + 0.06 * rise) * bell + (0.0 if home else 0.05 * rise) * ease,
        (0.7 + 0.3 * ahead) * share,
    ], axis=-1)  # fmt: skip
    vectors = np.zeros((len(share), len(body), 3))
    vectors[:, 0, 1] = (0.3 + 0.25 * turn) * ease
    vectors[:, 1] = np.outer(bell, [0.1 + 0.1 * bend, 0.1 * left, 0.1 * right])
    for first, size, sign in ((2, left, 1.0), (5, right, -1.0)):
        vectors[:, first] = np.outer(bell, [0.2 * bend, sign * (-0.8 - 0.4 * size), 0.3 + 0.2 * size])
        vectors[:, first + 1] = np.outer(late, [0.1, sign * (-0.4 - 0.3 * bend), 0.2 * size])
        vectors[:, first + 2] = np.outer(late, [0.3 * size, 0.1, 0.2 + 0.1 * bend])
    return Motion(body, fps, root, quat.exp(vectors))


def swing_source(folder: Path, *, count: int = 10, looping: bool = False, seed: int = 3) -> Path:
    """A source with one style adverb, for :func:`tests.verbs.redeclared.redeclare`."""
    rng, motions, rows = np.random.default_rng(seed), {}, []
    for k in range(count):
        amounts, duration_s = rng.uniform(-1.0, 1.0, 7), float(rng.integers(48, 90)) / 60.0
        motion = swing(amounts, duration_s, home=looping)
        marks = np.array(SHARES)
        marks[1:3] += rng.uniform(-0.06, 0.06, 2)
        motions[f"swing{k}"] = motion
        rows.append(example_row(f"swing{k}", (marks * motion.duration_s).tolist(), [float(k)]))
    head = (
        f'name = "swing"\nlooping = {str(looping).lower()}\nkeytime_names = {list(KEYTIMES)}\ncontacts = false\n'
        '[[adverb]]\nname = "mood"\nstyle = true\n'
    ).replace("'", '"')
    return write_source(folder, motions, rows, head)
