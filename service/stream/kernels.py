"""Compiled loops of streams: adverbs out of received bytes, messages to sockets, passed keytimes, budgets.

Frames follow RFC 6455, section 5.2.
"""

from __future__ import annotations

import socket
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.core.typing.templates import signature

from service.wire import OP_ADVERBS, OP_MANY, U8, U32
from verbs.conventions import F32, F64, I64
from verbs.kernels.character_state import PROGRESS, Records
from verbs.kernels.compile import direct, kernel

__all__ = [
    "BY_LOOP",
    "CLOSED",
    "DIRECT",
    "INCOMPLETE",
    "MAX_FRAME",
    "MORE",
    "NOT_SENT",
    "OTHER",
    "Lines",
    "aim",
    "choose",
    "passed_keytimes",
    "scan",
    "send_messages",
    "warm",
]

U16 = npt.NDArray[np.uint16]

# ── receiving ─────────────────────────────────────────────────────────────────────────────────────────────────────

OTHER, INCOMPLETE, MORE = range(3)
"""Why :func:`_scan` ends: at a frame of another kind, at the start of a frame that continues in the next read or at the
end, at adverbs of another length or where the arrays are full."""

MAX_FRAME = 65_536
"""Longest payload of a client, bytes."""

_BINARY = 0x82  # final frame of a binary message
_HEADER_BYTES = 14


@kernel
def _byte(data: U8, at: int) -> int:
    """A byte as a signed number: sums of unsigned and signed ones would be floats."""
    return int(np.int64(data[at]))


@kernel
def _unmasked(data: U8, at: int, key: int, k: int) -> int:
    """Byte ``k`` of a payload at ``at`` whose masking key is at ``key``."""
    return int(np.int64(data[at + k]) ^ np.int64(data[key + (k & 3)]))


@kernel
def _length(data: U8, at: int) -> tuple[int, int]:
    """Bytes of a frame's header, and of its payload; 0 and 0 where the header is not complete."""
    left = data.shape[0] - at
    if left < 2:
        return 0, 0
    size, head = _byte(data, at + 1) & 0x7F, 6
    if size == 127:
        return _HEADER_BYTES, MAX_FRAME + 1
    if size == 126:
        head = 8
        if left >= 4:
            size = (_byte(data, at + 2) << 8) | _byte(data, at + 3)
    return (head, size) if left >= head else (0, 0)


@kernel
def _shape(data: U8, body: int, key: int, size: int) -> tuple[int, int, int]:
    """First byte of a payload, its rows, and the bytes of a row; 0 rows where it is no message of adverbs."""
    op = _unmasked(data, body, key, 0)
    if op == OP_ADVERBS:
        return op, 1, size
    if op != OP_MANY:
        return op, 0, 0
    count = _unmasked(data, body, key, 2) | (_unmasked(data, body, key, 3) << 8)
    stride = (size - 4) // max(count, 1)
    fits = count > 0 and stride >= 8 and stride % 4 == 0 and stride * count == size - 4
    return op, (count if fits else 0), stride


@kernel
def _scan(data: U8, start: int, channels: U16, values: F32, result: I64) -> None:
    """Decode the adverb messages at the front of ``data[start:]``: several ``0x10`` of one length, or one ``0x11``.

    Parameters
    ----------
    data : (n,) uint8
        Received bytes.
    start : int
        Where a frame begins.
    channels : (rows,) uint16
    values : (rows · D,) float32
        Written: adverbs, one row after another.
    result : (5,) int64
        Written: where the rest begins; rows; adverbs of a row; first byte of the decoded messages; and why the loop
        ended: :data:`OTHER`, :data:`INCOMPLETE` or :data:`MORE`.
    """
    at, rows, width, first, ended = start, 0, 0, 0, INCOMPLETE
    while at < data.shape[0]:
        head, size = _length(data, at)
        if head == 0:
            break
        masked = _byte(data, at + 1) >= 0x80
        if _byte(data, at) != _BINARY or not masked or size < 8 or size % 4 != 0 or size > MAX_FRAME:
            ended = OTHER
            break
        if at + head + size > data.shape[0]:
            break
        key, body = at + head - 4, at + head
        op, count, stride = _shape(data, body, key, size)
        if count == 0:
            ended = OTHER
            break
        wide = stride // 4 - 1
        differs = rows > 0 and (OP_MANY in (op, first) or wide != width)
        if differs or rows + count > channels.shape[0] or (rows + count) * wide > values.shape[0]:
            ended = MORE if rows > 0 else OTHER
            break
        first, width = op, wide
        if op == OP_MANY:
            _rows(data, body + 4, key, count, stride, 0, channels[rows:], values[rows * wide :])
        else:
            _rows(data, body, key, 1, stride, 2, channels[rows:], values[rows * wide :])
        rows += count
        at = body + size
    result[0], result[1], result[2], result[3], result[4] = at, rows, width, first, ended


