"""The binary wire format, defined once: pose messages of streams and pose records of REST.

``docs/wire.md`` is the specification, and ``tests/golden/wire_vectors.v1.json`` holds test vectors for every client.
A record is a 24-byte head and a payload in one of four encodings. REST responses are built from one NumPy dtype;
streams write the records of many characters in one compiled call.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from verbs import library
from verbs.conventions import F32, F64, I64
from verbs.kernels.character_state import PROGRESS, Records
from verbs.kernels.compile import direct, kernel
from verbs.kernels.crowd_pose import TILE, Curves, finish_single, share, sort_by_interval, sums
from verbs.kernels.inertialization import place_row
from verbs.kernels.pose import forward, global_rotations
from verbs.runtime.characters import Characters, Frames, Step
from verbs.runtime.evaluate import Blend, Evaluator, Poses
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

F32_ENCODING, Q48, WEIGHTS, Q32 = range(4)
ENCODINGS = {"f32": F32_ENCODING, "q48": Q48, "weights": WEIGHTS, "q32": Q32}

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

_Q48_SCALE, _Q32_SCALE = 16_383.0, 511.0

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

    def part(self, first: int, stop: int) -> Targets:
        """Views of the targets of some adjacent characters."""
        rows = slice(first, stop)
        return Targets(self.at[rows], self.heads[rows], self.layouts[rows], self.spans[rows], self.joints)


class _Heads(NamedTuple):
    """What the heads of the records of B characters contain."""

    progress: Records
    error: F64
    clamped: Flags
    in_transition: Flags


class _Posed(NamedTuple):
    """Weights and poses of R of them, whose numbers are ``chosen``; ``world`` are global rotations."""

    chosen: I64
    weights: F64
    root: F64
    local: F64
    world: F64


class _Sums(NamedTuple):
    """Characters whose poses are sums of curves: ``slots`` of all, numbers of the ``chosen``, state and weights."""

    slots: I64
    chosen: I64
    state: Records
    weights: F64
    curves: Curves
    striding: bool
    parents: I64


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
    heads = _Heads(frames.progress, blend.error, blend.clamped, frames.in_transition)
    chosen = np.arange(len(frames.root))
    posed = _Posed(chosen, blend.weights, frames.root, frames.rotations, global_rotations)
    _pack_direct(heads, posed, targets, version, _words(words))


def pack_step(characters: Characters, slots: I64, step_s: float, version: int, targets: Targets, words: U32) -> Step:
    """Step characters, and write one record for each into ``words``.

    Nothing is allocated per character but what is returned; no two calls for the same characters may run at once.

    Parameters
    ----------
    characters : Characters
    slots : (B,) int64
        C-contiguous, each at most once.
    step_s : float
        Seconds, above 0.
    version : int
        Version of the verb.
    targets : Targets
        Of the B characters; where ``at`` is -1 the character moves, and no record is written.
    words : (…,) uint32
    """
    step = characters.advance(slots, step_s)
    heads, buffer = _Heads(*step[:4]), _words(words)
    parents, crowd = characters.verb.skeleton.parents, characters.crowd
    if len(step.complete):
        source = _Sums(
            slots, step.complete, crowd.state, crowd.weights, characters.curves, characters.striding, parents
        )  # fmt: skip
        _pack_sums_direct(heads, source, targets, version, buffer)
    if len(step.rest):
        world, places = np.empty_like(step.rotations), np.empty((len(step.rest), len(parents), 3))
        forward(step.root, step.rotations, parents, characters.verb.skeleton.offsets, world, places)
        posed = _Posed(step.rest, step.weights, step.root, step.rotations, world)
        _pack_direct(heads, posed, targets, version, buffer)
    return step


def _words(words: U32) -> _Words:
    return _Words(words, words.view(np.float32), words.view(np.uint16))


def warm() -> None:
    """Compile or load the kernels before the first frame."""
    layout = Layout("q48", "local", "gltf", np.zeros(1, np.int64), 1)
    unit = np.array([[[0.0, 0.0, 0.0, 1.0]]])
    blend = Blend("", np.ones((1, 1)), np.zeros((1, 0)), np.zeros(1), np.zeros(1, np.bool_))
    frames = Frames(blend, np.zeros(1, PROGRESS), np.zeros((1, 3)), unit, np.zeros(1, np.bool_))
    pack(frames, unit, 1, Targets.of([layout], [0], [0]), np.zeros(layout.words, np.uint32))
    characters = Characters(Evaluator(library.load("arm3")))
    slots, targets = np.array([characters.add()]), Targets.of([replace(layout, encoding="f32")], [0], [0])
    for _ in range(2):  # in a transition, and without one
        pack_step(characters, slots, 0.01, 1, targets, np.zeros(64, np.uint32))
        slots = np.array([characters.go_on(characters, int(slots[0]))])


@kernel
def _pack(heads: _Heads, posed: _Posed, targets: Targets, version: int, buffer: _Words) -> None:
    """Records of characters whose poses are computed."""
    for r in range(posed.chosen.shape[0]):
        b = posed.chosen[r]
        if targets.at[b] < 0:
            continue
        to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
        if targets.layouts[b, 0] == WEIGHTS:
            _write_weights(posed.weights[r], to, buffer.words, buffer.floats)
            continue
        rotations = posed.world[r] if targets.layouts[b, 1] == 1 else posed.local[r]
        _write_pose(b, to, posed.root[r], rotations, targets, buffer)


_pack_direct = direct(_pack)


@kernel
def _pack_sums(heads: _Heads, source: _Sums, targets: Targets, version: int, buffer: _Words) -> None:
    """Records of characters whose poses are sums of curves, each sum normalised and written once.

    They go through in tiles, sorted by knot interval; see :mod:`verbs.kernels.crowd_pose`.
    """
    slots, chosen, state, weights, curves, striding, parents = source
    rows, intervals, mode, references = curves
    needed, order, count = np.empty(chosen.shape[0], np.int64), np.empty(chosen.shape[0], np.int64), 0
    phases = np.empty(slots.shape[0])
    for c in range(chosen.shape[0]):
        b = chosen[c]
        if targets.at[b] >= 0:
            phases[b] = heads.progress[b]["phase"]
            needed[count] = b
            count += targets.layouts[b, 0] != WEIGHTS
            if targets.layouts[b, 0] == WEIGHTS:
                to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
                _write_weights(weights[slots[b], state[slots[b]]["weights"]], to, buffer.words, buffer.floats)
    sort_by_interval(needed[:count], phases, intervals, order)
    most, width = min(TILE, count), rows.shape[1]
    shares, tile = np.empty((most, 4 * weights.shape[2]), np.float32), np.empty((most, width), np.float32)
    scales, at, taps = np.empty(most * width // 4, np.float32), np.empty(most, np.int64), np.empty(4)
    world = np.empty((parents.shape[0], 4))
    for start in range(0, count, TILE):
        size = min(TILE, count - start)
        for k in range(size):
            s = slots[order[start + k]]
            at[k] = share(weights[s, state[s]["weights"]], phases[order[start + k]], intervals, taps, shares[k])
        sums(shares[:size], at[:size], rows, tile[:size])
        finish_single(tile[:size], scales, mode, references)
        for k in range(size):
            b = order[start + k]
            place_row(state[slots[b]], striding, tile[k])
            to = _write_head(b, heads, targets, version, buffer.words, buffer.floats)
            if targets.layouts[b, 3] == 1:
                _write_plain(targets.layouts[b, 0], tile[k], targets.spans[b, 1] - targets.spans[b, 0], to, buffer)
                continue
            rotations = tile[k, 4:].reshape(parents.shape[0], 4)
            if targets.layouts[b, 1] == 1:
                global_rotations(rotations, parents, world)
                _write_pose(b, to, tile[k], world, targets, buffer)
            else:
                _write_pose(b, to, tile[k], rotations, targets, buffer)


_pack_sums_direct = direct(_pack_sums)


@kernel
def _write_head(b: int, heads: _Heads, targets: Targets, version: int, words: U32, floats: F32) -> int:
    """Write the head of one record; return the first word of its payload."""
    to, step = targets.at[b], heads.progress[b]
    flags = (CLAMPED if heads.clamped[b] else 0) | (IN_TRANSITION if heads.in_transition[b] else 0)
    flags |= LAST if step["ended"] > 0.0 else 0
    words[to] = targets.heads[b] | (targets.layouts[b, 0] << 16) | (flags << 24)
    words[to + 1] = version
    floats[to + 2], floats[to + 3] = step["phase"], step["time_s"]
    floats[to + 4], floats[to + 5] = heads.error[b], step["duration_s"]
    return int(to + HEAD_WORDS)


@kernel
def _write_weights(weights: F64, to: int, words: U32, floats: F32) -> None:
    """Write the payload of a record of weights (N,)."""
    words[to] = weights.shape[0]
    for i in range(weights.shape[0]):
        floats[to + 1 + i] = weights[i]


@kernel
def _write_plain(encoding: int, row: F32, joints: int, to: int, buffer: _Words) -> None:
    """Write the payload of the first joints of a row (4 + 4·J,), in the space and frame that it is in."""
    words, floats, halves = buffer.words, buffer.floats, buffer.halves
    for a in range(3):
        floats[to + a] = row[a]
    to += 3
    if encoding == F32_ENCODING:
        for c in range(4 * joints):
            floats[to + c] = row[4 + c]
        return
    if encoding == Q48 and joints % 2:
        words[to + (3 * joints) // 2] = 0
    for j in range(joints):
        x, y, z, w = row[4 * j + 4], row[4 * j + 5], row[4 * j + 6], row[4 * j + 7]
        if encoding == Q48:
            _three_in_48(x, y, z, w, 2 * to + 3 * j, halves)
        else:
            words[to + j] = _three_in_32(x, y, z, w)


@kernel
def _write_pose(b: int, to: int, root: Any, rotations: Any, targets: Targets, buffer: _Words) -> None:
    """Write the payload of any layout of a root (3,) and rotations (J, 4) in the layout's space."""
    words, floats, halves = buffer.words, buffer.floats, buffer.halves
    encoding, frame = targets.layouts[b, 0], targets.layouts[b, 2]
    for a in range(3):
        floats[to + a] = _UNITS[frame] * _SIGN[frame, a] * root[_SOURCE[frame, a]]
    to += 3
    first, last = targets.spans[b, 0], targets.spans[b, 1]
    if encoding == Q48 and (last - first) % 2:
        words[to + (3 * (last - first)) // 2] = 0
    for k in range(first, last):
        q = rotations[targets.joints[k]]
        x = _DETERMINANT[frame] * _SIGN[frame, 0] * q[_SOURCE[frame, 0]]
        y = _DETERMINANT[frame] * _SIGN[frame, 1] * q[_SOURCE[frame, 1]]
        z = _DETERMINANT[frame] * _SIGN[frame, 2] * q[_SOURCE[frame, 2]]
        w = q[3]
        if encoding == F32_ENCODING:
            word = to + 4 * (k - first)
            floats[word], floats[word + 1], floats[word + 2], floats[word + 3] = x, y, z, w
        elif encoding == Q48:
            _three_in_48(x, y, z, w, 2 * to + 3 * (k - first), halves)
        else:
            words[to + k - first] = _three_in_32(x, y, z, w)


@kernel
def _three(x: float, y: float, z: float, w: float) -> tuple[int, float, float, float]:
    """Which of four components of a quaternion is the largest, and the others where it is positive, times √2."""
    largest, value = 0, x
    if abs(y) > abs(value):
        largest, value = 1, y
    if abs(z) > abs(value):
        largest, value = 2, z
    if abs(w) > abs(value):
        largest, value = 3, w
    scale = np.sqrt(2.0) * (-1.0 if value < 0.0 else 1.0)
    a = y if largest == 0 else x
    b = y if largest > 1 else z
    c = z if largest == 3 else w
    return largest, scale * a, scale * b, scale * c


@kernel
def _three_in_48(x: float, y: float, z: float, w: float, to: int, halves: U16) -> None:
    """Write three of four components of a unit quaternion, 15 bits each, and which one was left out."""
    largest, a, b, c = _three(x, y, z, w)
    halves[to] = _steps(a, _Q48_SCALE) | ((largest & 1) << 15)
    halves[to + 1] = _steps(b, _Q48_SCALE) | ((largest >> 1) << 15)
    halves[to + 2] = _steps(c, _Q48_SCALE)


@kernel
def _three_in_32(x: float, y: float, z: float, w: float) -> int:
    """Three of four components of a unit quaternion, 10 bits each, and which one was left out, as one word."""
    largest, a, b, c = _three(x, y, z, w)
    low, middle, high = _steps(a, _Q32_SCALE), _steps(b, _Q32_SCALE), _steps(c, _Q32_SCALE)
    return low | (middle << 10) | (high << 20) | (largest << 30)


@kernel
def _steps(value: float, scale: float) -> int:
    """A number within ±1 as 0 … 2 · scale."""
    return int(min(max(np.floor(value * scale + 0.5), -scale), scale)) + int(scale)
