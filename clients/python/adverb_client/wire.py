"""Binary messages of a stream: bytes in, arrays out. Pure functions; ``docs/wire.md`` is the specification."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.errors import DecodeError
from adverb_client.records import ENCODINGS, HEAD, Q48, WEIGHTS, record_of, rotations_from_q48

__all__ = ["Group", "Layout", "Message", "Record", "decode_message", "encode_adverbs"]

POSES, ADVERBS = 0x01, 0x10
WIRE = 1
_TOP = struct.Struct("<BBHIQI")
_ADVERBS = struct.Struct("<BBH")
_COUNT = struct.Struct("<HH")
_LONGEST_GROUP = 256  # bounds how often a record is looked at where layouts alternate

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Layout:
    """How the records of a channel are laid out.

    Parameters
    ----------
    encoding : int
        As in a record's head.
    count : int
        Joints of a record. Records of weights say their number themselves; there it is what was promised.
    """

    encoding: int
    count: int

    @classmethod
    def promised(cls, encoding: str, joints: int, record_bytes: int) -> Layout:
        """What an ``opened`` message promises.

        Raises
        ------
        DecodeError
            If the encoding is not known, or the length is not that of so many joints.
        """
        if encoding not in ENCODINGS:
            raise DecodeError(f"encoding {encoding!r} is not known; known: {', '.join(ENCODINGS)}")
        number = ENCODINGS[encoding]
        count = (record_bytes - HEAD.itemsize - _COUNT.size) // 4 if number == WEIGHTS else joints
        found = cls(number, count)
        if count < 0 or found.record_bytes != record_bytes:
            raise DecodeError(f"records of {record_bytes} bytes cannot hold {joints} joints as {encoding}")
        return found

    @property
    def record_bytes(self) -> int:
        """Length of a record, padding included."""
        return record_of(self.encoding, self.count).itemsize


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One channel at one tick.

    Parameters
    ----------
    channel, flags, version : int
    phase, time_s, duration_s : float
        Canonical time; seconds from the start; seconds of the motion or cycle.
    error : float
        Metres (or the unit of the verb's measure); NaN where nothing is measured.
    root : (3,) float32 or None
        Position of the root joint in the channel's frame. None of ``weights``.
    rotations : (J, 4) float32 or None
        None of ``weights``.
    weights : (N,) float32 or None
        Of ``weights`` only.
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


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Records of one layout that follow each other, column by column.

    Parameters
    ----------
    heads : (R,) structured
        Fields as of ``records.HEAD``.
    roots : (R, 3) float32 or None
    rotations : (R, J, 4) float32 or None
    weights : (R, N) float32 or None
    """

    heads: npt.NDArray[np.void]
    roots: F32 | None
    rotations: F32 | None
    weights: F32 | None

    def records(self) -> Iterator[Record]:
        """The records one by one; their arrays are views."""
        for row, head in enumerate(self.heads[list(HEAD.names or ())].tolist()):
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
class Message:
    """All channels that were due at one tick.

    Parameters
    ----------
    sequence : int
        One more in each message that the session sends.
    time_ns : int
        When the tick was due, on the server's clock.
    dropped : int
        Messages of the session that were due and did not arrive, so far.
    groups : tuple of Group
    """

    sequence: int
    time_ns: int
    dropped: int
    groups: tuple[Group, ...]

    def records(self) -> Iterator[Record]:
        """All records in the order in which they stand."""
        for group in self.groups:
            yield from group.records()


def decode_message(content: bytes, layouts: Mapping[int, Layout]) -> Message:
    """Read a pose message.

    Parameters
    ----------
    content : bytes
        A whole binary message from the server.
    layouts : mapping of int to Layout
        By channel.

    Returns
    -------
    Message
        Its arrays of f32 and weights are views of the content.

    Raises
    ------
    DecodeError
        If it is no pose message of this wire version, a record is of a channel without layout or of another encoding
        than its channel's, the length does not fit, or a number other than an error is not finite.
    """
    if len(content) < _TOP.size:
        raise DecodeError(f"a message of {len(content)} bytes; a pose message has at least {_TOP.size}")
    op, wire, records, sequence, time_ns, dropped = _TOP.unpack_from(content)
    if op != POSES or wire != WIRE:
        raise DecodeError(f"message 0x{op:02x} of wire version {wire}; expected 0x{POSES:02x} of {WIRE}")
    groups, at, left = [], _TOP.size, records
    while left:
        group, at = _group(content, at, left, layouts)
        groups.append(group)
        left -= len(group.heads)
    if at != len(content):
        raise DecodeError(f"{len(content) - at} bytes behind the last of {records} records")
    return Message(sequence, time_ns, dropped, tuple(groups))