@kernel
def _rows(data: U8, start: int, key: int, count: int, stride: int, before: int, channels: U16, values: F32) -> None:
    """Unmask rows of ``stride`` bytes: the channel after ``before`` bytes, the adverbs after four."""
    words = values.view(np.uint32)
    mask = np.int64(0)
    for k in range(4):
        mask |= _byte(data, key + k) << (8 * k)
    wide = stride // 4 - 1
    for row in range(count):
        at = start + row * stride
        channels[row] = _unmasked(data, at, key, before) | (_unmasked(data, at, key, before + 1) << 8)
        for a in range(wide):
            k = at + 4 + 4 * a
            word = _byte(data, k) | _byte(data, k + 1) << 8 | _byte(data, k + 2) << 16 | _byte(data, k + 3) << 24
            words[row * wide + a] = word ^ mask


@kernel
def _aim(numbers: I64, slots: I64, channels: U16, values: F32, limit: float, whole: bool, goals: F64) -> int:
    """Write adverbs as goals of characters up to the first row that is wrong; return that row, or -1.

    Parameters
    ----------
    numbers, slots : (n,) int64
        Channels of a session, rising, and their slots.
    channels : (rows,) uint16
    values : (rows · D,) float32
    limit : float
        Largest magnitude.
    whole : bool
        Whether nothing is written if any row is wrong.
    goals : (C, D) float64
        Written.
    """
    wide = goals.shape[1]
    for writes in range(0 if whole else 1, 2):
        for row in range(channels.shape[0]):
            k = np.searchsorted(numbers, np.int64(channels[row]))
            if k == numbers.shape[0] or numbers[k] != channels[row]:
                return row
            for a in range(wide):
                if not abs(values[row * wide + a]) <= limit:  # NaN compares false
                    return row
            if writes == 1:
                for a in range(wide):
                    goals[slots[k], a] = values[row * wide + a]
    return -1


# ── sending ───────────────────────────────────────────────────────────────────────────────────────────────────────

CLOSED, DIRECT, BY_LOOP = range(3)
"""How a session's pose messages are sent: not at all, to its socket, or by the event loop."""

NOT_SENT = -1

_FLAGS = getattr(socket, "MSG_DONTWAIT", 0) | getattr(socket, "MSG_NOSIGNAL", 0)
_SIGNATURE = signature(types.intp, types.int32, types.uintp, types.uintp, types.int32)  # type: ignore[no-untyped-call]
_send: Any = types.ExternalFunction("send", _SIGNATURE)


class Lines(NamedTuple):
    """Columns of the sessions of a server, one row each.

    Parameters
    ----------
    mode : (S,) int64
        :data:`CLOSED`, :data:`DIRECT` or :data:`BY_LOOP`; :data:`CLOSED` also while earlier bytes wait.
    socket : (S,) int64
        File descriptor.
    sequence, dropped : (S,) int64
        Number of the last pose message, and of those that were not sent.
    """

    mode: I64
    socket: I64
    sequence: I64
    dropped: I64


@kernel
def _send_messages(
    buffer: U8, words: U32, starts: I64, heads: I64, sizes: I64, rows: I64, lines: Lines, due_ns: int, left: I64
) -> None:
    """Number and date pose messages, and send them.

    Parameters
    ----------
    buffer : (n,) uint8
    words : (n / 4,) uint32
        The same memory.
    starts : (M,) int64
        First word of each message.
    heads, sizes : (M,) int64
        Bytes of the WebSocket header before it, and of the message; size 0: nothing is due.
    rows : (M,) int64
        Its session's row.
    lines : Lines
    due_ns : int
    left : (M,) int64
        Written: bytes that did not fit, 0 if all did; :data:`NOT_SENT`; where the event loop sends, all bytes.
    """
    mode, descriptors, sequence, dropped = lines
    address = buffer.ctypes.data
    for m in range(starts.shape[0]):
        left[m] = 0
        if sizes[m] == 0:
            continue
        row, word = rows[m], starts[m]
        if mode[row] == CLOSED:
            dropped[row] += 1
            left[m] = NOT_SENT
            continue
        words[word + 1] = np.uint32((sequence[row] + 1) & 0xFFFFFFFF)
        words[word + 2] = np.uint32(due_ns & 0xFFFFFFFF)
        words[word + 3] = np.uint32(due_ns >> 32)
        words[word + 4] = np.uint32(dropped[row] & 0xFFFFFFFF)
        whole = heads[m] + sizes[m]
        if mode[row] == DIRECT:
            sent = _send(descriptors[row], address + 4 * word - heads[m], whole, _FLAGS)
            if sent <= 0:
                dropped[row] += 1
                left[m] = NOT_SENT
                continue
            left[m] = whole - sent
        else:
            left[m] = whole
        sequence[row] = (sequence[row] + 1) & 0xFFFFFFFF


