"""The verb ``board``: from standing, the right hand draws on a board before the body and comes back.

Source: Rose, Sloan, Cohen 2001, section 4.1: examples whose hand positions all lie on one plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tools.authoring import reach, solver
from tools.authoring.figure import Figure
from tools.authoring.humanoid import BALANCE_POINT, humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64
from verbs.kernels import quat

__all__ = ["AXES", "ORIGIN_M", "arc", "manner", "source", "targets"]

_DECIMALS = 5

# The wrist stays a hand's length before the board, on a sheet parallel to it that leans back at the top.
ORIGIN_M = (-0.12, 1.33, 0.42)
"""Middle of the sheet of wrist positions: breast-high, a little to the drawing hand's side."""
AXES = ((1.0, 0.0, 0.0), (0.0, 0.984, 0.178))
"""Unit vectors along u (to the writer's left) and v (up along the board, which leans back by 10 degrees)."""

_COLUMNS_M = {"left": 0.50, "half_left": 0.25, "middle": 0.0, "half_right": -0.25, "right": -0.50}
_ROWS_M = {"low": -0.38, "level": 0.0, "high": 0.38}
_DETOUR_M = (0.0, 0.06, -0.04)  # the hand rises near the body, not through the board
_FADE = 0.5  # how the detour grows from none at the right edge to all at the left
_STOOP_M = 1.05  # below this the knees soften
_FINGERS = np.array([-1.0, 0.0, 0.0])


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``board``, or only some of its examples."""
    positions = targets()
    return Source(
        comment="Drawing on a board, authored by tools.authoring (python -m tools.authoring board).",
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
        examples=(
            Example(name, *reach.motion(at, manner, arc(humanoid(), at), "pinch"))
            for name, at in ((name, positions[name]) for name in names or positions)
        ),
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
    """Soft terms of drawing: upright, knees a little soft below, eyes on the hand, fingers on the board."""
    hand, head, left = (figure.skeleton.index(name) for name in ("RightHand", "Head", "LeftArm"))
    into = np.cross(*AXES) + 0.25 * np.array(AXES[1])
    hang = quat.rotate(figure.forward(figure.rest)[0][left], -_FINGERS)
    stoop = 0.12 * np.logaddexp(0.0, (_STOOP_M - goal[1]) / 0.12)
    return [
        solver.posture(figure),
        solver.limits(figure),
        solver.balance(figure, BALANCE_POINT, 16.0),
        solver.height(0, figure.rest.root[1] - 0.25 * stoop, 14.0),
        solver.aim(head, np.array([0.0, 0.0, 1.0]), target, 1.1 * share),
        solver.keep_direction(left, -_FINGERS, hang, 1.2),
        solver.keep_direction(hand, _FINGERS, into / np.linalg.norm(into), 1.8 * share),
    ]


def arc(figure: Figure, target: F64) -> F64:
    """Extra rotation vectors (J, 3) half-way to a target (3,), which lead the arm past a point near the body.

    They shrink toward the right edge, where a straight swing does not touch the board.
    """
    arm = figure.joints("RightShoulder", "RightArm", "RightForeArm", "RightHand")
    hanging = figure.forward(figure.rest)[1][arm[-1]]
    by = reach.apex(figure, 0.5 * (hanging + target) + _DETOUR_M, manner)
    extra = np.zeros((len(figure.skeleton), 3))
    extra[arm] = (solver.vectors(figure, by) - 0.5 * solver.vectors(figure, reach.apex(figure, target, manner)))[arm]
    share = (target[0] - ORIGIN_M[0] - min(_COLUMNS_M.values())) / float(np.ptp(list(_COLUMNS_M.values())))
    return np.asarray(extra * max(0.0, share) ** _FADE)