def _group(content: bytes, at: int, left: int, layouts: Mapping[int, Layout]) -> tuple[Group, int]:
    """The records from here on that share one layout, and where the next one starts."""
    layout = _layout_at(content, at, layouts)
    kind = record_of(layout.encoding, layout.count)
    whole = (len(content) - at) // kind.itemsize
    rows = np.frombuffer(content, kind, min(left, whole, _LONGEST_GROUP), at)
    rows = rows[: _alike(rows, layout, layouts)]
    for name in ("phase", "time", "duration"):
        _check_finite(rows[name], rows)
    if layout.encoding == WEIGHTS:
        weights = rows["weights"]
        _check_finite(weights, rows)
        return Group(rows, None, None, weights), at + rows.nbytes
    roots = rows["root"]
    rotations = rotations_from_q48(rows["words"]) if layout.encoding == Q48 else rows["rotations"]
    _check_finite(roots, rows)
    _check_finite(rotations, rows)
    return Group(rows, roots, rotations, None), at + rows.nbytes


def _layout_at(content: bytes, at: int, layouts: Mapping[int, Layout]) -> Layout:
    """The layout of the record that starts here; the whole record is there."""
    if len(content) - at < HEAD.itemsize:
        raise DecodeError(f"{len(content) - at} bytes where a record's head should be")
    channel, encoding = int.from_bytes(content[at : at + 2], "little"), content[at + 2]
    layout = layouts.get(channel)
    if layout is None:
        raise DecodeError(f"a record of channel {channel}, which is not open")
    if encoding != layout.encoding:
        raise DecodeError(f"a record of encoding {encoding} on channel {channel}, which has {layout.encoding}")
    if encoding == WEIGHTS:
        start = at + HEAD.itemsize
        if len(content) - start < _COUNT.size:
            raise DecodeError("a record of weights ends before their number")
        layout = Layout(WEIGHTS, _COUNT.unpack_from(content, start)[0])  # a new version may have more examples
    if len(content) - at < layout.record_bytes:
        raise DecodeError(f"{len(content) - at} bytes where a record of {layout.record_bytes} should be")
    return layout


def _alike(rows: npt.NDArray[np.void], layout: Layout, layouts: Mapping[int, Layout]) -> int:
    """How many records, from the first, are laid out as it is; what lies behind them means nothing in this layout."""
    channels, encodings = rows["channel"].tolist(), rows["encoding"].tolist()
    counts = rows["count"].tolist() if layout.encoding == WEIGHTS else None
    for k in range(1, len(rows)):
        own = layouts.get(channels[k])
        if own is None or encodings[k] != layout.encoding or own.encoding != layout.encoding:
            return k
        if (own.count if counts is None else counts[k]) != layout.count:
            return k
    return len(rows)


def _check_finite(numbers: F32, rows: npt.NDArray[np.void]) -> None:
    if not np.isfinite(numbers).all():
        raise DecodeError(f"numbers that are not finite, in records of channels {rows['channel'].tolist()[:8]}")


def encode_adverbs(channel: int, adverbs: Sequence[float] | npt.NDArray[Any]) -> bytes:
    """Adverbs of one channel as the server reads them fastest.

    Parameters
    ----------
    channel : int
        0 … 65,535.
    adverbs : (D,) floats
        All adverbs in the order of the verb's, in their units.

    Raises
    ------
    ValueError
        If there is no such channel, or an adverb is not finite as float32.
    """
    if not 0 <= channel <= 65_535:
        raise ValueError(f"channel {channel}; expected 0 to 65,535")
    with np.errstate(over="ignore"):
        numbers = np.asarray(adverbs, np.float64).ravel().astype("<f4")
    if not np.isfinite(numbers).all():
        raise ValueError(f"adverbs are finite numbers: {numbers.tolist()}")
    return _ADVERBS.pack(ADVERBS, 0, channel) + numbers.tobytes()
