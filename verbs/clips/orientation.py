"""Up, forward and left of a motion from the geometry of its body and its travel, never from a joint's local axes.

- *Up* is the axis along which the head is above the feet, and on which the lowest points stay at one height.
- *Left* is the mean direction from right to left of paired joints: hips and what hangs below them, shoulders and arms.
  Pairs are found by name; without names, by equal lengths of two limbs, and the feet distinguish left and right.
- *Forward* is at right angles to both; the feet, from ankle to toe, and the travel confirm or contradict it.

Axes are right-handed: left is up × forward.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from verbs.clips.pairs import mirrored_name
from verbs.conventions import F64
from verbs.errors import OutOfRange
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["AXES", "Orientation", "axis_name", "convert", "find", "heading", "root_frame"]

AXES = {f"{sign}{name}": (1.0 if sign == "+" else -1.0) * np.eye(3)[k] for sign in "+-" for k, name in enumerate("XYZ")}
"""Directions by name: ``+X`` to ``-Z``."""

SAMPLES = 120
"""Frames that are looked at."""

TRAVEL_M = 0.5
"""Way from the first frame to the last from which on it is evidence for the direction."""

_KEPT = 0.1
"""A direction that is already as our convention has it wins by this much."""

_HEAD = re.compile(r"head|neck|skull", re.IGNORECASE)
_FOOT = re.compile(r"foot|ankle|toe|hoof|paw(?!n)|heel", re.IGNORECASE)
_TOE = re.compile(r"toe|ball", re.IGNORECASE)

_NARROW = 0.06
"""Width of a pair of joints, as a share of the body's size, below which the joints that hang on them count."""

_SNAP_RAD, _SNAP_YAW_RAD = np.radians(35.0), np.radians(10.0)
"""Frames of a root within this angle, and this heading, of axes of the world are taken to be those axes."""


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """Directions of a motion in the space of its file.

    Parameters
    ----------
    up, forward : (3,) float64
        Unit vectors along axes of the file, at right angles.
    facing : (3,) float64
        Direction in which the body faces at the first frame, at right angles to ``up``; not rounded to an axis.
    confidence : float
        0 (nothing is known) to 1 (all evidence agrees), of the less certain direction.
    evidence : tuple of str
        What each direction rests on.
    """

    up: F64
    forward: F64
    facing: F64
    confidence: float
    evidence: tuple[str, ...]

    @property
    def left(self) -> F64:
        """Unit vector to the left."""
        return np.asarray(np.cross(self.up, self.forward))

    @property
    def text(self) -> str:
        """The directions as text: ``+Y up, +Z forward``."""
        return f"{axis_name(self.up)} up, {axis_name(self.forward)} forward"


def axis_name(direction: F64) -> str:
    """Name of the axis that is nearest to a direction (3,)."""
    return max(AXES, key=lambda name: float(AXES[name] @ direction))


def find(motion: Motion, *, up: str | None = None, forward: str | None = None) -> Orientation:
    """Find the directions of a motion.

    Parameters
    ----------
    motion : Motion
    up, forward : str, optional
        Known directions, names of :data:`AXES`; they are taken as they are.

    Raises
    ------
    OutOfRange
        A name is not known, or both lie on one axis.
    """
    given = {name: _axis(name, text) for name, text in (("up", up), ("forward", forward)) if text is not None}
    if len(given) == 2 and abs(float(given["up"] @ given["forward"])) > 0.5:
        raise OutOfRange(f"up is {up} and forward {forward}; they must lie on two axes")
    body = _Body.of_motion(motion)
    axis, sure, why = (given["up"], 1.0, f"{up} up as stated") if up is not None else _up(body, given.get("forward"))
    ahead, facing, certain, reasons = _forward(body, axis)
    if forward is not None:
        ahead, certain, reasons = given["forward"], 1.0, (f"{forward} forward as stated", *reasons)
    return Orientation(axis, ahead, facing, min(sure, certain), (why, *reasons))


