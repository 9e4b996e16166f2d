"""A client of large crowds: blocking-free sockets in one epoll loop and compiled parsing, a fraction of a core.

It opens sockets with many channels each, steers them, and counts what arrives. The last channel of each socket stands
at the keytime of the effector (its speed is next to 0), so that its poses can be compared with the goals.
"""

from __future__ import annotations

import gc
import json
import random
import select
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
from adverb_client.records import ENCODINGS

from adverb_load import frames
from adverb_load.client import Load
from adverb_load.crowd_frames import SOCKET, TOTALS, Counts, Totals, walk
from adverb_load.crowd_goals import NO_MASK, STRIDE, Steering, errors_of
from adverb_load.crowd_report import CrowdReport
from adverb_load.effector import Effector
from adverb_load.goals import Goals, base_of, fetch
from adverb_load.tally import Lateness
from adverb_load.websocket import SUBPROTOCOL

__all__ = ["Crowd", "run_crowd"]

BUFFER = 1 << 20
RECEIVED = 1 << 18
"""Bytes of one read at most."""
SLOW = 1e-8
"""Speed of the measured channel: it moves by less than a micrometre in a minute."""
SAMPLES, SAMPLE_EVERY = 4_096, 16
PINGS = 8
OPEN_S, TAIL_S = 120.0, 0.5
MAX_TEXTS = 256


