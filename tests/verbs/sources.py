"""Small verb sources for tests: a two-link arm in the plane, written as BVH."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from verbs.io import bvh
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

SKELETON = Skeleton(
    ("Upper", "Lower", "Hand"),
    np.array([-1, 0, 1]),
    np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.4, 0.0, 0.0]]),
)


def arm_motion(first: float, second: float, *, frames: int = 31, fps: float = 30.0, skeleton=SKELETON) -> Motion:
    """Rest, reach the angles in the middle frame, and back."""
    bell = np.sin(np.linspace(0, np.pi, frames)) ** 2
    vectors = np.zeros((frames, len(skeleton), 3))
    vectors[:, 0, 2], vectors[:, 1, 2] = first * bell, second * bell
    return Motion(skeleton, fps, np.zeros((frames, 3)), quat.exp(vectors))


def hand(first: float, second: float) -> tuple[float, float]:
    """Where the hand is at these angles."""
    x = 0.5 * np.cos(first) + 0.4 * np.cos(first + second)
    return float(x), float(0.5 * np.sin(first) + 0.4 * np.sin(first + second))


def write_source(folder: Path, motions: dict[str, Motion], rows: list[str], head: str = "") -> Path:
    """A source folder with the motions given and the text of its ``[[example]]`` tables."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, motion in motions.items():
        bvh.write(motion, folder / f"{name}.bvh", decimals=9)
    text = head or (
        'name = "arm"\neffector = "Hand"\neffector_keytime_index = 1\nmeasure = "joint_position"\n'
        'keytime_names = ["start", "reach", "end"]\n'
        '[[adverb]]\nname = "x"\nunit = "m"\n[[adverb]]\nname = "y"\nunit = "m"\n'
    )
    (folder / "verb.toml").write_text(text + "\n".join(rows))
    return folder


def jump_source(folder: Path) -> Path:
    """Jumps of the arm's root: distance in centimetres, direction in degrees, height in metres."""
    motions, rows, frames = {}, [], 31
    share = np.linspace(0.0, 1.0, frames)
    flight = 4.0 * share * (1.0 - share)
    for k, (distance, direction, height) in enumerate(
        [(30, 0, 0.2), (80, 0, 0.25), (60, 50, 0.2), (60, -50, 0.3), (55, 10, 0.5), (90, 25, 0.4)]
    ):
        turn = np.radians(direction)
        ahead = 0.01 * distance * share * share * (3.0 - 2.0 * share)
        root = np.stack([ahead * np.sin(turn), 1.0 + height * flight, ahead * np.cos(turn)], axis=-1)
        vectors = np.zeros((frames, 3, 3))
        vectors[:, 1, 2] = (0.2 + height) * flight
        motions[f"jump{k}"] = Motion(SKELETON, 30.0, root, quat.exp(vectors))
        rows.append(example_row(f"jump{k}", [0.0, 1.0], [distance, direction, height]))
    adverbs = "".join(
        f'[[adverb]]\nname = "{name}"\nunit = "{unit}"\n'
        for name, unit in (("distance", "cm"), ("direction", "deg"), ("height", "m"))
    )
    return write_source(
        folder, motions, rows, f'name = "jump"\nmeasure = "jump"\nkeytime_names = ["start", "end"]\n{adverbs}'
    )


def example_row(name: str, keytimes, values) -> str:
    """One ``[[example]]`` table."""
    return f'[[example]]\nfile = "{name}.bvh"\nkeytimes = {list(keytimes)}\nadverb_values = {list(values)}\n'


ANGLES = {"a": (0.2, 0.4), "b": (0.9, 0.5), "c": (0.3, 1.2), "d": (1.0, 1.3), "e": (0.6, 0.8)}


def arm_source(folder: Path, *, angles=None, lengths=None) -> Path:
    """Five reaches of the arm, of different length and rate."""
    angles = angles or ANGLES
    motions, rows = {}, []
    for k, (name, pair) in enumerate(angles.items()):
        frames, fps = (lengths or [(31, 30.0), (41, 30.0), (61, 60.0), (35, 25.0), (31, 30.0)])[k % 5]
        motions[name] = arm_motion(*pair, frames=frames, fps=fps)
        end = (frames - 1) / fps
        rows.append(example_row(name, [0.0, end / 2, end], hand(*pair)))
    return write_source(folder, motions, rows)
