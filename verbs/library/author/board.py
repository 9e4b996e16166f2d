"""The verb ``board``: from standing, the right hand draws on a board before the body and comes back.

Source: Rose, Sloan, Cohen 2001, section 4.1: examples whose hand positions all lie on one plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from verbs.conventions import F64
from verbs.library.author import reach, solver
from verbs.library.author.figure import Figure
from verbs.library.author.source import Adverb, Example, Source

__all__ = ["AXES", "ORIGIN_M", "manner", "source", "targets"]

_DECIMALS = 5

# The wrist stays a hand's length before the board, on a sheet parallel to it that leans back at the top.
ORIGIN_M = (-0.12, 1.28, 0.43)
"""Middle of the sheet of wrist positions: breast-high, a little to the drawing hand's side."""
AXES = ((1.0, 0.0, 0.0), (0.0, 0.984, 0.178))
"""Unit vectors along u (to the writer's left) and v (up along the board, which leans back by 10 degrees)."""

_COLUMNS_M = {"left": 0.50, "half_left": 0.25, "middle": 0.0, "half_right": -0.25, "right": -0.50}
_ROWS_M = {"low": -0.40, "level": 0.0, "high": 0.40}
_FINGERS = np.array([-1.0, 0.0, 0.0])


def source(names: Sequence[str] | None = None) -> Source:
    """Give the verb source of ``board``, or only some of its examples."""
    places = targets()
    return Source(
        comment="Drawing on a board, authored by verbs.library.author (python -m verbs.library.author board).",
        keys={
            "name": "board",
            "description": (
                "From standing, the right hand goes to a place on a board before the body, as if to draw there, and "
                "returns; all places lie on one plane, which leans back by 10 degrees. Poses are solved and keyed by "
                "code, not captured. The figure faces +Z and stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "RightHand",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "fps": reach.FPS,
            "keytime_names": ["start", "draw", "end"],
            "goal": {"origin": list(ORIGIN_M), "axes": [list(axis) for axis in AXES]},
        },
        adverbs=tuple(
            Adverb(name, "m", f"how far {way} on the board the right wrist (RightHand) is while it draws (keytime 1)")
            for name, way in (("u", "to the writer's left of the middle"), ("v", "above the middle"))
        ),
        examples=(Example(name, *reach.motion(places[name], manner)) for name in names or places),
        decimals=_DECIMALS,
    )


def targets() -> dict[str, F64]:
    """Names and wrist targets (3,) of the 15 examples, metres: a grid without jitter."""
    across, up = np.array(AXES)
    return {
        f"{row}_{column}": np.array(ORIGIN_M) + u * across + v * up
        for row, v in _ROWS_M.items()
        for column, u in _COLUMNS_M.items()
    }


def manner(figure: Figure, goal: F64, target: F64, share: float) -> list[solver.Term]:
    """Soft terms of drawing: those of a reach, and fingers that point at the board and a little up."""
    hand = figure.skeleton.index("RightHand")
    into = np.cross(*AXES) + 0.35 * np.array(AXES[1])
    terms = reach.manner(figure, goal, target, share)
    return [*terms, solver.keep_direction(hand, _FINGERS, into / np.linalg.norm(into), 1.2 * share)]
