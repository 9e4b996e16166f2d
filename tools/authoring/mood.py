"""The verb ``mood``: a walk from tired to lively and from sad to happy.

Sources: A. Atkinson et al., "Emotion Perception from Dynamic and Static Body Expressions", 2004, and work on gait and
emotion: a sad walk is slow, with short steps, bowed trunk and head, and little movement of the arms; a happy one has
long steps, much movement of the arms, and bounces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tools.authoring import gait_table
from tools.authoring.gait import cycle
from tools.authoring.gait_model import KEYTIME_NAMES, Gait
from tools.authoring.source import Adverb, Example, Source
from tools.authoring.steps import Path

__all__ = ["FPS", "GRID", "manner", "source"]

FPS = 60.0
_DECIMALS = 5

_ENERGIES = {"tired": -1.0, "calm": 0.0, "lively": 1.0}
_MOODS = {"sad": -1.0, "even": 0.0, "happy": 1.0}

GRID = {f"{energy}_{mood}": (_ENERGIES[energy], _MOODS[mood]) for energy in _ENERGIES for mood in _MOODS}
"""Examples: energy and mood, each -1 to 1."""


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``mood``, or only some of its examples."""
    return Source(
        comment="A walk in nine moods, authored by tools.authoring (python -m tools.authoring mood).",
        keys={
            "name": "mood",
            "description": (
                "A walk from tired to lively and from sad to happy: pace, step, posture, head, arms and bounce "
                "change. A cycle has two strides, which differ a little. The figure walks along +Z."
            ),
            "looping": True,
            "root": "Hips",
            "measure": "none",
            "fps": FPS,
            "samples": 120,
            "keytime_names": KEYTIME_NAMES,
        },
        adverbs=(
            Adverb("energy", "none", "from -1, tired, to 1, lively", style=True),
            Adverb("mood", "none", "from -1, sad, to 1, happy", style=True),
        ),
        examples=_examples(names or tuple(GRID)),
        decimals=_DECIMALS,
    )


def manner(energy: float, mood: float) -> tuple[Gait, Path]:
    """Gait and path of a walk of some energy and mood, each -1 to 1."""
    speed = 1.12 + 0.34 * energy + 0.14 * mood
    gait = gait_table.walk(speed)
    sad, happy = max(-mood, 0.0), max(mood, 0.0)
    tired, lively = max(-energy, 0.0), max(energy, 0.0)
    low = 0.5 * sad + 0.5 * tired  # how far the body hangs
    gait = replace(
        gait,
        # Tired walks drag: slower steps, longer stances; lively ones are quick. Happy steps are long, sad ones short.
        stride_s=gait.stride_s * (1.0 + 0.10 * tired - 0.05 * lively - 0.05 * sad + 0.03 * happy),
        duty=gait.duty + 0.02 * tired + 0.012 * sad - 0.01 * lively,
        width=gait.width + 0.02 * tired - 0.015 * happy,
        turn_out=gait.turn_out + 3.0 * tired + 2.0 * happy,
        strike=gait.strike * (1.0 - 0.30 * tired - 0.2 * sad + 0.1 * happy),
        push=gait.push * (1.0 - 0.12 * tired - 0.08 * sad),
        trail=gait.trail * (1.0 - 0.12 * tired - 0.08 * sad),
        late=gait.late * (1.0 - 0.25 * tired - 0.15 * sad),
        early_lift=gait.early_lift * (1.0 - 0.10 * tired + 0.15 * happy * (1 + lively)),
        knee=gait.knee + 5.0 * tired + 2.5 * sad,
        rise=gait.rise * (1.0 - 0.35 * sad - 0.2 * tired + 0.35 * happy + 0.15 * lively),
        sway=gait.sway * (1.0 + 0.45 * tired + 0.1 * happy - 0.2 * sad),
        list=gait.list * (1.0 + 0.3 * happy - 0.3 * sad),
        yaw=gait.yaw * (1.0 + 0.25 * happy - 0.2 * sad),
        tilt=gait.tilt + 2.0 * low,
        lean=gait.lean + 13.0 * low + 4.0 * sad * tired - 4.0 * happy + 1.0 * lively,
        lift_chest=-9.0 * low + 3.0 * happy,
        chest_yaw=gait.chest_yaw * (1.0 - 0.5 * sad - 0.2 * tired + 0.5 * happy + 0.2 * lively),
        head=17.0 * sad + 9.0 * tired - 6.0 * happy,
        arm=gait.arm * (1.0 - 0.55 * sad - 0.3 * tired + 0.45 * happy + 0.25 * lively) + 2.0,
        arm_mean=gait.arm_mean + 3.0 * low,
        elbow=gait.elbow + 10.0 * lively + 4.0 * happy - 3.0 * tired,
        elbow_swing=gait.elbow_swing * (1.0 + 0.4 * happy + 0.3 * lively - 0.4 * sad),
        abduct=gait.abduct + 4.0 * low + 3.0 * happy,
        twist=gait.twist + 10.0 * sad,
        shrug=-3.0 * low + 2.0 * happy + 2.0 * sad * lively,
        curl=0.30 * lively + 0.08 * tired,
        wave=gait.wave * (1.0 + 0.5 * lively - 0.2 * tired),
    )  # fmt: skip
    return gait, Path(speed, 0.0, 0.0)


def _examples(names: Sequence[str]) -> Iterator[Example]:
    for name in names:
        values = GRID[name]
        gait, path = manner(*values)
        vary = float(np.interp(values[0], (-1, 1), (1.4, 0.9)))
        motion, keytimes, contacts = cycle(gait, path, FPS, seed=80 + tuple(GRID).index(name), vary=vary)
        yield Example(name, motion, keytimes, values, contacts)
