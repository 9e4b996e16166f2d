"""Pose records: the 24-byte header and its payloads as NumPy dtypes. Specification: ``docs/wire.md``."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError

__all__ = [
    "CLAMPED",
    "ENCODINGS",
    "F32",
    "HEADER",
    "IN_TRANSITION",
    "LAST",
    "NEW_VERSION",
    "Q48",
    "WEIGHTS",
    "decode_q48",
    "joint_count",
    "parse_records",
    "record_dtype",
]

HEADER = np.dtype(
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
"""Header of every record, 24 bytes."""

CLAMPED, IN_TRANSITION, NEW_VERSION, LAST = 1, 2, 4, 8
"""Bits of ``flags``; unknown bits are ignored."""

F32, Q48, WEIGHTS = 0, 1, 2
"""Encodings, as numbered in the header."""

ENCODINGS = {"f32": F32, "q48": Q48, "weights": WEIGHTS}
"""Encodings by their names in ``open`` and ``opened``."""

_Q48_STEPS = 16_383
_Q48_SCALE = 1.0 / (_Q48_STEPS * math.sqrt(2.0))
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Row k: the components that are stored where component k is omitted."""

Records = npt.NDArray[np.void]


@lru_cache(maxsize=256)
def record_dtype(encoding: int, count: int) -> np.dtype[np.void]:
    """The dtype of a whole record: header, payload, padding.

    Parameters
    ----------
    encoding : int
        One of ``F32``, ``Q48``, ``WEIGHTS``.
    count : int
        Number of joints; for ``WEIGHTS``: of examples.
    """
    fields: list[tuple[str, str, tuple[int, ...]]]
    if encoding == WEIGHTS:
        fields = [("count", "<u2", ()), ("zero", "<u2", ()), ("weights", "<f4", (count,))]
    elif encoding == Q48:
        fields = [("root", "<f4", (3,)), ("words", "<u2", (count, 3)), ("padding", "<u2", (count % 2,))]
    else:
        fields = [("root", "<f4", (3,)), ("rotations", "<f4", (count, 4))]
    return np.dtype([*HEADER.descr, *fields])


def joint_count(content: bytes, records: int) -> int:
    """Number of joints of f32 records, derived from the length of all of them.

    Raises
    ------
    DecodeError
        If the length fits no number of joints.
    """
    joints, rest = divmod(len(content) - 36 * records, 16 * records) if records else (0, 1)
    if rest or joints < 1:
        raise DecodeError(f"{len(content)} bytes are not {records} records of 36 + 16·J bytes")
    return joints


def parse_records(content: bytes, joints: int) -> Records:
    """Parse the f32 records of a REST response.

    Parameters
    ----------
    content : bytes
    joints : int

    Returns
    -------
    (B,) structured
        A read-only view; fields of :data:`HEADER`, ``root`` (3,) and ``rotations`` (J, 4).

    Raises
    ------
    DecodeError
        If the length does not fit, the encoding is not f32, or a number is not finite.
    """
    layout = record_dtype(F32, joints)
    if not content or len(content) % layout.itemsize:
        raise DecodeError(
            f"{len(content)} bytes are not whole records of {joints} joints, {layout.itemsize} bytes each"
        )
    rows: Records = np.frombuffer(content, layout)
    if (rows["encoding"] != F32).any():
        raise DecodeError(f"records of encoding {rows['encoding'].max()}; expected {F32}")
    if not (np.isfinite(rows["root"]).all() and np.isfinite(rows["rotations"]).all()):
        raise DecodeError("non-finite numbers in records")
    return rows


def decode_q48(words: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    """Decode q48, "smallest three": words (..., 3) to unit quaternions (..., 4)."""
    omitted = (words[..., :1] >> 15).astype(np.intp) + 2 * (words[..., 1:2] >> 15)
    kept = ((words & 0x7FFF).astype(np.float64) - _Q48_STEPS) * _Q48_SCALE
    largest = np.sqrt(np.maximum(0.0, 1.0 - (kept * kept).sum(-1, keepdims=True)))
    rotations = np.empty((*words.shape[:-1], 4))
    np.put_along_axis(rotations, _OTHERS[omitted[..., 0]], kept, -1)
    np.put_along_axis(rotations, omitted, largest, -1)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)  # only malformed input exceeds length 1
    return rotations.astype(np.float32)
