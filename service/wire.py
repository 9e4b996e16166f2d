"""Binary pose records: one NumPy dtype, encode and decode. ``docs/wire.md`` is the specification."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from verbs.conventions import I64
from verbs.runtime.evaluate import Poses

__all__ = ["CLAMPED", "ENCODING_F32", "HEAD", "LAST", "decode", "encode", "encode_one", "record"]

ENCODING_F32 = 0

CLAMPED, IN_TRANSITION, NEW_VERSION, LAST = 1, 2, 4, 8
"""Flags of a record; the server sets, and clients ignore those that they do not know."""

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
"""The 24 bytes that every record starts with."""

_HEAD_AND_ROOT = struct.Struct("<HBBI4f3f")

Records = npt.NDArray[np.void]


@lru_cache(maxsize=256)
def record(joints: int) -> np.dtype[np.void]:
    """A whole record of so many joints: head, root, rotations; a multiple of 4 bytes long as it is."""
    return np.dtype([*HEAD.descr, ("root", "<f4", (3,)), ("rotations", "<f4", (joints, 4))])


def encode(
    poses: Poses, turns: npt.NDArray[Any], version: int, *, channels: I64 | int = 0, ended: bool = False
) -> Records:
    """Records (B,) of a batch of poses, in one array that is sent as it lies in memory.

    Parameters
    ----------
    poses : Poses
    turns : (B, J, 4)
        The rotations to send, in the requested space and of the requested joints.
    version : int
        The verb's.
    channels : (B,) int64 or int
    ended : bool
        Whether the last record ends a motion.
    """
    rows = np.empty(len(turns), record(turns.shape[1]))
    blend = poses.blend
    rows["channel"] = channels
    rows["encoding"] = ENCODING_F32
    rows["flags"] = blend.clamped  # True is 1 is CLAMPED
    rows["version"] = version
    rows["phase"] = poses.phase
    rows["time"] = poses.time_s
    rows["error"] = blend.error
    rows["duration"] = poses.duration_s
    rows["root"] = poses.root
    rows["rotations"] = turns
    if ended:
        rows["flags"][-1] |= LAST
    return rows


def encode_one(poses: Poses, turns: npt.NDArray[np.float32], version: int) -> bytes:
    """The record of the only pose of a batch, on channel 0: the bytes of :func:`encode` in a third of the time."""
    blend = poses.blend
    return (
        _HEAD_AND_ROOT.pack(
            0,
            ENCODING_F32,
            CLAMPED if blend.clamped[0] else 0,
            version,
            poses.phase[0],
            poses.time_s[0],
            blend.error[0],
            poses.duration_s[0],
            *poses.root[0].tolist(),
        )
        + turns.astype("<f4", copy=False).tobytes()
    )


def decode(content: bytes, joints: int) -> Records:
    """Records of so many joints, as a read-only view of what was received; raises ValueError where it does not fit."""
    return np.frombuffer(content, record(joints))
