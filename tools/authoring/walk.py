"""The verb ``walk``: a walker that is not human goes up and down slopes, whole or damaged.

Source: Rose, Sloan, Cohen 2001, section 5.2 and figure 17: the slope that is walked on and the damage of the walker.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tools.authoring.gait_model import KEYTIME_NAMES
from tools.authoring.source import Adverb, Example, Source
from tools.authoring.walker import Stalk, cycle

__all__ = ["FPS", "GRID", "manner", "source"]

FPS = 30.0
_DECIMALS = 5

_SLOPES_DEG = {"down": -22.0, "level": 0.0, "up": 22.0}
_DAMAGES = {"whole": 0.0, "hit": 0.5, "broken": 1.0}
GRID = {
    **{f"{slope}_{state}": (_SLOPES_DEG[slope], _DAMAGES[state]) for slope in _SLOPES_DEG for state in _DAMAGES},
    "gently_down_whole": (-11.0, 0.0),
    "gently_up_whole": (11.0, 0.0),
}
"""Examples: slope, degrees, and damage, 0 to 1."""


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``walk``, or only some of its examples."""
    return Source(
        comment="A walker on slopes, authored by tools.authoring (python -m tools.authoring walk).",
        keys={
            "name": "walk",
            "description": (
                "A walker on two legs that stand on their toes goes up and down slopes; damage makes it limp on its "
                "right leg, slower and unsteady. A cycle rises or falls with the ground, which is a plane under the "
                "path. The walker starts over the origin and faces +Z."
            ),
            "looping": True,
            "climbing": True,
            "root": "Hull",
            "measure": "none",
            "fps": FPS,
            "samples": 120,
            "keytime_names": KEYTIME_NAMES,
        },
        adverbs=(
            Adverb("slope", "deg", "rise of the ground ahead", style=True),
            Adverb("damage", "none", "from 0, whole, to 1, broken", style=True),
        ),
        examples=_examples(names or tuple(GRID)),
        decimals=_DECIMALS,
    )


def manner(slope: float, damage: float) -> tuple[Stalk, float]:
    """Manner and speed, m/s, of a walk on a slope, degrees, with damage from 0 to 1."""
    steep = slope / 15.0
    up, down = max(steep, 0.0), max(-steep, 0.0)
    speed = (1.35 - 0.28 * up - 0.18 * down) * (1.0 - 0.38 * damage)
    stalk = Stalk(
        stride_s=(1.40 + 0.10 * up - 0.08 * down) * (1.0 + 0.14 * damage),
        duty=(0.62 + 0.02 * up + 0.07 * damage, 0.62 + 0.02 * up - 0.05 * damage),
        right_at=0.5 - 0.05 * damage,
        slope=slope,
        width=0.40 + 0.06 * damage + 0.04 * down,
        ahead=0.02 + 0.03 * up - 0.02 * down,
        lift=(0.26 + 0.05 * up, (0.26 + 0.05 * up) * (1.0 - 0.40 * damage)),
        drag=(38.0, 38.0 - 18.0 * damage),
        push=(40.0 + 6.0 * up - 8.0 * down, (40.0 + 6.0 * up - 8.0 * down) * (1.0 - 0.45 * damage)),
        crouch=(50.0 + 6.0 * up + 8.0 * down, (50.0 + 6.0 * up + 8.0 * down) - 14.0 * damage),
        rise=0.035,
        sway=0.07 + 0.03 * damage,
        roll=2.5,
        list=3.0 * damage,
        pitch=4.0 + 8.0 * up - 3.0 * down + 5.0 * damage,
        yaw=4.0,
        limp=9.0 * damage,
        droop=2.0 + 12.0 * damage,
        hang=24.0 * damage,
        wave=0.8 + 0.5 * down + 0.5 * damage,
        shudder=0.5 * damage,
    )
    return stalk, speed


def _examples(names: Sequence[str]) -> Iterator[Example]:
    for name in names:
        slope, damage = GRID[name]
        stalk, speed = manner(slope, damage)
        motion, keytimes, contacts = cycle(stalk, speed, FPS, seed=120 + tuple(GRID).index(name))
        yield Example(name, motion, keytimes, (slope, damage), contacts)