# ── events ────────────────────────────────────────────────────────────────────────────────────────────────────────

MARGIN = 1e-6
"""Of phase: a first step begins a little before where it starts, see :func:`verbs.kernels.character_state.advance`."""


@kernel
def _passed_keytimes(progress: Records, wanted: I64, phases: F64, looping: bool, rows: I64, marks: I64, at: F64) -> int:
    """Keytimes between both ends of each step, in the order in which they passed; at most two cycles of them.

    Parameters
    ----------
    progress : (B,) of :data:`verbs.kernels.character_state.PROGRESS`
    wanted : (B,) int64
        Rows of 0 are left out.
    phases : (M,) float64
        Phases of the keytimes; a loop's last one is its first.
    looping : bool
    rows, marks : (R,) int64
        Written: row and keytime of each.
    at : (R,) float64
        Scratch.

    Returns
    -------
    int
        How many there are, R at most.
    """
    count = 0
    last = phases.shape[0] - 1 if looping else phases.shape[0]
    for b in range(progress.shape[0]):
        if wanted[b] == 0 or progress[b]["passed"] == 0.0:
            continue
        start, stop = progress[b]["start"], progress[b]["stop"]
        low, high = min(start, stop), max(start, stop)
        if high <= low:
            continue
        base = int(np.floor(low + MARGIN))
        cycles = 3 if low < -MARGIN or high > 1.0 + MARGIN else 1
        begin = count
        for c in range(cycles):
            for m in range(last):
                cycle = base + c if cycles > 1 else 0
                where = cycle + phases[m]
                if count == rows.shape[0] or not (start < where <= stop or stop <= where < start):
                    continue
                k = count
                while k > begin and ((at[k - 1] > where) if stop > start else (at[k - 1] < where)):
                    at[k], marks[k] = at[k - 1], marks[k - 1]
                    k -= 1
                at[k], marks[k] = where, m
                rows[count] = b
                count += 1
    return count


# ── budgets ───────────────────────────────────────────────────────────────────────────────────────────────────────


@kernel
def _choose(growth: F64, sizes: I64, rows: I64, fixed: int, available: float, waiting: F64, chosen: I64) -> int:
    """Grow priorities, choose the highest that fit, and reset those; return the bytes, 0 if none fits."""
    count = rows.shape[0]
    order = np.empty(count)
    for k in range(count):
        waiting[rows[k]] += growth[k]
        order[k] = -waiting[rows[k]]
    used = fixed
    for k in np.argsort(order, kind="mergesort"):
        if used + sizes[k] > available:
            break
        used += sizes[k]
        chosen[k] = 1
        waiting[rows[k]] = 0.0
    return used if used > fixed else 0


# ── calls without type resolution ─────────────────────────────────────────────────────────────────────────────────

scan, aim, send_messages = direct(_scan), direct(_aim), direct(_send_messages)
passed_keytimes, choose = direct(_passed_keytimes), direct(_choose)


def warm() -> None:
    """Compile or load the kernels before the first message."""
    one, number = np.zeros(1, np.int64), np.zeros(1)
    channels, values = np.zeros(1, np.uint16), np.zeros(2, np.float32)
    scan(np.frombuffer(bytes(16), np.uint8), 0, channels, values, np.empty(5, np.int64))
    aim(one, one, channels, values, 1.0, True, np.zeros((1, 2)))
    words, lines = np.zeros(16, np.uint32), Lines(*(np.zeros(1, np.int64) for _ in Lines._fields))
    send_messages(words.view(np.uint8), words, one, one, one, one, lines, 0, np.empty(1, np.int64))
    progress = np.zeros(1, PROGRESS)
    passed_keytimes(progress, one, np.zeros(2), False, one.copy(), one.copy(), number)
    choose(number, one, one, 0, 0.0, np.zeros(1), np.zeros(1, np.int64))
