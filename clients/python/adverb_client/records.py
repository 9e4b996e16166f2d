"""Pose records: the 24-byte header and its payloads as NumPy dtypes. Specification: ``docs/wire.md``."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError

__all__ = [
    "CLAMPED",
    "ENCODINGS",
    "ERROR",
    "F32",
    "HEADER",
    "IN_TRANSITION",
    "LAST",
    "NEW_VERSION",
    "Q32",
    "Q48",
    "WEIGHTS",
    "decode_q32",
    "decode_q48",
    "joint_count",
    "parse_records",
    "record_dtype",
    "support_of",
    "supports_of",
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

SUPPORT_SHIFT, SUPPORT_STEPS = 4, 14
"""The upper half of ``flags``: 0, or 1 + support in steps of 1/14."""

ERROR = 2
"""Place of the error in ``floats`` of a record, the only number that may be NaN."""

F32, Q48, WEIGHTS, Q32 = 0, 1, 2, 3
"""Encodings, as numbered in the header."""

ENCODINGS = {"f32": F32, "q48": Q48, "weights": WEIGHTS, "q32": Q32}
"""Encodings by their names in ``open`` and ``opened``."""

_Q48_STEPS, _Q32_STEPS = 16_383, 511
_SHIFTS = np.array([0, 10, 20], np.uint32)
_ORDER = np.array([[0, 1, 2, 3], [1, 0, 2, 3], [1, 2, 0, 3], [1, 2, 3, 0]])
"""Row k: where x, y, z, w stand among the omitted component and the three stored ones, if component k is omitted."""

Records = npt.NDArray[np.void]


@lru_cache(maxsize=256)
def record_dtype(encoding: int, count: int) -> np.dtype[np.void]:
    """The dtype of a whole record: header, payload, padding.

    Parameters
    ----------
    encoding : int
        One of ``F32``, ``Q48``, ``Q32``, ``WEIGHTS``.
    count : int
        Number of joints; for ``WEIGHTS``: of examples.

    Returns
    -------
    dtype
        Fields of :data:`HEADER` and of the payload. ``floats`` overlaps them: all float32 numbers from ``phase`` on
        that are adjacent, of which :data:`ERROR` is the error.
    """
    fields: list[tuple[str, str, tuple[int, ...]]]
    if encoding == WEIGHTS:
        floats = 4
        fields = [("count", "<u2", ()), ("zero", "<u2", ()), ("weights", "<f4", (count,))]
    elif encoding == Q48:
        floats = 7
        fields = [("root", "<f4", (3,)), ("words", "<u2", (count, 3)), ("padding", "<u2", (count % 2,))]
    elif encoding == Q32:
        floats = 7
        fields = [("root", "<f4", (3,)), ("words", "<u4", (count,))]
    else:
        floats = 7 + 4 * count
        fields = [("root", "<f4", (3,)), ("rotations", "<f4", (count, 4))]
    record = np.dtype([*HEADER.descr, *fields])
    columns = {name: (column[0], column[1]) for name, column in (record.fields or {}).items()}
    columns["floats"] = (np.dtype(("<f4", (floats,))), columns["phase"][1])
    return np.dtype(
        {
            "names": list(columns),
            "formats": [kind for kind, _ in columns.values()],
            "offsets": [offset for _, offset in columns.values()],
            "itemsize": record.itemsize,
        }
    )


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
    return _completed(words & 0x7FFF, (words[..., 0] >> 15) + 2 * (words[..., 1] >> 15), _Q48_STEPS)


def decode_q32(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.float32]:
    """Decode q32, "smallest three" in 32 bits: words (...) to unit quaternions (..., 4)."""
    return _completed((words[..., None] >> _SHIFTS) & 0x3FF, words >> 30, _Q32_STEPS)


def _completed(stored_steps: npt.NDArray[Any], omitted: npt.NDArray[Any], steps: int) -> npt.NDArray[np.float32]:
    """Unit quaternions (..., 4) of three stored components (..., 3) and the index of the omitted one (...)."""
    parts = np.empty((*omitted.shape, 4))  # the omitted component, then the stored ones
    stored = parts[..., 1:]
    np.subtract(stored_steps, float(steps), out=stored)
    stored *= 1.0 / (steps * math.sqrt(2.0))
    squares = np.einsum("...i,...i->...", stored, stored)
    if (squares > 1.0).any():  # malformed input only
        stored /= np.sqrt(np.maximum(squares, 1.0))[..., None]
        squares = np.minimum(squares, 1.0)
    np.sqrt(1.0 - squares, out=parts[..., 0])
    order = _ORDER[omitted].reshape(-1, 4) + 4 * np.arange(omitted.size)[:, None]
    found: npt.NDArray[np.float32] = parts.reshape(-1)[order].reshape(parts.shape).astype(np.float32)
    return found


def supports_of(flags: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64] | None:
    """Support (R,) in the flags of records, 0 to 1; None where they have none."""
    levels = flags >> SUPPORT_SHIFT
    return None if not levels.all() else (levels - 1.0) / SUPPORT_STEPS


def support_of(flags: int) -> float | None:
    """Support in the flags of a record, 0 to 1; None where they have none."""
    level = flags >> SUPPORT_SHIFT
    return (level - 1) / SUPPORT_STEPS if level else None
