"""The built-in humanoid: skeleton, masses, joint stiffness and limits, and the rest pose.

1.75 m tall, +Y up, +Z forward, +X left, joints named as most motion files name them. The zero pose is a T-pose with
the palms down, where every hinge rotates about one axis: elbows about Y, knees about X, fingers about Z. Each hand has
one joint for its thumb and a chain of two for its fingers. Everything is written for the right side and mirrored to
the left.

Sources: segment lengths and masses follow the tables of D. A. Winter, "Biomechanics and Motor Control of Human
Movement", chapter 4 (fractions of stature and of body mass), rounded; compliances and limits are chosen by hand.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from tools.authoring import solver
from tools.authoring.figure import Figure, Pose, skeleton_of
from verbs.conventions import F64, Floats
from verbs.kernels import quat
from verbs.skeleton import Skeleton

__all__ = ["BALANCE_POINT", "SOLE_M", "foot_outline", "humanoid", "mirror_name", "support_gap"]

SOLE_M = 0.075
"""Height of an ankle above the ground where its foot stands flat."""
_HEEL_M, _TOE_M, _HALF_WIDTH_M = 0.055, 0.205, 0.04

BALANCE_POINT = np.array([0.0, 0.0, 0.045])
"""Ground point under the centre of mass in the rest pose: a little before the ankles."""

_STANCE_HALF_WIDTH_M = 0.125
_STANCE_TURN_OUT_RAD = np.radians(9.0)

# joint: (parent, offset in the parent, metres). Legs point straight down, which the two-bone solver relies on.
_CENTRE = {
    "Hips": (None, (0.0, 0.0, 0.0)),
    "Spine": ("Hips", (0.0, 0.095, -0.010)),
    "Spine1": ("Spine", (0.0, 0.125, -0.010)),
    "Spine2": ("Spine1", (0.0, 0.125, 0.000)),
    "Neck": ("Spine2", (0.0, 0.165, 0.005)),
    "Head": ("Neck", (0.0, 0.100, 0.020)),
}
_RIGHT_ARM = {
    "RightShoulder": ("Spine2", (-0.030, 0.115, 0.025)),
    "RightArm": ("RightShoulder", (-0.150, -0.005, -0.025)),
    "RightForeArm": ("RightArm", (-0.295, 0.0, 0.0)),
    "RightHand": ("RightForeArm", (-0.260, 0.0, 0.0)),
    "RightHandMiddle1": ("RightHand", (-0.088, 0.0, 0.0)),
    "RightHandMiddle2": ("RightHandMiddle1", (-0.044, 0.0, 0.0)),
    "RightHandThumb1": ("RightHand", (-0.028, -0.010, 0.026)),
}
_RIGHT_LEG = {
    "RightUpLeg": ("Hips", (-0.095, -0.050, 0.0)),
    "RightLeg": ("RightUpLeg", (0.0, -0.430, 0.0)),
    "RightFoot": ("RightLeg", (0.0, -0.425, 0.0)),
    "RightToeBase": ("RightFoot", (0.0, -0.055, 0.135)),
}
_TIPS = {
    "Head": (0.0, 0.170, 0.020),
    "RightHandMiddle2": (-0.042, 0.0, 0.0),
    "RightHandThumb1": (-0.044, -0.018, 0.036),
    "RightToeBase": (0.0, 0.0, 0.070),
}

# joint: stiffness about its own x, y, z (cost of one radian, 0 = locked), then limits about the rest pose, degrees.
# Lower numbers move first: arms before clavicles, hips and legs before the spine, twists and side bends last.
_SPINE = ((4.0, 4.0, 8.0), (-3, 28), (-20, 20), (-12, 12))
_LOCKED = ((0.0, 0.0, 0.0), (0, 0), (0, 0), (0, 0))
_DOFS: dict[str, tuple[tuple[float, float, float], tuple[int, int], tuple[int, int], tuple[int, int]]] = {
    "Hips": ((2.5, 2.5, 8.0), (-3, 60), (-45, 45), (-15, 15)),
    "Spine": _SPINE,
    "Spine1": _SPINE,
    "Spine2": ((5.0, 3.5, 9.0), (-4, 20), (-20, 20), (-10, 10)),
    "Neck": ((2.0, 2.5, 5.0), (-25, 30), (-35, 35), (-15, 15)),
    "Head": ((2.0, 2.5, 5.0), (-25, 30), (-35, 35), (-15, 15)),
    "RightShoulder": ((0.0, 8.0, 5.0), (0, 0), (-10, 18), (-22, 6)),
    "RightArm": ((1.0, 0.35, 0.5), (-60, 60), (-40, 140), (-110, 25)),
    "RightForeArm": ((2.0, 0.35, 0.0), (-60, 60), (-14, 115), (0, 0)),
    "RightHand": ((0.0, 4.0, 4.0), (0, 0), (-20, 20), (-40, 40)),
    "RightHandMiddle1": _LOCKED,
    "RightHandMiddle2": _LOCKED,
    "RightHandThumb1": _LOCKED,
    "RightUpLeg": ((0.3, 2.0, 1.5), (-110, 15), (-30, 30), (-25, 25)),
    "RightLeg": ((0.8, 0.0, 0.0), (-3, 110), (0, 0), (0, 0)),
    "RightFoot": ((0.3, 1.0, 1.0), (-35, 30), (-20, 20), (-20, 20)),
    "RightToeBase": _LOCKED,
}

# joint: rotation vectors from the T-pose, degrees, applied in this order; a first guess that balancing refines.
_STANDING: dict[str, tuple[tuple[float, float, float], ...]] = {
    "Spine": ((2.0, 0.0, 0.0),),
    "Spine2": ((2.0, 0.0, 0.0),),
    "Neck": ((3.0, 0.0, 0.0),),
    "Head": ((-6.0, 0.0, 0.0),),
    "RightArm": ((0.0, 0.0, 80.0), (0.0, -3.0, 0.0), (14.0, 0.0, 0.0)),
    "RightForeArm": ((0.0, 22.0, 0.0),),
    "RightHand": ((0.0, 4.0, 0.0),),
    "RightHandMiddle1": ((0.0, 0.0, 22.0),),
    "RightHandMiddle2": ((0.0, 0.0, 26.0),),
    "RightUpLeg": ((-5.0, 0.0, 0.0),),
    "RightLeg": ((8.0, 0.0, 0.0),),
}

# (from joint, to joint, share of body mass, where its centre lies between them); the left side is mirrored.
_MASSES = (
    ("Hips", "Spine", 0.142, 0.2),
    ("Spine", "Spine2", 0.139, 0.5),
    ("Spine2", "Neck", 0.216, 0.4),
    ("Head", "Head", 0.081, 0.0),
    ("RightArm", "RightForeArm", 0.028, 0.44),
    ("RightForeArm", "RightHand", 0.016, 0.43),
    ("RightHand", "RightHand", 0.006, 0.0),
    ("RightUpLeg", "RightLeg", 0.100, 0.43),
    ("RightLeg", "RightFoot", 0.0465, 0.43),
    ("RightFoot", "RightToeBase", 0.0145, 0.4),
)


def mirror_name(name: str) -> str:
    """Name of the same joint on the other side of the body; a centre joint is its own mirror."""
    if name.startswith("Right"):
        return "Left" + name[5:]
    return "Right" + name[4:] if name.startswith("Left") else name


@cache
def humanoid() -> Figure:
    """Return the built-in humanoid, standing balanced on both feet at the origin, facing +Z.

    Returns
    -------
    figure : Figure
        Its ``rest`` is exactly planted: soles on the ground, centre of mass over the middle of the feet.
    """
    skeleton = _skeleton()
    figure = Figure(
        skeleton=skeleton,
        rest=Pose(np.array([0.0, 0.976, 0.0]), _standing_guess(skeleton)),
        stiffness=_mirrored_table(skeleton, 0),
        lower=np.radians(_mirrored_table(skeleton, 1)),
        upper=np.radians(_mirrored_table(skeleton, 2)),
        mass_shares=_mass_shares(skeleton),
    )
    return replace(figure, rest=_balanced(figure))


def foot_outline(ankles: Floats, feet: Floats) -> F64:
    """Corners (..., 4, 3) of the sole of a foot from its ankle (..., 3) and global rotation (..., 4)."""
    corners = np.array(
        [
            [x, -SOLE_M, z]
            for x, z in (
                (-_HALF_WIDTH_M, -_HEEL_M),
                (_HALF_WIDTH_M, -_HEEL_M),
                (_HALF_WIDTH_M, _TOE_M),
                (-_HALF_WIDTH_M, _TOE_M),
            )
        ]
    )
    rotated = quat.rotate(np.asarray(feet)[..., None, :], corners)
    return np.asarray(np.asarray(ankles)[..., None, :] + rotated)


def support_gap(outline: Floats, points: Floats) -> F64:
    """Horizontal distance (...) by which points (..., 3) lie outside the hull of ground points (N, 3); inside < 0.

    The distance is to the nearest edge line, so it is exact inside and near edges, a lower bound near corners.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(np.asarray(outline)[:, [0, 2]])
    distances = np.asarray(points)[..., [0, 2]] @ hull.equations[:, :2].T + hull.equations[:, 2]
    return np.asarray(distances.max(axis=-1))