def convert(motion: Motion, *, up: str | None = None, forward: str | None = None) -> Motion:
    """Rotate a motion in the world so that +Y is up and +Z forward.

    Only the path and the rotation of the root change; local axes of joints point where they did.

    Parameters
    ----------
    motion : Motion
    up, forward : str, optional
        Directions in the file, names of :data:`AXES`. Default: those of :func:`find`.

    Raises
    ------
    OutOfRange
        As :func:`find`.
    """
    if up is not None and forward is not None:
        axis, ahead = _axis("up", up), _axis("forward", forward)
        if abs(float(axis @ ahead)) > 0.5:
            raise OutOfRange(f"up is {up} and forward {forward}; they must lie on two axes")
    else:
        found = find(motion, up=up, forward=forward)
        axis, ahead = found.up, found.forward
    turn = quat.conjugate(_from_axes(np.cross(axis, ahead), axis, ahead))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(turn, motion.root), rotations)


def heading(motion: Motion, frame: int = 0) -> float | None:
    """Angle about +Y, radians, from +Z to where the body faces at a frame; positive towards +X, its left.

    None where nothing shows it.
    """
    still = Motion(motion.skeleton, motion.fps, motion.root[[frame]], motion.rotations[[frame]])
    _, facing, sure, _ = _forward(_Body.of_motion(still), AXES["+Y"])
    return float(np.arctan2(facing[0], facing[2])) if sure > 0.0 or facing @ AXES["+Z"] < 1.0 else None


def root_frame(skeleton: Skeleton, rotations: F64) -> F64:
    """Rotation (4,) of the root where the body is upright and faces +Z.

    A root rotation q has the heading of q · r⁻¹, where r is this one. It depends on where the root's local axes point,
    and on the posture only by how far the root leans in it; it is the identity, or a rotation between axes, where the
    local axes lie close to those of the body.

    Parameters
    ----------
    skeleton : Skeleton
    rotations : (J, 4) float64
        Local rotations of a usual posture; the world is +Y up.

    Returns
    -------
    rotation : (4,) float64
        The identity where no pair of joints distinguishes left and right.
    """
    _, positions = fk.forward(np.zeros(3), rotations, skeleton.parents, skeleton.offsets)
    pairs = _named_pairs(skeleton)
    if not pairs:
        return np.array([0.0, 0.0, 0.0, 1.0])
    depth = {left: len(skeleton.chain(left)) for left, _ in pairs}
    nearest = [(left, right) for left, right in pairs if depth[left] == min(depth.values())]
    across = sum((positions[left] - positions[right] for left, right in nearest), np.zeros(3))
    yaw = float(np.arctan2(-across[2], across[0]))
    upright = quat.mul(quat.exp(np.array([0.0, -yaw, 0.0])), rotations[0])
    closest = _CUBE[np.argmax(np.abs(_CUBE @ upright))]
    apart = quat.mul(upright, quat.conjugate(closest))
    heading = 2.0 * np.arctan2(apart[1], apart[3])
    near = np.linalg.norm(quat.log(apart)) < _SNAP_RAD and abs(np.sin(0.5 * heading)) < np.sin(0.5 * _SNAP_YAW_RAD)
    return np.asarray(closest if near else upright)


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """Positions (F, J, 3) of joints and (F, T, 3) of tips at some frames, and the joints that directions rest on."""

    skeleton: Skeleton
    positions: F64
    tips: F64
    size: float

    @classmethod
    def of_motion(cls, motion: Motion) -> _Body:
        frames = np.unique(np.linspace(0, len(motion) - 1, SAMPLES).round().astype(np.int64))
        skeleton = motion.skeleton
        rotations, positions = fk.forward(
            motion.root[frames], motion.rotations[frames], skeleton.parents, skeleton.offsets
        )
        carriers = skeleton.tip_parents
        tips = positions[:, carriers] + quat.rotate(rotations[:, carriers], skeleton.tip_offsets)
        size = float(np.median(np.linalg.norm(np.ptp(positions, axis=1), axis=-1)))
        return cls(skeleton, positions, tips, max(size, 1e-9))

    def named(self, pattern: re.Pattern[str]) -> list[int]:
        """Joints whose names match."""
        return [k for k, name in enumerate(self.skeleton.names) if pattern.search(name)]


def _axis(what: str, name: str) -> F64:
    if name not in AXES:
        raise OutOfRange(f"{what} is '{name}'; known: {', '.join(AXES)}")
    return np.asarray(AXES[name])


