"""The binary wire format, defined once: pose messages of streams and pose records of REST.

``docs/wire.md`` is the specification, and ``tests/golden/wire_vectors.v1.json`` holds test vectors for every client.
A record is a 24-byte head and a payload in one of four encodings. REST responses are built from one NumPy dtype;
:mod:`service.packing` writes the records of streams.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from verbs.conventions import F64, I64
from verbs.kernels.character_state import Records
from verbs.runtime.evaluate import Poses
from verbs.skeleton import Skeleton

__all__ = [
    "CLAMPED",
    "DETERMINANT",
    "ENCODINGS",
    "F32_ENCODING",
    "FRAMES",
    "HEAD",
    "HEADER",
    "HEADER_WORDS",
    "HEAD_WORDS",
    "IN_TRANSITION",
    "LAST",
    "NEW_VERSION",
    "OP_ADVERBS",
    "OP_MANY",
    "OP_POSES",
    "Q32",
    "Q32_SCALE",
    "Q48",
    "Q48_SCALE",
    "SIGN",
    "SOURCE",
    "U8",
    "U16",
    "U32",
    "UNITS",
    "WEIGHTS",
    "WIRE",
    "Flags",
    "Layout",
    "Targets",
    "encode",
    "encode_one",
    "offsets_in",
    "record",
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

F32_ENCODING, Q48, WEIGHTS, Q32 = range(4)
ENCODINGS = {"f32": F32_ENCODING, "q48": Q48, "weights": WEIGHTS, "q32": Q32}

CLAMPED, IN_TRANSITION, NEW_VERSION, LAST = 1, 2, 4, 8
"""Flags of a record; clients ignore unknown ones."""

SUPPORT_SHIFT, SUPPORT_STEPS = 4, 14
"""The upper half of the flags: 0, or 1 + support in steps of 1/14, where the client requests it."""

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
SOURCE = np.array([[0, 1, 2], [0, 1, 2], [2, 0, 1], [0, 2, 1]], np.int64)
SIGN = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])
UNITS = np.array([1.0, 1.0, 100.0, 1.0])
DETERMINANT = np.array([1.0, -1.0, -1.0, 1.0])

Q48_SCALE, Q32_SCALE = 16_383.0, 511.0

# ── records of REST ───────────────────────────────────────────────────────────────────────────────────────────────

_HEAD_AND_ROOT = struct.Struct("<HBBI4f3f")


@lru_cache(maxsize=256)
def record(joints: int) -> np.dtype[np.void]:
    """Dtype of an f32 record with a number of joints: head, root, rotations."""
    return np.dtype([*HEAD.descr, ("root", "<f4", (3,)), ("rotations", "<f4", (joints, 4))])


def support_flags(support: F64) -> U8:
    """Flags (B,) of support (B,), 0 to 1."""
    return ((1 + np.rint(SUPPORT_STEPS * support)).astype(np.uint8) << SUPPORT_SHIFT).astype(np.uint8)


def encode(
    poses: Poses,
    rotations: npt.NDArray[Any],
    version: int,
    *,
    channels: I64 | int = 0,
    ended: bool = False,
    support: F64 | None = None,
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
    support : (B,) or (1,) float64, optional
        Written to the flags.
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
    if support is not None:
        rows["flags"] |= support_flags(support)
    return rows


def encode_one(poses: Poses, rotations: npt.NDArray[np.float32], version: int, *, support: F64 | None = None) -> bytes:
    """Record of the only pose of a batch, on channel 0: the bytes of :func:`encode` in a third of the time."""
    blend = poses.blend
    flags = CLAMPED if blend.clamped[0] else 0
    if support is not None:
        flags |= int(support_flags(support)[0])
    return (
        _HEAD_AND_ROOT.pack(
            0,
            F32_ENCODING,
            flags,
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
    return np.ascontiguousarray(skeleton.offsets[:, SOURCE[k]] * SIGN[k] * UNITS[k])


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
        payloads = {
            "f32": 3 + 4 * count,
            "q48": 3 + (3 * count + 1) // 2,
            "weights": 1 + self.examples,
            "q32": 3 + count,
        }
        return HEAD_WORDS + payloads[self.encoding]

    def numbers(self) -> tuple[int, int, int, int]:
        """Encoding, space, frame, and whether the record is the pose as it is computed, from the root on."""
        space, frame = int(self.space == "global"), FRAMES[self.frame]
        plain = space == frame == 0 and np.array_equal(self.joints, np.arange(len(self.joints)))
        return ENCODINGS[self.encoding], space, frame, int(plain)


class Targets(NamedTuple):
    """Places and formats of the records of B characters.

    Parameters
    ----------
    at : (B,) int64
        First word of each record; -1 writes none.
    heads : (B,) uint32
        Channel, and flags beside those of the frame in the high byte.
    layouts : (B, 4) int64
        :meth:`Layout.numbers`.
    spans : (B, 2) int64
        Where the joints of each begin and end in ``joints``.
    joints : (…,) int64
        Joints of all layouts; those of a layout that several characters have stand here once.
    """

    at: I64
    heads: U32
    layouts: I64
    spans: I64
    joints: I64

    @classmethod
    def of(cls, layouts: Sequence[Layout], at: Sequence[int], heads: Sequence[int]) -> Targets:
        """Gather the targets of several characters."""
        known: dict[int, tuple[int, ...]] = {}
        joints: list[I64] = []
        count = 0
        for layout in layouts:
            if id(layout) not in known:
                known[id(layout)] = (*layout.numbers(), count, count + len(layout.joints))
                joints.append(layout.joints)
                count += len(layout.joints)
        rows = np.array([known[id(layout)] for layout in layouts], np.int64).reshape(-1, 6)
        return cls(
            np.array(at, np.int64),
            np.array(heads, np.uint32),
            np.ascontiguousarray(rows[:, :4]),
            np.ascontiguousarray(rows[:, 4:]),
            np.concatenate([np.zeros(0, np.int64), *joints]),
        )

    @classmethod
    def joined(cls, some: Sequence[Targets]) -> Targets:
        """Targets of several groups of characters, one after another."""
        shifts = np.cumsum([0, *(len(one.joints) for one in some[:-1])])
        return cls(
            np.concatenate([one.at for one in some]),
            np.concatenate([one.heads for one in some]),
            np.concatenate([one.layouts for one in some]),
            np.concatenate([one.spans + shift for one, shift in zip(some, shifts.tolist(), strict=True)]),
            np.concatenate([one.joints for one in some]),
        )

    def only(self, rows: I64) -> Targets:
        """The targets of some of the characters."""
        return Targets(self.at[rows], self.heads[rows], self.layouts[rows], self.spans[rows], self.joints)

    def part(self, first: int, stop: int) -> Targets:
        """Views of the targets of some adjacent characters."""
        rows = slice(first, stop)
        return Targets(self.at[rows], self.heads[rows], self.layouts[rows], self.spans[rows], self.joints)
