"""Motion files of every kind that is read, written by code that shares nothing with the readers.

A :class:`Bone` is a joint as a file has it: any joint may have position channels. :func:`bvh_text` lays bones out as
BVH, :func:`global_positions` poses them by matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

BODY = (
    ("Hips", None, (0.0, 0.0, 0.0)),
    ("Spine", "Hips", (0.0, 0.1, -0.02)),
    ("Chest", "Spine", (0.0, 0.2, 0.0)),
    ("Head", "Chest", (0.0, 0.3, 0.02)),
    ("LeftArm", "Chest", (0.18, 0.2, 0.0)),
    ("LeftForeArm", "LeftArm", (0.28, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (0.25, 0.0, 0.0)),
    ("RightArm", "Chest", (-0.18, 0.2, 0.0)),
    ("RightForeArm", "RightArm", (-0.28, 0.0, 0.0)),
    ("RightHand", "RightForeArm", (-0.25, 0.0, 0.0)),
    ("LeftUpLeg", "Hips", (0.09, -0.05, 0.0)),
    ("LeftLeg", "LeftUpLeg", (0.0, -0.42, 0.0)),
    ("LeftFoot", "LeftLeg", (0.0, -0.4, -0.01)),
    ("LeftToe", "LeftFoot", (0.0, -0.06, 0.13)),
    ("RightUpLeg", "Hips", (-0.09, -0.05, 0.0)),
    ("RightLeg", "RightUpLeg", (0.0, -0.42, 0.0)),
    ("RightFoot", "RightLeg", (0.0, -0.4, -0.01)),
    ("RightToe", "RightFoot", (0.0, -0.06, 0.13)),
)
"""A human body facing +Z: name, parent, offset in metres."""

TIPS = (("Head", (0.0, 0.18, 0.0)), ("LeftHand", (0.1, 0.0, 0.0)), ("RightHand", (-0.1, 0.0, 0.0)),
        ("LeftToe", (0.0, 0.0, 0.07)), ("RightToe", (0.0, 0.0, 0.07)))  # fmt: skip


def body() -> Skeleton:
    """The skeleton of :data:`BODY`."""
    names = tuple(name for name, _, _ in BODY)
    parents = np.array([-1 if parent is None else names.index(parent) for _, parent, _ in BODY])
    tips = np.array([names.index(name) for name, _ in TIPS])
    offsets = np.array([offset for *_, offset in BODY])
    return Skeleton(names, parents, offsets, tips, np.array([offset for _, offset in TIPS]))


def walk(
    frames: int = 31, fps: float = 30.0, *, speed: float = 1.2, turn: float = 0.0, side: float = 0.0, seed: int = 0
) -> Motion:
    """One closed cycle of a walk: arms and legs swing, the hips bob, tilt and advance along +Z; ``turn`` in rad/s."""
    skeleton = body()
    share = np.linspace(0.0, 1.0, frames)
    swing, twice = np.sin(2 * np.pi * share), np.sin(4 * np.pi * share)
    vectors = np.zeros((frames, len(skeleton), 3))
    lively = 0.1 * np.random.default_rng(seed).normal(size=(len(skeleton), 3))
    vectors += lively * (swing + 0.3 * twice)[:, None, None]
    for name, angle in (("LeftUpLeg", -0.5), ("RightUpLeg", 0.5), ("LeftArm", 0.4), ("RightArm", -0.4)):
        vectors[:, skeleton.index(name), 0] += angle * swing * (0.5 + 0.5 * min(speed, 3.0))
    for name, sign in (("LeftLeg", 1.0), ("RightLeg", -1.0)):
        vectors[:, skeleton.index(name), 0] += 0.4 * (1.0 + sign * np.cos(2 * np.pi * share))
    seconds = share * (frames - 1) / fps
    heading = np.zeros((frames, 1, 3))
    heading[:, 0, 1] = turn * seconds
    rotations = quat.exp(vectors)
    rotations[:, 0] = quat.mul(quat.exp(heading)[:, 0], quat.mul(quat.exp(vectors)[:, 0], quat.exp([0.12, 0.05, 0.02])))
    mid = 0.5 * (heading[1:, 0, 1] + heading[:-1, 0, 1])
    steps = np.stack([side * np.cos(mid) + speed * np.sin(mid), 0 * mid, speed * np.cos(mid) - side * np.sin(mid)], -1)
    root = np.concatenate([np.zeros((1, 3)), np.cumsum(steps / fps, axis=0)])
    root[:, 1] = 0.92 + 0.02 * twice
    return Motion(skeleton, fps, root, rotations)


def rerigged(motion: Motion, frames: np.ndarray) -> Motion:
    """The same motion of a rig whose joints have other local axes: rotations (J, 4) from the new axes to the old.

    Every joint is at the same place in every frame.
    """
    parents, offsets = motion.skeleton.parents, motion.skeleton.offsets.copy()
    rotations = quat.mul(motion.rotations, frames)
    for joint, parent in enumerate(parents.tolist()):
        if joint:
            back = quat.conjugate(frames[parent])
            rotations[:, joint] = quat.mul(back, rotations[:, joint])
            offsets[joint] = quat.rotate(back, offsets[joint])
    tips = motion.skeleton.tip_parents
    tip_offsets = quat.rotate(quat.conjugate(frames[tips]), motion.skeleton.tip_offsets)
    skeleton = Skeleton(motion.skeleton.names, parents, offsets, tips, tip_offsets)
    return Motion(skeleton, motion.fps, motion.root, rotations)


@dataclass
class Bone:
    """One joint of a file: channels by name, and their values (F,) each, in degrees and the file's unit."""

    name: str
    parent: int
    offset: Sequence[float]
    channels: dict[str, np.ndarray] = field(default_factory=dict)
    tips: list[Sequence[float]] = field(default_factory=list)
    tip_channels: dict[str, np.ndarray] = field(default_factory=dict)


