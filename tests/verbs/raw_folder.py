"""Folders of raw clips: reaches of a figure without ``verb.toml``, and a folder of clips that do not fit together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.verbs import walker
from verbs.io import bvh
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

FPS = 30.0

ARMS = ("Shoulder", "Arm", "ForeArm", "Hand")

AWKWARD = {
    "wrong.bvh": "'RightHand' moves 0.00 m from its start",
    "centimetres.bvh": "another unit of length",
    "renamed.bvh": "'RightWrist' where the others have 'RightHand'",
    "truncated.bvh": "cannot be read",
}
"""Clips of :func:`awkward_folder` that are refused, and a part of the reason. ``rate.bvh``, at 60 frames per second, is
not among them."""

MENDED = {"spinning.bvh": ("spin", "RightHand"), "backwards.bvh": ("heading", None)}
"""Clips of :func:`awkward_folder` that are mended, and how."""


def body() -> Skeleton:
    """A figure of 1.65 m with two legs, a spine and two arms; a hand ends in a tip."""
    legs = walker.skeleton()
    names, parents, offsets = list(legs.names), legs.parents.tolist(), legs.offsets.tolist()
    tips, ends = legs.tip_parents.tolist(), legs.tip_offsets.tolist()
    offsets[2] = [0.0, 0.35, 0.0]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        above = names.index("Chest")
        for part, offset in zip(ARMS, ([0.06, 0.12, 0.0], [0.12, 0.0, 0.0], [0.28, 0, 0], [0.26, 0, 0]), strict=True):
            names.append(side + part)
            parents.append(above)
            offsets.append([sign * offset[0], offset[1], offset[2]])
            above = len(names) - 1
        tips.append(above)
        ends.append([sign * 0.12, 0.0, 0.0])
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), np.array(tips), np.array(ends))


def pulse(frames: int, apex: float, width: float) -> np.ndarray:
    """A smooth rise and fall (F,) about the share ``apex`` of a clip, with a plateau."""
    share = np.linspace(0.0, 1.0, frames)
    rise = np.clip((width - np.abs(share - apex)) / (0.75 * width), 0.0, 1.0)
    return rise * rise * (3.0 - 2.0 * rise)


def reach(yaw: float, pitch: float, *, frames: int = 91, apex: float = 0.5, fps: float = FPS, height=0.9) -> Motion:
    """The right arm hangs, reaches ``yaw`` sideways and ``pitch`` up (radians) at ``apex``, and returns."""
    skeleton = body()
    bell = pulse(frames, apex, 0.35)
    rotations = np.zeros((frames, len(skeleton), 4))
    rotations[..., 3] = 1.0
    hang = np.zeros((frames, 3))
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        hang[:] = 0.0
        hang[:, 2] = -sign * 1.35
        arm = quat.exp(hang)
        if side == "Right":
            aim = quat.mul(quat.exp(np.array([0.0, 1.3 - yaw, 0.0])), quat.exp(np.array([0.0, 0.0, -pitch])))
            arc = quat.log(quat.mul(quat.conjugate(arm[0]), aim))
            arm = quat.mul(arm, quat.exp(bell[:, None] * arc))
        rotations[:, skeleton.index(f"{side}Arm")] = arm
    lean = np.zeros((frames, 3))
    lean[:, 0], lean[:, 1] = 0.15 * bell * (1.0 - pitch), -0.2 * bell * yaw
    rotations[:, skeleton.index("Chest")] = quat.exp(lean)
    root = np.tile([0.0, height, 0.0], (frames, 1))
    root[:, 1] -= 0.04 * bell * (0.6 - pitch)
    return Motion(skeleton, fps, root, rotations)


GOALS = [(yaw, pitch) for yaw in (-0.6, 0.0, 0.6) for pitch in (-0.4, 0.1, 0.6)]


def reaches() -> dict[str, Motion]:
    """Nine reaches with apexes at different instants."""
    return {
        f"reach_{k}": reach(*goal, frames=81 + 5 * k, apex=0.42 + 0.015 * k) for k, goal in enumerate(GOALS)
    }  # fmt: skip


def write(folder: Path, motions: dict[str, Motion]) -> Path:
    """A folder of BVH files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, motion in motions.items():
        bvh.write(motion, folder / f"{name}.bvh", decimals=7)
    return folder


def scaled(motion: Motion, factor: float) -> Motion:
    """A motion with all lengths multiplied."""
    skeleton = motion.skeleton
    larger = replace(skeleton, offsets=skeleton.offsets * factor, tip_offsets=skeleton.tip_offsets * factor)
    return Motion(larger, motion.fps, motion.root * factor, motion.rotations)


def renamed(motion: Motion, old: str, new: str) -> Motion:
    """A motion with one joint renamed."""
    names = tuple(new if name == old else name for name in motion.skeleton.names)
    return Motion(replace(motion.skeleton, names=names), motion.fps, motion.root, motion.rotations)


def turned(motion: Motion, angle: float) -> Motion:
    """A motion turned about +Y."""
    about = quat.exp(np.array([0.0, angle, 0.0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(about, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(about, motion.root), rotations)


def zup(motion: Motion) -> Motion:
    """A motion with +Z up and -Y forward."""
    about = quat.exp(np.array([0.5 * np.pi, 0.0, 0.0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(about, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(about, motion.root), rotations)


def spinning(motion: Motion, joint: str) -> Motion:
    """A motion in which one joint turns once about the limb's axis, and stays there."""
    rotations, index = motion.rotations.copy(), motion.skeleton.index(joint)
    vectors = np.zeros((len(motion), 3))
    vectors[:, 0] = 2.0 * np.pi * np.clip(np.linspace(-1.0, 2.0, len(motion)), 0.0, 1.0)
    rotations[:, index] = quat.mul(rotations[:, index], quat.exp(vectors))
    return Motion(motion.skeleton, motion.fps, motion.root, rotations)


def stepping(frames: int = 100) -> Motion:
    """A motion of another kind: both legs lift in turn while the figure walks."""
    skeleton = body()
    walk = walker.walk(1.2, cycle_s=1.0, fps=FPS)
    rotations = np.zeros((frames, len(skeleton), 4))
    rotations[..., 3] = 1.0
    root = np.zeros((frames, 3))
    for k in range(frames):
        cycle, frame = divmod(k, len(walk) - 1)
        rotations[k, : len(walk.skeleton)] = walk.rotations[frame]
        root[k] = walk.root[frame] + cycle * (walk.root[-1] - walk.root[0])
    return Motion(skeleton, FPS, root, rotations)


def awkward_folder(folder: Path) -> Path:
    """Nine good reaches, one at another frame rate, and those of :data:`AWKWARD`."""
    own = reach(0.3, 0.3, frames=90)
    odd = {
        "wrong": stepping(),
        "rate": reach(0.3, -0.1, frames=181, fps=60.0),
        "centimetres": scaled(own, 100.0),
        "renamed": renamed(own, "RightHand", "RightWrist"),
        "spinning": spinning(reach(-0.3, 0.3, frames=90), "RightHand"),
        "backwards": turned(reach(-0.3, -0.2), np.pi),
    }
    write(folder, {**reaches(), **odd})
    text = (folder / "reach_4.bvh").read_text()
    (folder / "truncated.bvh").write_text(text[: int(0.7 * len(text))])
    return folder