def _skeleton() -> Skeleton:
    rows: dict[str, tuple[str | None, tuple[float, float, float]]] = dict(_CENTRE)
    for side in (_RIGHT_ARM, _RIGHT_LEG):
        left = {mirror_name(name): (mirror_name(row[0]), (-row[1][0], *row[1][1:])) for name, row in side.items()}
        rows |= left | dict(side)
    tips = {
        each: (x if each == name else -x, y, z)
        for name, (x, y, z) in _TIPS.items()
        for each in {name: 0, mirror_name(name): 0}
    }
    return skeleton_of(rows, tips)


def _mirrored_table(skeleton: Skeleton, column: int) -> F64:
    """(J, 3) of stiffness (column 0), lower (1) or upper (2) limits in degrees, for both sides."""
    table = np.zeros((len(skeleton), 3))
    for name, (stiffness, *limits) in _DOFS.items():
        lower, upper = np.array(limits, np.float64).T
        table[skeleton.index(name)] = (stiffness, lower, upper)[column]
        if mirror_name(name) != name:
            # Mirroring maps rotation vectors (x, y, z) to (x, -y, -z): limits about y and z swap.
            swapped = (stiffness, np.array([lower[0], *-upper[1:]]), np.array([upper[0], *-lower[1:]]))
            table[skeleton.index(mirror_name(name))] = swapped[column]
    return table


