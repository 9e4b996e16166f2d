"""Pose a whole motion from few curves: trunk, head, arms and legs in closed form, frame by frame.

Every function returns new rotations (F, J, 4) in which only its own joints are replaced. Call them from the root
outward: trunk and head, then limbs, which reach for positions in the world.
"""

from __future__ import annotations

import numpy as np

from tools.authoring.figure import Figure
from verbs.conventions import F64, Floats
from verbs.kernels import fk, quat

__all__ = ["arm", "feet_on_balls", "head", "leg", "leg_limit", "trunk", "turn", "within_reach", "yaw_of"]

_SPINE_SHARES = {"Spine": 0.36, "Spine1": 0.34, "Spine2": 0.30}
_TOE = np.array([0.0, -0.055, 0.135])
"""Toe joint in the frame of the foot, metres."""


def turn(yaw: Floats, lean: Floats | None = None) -> F64:
    """Global rotations (F, 4): about the vertical by ``yaw`` (F,), then a lean by rotation vectors (F, 3)."""
    yaw = np.asarray(yaw, np.float64)
    about = quat.exp(np.stack([0 * yaw, yaw, 0 * yaw], axis=-1))
    return about if lean is None else quat.mul(quat.exp(lean), about)


def yaw_of(direction: Floats) -> F64:
    """Angle (...) of directions (..., 3) from +Z toward +X, seen from above."""
    direction = np.asarray(direction, np.float64)
    return np.asarray(np.arctan2(direction[..., 0], direction[..., 2]))


def trunk(figure: Figure, rotations: Floats, pelvis: Floats, chest: Floats) -> F64:
    """Rotate the pelvis (F, 4) and bend the spine evenly until the chest has its global rotation (F, 4)."""
    solved: F64 = np.array(rotations, np.float64)
    bend = quat.log(quat.mul(quat.conjugate(pelvis), chest))
    solved[:, 0] = pelvis
    for name, share in _SPINE_SHARES.items():
        solved[:, figure.skeleton.index(name)] = quat.exp(share * bend)
    return solved


def head(figure: Figure, rotations: Floats, chest: Floats, gaze: Floats) -> F64:
    """Give the head the global rotation ``gaze`` (F, 4), over a chest rotated by ``chest`` (F, 4)."""
    solved: F64 = np.array(rotations, np.float64)
    half = quat.exp(0.5 * quat.log(quat.mul(quat.conjugate(chest), gaze)))
    for name in ("Neck", "Head"):
        solved[:, figure.skeleton.index(name)] = half
    return solved


def arm(
    figure: Figure,
    root: Floats,
    rotations: Floats,
    side: str,
    wrists: Floats,
    poles: Floats,
    hands: Floats,
) -> F64:
    """Bring a wrist to positions (F, 3).

    Parameters
    ----------
    figure : Figure
        The humanoid: arms that point sideways in the zero pose, elbows that rotate about Y.
    root, rotations : (F, 3), (F, J, 4)
        With the trunk and the clavicles in place.
    side : {"Left", "Right"}
    wrists : (F, 3)
        Targets, metres.
    poles : (F, 3)
        Directions to which the elbows point.
    hands : (F, 3)
        Rotation vectors of the hand against the forearm; the twist about the forearm is the forearm's own.
    """
    solved: F64 = np.array(rotations, np.float64)
    skeleton = figure.skeleton
    upper, fore, hand = figure.joints(side + "Arm", side + "ForeArm", side + "Hand")
    global_rotations, positions = fk.forward(root, solved, skeleton.parents, skeleton.offsets)
    outward = np.sign(skeleton.offsets[fore, 0])
    lengths = np.abs(skeleton.offsets[[fore, hand], 0])
    along, bend, angle = _two_bones(np.asarray(wrists) - positions[:, upper], np.asarray(poles), lengths)
    frame = _frame(outward * along, np.cross(-bend, outward * along), -bend)
    solved[:, upper] = quat.mul(quat.conjugate(global_rotations[:, skeleton.parents[upper]]), frame)
    twist = np.asarray(hands) * [1.0, 0.0, 0.0]
    hinge = quat.exp(-outward * angle[:, None] * [0.0, 1.0, 0.0])
    solved[:, fore] = quat.mul(hinge, quat.exp(twist))
    solved[:, hand] = quat.mul(quat.exp(-twist), quat.exp(np.asarray(hands)))
    return solved


def leg(
    figure: Figure,
    root: Floats,
    rotations: Floats,
    side: str,
    ankles: Floats,
    feet: Floats,
    poles: Floats,
) -> F64:
    """Bring an ankle to positions (F, 3) and its foot to global rotations (F, 4), knees toward ``poles`` (F, 3)."""
    solved: F64 = np.array(rotations, np.float64)
    skeleton = figure.skeleton
    hip, knee, foot = figure.joints(side + "UpLeg", side + "Leg", side + "Foot")
    global_rotations, positions = fk.forward(root, solved, skeleton.parents, skeleton.offsets)
    lengths = -skeleton.offsets[[knee, foot], 1]
    along, bend, angle = _two_bones(np.asarray(ankles) - positions[:, hip], np.asarray(poles), lengths)
    frame = _frame(np.cross(-along, bend), -along, bend)
    solved[:, hip] = quat.mul(quat.conjugate(global_rotations[:, 0]), frame)
    solved[:, knee] = quat.exp(angle[:, None] * [1.0, 0.0, 0.0])
    solved[:, foot] = quat.mul(quat.conjugate(quat.mul(frame, solved[:, knee])), feet)
    return solved


