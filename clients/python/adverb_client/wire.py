"""Binary messages of a stream: pose messages decoded to arrays, adverbs encoded. Specification: ``docs/wire.md``."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError
from adverb_client.records import (
    ENCODINGS,
    ERROR,
    HEADER,
    Q32,
    Q48,
    WEIGHTS,
    decode_q32,
    decode_q48,
    record_dtype,
    support_of,
)

__all__ = [
    "ADVERBS",
    "BULK_ADVERBS",
    "MAX_MESSAGE_BYTES",
    "MESSAGE_HEADER",
    "POSES",
    "WIRE",
    "Layout",
    "PoseMessage",
    "Record",
    "RecordBatch",
    "decode_message",
    "encode_adverbs",
    "encode_bulk_adverbs",
]

POSES, ADVERBS, BULK_ADVERBS = 0x01, 0x10, 0x11
"""Ops of binary messages."""
WIRE = 1
MESSAGE_HEADER = struct.Struct("<BBHIQI")
"""Header of a pose message: op, wire version, records, sequence, time in ns, dropped."""
MAX_MESSAGE_BYTES = 65_536
"""The longest message that the server takes."""
MAX_ADVERB = 1e9
"""The largest magnitude of an adverb."""
_ADVERBS = struct.Struct("<BBH")
_COUNT = struct.Struct("<HH")
_MAX_BATCH = 256  # bounds repeated scans where layouts alternate

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a channel's records.

    Parameters
    ----------
    encoding : int
        As in a record's header.
    count : int
        Joints of a record; for ``weights`` the number of examples, which each record states as well.
    """

    encoding: int
    count: int

    @classmethod
    def from_opened(cls, encoding: str, joints: int, record_bytes: int) -> Layout:
        """The layout that an ``opened`` message states.

        Raises
        ------
        DecodeError
            If the encoding is unknown, or the length does not fit the number of joints.
        """
        if encoding not in ENCODINGS:
            raise DecodeError(f"unknown encoding {encoding!r}; known: {', '.join(ENCODINGS)}")
        number = ENCODINGS[encoding]
        count = (record_bytes - HEADER.itemsize - _COUNT.size) // 4 if number == WEIGHTS else joints
        found = cls(number, count)
        if count < 0 or found.record_bytes != record_bytes:
            raise DecodeError(f"records of {record_bytes} bytes do not fit {joints} joints as {encoding}")
        return found

    @property
    def record_bytes(self) -> int:
        """Length of a record, including padding."""
        return record_dtype(self.encoding, self.count).itemsize


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One channel at one tick.

    Parameters
    ----------
    channel, flags, version : int
    phase, time_s, duration_s : float
        Canonical time; seconds from the start; duration of the motion or cycle, seconds.
    error : float
        Metres, or m/s where the verb is measured by velocity; NaN where nothing is measured.
    root : (3,) float32 or None
        Position of the root joint in the channel's frame. None for ``weights``.
    rotations : (J, 4) float32 or None
        None for ``weights``.
    weights : (N,) float32 or None
        For ``weights`` only.
    """

    channel: int
    flags: int
    version: int
    phase: float
    time_s: float
    error: float
    duration_s: float
    root: F32 | None
    rotations: F32 | None
    weights: F32 | None

    @property
    def support(self) -> float | None:
        """How well the examples support the pose, 0 to 1, in steps of 1/14; None unless the channel requests it."""
        return support_of(self.flags)


@dataclass(frozen=True, slots=True, eq=False)
class RecordBatch:
    """Consecutive records of one layout, as columns.

    Parameters
    ----------
    headers : (R,) structured
        Fields of ``records.HEADER``.
    roots : (R, 3) float32 or None
    rotations : (R, J, 4) float32 or None
    weights : (R, N) float32 or None
    """

    headers: npt.NDArray[np.void]
    roots: F32 | None
    rotations: F32 | None
    weights: F32 | None

    def records(self) -> Iterator[Record]:
        """The records one by one; their arrays are views of the columns."""
        for row, head in enumerate(self.headers[list(HEADER.names or ())].tolist()):
            channel, _, flags, version, phase, time_s, error, duration_s = head
            yield Record(
                channel,
                flags,
                version,
                phase,
                time_s,
                error,
                duration_s,
                None if self.roots is None else self.roots[row],
                None if self.rotations is None else self.rotations[row],
                None if self.weights is None else self.weights[row],
            )


@dataclass(frozen=True, slots=True, eq=False)
class PoseMessage:
    """The records of all channels that were due at one tick.

    Parameters
    ----------
    sequence : int
        Number of the message in its session, modulo 2³².
    time_ns : int
        Due time of the tick on the server's clock, ns.
    dropped : int
        Messages of the session so far that were due and not sent, or lost with a connection.
    batches : tuple of RecordBatch
    """

    sequence: int
    time_ns: int
    dropped: int
    batches: tuple[RecordBatch, ...]

    def records(self) -> Iterator[Record]:
        """All records in the order of the message."""
        for batch in self.batches:
            yield from batch.records()


def decode_message(content: bytes, layouts: Mapping[int, Layout]) -> PoseMessage:
    """Decode a pose message.

    Parameters
    ----------
    content : bytes
        A whole binary message from the server.
    layouts : mapping of int to Layout
        Layout of each open channel.

    Returns
    -------
    PoseMessage
        Arrays of ``f32`` and ``weights`` are views of the content.

    Raises
    ------
    DecodeError
        If the message is not a pose message of this wire version, a record belongs to a channel without layout or has
        another encoding than its channel, the length does not fit, or a number other than ``error`` is not finite.
    """
    if len(content) < MESSAGE_HEADER.size:
        raise DecodeError(f"a message of {len(content)} bytes; a pose message has at least {MESSAGE_HEADER.size}")
    op, wire, records, sequence, time_ns, dropped = MESSAGE_HEADER.unpack_from(content)
    if op != POSES or wire != WIRE:
        raise DecodeError(f"message 0x{op:02x} of wire version {wire}; expected 0x{POSES:02x} of {WIRE}")
    batches, at, left = [], MESSAGE_HEADER.size, records
    while left:
        batch, at = _batch(content, at, left, layouts)
        batches.append(batch)
        left -= len(batch.headers)
    if at != len(content):
        raise DecodeError(f"{len(content) - at} bytes after the last of {records} records")
    return PoseMessage(sequence, time_ns, dropped, tuple(batches))


def _batch(content: bytes, at: int, left: int, layouts: Mapping[int, Layout]) -> tuple[RecordBatch, int]:
    """The records at an offset that share one layout, and the offset of the next record."""
    layout = _layout_at(content, at, layouts)
    kind = record_dtype(layout.encoding, layout.count)
    whole = (len(content) - at) // kind.itemsize
    rows = np.frombuffer(content, kind, min(left, whole, _MAX_BATCH), at)
    rows = rows[: _same_layout(rows, layout, layouts)]
    finite = np.isfinite(rows["floats"])
    finite[:, ERROR] = True
    weights = rows["weights"] if layout.encoding == WEIGHTS else None
    if not finite.all() or (weights is not None and not np.isfinite(weights).all()):
        raise DecodeError(f"non-finite numbers in records of channels {rows['channel'].tolist()[:8]}")
    if weights is not None:
        return RecordBatch(rows, None, None, weights), at + rows.nbytes
    return RecordBatch(rows, rows["root"], _rotations(rows, layout.encoding), None), at + rows.nbytes


def _rotations(rows: npt.NDArray[np.void], encoding: int) -> F32:
    if encoding == Q48:
        return decode_q48(rows["words"])
    return decode_q32(rows["words"]) if encoding == Q32 else rows["rotations"]


def _layout_at(content: bytes, at: int, layouts: Mapping[int, Layout]) -> Layout:
    """The layout of the record at an offset, after a check that the record is complete."""
    if len(content) - at < HEADER.itemsize:
        raise DecodeError(f"{len(content) - at} bytes left; a record's header has {HEADER.itemsize}")
    channel, encoding = int.from_bytes(content[at : at + 2], "little"), content[at + 2]
    layout = layouts.get(channel)
    if layout is None:
        raise DecodeError(f"a record of channel {channel}, which is not open")
    if encoding != layout.encoding:
        raise DecodeError(f"a record of encoding {encoding} on channel {channel}, which has encoding {layout.encoding}")
    if encoding == WEIGHTS:
        start = at + HEADER.itemsize
        if len(content) - start < _COUNT.size:
            raise DecodeError("a record of weights ends before its count")
        layout = Layout(WEIGHTS, _COUNT.unpack_from(content, start)[0])  # a new version may have more examples
    if len(content) - at < layout.record_bytes:
        raise DecodeError(f"{len(content) - at} bytes left; a record of channel {channel} has {layout.record_bytes}")
    return layout


def _same_layout(rows: npt.NDArray[np.void], layout: Layout, layouts: Mapping[int, Layout]) -> int:
    """Number of leading records with the given layout; what follows them cannot be read in this layout."""
    if len(rows) == 1:
        return 1
    channels, encodings = rows["channel"].tolist(), rows["encoding"].tolist()
    counts = rows["count"].tolist() if layout.encoding == WEIGHTS else None
    for k in range(1, len(rows)):
        own = layouts.get(channels[k])
        if own is None or encodings[k] != layout.encoding or own.encoding != layout.encoding:
            return k
        if (own.count if counts is None else counts[k]) != layout.count:
            return k
    return len(rows)


def encode_adverbs(channel: int, adverbs: Sequence[float] | npt.NDArray[Any]) -> bytes:
    """Encode all adverbs of one channel as a binary message.

    Parameters
    ----------
    channel : int
        0 … 65,535.
    adverbs : (D,) floats
        All adverbs in the order of the verb's, in their units.

    Raises
    ------
    ValueError
        If the channel number is out of range, or an adverb is not finite as float32.
    """
    if not 0 <= channel <= 65_535:
        raise ValueError(f"channel {channel}; expected 0 to 65,535")
    with np.errstate(over="ignore"):
        numbers = np.asarray(adverbs, np.float64).ravel().astype("<f4")
    if not np.isfinite(numbers).all():
        raise ValueError(f"adverbs must be finite: {numbers.tolist()}")
    return _ADVERBS.pack(ADVERBS, 0, channel) + numbers.tobytes()


def encode_bulk_adverbs(channels: npt.ArrayLike, adverbs: npt.ArrayLike) -> list[bytes]:
    """Encode all adverbs of many channels as binary messages, each of at most 64 KiB.

    Parameters
    ----------
    channels : (B,) int
        0 … 65,535.
    adverbs : (B, D) floats
        All adverbs in the order of the verbs', in their units.

    Returns
    -------
    list of bytes
        One message up to 4,095 channels with three adverbs; none for B = 0.

    Raises
    ------
    ValueError
        If shapes do not fit, a channel number is out of range, or an adverb is not finite or exceeds 1e9.
    """
    numbers, goals = np.asarray(channels), np.asarray(adverbs)
    if numbers.ndim != 1 or goals.ndim != 2 or len(numbers) != len(goals) or not (goals.shape[1] or not len(goals)):
        raise ValueError(f"channels {numbers.shape} and adverbs {goals.shape}; expected (B,) and (B, D)")
    if ((numbers < 0) | (numbers > 65_535)).any():
        raise ValueError(f"channels {numbers.min()} to {numbers.max()}; expected 0 to 65,535")
    if not (np.abs(goals) <= MAX_ADVERB).all():
        raise ValueError(f"adverbs must be finite and at most {MAX_ADVERB:g} in magnitude")
    rows = np.zeros(len(numbers), [("channel", "<u2"), ("zero", "<u2"), ("adverbs", "<f4", (goals.shape[1],))])
    rows["channel"], rows["adverbs"] = numbers, goals
    most = (MAX_MESSAGE_BYTES - _ADVERBS.size) // rows.itemsize
    parts = [rows[at : at + most] for at in range(0, len(rows), most)]
    return [_ADVERBS.pack(BULK_ADVERBS, 0, len(part)) + part.tobytes() for part in parts]
