"""The verb ``locomotion``: standing, walking, running, turning and side-stepping, steered by three speeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tools.authoring import gait_table
from tools.authoring.gait import cycle
from tools.authoring.gait_model import KEYTIME_NAMES, Gait
from tools.authoring.source import Adverb, Example, Source
from tools.authoring.standing import idle
from tools.authoring.steps import Path

__all__ = ["ADVERBS", "FPS", "PATHS", "gait_of", "source"]

FPS, IDLE_FPS = 60.0, 30.0
_DECIMALS = 5
_RUN_FROM = 2.0
"""Speed, m/s, at which a walk becomes a run."""

_MOST_TURN_RAD = 1.75
"""Most that a body turns in a stride of a walk."""

PATHS = {
    "idle": (0.0, 0.0, 0.0),
    "walk_very_slow": (0.45, 0.0, 0.0),
    "walk_slow": (0.9, 0.0, 0.0),
    "walk": (1.35, 0.0, 0.0),
    "walk_fast": (1.85, 0.0, 0.0),
    "jog": (2.2, 0.0, 0.0),
    "run": (3.2, 0.0, 0.0),
    "run_fast": (4.0, 0.0, 0.0),
    "walk_back": (-0.7, 0.0, 0.0),
    "walk_arc_left": (1.1, 0.8, 0.0),
    "walk_arc_right": (1.1, -0.8, 0.0),
    "walk_turn_left": (0.6, 1.6, 0.0),
    "walk_turn_right": (0.6, -1.6, 0.0),
    "turn_left": (0.0, 1.5, 0.0),
    "turn_right": (0.0, -1.5, 0.0),
    "run_arc_left": (2.5, 1.3, 0.0),
    "run_arc_right": (2.5, -1.3, 0.0),
    "step_left": (0.0, 0.0, 0.5),
    "step_right": (0.0, 0.0, -0.5),
    "shuffle_left": (0.0, 0.0, 1.0),
    "shuffle_right": (0.0, 0.0, -1.0),
    "walk_veer_left": (1.0, 0.0, 0.4),
    "walk_veer_right": (1.0, 0.0, -0.4),
}
"""Examples: forward speed (m/s), turn rate (rad/s) and sideways speed (m/s)."""

ADVERBS = (
    Adverb("forward_speed", "m/s", "mean speed of the root along the direction that the body faces"),
    Adverb("turn_rate", "rad/s", "mean turning rate about +Y; positive turns left"),
    Adverb("sideways_speed", "m/s", "mean speed of the root across that direction; positive is to the left"),
)


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``locomotion``, or only some of its examples."""
    return Source(
        comment="Standing, walking and running, authored by tools.authoring (python -m tools.authoring locomotion).",
        keys={
            "name": "locomotion",
            "description": (
                "Standing, walking, running, turning and side-stepping. A cycle has two strides, which differ a "
                "little. Gaits are fitted to published joint curves and solved so that standing feet stay where they "
                "are; nothing is captured. The figure starts at the origin, faces +Z and moves on y = 0."
            ),
            "looping": True,
            "root": "Hips",
            "effector": "Hips",
            "effector_keytime_index": -1,
            "measure": "root_velocity",
            "fps": FPS,
            "samples": 160,
            "keytime_names": KEYTIME_NAMES,
        },
        adverbs=ADVERBS,
        examples=_examples(names or tuple(PATHS)),
        decimals=_DECIMALS,
    )


def gait_of(path: Path) -> Gait:
    """The manner in which a body moves along a path."""
    speed = abs(path.forward)
    if speed >= _RUN_FROM:
        return gait_table.run(speed, path.turn)
    gait = gait_table.walk(max(speed, 0.5 if not path.side else 0.6))
    roll = min(1.0, speed / 0.5)  # a foot that goes nowhere hardly rolls
    if roll < 1.0:
        gait = _shuffle(gait, roll)
        gait = replace(gait, stride_s=1.22 if path.turn else gait.stride_s, width=0.20 - 0.10 * roll)
    if path.turn:  # steps so quick that no leg twists far
        stride_s = min(gait.stride_s, _MOST_TURN_RAD / abs(path.turn))
        gait = replace(gait, width=gait.width + 0.05 * min(1.0, abs(path.turn)), stride_s=stride_s)
    if path.side:
        quick = abs(path.side)
        stride_s = float(np.interp(quick, (0.4, 0.5, 1.0), (1.06, 1.16, 0.72)))
        wide = 0.12 + 0.5 * quick * stride_s if not speed else 0.10 + 0.30 * quick
        gait = replace(gait, stride_s=stride_s, width=wide, knee=max(gait.knee, 5.0 + 9.0 * quick * (not speed)))
        gait = replace(gait, sway=0.4 * gait.sway, list=2.0) if not speed else gait
    if path.forward < 0.0:
        gait = replace(gait, wave=0.0, arm=0.6 * gait.arm, lean=1.0)
    return gait


def _shuffle(gait: Gait, roll: float) -> Gait:
    """A walk that hardly advances: the feet roll less, and are lifted straight."""
    names = ("ahead", "strike", "push", "trail", "fold", "late", "early_ahead", "late_ahead", "surge", "arm", "yaw")
    scaled = {name: getattr(gait, name) * (0.35 + 0.65 * roll) for name in names}
    return replace(gait, **scaled, early_lift=0.045 + 0.5 * roll * gait.early_lift, late_lift=0.0)


def _examples(names: Sequence[str]) -> Iterator[Example]:
    for name in names:
        speeds = PATHS[name]
        if name == "idle":
            motion, keytimes, contacts = idle(IDLE_FPS)
        else:
            path = Path(*speeds)
            seed = 10 + tuple(PATHS).index(name)
            motion, keytimes, contacts = cycle(gait_of(path), path, FPS, seed=seed, backward=path.forward < 0.0)
        yield Example(name, motion, keytimes, speeds, contacts)
