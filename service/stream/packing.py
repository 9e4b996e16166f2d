"""Frames of characters → records of a pose message, in one compiled call. ``docs/wire.md`` is the specification."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.conventions import F32, F64, I64
from verbs.kernels import character_state
from verbs.kernels.compile import kernel
from verbs.runtime.characters import Frames
from verbs.runtime.evaluate import Blend
from verbs.skeleton import Skeleton

__all__ = ["ENCODINGS", "FRAMES", "HEADER", "OP_POSES", "WIRE", "Layout", "Targets", "offsets_in", "pack", "warm"]

OP_POSES, WIRE = 0x01, 1
U32 = npt.NDArray[np.uint32]
U16 = npt.NDArray[np.uint16]
Flags = npt.NDArray[np.bool_]

HEADER = struct.Struct("<BBHIQI")
"""Head of a pose message: op, wire version, records, sequence, time in ns, dropped."""
HEADER_WORDS, HEAD_WORDS = HEADER.size // 4, 6

FULL, Q48, WEIGHTS = range(3)
ENCODINGS = {"f32": FULL, "q48": Q48, "weights": WEIGHTS}

FRAMES = {"gltf": 0, "unity": 1, "unreal": 2, "zup": 3}
_SOURCE = np.array([[0, 1, 2], [0, 1, 2], [2, 0, 1], [0, 2, 1]], np.int64)
_SIGN = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])
_UNITS = np.array([1.0, 1.0, 100.0, 1.0])
_DETERMINANT = np.array([1.0, -1.0, -1.0, 1.0])

_Q48_SCALE = 16_383.0


def offsets_in(skeleton: Skeleton, frame: str) -> F64:
    """Offsets (J, 3) of a skeleton in another frame, in its unit of length."""
    k = FRAMES[frame]
    return np.ascontiguousarray(skeleton.offsets[:, _SOURCE[k]] * _SIGN[k] * _UNITS[k])


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """How the records of one channel are written.

    Parameters
    ----------
    encoding, space, frame : str
    joints : (J,) int64
        Joints of the verb, in the order of the record.
    examples : int
        How many weights there are.
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
        """Encoding, space and frame as :func:`pack` wants them."""
        return ENCODINGS[self.encoding], int(self.space == "global"), FRAMES[self.frame]


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Where the records of B characters go, and how each is written.

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
        """Gather what was said of each character."""
        return cls(
            np.array(at, np.int64),
            np.array(heads, np.uint32),
            np.array([layout.numbers() for layout in layouts], np.int64),
            np.cumsum([0, *(len(layout.joints) for layout in layouts)], dtype=np.int64),
            np.concatenate([layout.joints for layout in layouts]),
        )

    def part(self, first: int, stop: int) -> Targets:
        """Those of some characters in a row; whatever is written to these is written to all."""
        rows = slice(first, stop)
        return Targets(self.at[rows], self.heads[rows], self.layouts[rows], self.starts[first : stop + 1], self.joints)


def pack(frames: Frames, turns: F64, version: int, targets: Targets, words: U32) -> None:
    """Write one record per character into ``words``.

    ``turns`` (B, J, 4) are global rotations, or the local ones where nobody asks for global ones.
    """
    blend = frames.blend
    _pack(
        frames.ends,
        blend.error,
        blend.clamped,
        frames.in_transition,
        frames.root,
        frames.rotations,
        turns,
        blend.weights,
        targets.at,
        targets.heads,
        version,
        targets.layouts,
        targets.starts,
        targets.joints,
        _SOURCE,
        _SIGN,
        _UNITS,
        _DETERMINANT,
        words,
        words.view(np.float32),
        words.view(np.uint16),
    )


def warm() -> None:
    """Compile or load the kernels, so that no frame waits for them."""
    layout = Layout("q48", "local", "gltf", np.zeros(1, np.int64), 1)
    unit = np.array([[[0.0, 0.0, 0.0, 1.0]]])
    blend = Blend("", np.ones((1, 1)), np.zeros((1, 0)), np.zeros(1), np.zeros(1, np.bool_))
    frames = Frames(blend, np.zeros((1, character_state.REPORTS)), np.zeros((1, 3)), unit, np.zeros(1, np.bool_))
    pack(frames, unit, 1, Targets.of([layout], [0], [0]), np.zeros(layout.words, np.uint32))


@kernel
def _pack(
    ends: F64,
    error: F64,
    clamped: Flags,
    moving: Flags,
    root: F64,
    local: F64,
    turned: F64,
    weights: F64,
    at: I64,
    heads: U32,
    version: int,
    layouts: I64,
    starts: I64,
    joints: I64,
    source: I64,
    sign: F64,
    units: F64,
    determinant: F64,
    words: U32,
    floats: F32,
    halves: U16,
) -> None:
    """The loop of :func:`pack`."""
    for b in range(at.shape[0]):
        to = at[b]
        if to < 0:
            continue
        encoding, space, frame = layouts[b, 0], layouts[b, 1], layouts[b, 2]
        flags = (1 if clamped[b] else 0) | (2 if moving[b] else 0) | (8 if ends[b, character_state.ENDED] > 0.0 else 0)
        words[to] = heads[b] | (encoding << 16) | (flags << 24)
        words[to + 1] = version
        floats[to + 2], floats[to + 3] = ends[b, character_state.AT], ends[b, character_state.TIME]
        floats[to + 4], floats[to + 5] = error[b], ends[b, character_state.DURATION]
        to += HEAD_WORDS
        if encoding == WEIGHTS:
            words[to] = weights.shape[1]
            for i in range(weights.shape[1]):
                floats[to + 1 + i] = weights[b, i]
            continue
        for a in range(3):
            floats[to + a] = units[frame] * sign[frame, a] * root[b, source[frame, a]]
        to += 3
        first, last = starts[b], starts[b + 1]
        rotations = turned if space == 1 else local
        if encoding == Q48 and (last - first) % 2:
            words[to + (3 * (last - first)) // 2] = 0
        for k in range(first, last):
            q = rotations[b, joints[k]]
            x = determinant[frame] * sign[frame, 0] * q[source[frame, 0]]
            y = determinant[frame] * sign[frame, 1] * q[source[frame, 1]]
            z = determinant[frame] * sign[frame, 2] * q[source[frame, 2]]
            w = q[3]
            if encoding == FULL:
                place = to + 4 * (k - first)
                floats[place], floats[place + 1], floats[place + 2], floats[place + 3] = x, y, z, w
            else:
                _smallest_three(x, y, z, w, 2 * to + 3 * (k - first), halves)


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
