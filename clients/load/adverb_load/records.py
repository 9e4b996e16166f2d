"""Pose messages read in full and doubted: lengths, encodings, unit quaternions, finite numbers."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["HEADER", "DecodeError", "Layout", "Record", "decode", "layout_of"]

HEADER = struct.Struct("<BBHIQI")
HEAD = struct.Struct("<HBBIffff")
POSES, WIRE = 0x01, 1
F32, Q48, WEIGHTS = range(3)
ENCODINGS = {"f32": F32, "q48": Q48, "weights": WEIGHTS}

UNIT = 1e-5
"""How far a quaternion of 32-bit floats may be from length one."""

Q48_SCALE = 16_383.0 * math.sqrt(2.0)
KNOWN_FLAGS = 0x0F

Numbers = npt.NDArray[np.float64]


class DecodeError(Exception):
    """A message is not what docs/wire.md says."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What a channel's records look like, as ``opened`` promised."""

    encoding: int
    joints: int
    record_bytes: int


@dataclass(frozen=True, slots=True)
class Record:
    """One channel at one tick; ``rotations`` (J, 4) and ``root`` (3,), or ``weights`` (N,)."""

    channel: int
    flags: int
    version: int
    phase: float
    error: float
    root: Numbers | None
    rotations: Numbers | None
    weights: Numbers | None


def layout_of(opened: Mapping[str, Any]) -> Layout:
    """The layout that an ``opened`` message promises; raises :class:`DecodeError`."""
    encoding, joints = opened["encoding"], len(opened["joints"])
    size = int(opened["record_bytes"])
    expected = {"f32": 36 + 16 * joints, "q48": 36 + (6 * joints + 3) // 4 * 4}.get(encoding, size)
    if encoding not in ENCODINGS or size != expected or size % 4:
        raise DecodeError(f"records of {size} bytes for {joints} joints as {encoding}")
    return Layout(ENCODINGS[encoding], joints, size)


def decode(content: bytes, layouts: Mapping[int, Layout]) -> list[Record]:
    """All records of a pose message; raises :class:`DecodeError`."""
    op, wire, count, _, _, _ = HEADER.unpack_from(content)
    if op != POSES or wire != WIRE:
        raise DecodeError(f"message 0x{op:02x} of wire {wire}")
    found, at = [], HEADER.size
    for _ in range(count):
        if len(content) - at < HEAD.size:
            raise DecodeError(f"{len(content) - at} bytes where a record's head should be")
        channel, encoding = HEAD.unpack_from(content, at)[:2]
        layout = layouts.get(channel)
        if layout is None:
            raise DecodeError(f"a record of channel {channel}, which was never opened")
        if encoding != layout.encoding:
            raise DecodeError(f"encoding {encoding} on channel {channel}, where {layout.encoding} was promised")
        if len(content) - at < layout.record_bytes:
            raise DecodeError(f"{len(content) - at} bytes where {layout.record_bytes} should be")
        found.append(_record(content, at, layout))
        at += layout.record_bytes
    if at != len(content):
        raise DecodeError(f"{len(content) - at} bytes behind the last of {count} records")
    return found


def _record(content: bytes, at: int, layout: Layout) -> Record:
    channel, _, flags, version, phase, time_s, error, duration_s = HEAD.unpack_from(content, at)
    if not (math.isfinite(phase) and 0.0 <= phase <= 1.0 and time_s >= 0.0 and duration_s > 0.0):
        raise DecodeError(f"phase {phase}, time {time_s} s, duration {duration_s} s on channel {channel}")
    if not error >= 0.0 and not math.isnan(error):
        raise DecodeError(f"error {error} on channel {channel}")
    start = at + HEAD.size
    root = rotations = weights = None
    if layout.encoding == WEIGHTS:
        weights = _weights(content, start, layout)
    else:
        root = np.frombuffer(content, "<f4", 3, start).astype(np.float64)
        body = _full if layout.encoding == F32 else _smallest_three
        rotations = body(content, start + 12, layout.joints)
        if not np.isfinite(root).all():
            raise DecodeError(f"root {root} on channel {channel}")
    return Record(channel, flags & KNOWN_FLAGS, version, phase, error, root, rotations, weights)


def _full(content: bytes, start: int, joints: int) -> Numbers:
    rotations = np.frombuffer(content, "<f4", 4 * joints, start).reshape(joints, 4).astype(np.float64)
    length = np.linalg.norm(rotations, axis=1)
    if not (np.abs(length - 1.0) <= UNIT).all():
        raise DecodeError(f"a quaternion of length {length[np.argmax(np.abs(length - 1.0))]}")
    return rotations


def _smallest_three(content: bytes, start: int, joints: int) -> Numbers:
    words = np.frombuffer(content, "<u2", 3 * joints, start).reshape(joints, 3)
    if (words[:, 2] >> 15).any() or ((words & 0x7FFF) > 32_766).any():
        raise DecodeError("q48 words out of range")
    left_out = (words[:, 0] >> 15) + 2 * (words[:, 1] >> 15)
    three = ((words & 0x7FFF).astype(np.float64) - 16_383.0) / Q48_SCALE
    rest = 1.0 - np.square(three).sum(axis=1)
    if (rest < 0.25 - 1e-3).any():  # the largest of four is half at least
        raise DecodeError("a q48 rotation whose largest component is not the one left out")
    rotations = np.empty((joints, 4))
    rows = np.arange(joints)
    kept = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[left_out]
    rotations[rows[:, None], kept] = three
    rotations[rows, left_out] = np.sqrt(rest)
    return rotations


def _weights(content: bytes, start: int, layout: Layout) -> Numbers:
    count, zero = struct.unpack_from("<HH", content, start)
    if zero or HEAD.size + 4 + 4 * count != layout.record_bytes:
        raise DecodeError(f"{count} weights in a record of {layout.record_bytes} bytes")
    weights = np.frombuffer(content, "<f4", count, start + 4).astype(np.float64)
    if not abs(weights.sum() - 1.0) < 1e-4:
        raise DecodeError(f"weights that sum to {weights.sum()}")
    return weights
