"""The verb ``jog``: running at an easy or a brisk pace, straight and in curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from tools.authoring import gait_table
from tools.authoring.gait import cycle
from tools.authoring.gait_model import KEYTIME_NAMES
from tools.authoring.locomotion import ADVERBS, FPS
from tools.authoring.source import Example, Source
from tools.authoring.steps import Path

__all__ = ["PATHS", "source"]

_DECIMALS = 5

PATHS = {
    "easy": (2.1, 0.0, 0.0),
    "easy_left": (2.0, 1.5, 0.0),
    "easy_right": (2.0, -1.5, 0.0),
    "steady": (2.8, 0.0, 0.0),
    "steady_left": (2.7, 1.1, 0.0),
    "steady_right": (2.7, -1.1, 0.0),
    "brisk": (3.6, 0.0, 0.0),
    "brisk_left": (3.5, 0.8, 0.0),
    "brisk_right": (3.5, -0.8, 0.0),
    "drift_left": (2.6, 0.0, 0.45),
    "drift_right": (2.6, 0.0, -0.45),
}
"""Examples: forward speed (m/s), turn rate (rad/s) and sideways speed (m/s)."""


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``jog``, or only some of its examples."""
    return Source(
        comment="Jogging, authored by tools.authoring (python -m tools.authoring jog).",
        keys={
            "name": "jog",
            "description": (
                "Jogging at an easy to a brisk pace, straight, in curves and drifting to a side. The body leans into "
                "a curve and falls freely between two steps. The figure starts at the origin and faces +Z."
            ),
            "looping": True,
            "root": "Hips",
            "effector": "Hips",
            "effector_keytime_index": -1,
            "measure": "root_velocity",
            "fps": FPS,
            "keytime_names": KEYTIME_NAMES,
        },
        adverbs=ADVERBS,
        examples=_examples(names or tuple(PATHS)),
        decimals=_DECIMALS,
    )


def _examples(names: Sequence[str]) -> Iterator[Example]:
    for name in names:
        speeds = PATHS[name]
        gait = gait_table.run(*speeds[:2])
        if speeds[2]:
            gait = replace(gait, width=0.12)
        motion, keytimes, contacts = cycle(gait, Path(*speeds), FPS, seed=50 + tuple(PATHS).index(name))
        yield Example(name, motion, keytimes, speeds, contacts)