class Crowd:
    """The sockets of one load.

    Parameters
    ----------
    load : Load
        ``steer_hz`` is the rate of goals of each channel; ``bulk``: one message for all channels of a socket.
    walk_goals : bool
        Whether the server describes the verb; the bare push loop does not.
    """

    def __init__(self, load: Load, *, walk_goals: bool = True) -> None:
        self.load, self._rng = load, random.Random(load.seed)
        self._verb = fetch(base_of(load.url), f"/v1/verbs/{quote(load.verb, safe='')}") if walk_goals else None
        self._effector: Effector | None = None
        if self._verb is not None and load.encoding != "weights":  # weights are no pose that could be measured
            self._effector = Effector.of(self._verb)
        self._steering: Steering | None = None
        self._goals = None if self._verb is None else Goals.of(self._verb, np.random.default_rng(load.seed))
        if self._goals is not None and load.steer_hz > 0:
            self._steering = Steering.of(self._goals, load.channels, bulk=load.bulk)
        self._sockets: list[socket.socket] = []
        self._index: dict[int, int] = {}
        self._epoll = select.epoll()
        self._rests = [b""] * load.sockets
        self._unsent = [b""] * load.sockets
        self._space = np.zeros(BUFFER, np.uint8)
        self._view = self._space.data
        self._record_bytes, self._opened, self._round_trip_ns = 0, 0, 0
        self._answer_ns: int | None = None
        self.codes: Counter[str] = Counter()
        self.steered = self.held_back = 0
        self._counts = self._new_counts(1, 1)

    def _new_counts(self, messages: int, record_bytes: int) -> Counts:
        return Counts(
            np.zeros((self.load.sockets, len(SOCKET)), np.int64),
            np.zeros(len(TOTALS), np.int64),
            np.zeros(messages, np.int64),
            np.zeros((MAX_TEXTS, 3), np.int64),
            np.zeros((SAMPLES, record_bytes), np.uint8),
            np.zeros((SAMPLES, 2), np.int64),
        )

    # ── opening ──────────────────────────────────────────────────────────────────────────────────────────────────

    def open(self) -> None:
        """Connect, compare clocks, and open all channels of one socket after the other.

        Raises
        ------
        FrameError, OSError, TimeoutError
            If the server cannot be reached, or does not open the channels in :data:`OPEN_S`.
        """
        end = time.monotonic() + OPEN_S
        for number in range(self.load.sockets):
            self._connect(number)
            self._compare_clocks(number)
            step = self._rng.randrange(len(self._goals.rows)) if self._goals is not None else 0
            self._counts.sockets[number, 4] = step
            opening = [json.dumps(self._open_message(channel, step)) for channel in range(self.load.channels)]
            self._send(number, b"".join(frames.frame(frames.TEXT, text.encode(), NO_MASK) for text in opening))
            wanted = (number + 1) * self.load.channels
            while self._opened < wanted:
                self._poll(0.1)
                self._flush(number)
                if self.codes:
                    raise frames.FrameError(f"channels were not opened: {dict(self.codes)}")
                if time.monotonic() > end:
                    raise TimeoutError(f"{self._opened} channels are open after {OPEN_S:g} s")

    def _connect(self, number: int) -> None:
        parts = urlsplit(self.load.url)
        host, port, key = str(parts.hostname), parts.port or 80, self._rng.randbytes(16)
        found = socket.create_connection((host, port), timeout=10.0)
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        found.sendall(frames.request(host, port, parts.path, key, SUBPROTOCOL))
        response = b""
        while b"\r\n\r\n" not in response:
            response += found.recv(4_096) or b"\r\n\r\n"
        head, _, rest = response.partition(b"\r\n\r\n")
        frames.accepted(head, key, SUBPROTOCOL)
        found.setblocking(False)
        self._sockets.append(found)
        self._index[found.fileno()] = number
        self._rests[number] = rest
        self._epoll.register(found.fileno(), select.EPOLLIN)

    def _compare_clocks(self, number: int) -> None:
        """Bound the offset of the server's clock by round trips; the bounds of all pings hold together."""
        low, high = -(2**62), 2**62
        for _ in range(PINGS):
            self._answer_ns = None
            sent = time.monotonic_ns()
            self._send(number, frames.frame(frames.TEXT, b'{"op":"ping","t":0}', NO_MASK))
            while self._answer_ns is None:
                self._poll(1.0)
                if time.monotonic_ns() > sent + 10**10:
                    raise TimeoutError("no pong within 10 s")
            low, high = max(low, self._answer_ns - time.monotonic_ns()), min(high, self._answer_ns - sent)
        self._counts.sockets[number, 3] = (low + high) // 2
        self._round_trip_ns = max(self._round_trip_ns, high - low)

    def _open_message(self, channel: int, step: int) -> dict[str, Any]:
        load = self.load
        message: dict[str, Any] = {"op": "open", "channel": channel, "verb": load.verb, "encoding": load.encoding}
        message |= {"fps": load.fps, "loop": True, "phase": round(self._rng.random(), 6)}
        if load.method is not None:
            message["method"] = load.method
        if not load.events:
            message["events"] = False
        if self._goals is not None:
            message["adverbs"] = self._goals.adverbs(step + STRIDE * channel)
        if self._effector is not None and channel == load.channels - 1:
            message |= {"phase": self._effector.phase, "speed": SLOW, "half_life": 0.0}
        return message

    # ── the loop ─────────────────────────────────────────────────────────────────────────────────────────────────

    def measure(self, seconds: float, *, settle_s: float, probe: Callable[[], float]) -> CrowdReport:
        """Steer and count; ``probe`` returns the server's CPU seconds so far."""
        load = self.load
        before, most = self._counts, round(load.sockets * load.fps * (seconds + 1.0)) + 1_024
        self._counts = self._new_counts(most, max(self._record_bytes, 1))
        self._counts.sockets[:] = before.sockets
        start_ns = time.monotonic_ns() + round(settle_s * 1e9)
        self._counts.totals[:2] = start_ns, start_ns + round(seconds * 1e9)
        count = self._steer_until(start_ns, time.monotonic_ns(), 0)
        self.steered = self.held_back = 0
        cpu_s, own_s = probe(), time.process_time()
        self._steer_until(start_ns + round(seconds * 1e9), start_ns, count)
        cpu_s, own_s = probe() - cpu_s, time.process_time() - own_s
        end = time.monotonic() + TAIL_S
        while time.monotonic() < end:  # late messages of the window
            self._poll(0.05)
        return self._report(seconds, cpu_s, own_s / seconds)

    def _steer_until(self, end_ns: int, start_ns: int, count: int) -> int:
        """Read until a time, and send goals to one socket after the other; returns the number of sendings."""
        if self._steering is None:
            while (left_ns := end_ns - time.monotonic_ns()) > 0:
                self._poll(left_ns * 1e-9)
            return count
        interval_ns, first = 1e9 / (self.load.steer_hz * self.load.sockets), count
        while (now_ns := time.monotonic_ns()) < end_ns:
            due = first + int((now_ns - start_ns) / interval_ns)
            if due - count > self.load.sockets:  # this process was late: skip what is outdated
                self.held_back += (due - count - self.load.sockets) * self.load.channels
                count = due - self.load.sockets
            for number in range(count, due):
                self._steer(number % self.load.sockets, self._steering)
            count = due
            next_ns = start_ns + round((count - first + 1) * interval_ns)
            self._poll(max(min(next_ns, end_ns) - time.monotonic_ns(), 0) * 1e-9)
        return count

    def _steer(self, number: int, steering: Steering) -> None:
        if self._unsent[number] and not self._flush(number):
            self.held_back += self.load.channels
            return
        step = int(self._counts.sockets[number, 4]) + 1
        self._counts.sockets[number, 4] = step
        self._send(number, steering.frames[step % len(steering.frames)])
        self.steered += self.load.channels

    def _send(self, number: int, content: bytes) -> None:
        self._unsent[number] += content
        self._flush(number)

    def _flush(self, number: int) -> bool:
        """Send what is left of a socket; False if the server does not read."""
        content = self._unsent[number]
        if content:
            try:
                self._unsent[number] = content[self._sockets[number].send(content) :]
            except BlockingIOError:
                return False
            except OSError:
                self.codes["lost"] += 1
                self._unsent[number] = b""
        return not self._unsent[number]

    def _poll(self, seconds: float) -> None:
        for file, _ in self._epoll.poll(seconds):
            self._read(self._index[file])

    def _read(self, number: int) -> None:
        rest = self._rests[number]
        size = len(rest)
        if size:
            self._view[:size] = rest
        try:
            received = self._sockets[number].recv_into(self._view[size : size + RECEIVED])
        except BlockingIOError:
            return
        except OSError:
            received = 0
        now_ns = time.monotonic_ns()
        if not received:
            self.codes["closed"] += 1
            self._epoll.unregister(self._sockets[number].fileno())
            return
        end, load, at = size + received, self.load, 0
        while True:
            parsed, texts = walk(
                self._space[at:], end - at, number, now_ns, self._record_bytes, ENCODINGS[load.encoding],
                load.channels - 1, SAMPLE_EVERY, self._counts,
            )  # fmt: skip
            for first, start, length in self._counts.texts[:texts].tolist():
                self._text(number, first & 0x0F, bytes(self._view[at + start : at + start + length]))
            at += parsed
            if texts < MAX_TEXTS:
                break
        if end - at + RECEIVED > BUFFER:
            raise frames.FrameError(f"a message of more than {end - at} bytes")
        self._rests[number] = bytes(self._view[at:end]) if at < end else b""

    def _text(self, number: int, opcode: int, content: bytes) -> None:
        """Handle a frame that is no pose message."""
        if opcode == frames.PING:
            self._send(number, frames.frame(frames.PONG, content, NO_MASK))
        elif opcode == frames.CLOSE:
            self.codes[f"close {frames.close_code(content)[0]}"] += 1
        elif content.startswith(b'{"op":"opened"') or content.startswith(b'{"op": "opened"'):
            self._opened += 1
            if not self._record_bytes:
                self._record_bytes = int(json.loads(content)["record_bytes"])
        elif opcode == frames.TEXT:
            message = json.loads(content)
            if message["op"] == "pong":
                self._answer_ns = int(message["server_time_ns"])
            elif message["op"] == "error":
                self.codes[str(message["code"])] += 1

    # ── the end ──────────────────────────────────────────────────────────────────────────────────────────────────

    def close(self) -> None:
        """Close all connections."""
        for number, found in enumerate(self._sockets):
            self._unsent[number] += frames.close_frame(1000, NO_MASK)
            self._flush(number)
            found.close()
        self._epoll.close()

    def _report(self, seconds: float, cpu_s: float, own: float) -> CrowdReport:
        load, counts = self.load, self._counts
        totals = Totals(*counts.totals.tolist())
        late_ms = counts.late_ns[: totals.delivered] * 1e-6
        late = np.quantile(late_ms, [0.5, 0.95, 0.99, 1.0]).tolist() if late_ms.size else [float("nan")] * 4
        measured = float("nan")
        if totals.samples and self._effector is not None and self._goals is not None:
            measured = float(
                errors_of(
                    counts.samples[: totals.samples], counts.sampled[: totals.samples, 1], load.channels - 1,
                    self._goals, self._effector, load.encoding, moving=self._steering is not None,
                ).max()
            )  # fmt: skip
        return CrowdReport(
            load=load,
            seconds=seconds,
            delivered=totals.records,
            expected=load.sockets * load.channels * round(seconds * load.fps),
            messages=totals.delivered,
            bytes=totals.bytes,
            gaps=totals.gaps,
            dropped=totals.dropped,
            wrong=totals.wrong,
            lateness_ms=Lateness(*late),
            clock_ms=0.5e-6 * self._round_trip_ns,
            server_cpu_s=cpu_s,
            reader_cpu=own,
            clamped=totals.clamped,
            stated_m=float(np.array([totals.worst], np.uint32).view(np.float32)[0]),
            measured_m=measured,
            samples=totals.samples,
            events=totals.events,
            steered=self.steered,
            held_back=self.held_back,
            codes=dict(self.codes),
        )


def run_crowd(
    load: Load,
    *,
    seconds: float,
    settle_s: float = 1.0,
    probe: Callable[[], float] = lambda: 0.0,
    walk_goals: bool = True,
) -> CrowdReport:
    """Open a load, measure it, close it; see :class:`Crowd`.

    Raises
    ------
    RequestError, FrameError, OSError, TimeoutError
        If the server cannot be reached or does not open the channels.
    """
    crowd = Crowd(replace(load), walk_goals=walk_goals)
    gc.collect()
    gc.disable()
    try:
        crowd.open()
        return crowd.measure(seconds, settle_s=settle_s, probe=probe)
    finally:
        crowd.close()
        gc.enable()