def feet_on_balls(
    balls: Floats, yaw: Floats, pitch: Floats, figure: Figure, rotations: Floats, side: str
) -> tuple[F64, F64, F64]:
    """Ankles (F, 3), feet (F, 4) and rotations of a foot that stands on its toe joint at (F, 3).

    ``pitch`` (F,) raises the heel about the toe joint, radians; the toes stay level.
    """
    solved: F64 = np.array(rotations, np.float64)
    pitch = np.asarray(pitch, np.float64)
    sideways = np.stack([pitch, 0 * pitch, 0 * pitch], axis=-1)
    feet = quat.mul(turn(yaw), quat.exp(sideways))
    solved[:, figure.skeleton.index(side + "ToeBase")] = quat.exp(-sideways)
    return np.asarray(balls) - quat.rotate(feet, _TOE), feet, solved


def within_reach(
    figure: Figure,
    root: Floats,
    rotations: Floats,
    side: str,
    ankles: Floats,
    knee_rad: float,
    softness_m: float = 0.006,
) -> F64:
    """Ankles (F, 3) pulled toward the hip, with a soft corner, until the knee is bent by ``knee_rad``.

    For feet that may leave the ground; :func:`leg_limit` lowers the root over feet that stand.
    """
    skeleton = figure.skeleton
    hip, knee, foot = figure.joints(side + "UpLeg", side + "Leg", side + "Foot")
    thigh, shank = -skeleton.offsets[[knee, foot], 1]
    hips = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)[1][:, hip]
    distance = np.linalg.norm(ankles - hips, axis=-1)
    most = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(knee_rad))
    limited = distance - softness_m * np.logaddexp(0.0, (distance - most) / softness_m)
    return np.asarray(hips + (ankles - hips) * (limited / distance)[:, None])


def leg_limit(
    figure: Figure, root: Floats, pelvis: Floats, ankles: dict[str, F64], knee_rad: float, softness_m: float = 0.008
) -> F64:
    """Root positions (F, 3) lowered, with a soft corner, until no knee is straighter than ``knee_rad``.

    Parameters
    ----------
    figure : Figure
    root, pelvis : (F, 3), (F, 4)
    ankles : of (F, 3)
        By side; only the legs that stand.
    knee_rad : float
    softness_m : float
        How much lower than its limit the root is where it just reaches it, ÷ ln 2.
    """
    skeleton = figure.skeleton
    lowered: F64 = np.array(root, np.float64)
    heights = [lowered[:, 1]]
    for side, targets in ankles.items():
        hip, knee, foot = figure.joints(side + "UpLeg", side + "Leg", side + "Foot")
        thigh, shank = -skeleton.offsets[[knee, foot], 1]
        reach2 = thigh**2 + shank**2 + 2 * thigh * shank * np.cos(knee_rad)
        offset = quat.rotate(pelvis, skeleton.offsets[hip])
        level = np.linalg.norm((targets - lowered - offset)[:, [0, 2]], axis=-1)
        heights.append(targets[:, 1] + np.sqrt(np.maximum(reach2 - level**2, 0.01)) - offset[:, 1])
    lowered[:, 1] = -softness_m * np.logaddexp.reduce(-np.array(heights) / softness_m, axis=0)
    return lowered


def _two_bones(reach: F64, poles: F64, lengths: F64) -> tuple[F64, F64, F64]:
    """Direction (F, 3) of the first bone, direction (F, 3) toward the pole across it, and bend (F,), radians.

    Raises
    ------
    RuntimeError
        If a target is out of reach: a mistake in the authoring code, since a straight limb pops.
    """
    first, second = lengths
    distance = np.linalg.norm(reach, axis=-1)
    if distance.max() > first + second or distance.min() < abs(first - second):
        frame = int(np.argmax(distance))
        raise RuntimeError(f"frame {frame}: a limb of {first + second:.3f} m reaches for {distance.max():.3f} m")
    cosine = (distance**2 - first**2 - second**2) / (2.0 * first * second)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    toward = reach / distance[:, None]
    out = poles - np.sum(poles * toward, axis=-1, keepdims=True) * toward
    out = out / np.linalg.norm(out, axis=-1, keepdims=True)
    opening = np.arctan2(second * np.sin(angle), first + second * np.cos(angle))[:, None]
    along = np.cos(opening) * toward + np.sin(opening) * out
    across = np.cos(opening) * out - np.sin(opening) * toward
    return along, across, angle


def _frame(x: F64, y: F64, z: F64) -> F64:
    """Rotations (F, 4) that take the axes to orthonormal x, y, z (F, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(quat.unroll(Rotation.from_matrix(np.stack([x, y, z], axis=-1)).as_quat()))