def _standing_guess(skeleton: Skeleton) -> F64:
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(skeleton), 1))
    for name, vectors in _STANDING.items():
        for each, signs in ((name, (1, 1, 1)), (mirror_name(name), (1, -1, -1)))[: 1 + (name != mirror_name(name))]:
            for vector in vectors:
                step = quat.exp(np.radians(np.multiply(vector, signs)))
                rotations[skeleton.index(each)] = quat.mul(rotations[skeleton.index(each)], step)
    return rotations


def _mass_shares(skeleton: Skeleton) -> F64:
    shares = np.zeros(len(skeleton))
    for start, end, mass, along in _MASSES:
        for one, other in {(start, end): 0, (mirror_name(start), mirror_name(end)): 0}:
            shares[skeleton.index(one)] += mass * (1 - along)
            shares[skeleton.index(other)] += mass * along
    return np.asarray(shares / shares.sum())


def _stance() -> tuple[F64, F64]:
    """Ankle positions (2, 3) and foot rotations (2, 4) of the stance, left then right."""
    side = np.array([1.0, -1.0])
    ankles = np.stack([side * _STANCE_HALF_WIDTH_M, np.full(2, SOLE_M), np.zeros(2)], axis=-1)
    return ankles, quat.exp(np.stack([np.zeros(2), side * _STANCE_TURN_OUT_RAD, np.zeros(2)], axis=-1))


def _balanced(figure: Figure) -> Pose:
    """Turn the guessed standing pose into one that is exactly planted and balanced."""
    ankles, feet = _stance()
    feet_joints = figure.joints("LeftFoot", "RightFoot")
    values = solver.solve(
        figure,
        soft=[solver.posture(figure)],
        hard=[
            solver.place(feet_joints, ankles),
            solver.orient(feet_joints, feet),
            solver.balance(figure, BALANCE_POINT, 1.0),
        ],
    )
    return solver.pose(figure, values)