def _up(body: _Body, forward: F64 | None) -> tuple[F64, float, str]:
    """The axis that is up, how sure that is, and why."""
    points = np.concatenate([body.positions, body.tips], axis=1)
    heads, feet = body.named(_HEAD), body.named(_FOOT)
    stands = np.zeros(3)
    if heads and feet:
        stands = (body.positions[:, heads].mean(axis=1) - body.positions[:, feet].mean(axis=1)).mean(axis=0)
        stands /= max(float(np.linalg.norm(stands)), 1e-9)
    scores: dict[str, float] = {}
    swings: dict[str, float] = {}
    for name, axis in AXES.items():
        if forward is not None and abs(float(axis @ forward)) > 0.5:
            continue
        lowest = (points @ axis).min(axis=1)
        swings[name] = float(np.ptp(np.quantile(lowest, [0.1, 0.9])))
        level = np.exp(-swings[name] / (0.1 * body.size))
        scores[name] = 2.0 * float(stands @ axis) + level + _KEPT * (name == "+Y")
    best, second = sorted(scores, key=lambda name: -scores[name])[:2]
    lean = float(np.degrees(np.arccos(np.clip(stands @ AXES[best], -1.0, 1.0))))
    body_text = f"the head is above the feet within {lean:.0f}°" if stands.any() else "no head and feet by name"
    why = f"{best} up: {body_text}, the lowest points stay within {1000.0 * swings[best]:.0f} mm"
    sure = float(np.clip((scores[best] - scores[second]) / 1.5, 0.0, 1.0)) * (1.0 if stands.any() else 0.5)
    return AXES[best], sure, why


def _forward(body: _Body, up: F64) -> tuple[F64, F64, float, tuple[str, ...]]:
    """The axis that is forward, the exact direction at the first frame, how sure that is, and why."""
    evidence: list[str] = []
    feet = _level(_toes(body), up)
    pairs = _wide_pairs(body)
    how = ", ".join(f"'{body.skeleton.names[left]}' and '{body.skeleton.names[right]}'" for left, right in pairs)
    if not pairs:
        pairs = _equal_limbs(body.skeleton)
        how = f"{len(pairs)} pairs of equal limbs"
    across = np.zeros(3)
    for left, right in pairs:
        across += body.positions[0, left] - body.positions[0, right]
    sides = _level(np.cross(across, up), up)
    if not _wide_pairs(body) and feet.any() and float(sides @ feet) < 0.0:
        sides = -sides
    way = body.positions[-1, 0] - body.positions[0, 0]
    travel = _level(way, up) if float(np.linalg.norm(way - up * (up @ way))) > TRAVEL_M else np.zeros(3)
    known = {"sides": sides, "feet": feet, "travel": travel}
    facing = next((known[name] for name in ("sides", "feet", "travel") if known[name].any()), np.zeros(3))
    if not facing.any():
        usual = AXES["+Z"] if abs(float(up @ AXES["+Z"])) < 0.5 else AXES["-Y"] * np.sign(up @ AXES["+Z"])
        return usual, usual, 0.0, (f"{axis_name(usual)} forward: nothing shows it",)
    candidates = {name: axis for name, axis in AXES.items() if abs(float(axis @ up)) < 0.5}
    best = max(candidates, key=lambda name: float(candidates[name] @ facing) + _KEPT * (name == "+Z"))
    names = {"sides": how, "feet": "ankle to toe", "travel": "the way from start to end"}
    for name, direction in known.items():
        if direction.any():
            angle = float(np.degrees(np.arccos(np.clip(direction @ candidates[best], -1.0, 1.0))))
            evidence.append(f"{names[name]}: {angle:.0f}° from {best}")
    agree = float(sides @ feet) if sides.any() and feet.any() else 0.5
    sure = float(np.clip(0.5 + 0.5 * agree, 0.0, 1.0)) * float(
        np.clip(2.0 * (candidates[best] @ facing) - 0.5, 0.0, 1.0)
    )
    evidence[0] = f"{best} forward: {evidence[0]}"
    return candidates[best], facing, sure, tuple(evidence)


