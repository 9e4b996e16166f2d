"""The verb ``reach``: from standing, the right hand goes to a point around the body and comes back."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tools.authoring import hands, legs, solver, timing
from tools.authoring.figure import Figure
from tools.authoring.humanoid import BALANCE_POINT, humanoid
from tools.authoring.source import Adverb, Example, Source
from verbs.conventions import F64, Floats
from verbs.kernels import quat
from verbs.motion import Motion

__all__ = ["FPS", "Manner", "apex", "manner", "motion", "source", "targets"]

Manner = Callable[[Figure, F64, F64, float], list[solver.Term]]
"""Soft terms of a reach from the figure, the goal (3,) of this solve, the target (3,) and the share of the way."""

FPS = 30.0
_DECIMALS = 5  # metres and degrees: feet stay in place to a hundredth of a millimetre, 24 files stay near 1 MB

# Where the wrist goes, about the right shoulder at rest: height above the ground, direction seen from above (0 is
# forward, positive to the left, across the body), horizontal distance (near, far).
_HEIGHTS_M = {"low": 0.58, "middle": 1.14, "high": 1.70}
_DIRECTIONS_RAD = {"across": 0.68, "forward": 0.15, "outward": -0.50, "side": -1.10}
_DISTANCES_M = {"low": (0.42, 0.61), "middle": (0.40, 0.66), "high": (0.38, 0.60)}
_JITTER = (0.025, 0.06, 0.02)  # of height (m), direction (rad), distance (m)
_SEED = 24

_LEFT, _FORWARD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_TABLE_M = 1.05  # hands that go below this make the knees bend
_STEPS = 6  # the target moves from the hanging hand to its position in this many solves, so all take one branch

# When each group moves, as shares of the way out and of the way back. The head moves first and the arm arrives last;
# on the way back the arm leaves first and the head last.
_WINDOWS = {
    "head": ((0.00, 0.78), (0.10, 1.00)),
    "trunk": ((0.02, 0.94), (0.04, 0.97)),
    "arm": ((0.05, 0.97), (0.03, 0.94)),
    "hand": ((0.12, 1.00), (0.00, 0.88)),
    "other": ((0.06, 0.94), (0.06, 1.00)),
}
_GROUPS = {
    "head": ("Neck", "Head"),
    "arm": ("RightShoulder", "RightArm", "RightForeArm"),
    "hand": ("RightHand",),
    "other": ("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"),
}


def source(names: Sequence[str] | None = None) -> Source:
    """Return the verb source of ``reach``, or only some of its examples."""
    positions = targets()
    return Source(
        comment="A whole-body reach, authored by tools.authoring (python -m tools.authoring reach).",
        keys={
            "name": "reach",
            "description": (
                "From standing, the right hand reaches for a point before, beside, above or below the body and "
                "returns; the eyes lead, the trunk and the knees help, the feet stay where they are. Poses are solved "
                "and keyed by code, not captured. The figure faces +Z and stands on y = 0."
            ),
            "looping": False,
            "root": "Hips",
            "effector": "RightHand",
            "effector_keytime_index": 1,
            "measure": "joint_position",
            "fps": FPS,
            "keytime_names": ["start", "apex", "end"],
        },
        adverbs=tuple(
            Adverb(axis, "m", f"{way} coordinate of the right wrist (RightHand) at the apex of the reach (keytime 1)")
            for axis, way in (("x", "+X (left)"), ("y", "+Y (height above ground)"), ("z", "+Z (forward)"))
        ),
        examples=(Example(name, *motion(positions[name])) for name in names or positions),
        decimals=_DECIMALS,
    )


def targets() -> dict[str, F64]:
    """Names and wrist targets (3,) of the 24 examples, metres, always the same."""
    rng = np.random.default_rng(_SEED)
    figure = humanoid()
    shoulder = figure.forward(figure.rest)[1][figure.skeleton.index("RightArm")]
    result = {}
    for height_name, height in _HEIGHTS_M.items():
        for direction_name, direction in _DIRECTIONS_RAD.items():
            for distance_name, distance in zip(("near", "far"), _DISTANCES_M[height_name], strict=True):
                y, angle, radius = np.array([height, direction, distance]) + rng.uniform(-1, 1, 3) * _JITTER
                point = np.array([shoulder[0] + radius * np.sin(angle), y, shoulder[2] + radius * np.cos(angle)])
                result[f"{height_name}_{direction_name}_{distance_name}"] = point
    return result


def apex(figure: Figure, target: Floats, how: Manner | None = None) -> F64:
    """Solve the pose with the right wrist at a target (3,), feet planted and in balance.

    Parameters
    ----------
    figure : Figure
    target : (3,)
    how : Manner, optional
        :func:`manner` unless given.

    Returns
    -------
    values : (N,) float64
        For :func:`solver.pose` and :func:`solver.vectors`.
    """
    global_rotations, positions = figure.forward(figure.rest)
    feet, wrist = figure.joints("LeftFoot", "RightFoot"), figure.joints("RightHand")
    planted = [solver.place(feet, positions[feet]), solver.orient(feet, global_rotations[feet])]
    values, how = None, how or manner
    for share in np.linspace(0.0, 1.0, _STEPS + 1)[1:]:
        goal = (1 - share) * positions[wrist[0]] + share * np.asarray(target)
        soft = how(figure, goal, np.asarray(target), share)
        hard = [*planted, solver.place(wrist, goal[None])]
        values = solver.solve(figure, soft, hard, start=values, tolerance=1e-10 if share == 1.0 else 1e-3)
    assert values is not None  # there is at least one step
    return values


def manner(figure: Figure, goal: F64, target: F64, share: float) -> list[solver.Term]:
    """Soft terms of a reach: little effort, in balance, eyes on the target, knees and free arm by the height."""
    left, head = figure.skeleton.index("LeftArm"), figure.skeleton.index("Head")
    stoop = _stoop(goal)
    # The free arm hangs, held a little away from the thighs when they come up.
    hang = quat.rotate(figure.forward(figure.rest)[0][left], _LEFT) + 0.7 * stoop * _LEFT
    return [
        solver.posture(figure),
        solver.limits(figure),
        solver.balance(figure, BALANCE_POINT, 16.0),
        solver.height(0, figure.rest.root[1] - 0.44 * stoop, 14.0),
        solver.aim(head, _FORWARD, target, 1.1 * share),
        solver.keep_direction(left, _LEFT, hang / np.linalg.norm(hang), 1.2),
    ]


def _stoop(goal: F64) -> float:
    """How far a hand goes below table height, metres, with a soft corner so that poses stay smooth in the target.

    It sets the height of the hips: if bending the back cost as little as bending the knees, neighbouring targets could
    be solved in different ways.
    """
    return float(0.12 * np.logaddexp(0.0, (_TABLE_M - goal[1]) / 0.12))


def motion(target: Floats, how: Manner | None = None, arc: F64 | None = None, hand: str = "open") -> tuple[Motion, F64]:
    """Author one reach.

    Parameters
    ----------
    target : (3,)
        Where the right wrist goes, metres.
    how : Manner, optional
        :func:`manner` unless given.
    arc : (J, 3) float64, optional
        Extra rotation vectors half-way out and back, spread over the whole way; unless given, the elbow folds and
        the hand trails for a while.
    hand : str
        Shape of the right hand at the target, one of :data:`hands.SHAPES`.

    Returns
    -------
    motion : Motion
        From rest to the target and back to rest.
    keytimes : (3,) float64
        Start, apex, end, seconds; all on frames.
    """
    figure = humanoid()
    values = apex(figure, target, how)
    out, back = _frame_counts(figure, np.asarray(target))
    phases = np.concatenate([np.arange(out) / out, 1.0 + np.arange(back + 1) / back])
    progress = _progress(figure, phases)
    # The parabola has a slope at its ends, but progress has none there: joints start and stop smoothly.
    extra = _arc(figure, values, progress) if arc is None else (4.0 * progress * (1.0 - progress))[..., None] * arc
    root, rotations = _in_between(figure, values, progress, extra)
    global_rotations, positions = figure.forward(figure.rest)
    for side in ("Left", "Right"):
        foot = figure.skeleton.index(side + "Foot")
        rotations = legs.plant(figure, root, rotations, side, positions[foot], global_rotations[foot])
    share = progress[:, figure.skeleton.index("RightHand")]
    rotations = hands.shape(figure, rotations, "Right", hand, share)
    keytimes = np.array([0, out, out + back]) / FPS
    return Motion(figure.skeleton, FPS, root, quat.unroll(rotations)), keytimes


def _frame_counts(figure: Figure, target: F64) -> tuple[int, int]:
    """Frames out and back: longer for farther hands, and for hips that must go down and up again."""
    hand = figure.forward(figure.rest)[1][figure.skeleton.index("RightHand")]
    travel = float(np.linalg.norm(target - hand))
    stoop = max(0.0, 1.0 - float(target[1]))
    out = 0.72 + 0.38 * travel + 0.42 * stoop
    return round(out * FPS), round(1.06 * out * FPS)


def _in_between(figure: Figure, values: F64, progress: F64, extra: F64) -> tuple[F64, F64]:
    """Root (F, 3) and rotations (F, J, 4) on the way: every joint with its own timing, the wrist on an arc."""
    vectors = progress[..., None] * solver.vectors(figure, values) + extra
    rotations = quat.mul(figure.rest.rotations, quat.exp(vectors))
    root = figure.rest.root + progress[:, :1] * values[:3]
    return root, rotations


def _progress(figure: Figure, phases: F64) -> F64:
    """How far each joint (F, J) is on its way to the apex."""
    progress = np.repeat(timing.there_and_back(phases, *_WINDOWS["trunk"])[:, None], len(figure.skeleton), axis=1)
    for group, names in _GROUPS.items():
        progress[:, figure.joints(*names)] = timing.there_and_back(phases, *_WINDOWS[group])[:, None]
    return progress


def _arc(figure: Figure, values: F64, progress: F64) -> F64:
    """Extra rotation vectors (F, J, 3) on the way: the elbow folds and the hand trails, in step with the swing."""
    forearm, hand, arm = figure.joints("RightForeArm", "RightHand", "RightArm")
    swing = float(np.linalg.norm(solver.vectors(figure, values)[arm]))
    extra = np.zeros((*progress.shape, 3))
    extra[:, forearm, 1] = 0.30 * swing * timing.bump(progress[:, forearm])
    extra[:, hand, 2] = 0.12 * swing * timing.bump(progress[:, hand])
    return extra