def moving(order: str, angles: np.ndarray, positions: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Channels of a joint: positions (F, 3), if any, and angles (F, len(order)) in degrees."""
    channels = {} if positions is None else {f"{axis}position": positions[:, k] for k, axis in enumerate("XYZ")}
    return channels | {f"{axis}rotation": angles[:, k] for k, axis in enumerate(order)}


def bvh_text(bones: Sequence[Bone], fps: float = 30.0) -> str:
    """BVH text of bones; each with the parent -1 starts a ROOT."""
    columns: list[np.ndarray] = []

    def channels(rows: dict[str, np.ndarray]) -> str:
        columns.extend(rows.values())
        return f"CHANNELS {len(rows)} {' '.join(rows)}\n"

    def block(index: int) -> str:
        bone = bones[index]
        text = f"{'ROOT' if bone.parent < 0 else 'JOINT'} {bone.name}\n{{\nOFFSET {_numbers(bone.offset)}\n"
        text += channels(bone.channels)
        for tip in bone.tips:
            text += f"End Site\n{{\nOFFSET {_numbers(tip)}\n"
            text += (channels(bone.tip_channels) if bone.tip_channels else "") + "}\n"
        return text + "".join(block(k) for k, child in enumerate(bones) if child.parent == index) + "}\n"

    head = "".join(block(k) for k, bone in enumerate(bones) if bone.parent < 0)
    table = np.stack(columns, axis=-1)
    rows = "\n".join(_numbers(row) for row in table)
    return f"HIERARCHY\n{head}MOTION\nFrames: {len(table)}\nFrame Time: {1.0 / fps:.10f}\n{rows}\n"


def _numbers(row: Sequence[float]) -> str:
    return " ".join(f"{value:.9f}" for value in row)


def _about(axis: str, degrees: np.ndarray) -> np.ndarray:
    """Rotation matrices (F, 3, 3)."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.tile(np.eye(3), (len(degrees), 1, 1))
    first, second = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    matrix[:, first, first] = matrix[:, second, second] = cosine
    matrix[:, second, first], matrix[:, first, second] = sine, -sine
    return matrix


def global_positions(bones: Sequence[Bone]) -> dict[str, np.ndarray]:
    """Positions (F, 3) of the bones by name, in the unit of the file."""
    frames = max(len(track) for bone in bones for track in bone.channels.values())
    turns: list[np.ndarray] = []
    places: list[np.ndarray] = []
    for bone in bones:
        place, turn = np.tile(np.asarray(bone.offset, float), (frames, 1)), np.tile(np.eye(3), (frames, 1, 1))
        for name, track in bone.channels.items():
            if name.endswith("position"):
                place[:, "XYZ".index(name[0])] = track
            else:
                turn = turn @ _about(name[0], track)
        if bone.parent >= 0:
            above = turns[bone.parent]
            place = places[bone.parent] + np.einsum("fij,fj->fi", above, place)
            turn = above @ turn
        places.append(place)
        turns.append(turn)
    return {bone.name: place for bone, place in zip(bones, places, strict=True)}


def body_bones(frames: int = 20, seed: int = 0) -> list[Bone]:
    """The body as bones in metres, each with an own rotation order; the hips alone have positions."""
    rng, names = np.random.default_rng(seed), [name for name, _, _ in BODY]
    orders, tips = ("ZXY", "XYZ", "YZX", "ZYX"), dict(TIPS)
    bones = []
    for k, (name, parent, offset) in enumerate(BODY):
        angles = rng.uniform(-40, 40, 3) + 20 * np.sin(np.linspace(0, 4, frames)[:, None] + rng.uniform(0, 6, 3))
        place = None if parent else np.array([0.0, 0.95, 0.0]) + np.linspace([0, 0, 0], [0.1, 0.02, 1.1], frames)
        bone = Bone(name, -1 if parent is None else names.index(parent), offset, moving(orders[k % 4], angles, place))
        bone.tips = [tips[name]] if name in tips else []
        bones.append(bone)
    return bones


def on_the_ground(bones: list[Bone], *above: Bone) -> list[Bone]:
    """A root-motion rig: bones under the chain of bones given, whose parents are set."""
    for k, bone in enumerate(above):
        bone.parent = k - 1
    for bone in bones:
        bone.parent += len(above)
    return [*above, *bones]


def ground(frames: int = 20, name: str = "Reference") -> Bone:
    """A root that travels and turns on the ground."""
    share = np.linspace(0.0, 1.0, frames)
    positions = np.stack([0.3 * share, 0.0 * share, 1.5 * share], axis=-1)
    return Bone(name, -1, (0.0, 0.0, 0.0), moving("YXZ", np.outer(share, [70.0, 0.0, 0.0]), positions))


def write_bvh(path: Path, bones: Sequence[Bone], fps: float = 30.0) -> Path:
    """Write bones as a BVH file; returns its path."""
    path.write_text(bvh_text(bones, fps))
    return path
