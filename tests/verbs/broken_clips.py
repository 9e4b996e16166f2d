"""Clean clips of the built-in verbs, and every way in which they are broken for tests of mends."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from verbs import library
from verbs.clips.resample import resample
from verbs.io import bvh
from verbs.kernels import fk, quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

LIBRARY = Path(library.__file__).parent


@cache
def clean(verb="reach", *, fps=60.0) -> Motion:
    """The first clip of a built-in verb."""
    motion = bvh.read(min((LIBRARY / verb).glob("*.bvh")))
    return motion if motion.fps == fps else resample(motion, fps)


def positions(motion: Motion):
    return fk.forward(motion.root, motion.rotations, motion.skeleton.parents, motion.skeleton.offsets)[1]


def apart_m(one: Motion, other: Motion) -> float:
    """Largest distance of any joint at any frame."""
    return float(np.linalg.norm(positions(one) - positions(other), axis=-1).max())


def apart_deg(one: Motion, other: Motion) -> float:
    """Largest angle between the local rotations of any joint at any frame."""
    turn = quat.mul(quat.conjugate(one.rotations), other.rotations)
    return float(np.degrees(np.linalg.norm(quat.log(turn), axis=-1)).max())


def with_rotation(motion: Motion, joint: str, frames, vectors) -> Motion:
    """Extra rotations, rotation vectors in degrees, of one joint at some frames."""
    rotations, at = motion.rotations.copy(), motion.skeleton.index(joint)
    extra = quat.exp(np.radians(np.broadcast_to(vectors, (len(rotations[frames, at]), 3))))
    rotations[frames, at] = quat.mul(rotations[frames, at], extra)
    return Motion(motion.skeleton, motion.fps, motion.root, rotations)


def spin(motion: Motion, joint: str, first: int, last: int, *, axis=(1.0, 0.0, 0.0), turns=1.0) -> Motion:
    """A smooth whole turn from one frame to another; the joint keeps it, which is the same rotation as before."""
    share = np.clip((np.arange(len(motion)) - first) / (last - first), 0.0, 1.0)
    angle = 360.0 * turns * share * share * (3.0 - 2.0 * share)
    return with_rotation(motion, joint, slice(None), angle[:, None] * np.array(axis))


def spike(motion: Motion, joint: str, frame: int, *, degrees=40.0, frames=1) -> Motion:
    return with_rotation(motion, joint, slice(frame, frame + frames), [0.0, degrees, 0.0])


def flip(motion: Motion, joint: str, frame: int, *, frames=2) -> Motion:
    """Half a turn about an axis for two frames."""
    return spike(motion, joint, frame, degrees=180.0, frames=frames)


def root_spike(motion: Motion, frame: int, *, metres=0.3) -> Motion:
    root = motion.root.copy()
    root[frame, 1] += metres
    return Motion(motion.skeleton, motion.fps, root, motion.rotations)


def gap(motion: Motion, joint: str | None, first: int, last: int) -> Motion:
    """Frames ``first`` to ``last`` hold the frame before them, of one joint or of everything."""
    rotations, root = motion.rotations.copy(), motion.root.copy()
    if joint is None:
        rotations[first : last + 1], root[first : last + 1] = rotations[first - 1], root[first - 1]
    else:
        at = motion.skeleton.index(joint)
        rotations[first : last + 1, at] = rotations[first - 1, at]
    return Motion(motion.skeleton, motion.fps, root, rotations)


def missing(motion: Motion, joint: str, first: int, last: int) -> Motion:
    """Quaternions of zero length."""
    rotations = motion.rotations.copy()
    rotations[first : last + 1, motion.skeleton.index(joint)] = 0.0
    return Motion(motion.skeleton, motion.fps, motion.root, rotations)


def jitter(motion: Motion, joint: str, *, degrees=1.0, seed=1) -> Motion:
    noise = degrees * np.random.default_rng(seed).standard_normal((len(motion), 3))
    return with_rotation(motion, joint, slice(None), noise)


def root_jitter(motion: Motion, *, metres=0.005, seed=1) -> Motion:
    noise = metres * np.random.default_rng(seed).standard_normal((len(motion), 3))
    return Motion(motion.skeleton, motion.fps, motion.root + noise, motion.rotations)


def idle(motion: Motion, head: int, tail: int) -> Motion:
    """The first pose held before, and the last one after the motion."""
    frames = np.clip(np.arange(-head, len(motion) + tail), 0, len(motion) - 1)
    return Motion(motion.skeleton, motion.fps, motion.root[frames], motion.rotations[frames])


def moved(motion: Motion, x=0.0, y=0.0, z=0.0) -> Motion:
    return Motion(motion.skeleton, motion.fps, motion.root + np.array([x, y, z]), motion.rotations)


def turned(motion: Motion, degrees: float) -> Motion:
    """Rotated about +Y at the origin."""
    turn = quat.exp(np.array([0.0, np.radians(degrees), 0.0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return Motion(motion.skeleton, motion.fps, quat.rotate(turn, motion.root), rotations)


def scaled(motion: Motion, factor: float, *, joints: dict[str, float] | None = None) -> Motion:
    """Other bone lengths: all by one factor, or those of some joints by their own; the root's height by the legs'."""
    skeleton = motion.skeleton
    factors = np.full(len(skeleton), factor)
    for name, own in (joints or {}).items():
        factors[skeleton.index(name)] = own
    other = Skeleton(
        skeleton.names, skeleton.parents, skeleton.offsets * factors[:, None], skeleton.tip_parents,
        skeleton.tip_offsets * factor,
    )  # fmt: skip
    return Motion(other, motion.fps, motion.root * factor, motion.rotations)


def local_frame(motion: Motion, frame) -> Motion:
    """The root's local frame rotated by a quaternion: other offsets and rotations, the same joint positions."""
    skeleton, inverse = motion.skeleton, quat.conjugate(frame)
    children = np.flatnonzero(skeleton.parents == 0)
    offsets, rotations = skeleton.offsets.copy(), motion.rotations.copy()
    offsets[children] = quat.rotate(inverse, offsets[children])
    rotations[:, 0] = quat.mul(rotations[:, 0], frame)
    rotations[:, children] = quat.mul(inverse, rotations[:, children])
    other = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.tip_parents, skeleton.tip_offsets)
    return Motion(other, motion.fps, motion.root, rotations)


def calibrated(motion: Motion, head: int, tail: int = 0) -> Motion:
    """A clip with frames of a T-pose before and after it."""
    still = np.zeros((1, len(motion.skeleton), 4))
    still[..., 3] = 1.0
    rotations = [np.repeat(still, head, axis=0), motion.rotations, np.repeat(still, tail, axis=0)]
    root = [np.repeat(motion.root[:1], head, axis=0), motion.root, np.repeat(motion.root[-1:], tail, axis=0)]
    return Motion(motion.skeleton, motion.fps, np.concatenate(root), np.concatenate(rotations))