def _level(direction: F64, up: F64) -> F64:
    """The part of a direction at right angles to up, as a unit vector; zero where there is none."""
    flat = direction - up * float(up @ direction)
    size = float(np.linalg.norm(flat))
    return flat / size if size > 1e-6 else np.zeros(3)


def _toes(body: _Body) -> F64:
    """Direction from the ankles to the toes at the first frame, summed over the feet."""
    total = np.zeros(3)
    parents = body.skeleton.parents
    for foot in body.named(_FOOT):
        below = [k for k in np.flatnonzero(parents == foot) if _TOE.search(body.skeleton.names[k])]
        ends = [body.positions[0, k] for k in below] or list(body.tips[0, body.skeleton.tip_parents == foot])
        for end in ends:
            total += end - body.positions[0, foot]
    return total


def _named_pairs(skeleton: Skeleton) -> list[tuple[int, int]]:
    """Left and right joint of each pair that names show."""
    index = {name: k for k, name in enumerate(skeleton.names)}
    pairs = []
    for name, left in index.items():
        mate = mirrored_name(name)
        if mate in index and _is_left(name, mate):
            pairs.append((left, index[mate]))
    return pairs


def _wide_pairs(body: _Body) -> list[tuple[int, int]]:
    """Pairs where limbs begin, the hips and the shoulders; below a short collar bone, the joints that hang on it."""
    parents = body.skeleton.parents
    pairs = _named_pairs(body.skeleton)
    first = [(left, right) for left, right in pairs if parents[left] == parents[right]]
    found = []
    for left, right in first:
        below = [pair for pair in pairs if parents[pair[0]] == left and parents[pair[1]] == right]
        width = float(np.linalg.norm(body.positions[0, left] - body.positions[0, right]))
        found += below if below and width < _NARROW * body.size else [(left, right)]
    return found or pairs


def _is_left(name: str, mate: str) -> bool:
    """Whether the first of two paired names is the left one: where they differ, it has the L."""
    at = next((k for k, (a, b) in enumerate(zip(name, mate, strict=False)) if a != b), None)
    return at is not None and name[at] in "lL"


def _equal_limbs(skeleton: Skeleton) -> list[tuple[int, int]]:
    """Pairs of first joints of two limbs that hang on one joint and have the same lengths, in an order without meaning.

    All pairs are ordered alike by their offsets, so that their differences add up.
    """
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint, parent in enumerate(skeleton.parents.tolist()[1:], start=1):
        children[parent].append(joint)

    def limb(joint: int) -> tuple[float, ...]:
        found, waiting = [], [joint]
        while waiting:
            at = waiting.pop()
            found.append(round(float(lengths[at]), 3))
            waiting += sorted(children[at], key=lambda child: float(lengths[child]))
        return tuple(found)

    pairs = []
    for group in children:
        limbs = [(limb(joint), joint) for joint in group]
        for shape, joint in limbs:
            mates = [other for other_shape, other in limbs if other_shape == shape and len(shape) > 1]
            if len(mates) == 2 and mates[0] == joint:
                gap = skeleton.offsets[mates[0]] - skeleton.offsets[mates[1]]
                lead = float(gap[np.argmax(np.abs(gap))])
                pairs.append((mates[0], mates[1]) if lead > 0 else (mates[1], mates[0]))
    return pairs[:1]  # local axes of different parents do not compare


def _from_axes(left: F64, up: F64, forward: F64) -> F64:
    """Unit quaternion (4,) that takes +X, +Y and +Z to left, up and forward."""
    matrix = np.stack([left, up, forward], axis=-1)
    return np.asarray(_CUBE[np.argmin([np.abs(quat.to_matrix(one) - matrix).max() for one in _CUBE])])


def _cube() -> F64:
    """The 24 rotations (24, 4) between axes."""
    half = [quat.exp(0.5 * np.pi * np.eye(3)[k]) for k in range(3)]
    found = [np.array([0.0, 0.0, 0.0, 1.0])]
    for one in found:  # grows while it is walked through
        for step in half:
            more = quat.mul(one, step)
            if not any(abs(float(more @ other)) > 0.99 for other in found):
                found.append(more)
    exact = np.sqrt(np.round(np.array(found) ** 2 * 4.0) / 4.0) * np.sign(np.array(found))
    return np.asarray(exact)


_CUBE = _cube()
