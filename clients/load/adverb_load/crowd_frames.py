"""Compiled parsing of what a server sends to a crowd client: WebSocket frames, pose messages, heads of records."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

__all__ = ["SOCKET", "TOTALS", "Counts", "Totals", "walk"]

I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]

BINARY, MESSAGE_HEAD, RECORD_HEAD = 0x82, 20, 24
CLAMPED = 1
NAN = 0x7F800000
"""Bits of a float32 from which on it is not finite; below, order of bits is order of numbers."""

SOCKET = ("sequence", "dropped", "due_ns", "offset_ns", "step")
"""Columns of a socket's state; ``offset_ns``: the server's clock minus this machine's; ``step``: of its goals."""

TOTALS = (
    "start_ns", "stop_ns", "messages", "delivered", "records", "bytes", "gaps", "dropped", "wrong", "clamped",
    "worst", "events", "samples",
)  # fmt: skip
"""Columns of the counters. The window comes first, on this machine's clock; ``worst``: bits of the largest error."""


class Counts(NamedTuple):
    """Arrays that :func:`walk` changes.

    Parameters
    ----------
    sockets : (S, 5) int64
        Columns of :data:`SOCKET`.
    totals : (13,) int64
        Columns of :data:`TOTALS`.
    late_ns : (M,) int64
        Arrival minus due time of each delivered message.
    texts : (T, 3) int64
        First byte, start and length of frames that are not pose messages.
    samples : (K, bytes) uint8
        Records of the channel that is measured.
    sampled : (K, 2) int64
        Socket and step of its goals at arrival.
    """

    sockets: I64
    totals: I64
    late_ns: I64
    texts: I64
    samples: U8
    sampled: I64


class Totals(NamedTuple):
    """The counters by name, in the order of :data:`TOTALS`."""

    start_ns: int
    stop_ns: int
    messages: int
    delivered: int
    records: int
    bytes: int
    gaps: int
    dropped: int
    wrong: int
    clamped: int
    worst: int
    events: int
    samples: int


@numba.njit(cache=True, nogil=True)
def _u32(content: U8, at: int) -> np.int64:
    return (
        np.int64(content[at])
        | np.int64(content[at + 1]) << 8
        | np.int64(content[at + 2]) << 16
        | np.int64(content[at + 3]) << 24
    )


@numba.njit(cache=True, nogil=True)
def _message(content: U8, at: int, size: np.int64, socket: int, now_ns: int, record_bytes: int, encoding: int,
             sample: int, sample_every: int, counts: Counts) -> None:  # fmt: skip
    """Count one pose message."""
    state, totals = counts.sockets[socket], counts.totals
    records = np.int64(content[at + 2]) | np.int64(content[at + 3]) << 8
    if content[at] != 1 or content[at + 1] != 1:
        totals[8] += 1
        return
    sequence, dropped = _u32(content, at + 4), _u32(content, at + 16)
    due_ns = _u32(content, at + 8) | _u32(content, at + 12) << 32
    missing, more = sequence - state[0] - 1, dropped - state[1]
    state[0], state[1], state[2] = sequence, dropped, due_ns
    totals[6] += 1 if missing < 0 else max(0, missing - more)  # dropped messages may have no number
    if size != MESSAGE_HEAD + records * record_bytes:
        totals[8] += 1  # also a message that comes in one read with the length of records: it is not missing
        return
    totals[2] += 1
    late_ns = now_ns + state[3] - due_ns
    inside = totals[0] <= due_ns - state[3] < totals[1]
    if inside:
        if totals[3] < len(counts.late_ns):
            counts.late_ns[totals[3]] = late_ns
        totals[3] += 1
        totals[4] += records
        totals[5] += size
        totals[7] += more
    measured = inside and totals[2] % sample_every == 0 and totals[12] < len(counts.samples)
    worst, clamped = totals[10], 0
    for row in range(records):
        start = at + MESSAGE_HEAD + row * record_bytes
        if content[start + 2] != encoding:
            totals[8] += 1
            return
        error = _u32(content, start + 16)
        if worst < error < NAN:
            worst = error
        clamped += content[start + 3] & CLAMPED
        if measured and (np.int64(content[start]) | np.int64(content[start + 1]) << 8) == sample:
            counts.samples[totals[12]] = content[start : start + record_bytes]
            counts.sampled[totals[12], 0], counts.sampled[totals[12], 1] = socket, state[4]
            totals[12] += 1
    if inside:
        totals[9] += clamped
        totals[10] = worst


@numba.njit(cache=True, nogil=True)
def walk(content: U8, end: int, socket: int, now_ns: int, record_bytes: int, encoding: int, sample: int,
         sample_every: int, counts: Counts) -> tuple[int, int]:  # fmt: skip
    """Parse received bytes.

    Parameters
    ----------
    content : (B,) uint8
    end : int
        Number of received bytes.
    socket : int
        Row of ``counts.sockets``.
    now_ns : int
        Time of arrival, this machine's monotonic clock.
    record_bytes, encoding : int
        Length and encoding of every record.
    sample, sample_every : int
        Channel that is copied, in every message of this number.
    counts : Counts

    Returns
    -------
    (int, int)
        Number of parsed bytes, and of rows of ``counts.texts`` that were written.
    """
    at, texts = 0, 0
    while end - at >= 2 and texts < len(counts.texts):
        size, start = np.int64(content[at + 1]), at + 2
        if size == 126 and end - at >= 4:
            size, start = np.int64(content[at + 2]) << 8 | np.int64(content[at + 3]), at + 4
        elif size == 127 and end - at >= 10:
            size, start = np.int64(0), at + 10
            for k in range(8):
                size = size << 8 | np.int64(content[at + 2 + k])
        elif size >= 126:
            break  # the length is incomplete
        if end - start < size:
            break
        if content[at] == BINARY and size >= MESSAGE_HEAD:
            _message(content, start, size, socket, now_ns, record_bytes, encoding, sample, sample_every, counts)
        elif size > 11 and content[start + 7] == 101 and content[start + 8] == 118:  # {"op":"ev
            counts.totals[11] += 1
        else:
            counts.texts[texts, 0], counts.texts[texts, 1], counts.texts[texts, 2] = content[at], start, size
            texts += 1
        at = start + int(size)
    return at, texts
