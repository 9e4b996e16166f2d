"""The binary wire format, defined once: pose messages of streams and pose records of REST.

``docs/wire.md`` is the specification, and ``tests/golden/wire_vectors.v1.json`` holds test vectors for every client.
A record is a 24-byte head and a payload in one of three encodings. REST responses are built from one NumPy dtype;
streams write the records of many characters in one compiled call.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F32, F64, I64
from verbs.kernels import pose
from verbs.kernels.character_state import PROGRESS, Records
from verbs.kernels.compile import direct, kernel
from verbs.runtime.characters import Characters, Frames
from verbs.runtime.evaluate import Blend, Poses
from verbs.skeleton import Skeleton

__all__ = [
    "CLAMPED",
    "ENCODINGS",
    "FRAMES",
    "HEAD",
    "HEADER",
    "HEADER_WORDS",
    "IN_TRANSITION",
    "LAST",
    "NEW_VERSION",
    "OP_ADVERBS",
    "OP_MANY",
    "OP_POSES",
    "U8",
    "U32",
    "WIRE",
    "Layout",
    "Step",
    "Targets",
    "encode",
    "encode_one",
    "offsets_in",
    "pack",
    "pack_step",
    "record",
    "warm",
]

U32 = npt.NDArray[np.uint32]
U16 = npt.NDArray[np.uint16]
U8 = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

# ── the format ────────────────────────────────────────────────────────────────────────────────────────────────────

WIRE = 1
"""Version of the format."""

OP_POSES, OP_ADVERBS, OP_MANY = 0x01, 0x10, 0x11
"""First byte of binary messages: poses from the server; adverbs of one channel, or of many, from the client."""

F32_ENCODING, Q48, WEIGHTS = range(3)
ENCODINGS = {"f32": F32_ENCODING, "q48": Q48, "weights": WEIGHTS}

CLAMPED, IN_TRANSITION, NEW_VERSION, LAST = 1, 2, 4, 8
"""Flags of a record; clients ignore unknown ones."""

HEADER = struct.Struct("<BBHIQI")
"""Header of a pose message: op, wire version, records, sequence, time in ns, dropped."""

HEAD = np.dtype(
    [
        ("channel", "<u2"),
        ("encoding", "u1"),
        ("flags", "u1"),
        ("version", "<u4"),
        ("phase", "<f4"),
        ("time", "<f4"),
        ("error", "<f4"),
        ("duration", "<f4"),
    ]
)
"""Head of a record, 24 bytes."""

HEADER_WORDS, HEAD_WORDS = HEADER.size // 4, HEAD.itemsize // 4

FRAMES = {"gltf": 0, "unity": 1, "unreal": 2, "zup": 3}
_SOURCE = np.array([[0, 1, 2], [0, 1, 2], [2, 0, 1], [0, 2, 1]], np.int64)
_SIGN = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])
_UNITS = np.array([1.0, 1.0, 100.0, 1.0])
_DETERMINANT = np.array([1.0, -1.0, -1.0, 1.0])

_Q48_SCALE = 16_383.0

# ── records of REST ───────────────────────────────────────────────────────────────────────────────────────────────

_HEAD_AND_ROOT = struct.Struct("<HBBI4f3f")


@lru_cache(maxsize=256)
def record(joints: int) -> np.dtype[np.void]:
    """Dtype of an f32 record with a number of joints: head, root, rotations."""
    return np.dtype([*HEAD.descr, ("root", "<f4", (3,)), ("rotations", "<f4", (joints, 4))])


def encode(
    poses: Poses, rotations: npt.NDArray[Any], version: int, *, channels: I64 | int = 0, ended: bool = False
) -> Records:
    """Records (B,) of a batch of poses, as one array whose memory is sent.

    Parameters
    ----------
    poses : Poses
    rotations : (B, J, 4)
        The rotations to send, in the requested space and of the requested joints.
    version : int
        Version of the verb.
    channels : (B,) int64 or int
    ended : bool
        Whether the last record ends a motion.
    """
    rows = np.empty(len(rotations), record(rotations.shape[1]))
    blend = poses.blend
    rows["channel"] = channels
    rows["encoding"] = F32_ENCODING
    rows["flags"] = blend.clamped  # True is 1 is CLAMPED
    rows["version"] = version
    rows["phase"] = poses.phase
    rows["time"] = poses.time_s
    rows["error"] = blend.error
    rows["duration"] = poses.duration_s
    rows["root"] = poses.root
    rows["rotations"] = rotations
    if ended:
        rows["flags"][-1] |= LAST
    return rows


def encode_one(poses: Poses, rotations: npt.NDArray[np.float32], version: int) -> bytes:
    """Record of the only pose of a batch, on channel 0: the bytes of :func:`encode` in a third of the time."""
    blend = poses.blend
    return (
        _HEAD_AND_ROOT.pack(
            0,
            F32_ENCODING,
            CLAMPED if blend.clamped[0] else 0,
            version,
            poses.phase[0],
            poses.time_s[0],
            blend.error[0],
            poses.duration_s[0],
            *poses.root[0].tolist(),
        )
        + rotations.astype("<f4", copy=False).tobytes()
    )


# ── records of streams ────────────────────────────────────────────────────────────────────────────────────────────


def offsets_in(skeleton: Skeleton, frame: str) -> F64:
    """Offsets (J, 3) of a skeleton in another frame, in its unit of length."""
    k = FRAMES[frame]
    return np.ascontiguousarray(skeleton.offsets[:, _SOURCE[k]] * _SIGN[k] * _UNITS[k])


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Format of the records of one channel.

    Parameters
    ----------
    encoding, space, frame : str
    joints : (J,) int64
        Joints of the verb, in the order of the record.
    examples : int
        Number of weights.
    """

    encoding: str
    space: str
    frame: str
    joints: I64
    examples: int

    @property
    def words(self) -> int:
        """Length of a record in words of 4 bytes."""
        count = len(self.joints)
        return (
            HEAD_WORDS
            + {"f32": 3 + 4 * count, "q48": 3 + (3 * count + 1) // 2, "weights": 1 + self.examples}[self.encoding]
        )

    def numbers(self) -> tuple[int, int, int]:
        """Encoding, space and frame as :func:`pack` takes them."""
        return ENCODINGS[self.encoding], int(self.space == "global"), FRAMES[self.frame]


class Targets(NamedTuple):
    """Places and formats of the records of B characters.

    Parameters
    ----------
    at : (B,) int64
        First word of each record; -1 writes none.
    heads : (B,) uint32
        Channel, and flags beside those of the frame in the high byte.
    layouts : (B, 3) int64
        :meth:`Layout.numbers`.
    starts : (B + 1,) int64
        Where the joints of each begin in ``joints``.
    joints : (…,) int64
    """

    at: I64
    heads: U32
    layouts: I64
    starts: I64
    joints: I64

    @classmethod
    def of(cls, layouts: Sequence[Layout], at: Sequence[int], heads: Sequence[int]) -> Targets:
        """Gather the targets of several characters."""
        return cls(
            np.array(at, np.int64),
            np.array(heads, np.uint32),
            np.array([layout.numbers() for layout in layouts], np.int64),
            np.cumsum([0, *(len(layout.joints) for layout in layouts)], dtype=np.int64),
            np.concatenate([layout.joints for layout in layouts]),
        )

    @classmethod
    def joined(cls, some: Sequence[Targets]) -> Targets:
        """Targets of several groups of characters, one after another."""
        shifts = np.cumsum([0, *(len(one.joints) for one in some[:-1])])
        starts = [one.starts[:-1] + shift for one, shift in zip(some, shifts, strict=True)]
        total = int(shifts[-1]) + len(some[-1].joints)
        return cls(
            np.concatenate([one.at for one in some]),
            np.concatenate([one.heads for one in some]),
            np.concatenate([one.layouts for one in some]),
            np.concatenate([*starts, [total]]).astype(np.int64),
            np.concatenate([one.joints for one in some]),
        )

    def part(self, first: int, stop: int) -> Targets:
        """Views of the targets of some adjacent characters."""
        rows = slice(first, stop)
        return Targets(self.at[rows], self.heads[rows], self.layouts[rows], self.starts[first : stop + 1], self.joints)


class Step(NamedTuple):
    """What a step did to B characters.

    Parameters
    ----------
    progress : (B,) of :data:`verbs.kernels.character_state.PROGRESS`
    error : (B,) float64
    clamped : (B,) bool
    """

    progress: Records
    error: F64
    clamped: Flags


def pack_step(characters: Characters, slots: I64, step_s: float, version: int, targets: Targets, words: U32) -> Step:
    """Step characters, and write their records into ``words``."""
    frames = characters.step(slots, step_s)
    rotations = frames.rotations
    if targets.layouts[:, 1].any():
        skeleton = characters.verb.skeleton
        rotations, positions = np.empty_like(frames.rotations), np.empty((*frames.rotations.shape[:2], 3))
        pose.forward(frames.root, frames.rotations, skeleton.parents, skeleton.offsets, rotations, positions)
    pack(frames, rotations, version, targets, words)
    return Step(frames.progress, frames.blend.error, frames.blend.clamped)


class _Frames(NamedTuple):
    """Arrays of one frame of B characters; rotations are local and global."""

    progress: Records
    error: F64
    clamped: Flags
    in_transition: Flags
    root: F64
    local: F64
    world: F64
    weights: F64


class _Words(NamedTuple):
    """One buffer as words, floats and half words."""

    words: U32
    floats: F32
    halves: U16


def pack(frames: Frames, global_rotations: F64, version: int, targets: Targets, words: U32) -> None:
    """Write one record per character into ``words``.

    ``global_rotations`` are (B, J, 4); the local ones serve where no record has global ones.
    """
    blend = frames.blend
    flags = frames.in_transition
    arrays = _Frames(
        frames.progress, blend.error, blend.clamped, flags, frames.root, frames.rotations, global_rotations,
        blend.weights,
    )  # fmt: skip
    _pack_direct(arrays, targets, version, _Words(words, words.view(np.float32), words.view(np.uint16)))


def warm() -> None:
    """Compile or load the kernels before the first frame."""
    layout = Layout("q48", "local", "gltf", np.zeros(1, np.int64), 1)
    unit = np.array([[[0.0, 0.0, 0.0, 1.0]]])
    blend = Blend("", np.ones((1, 1)), np.zeros((1, 0)), np.zeros(1), np.zeros(1, np.bool_))
    frames = Frames(blend, np.zeros(1, PROGRESS), np.zeros((1, 3)), unit, np.zeros(1, np.bool_))
    pack(frames, unit, 1, Targets.of([layout], [0], [0]), np.zeros(layout.words, np.uint32))


@kernel
def _pack(frames: _Frames, targets: Targets, version: int, buffer: _Words) -> None:
    """The loop of :func:`pack`."""
    words, floats, halves = buffer.words, buffer.floats, buffer.halves
    at, starts, joints, weights = targets.at, targets.starts, targets.joints, frames.weights
    for b in range(at.shape[0]):
        to = at[b]
        if to < 0:
            continue
        encoding, space, frame = targets.layouts[b, 0], targets.layouts[b, 1], targets.layouts[b, 2]
        step = frames.progress[b]
        flags = (CLAMPED if frames.clamped[b] else 0) | (IN_TRANSITION if frames.in_transition[b] else 0)
        flags |= LAST if step["ended"] > 0.0 else 0
        words[to] = targets.heads[b] | (encoding << 16) | (flags << 24)
        words[to + 1] = version
        floats[to + 2], floats[to + 3] = step["phase"], step["time_s"]
        floats[to + 4], floats[to + 5] = frames.error[b], step["duration_s"]
        to += HEAD_WORDS
        if encoding == WEIGHTS:
            words[to] = weights.shape[1]
            for i in range(weights.shape[1]):
                floats[to + 1 + i] = weights[b, i]
            continue
        for a in range(3):
            floats[to + a] = _UNITS[frame] * _SIGN[frame, a] * frames.root[b, _SOURCE[frame, a]]
        to += 3
        first, last = starts[b], starts[b + 1]
        rotations = frames.world if space == 1 else frames.local
        if encoding == Q48 and (last - first) % 2:
            words[to + (3 * (last - first)) // 2] = 0
        for k in range(first, last):
            q = rotations[b, joints[k]]
            x = _DETERMINANT[frame] * _SIGN[frame, 0] * q[_SOURCE[frame, 0]]
            y = _DETERMINANT[frame] * _SIGN[frame, 1] * q[_SOURCE[frame, 1]]
            z = _DETERMINANT[frame] * _SIGN[frame, 2] * q[_SOURCE[frame, 2]]
            w = q[3]
            if encoding == F32_ENCODING:
                word = to + 4 * (k - first)
                floats[word], floats[word + 1], floats[word + 2], floats[word + 3] = x, y, z, w
            else:
                _smallest_three(x, y, z, w, 2 * to + 3 * (k - first), halves)


_pack_direct = direct(_pack)


@kernel
def _smallest_three(x: float, y: float, z: float, w: float, to: int, halves: U16) -> None:
    """Three of four components of a unit quaternion, 15 bits each, and which one was left out."""
    largest, value = 0, x
    if abs(y) > abs(value):
        largest, value = 1, y
    if abs(z) > abs(value):
        largest, value = 2, z
    if abs(w) > abs(value):
        largest, value = 3, w
    scale = _Q48_SCALE * np.sqrt(2.0) * (-1.0 if value < 0.0 else 1.0)
    a = y if largest == 0 else x
    b = y if largest > 1 else z
    c = z if largest == 3 else w
    halves[to] = _fifteen(a * scale) | ((largest & 1) << 15)
    halves[to + 1] = _fifteen(b * scale) | ((largest >> 1) << 15)
    halves[to + 2] = _fifteen(c * scale)


@kernel
def _fifteen(value: float) -> int:
    """A number within ±16,383 as 0 … 32,766."""
    return int(min(max(np.floor(value + 0.5), -_Q48_SCALE), _Q48_SCALE)) + int(_Q48_SCALE)
