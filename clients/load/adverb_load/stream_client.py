"""One socket of a load of streams: its channels, their goals, and what arrives."""

from __future__ import annotations

import json
import random
import struct
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from adverb_client import Clock, DecodeError, encode_bulk_adverbs
from adverb_client.messages import ChannelOpened, CommandRejected, Hello, Pong, parse_message
from adverb_client.records import CLAMPED, HEADER
from adverb_client.wire import MESSAGE_HEADER, POSES, WIRE

from adverb_load import frames
from adverb_load.effector_errors import Arrival, Goal
from adverb_load.profile import Streams
from adverb_load.series import Counts, Series
from adverb_load.tally import Track
from adverb_load.target import VerbInfo
from adverb_load.websocket import WebSocket

__all__ = ["Group", "StreamClient"]

STRIDE = 37
"""Steps of the walk between two channels of a socket."""

SLOW = 1e-8
"""Speed of a measured channel: it stays at the keytime of the effector, and its frames are computed as all others."""

MAX_GOALS = 64
MAX_MISSED = 600
"""Missed frames between two that arrive which are counted as late."""

SPOT_EVERY = 16
"""One message of this number has the heads of all its records parsed."""


@dataclass(slots=True)
class Group:
    """What the sockets of a group share.

    Parameters
    ----------
    plan : Streams
    verbs : list of VerbInfo
        Channel k plays the verb k modulo their number.
    lateness, spacing, response, error : Series
        Seconds from the due time of a frame to its arrival, and between arrivals; seconds from the scheduled time of
        a goal to the first frame that shows it; metres between goal and effector, by forward kinematics.
    counts, errors : Counts
    """

    plan: Streams
    verbs: list[VerbInfo]
    lateness: Series
    spacing: Series
    response: Series
    error: Series
    counts: Counts
    errors: Counts
    stated_m: float = 0.0
    arrivals: list[Arrival] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def fault(self, now_s: float, problem: str) -> None:
        """Count bytes that do not follow the specification."""
        self.counts.add(now_s, "faults")
        if len(self.problems) < 8 and problem not in self.problems:
            self.problems.append(problem)

    def measures(self, channel: int) -> bool:
        """Whether the poses of a channel are compared with its goals."""
        verb = self.verbs[channel % len(self.verbs)]
        return channel < self.plan.measured and verb.effector is not None and self.plan.encoding != "weights"


class StreamClient:
    """A socket; a :class:`~adverb_load.websocket.Listener`.

    Parameters
    ----------
    group : Group
    rng : random.Random
    slow : bool
        Whether it reads slowly; its lateness is then not counted.
    """

    def __init__(self, group: Group, rng: random.Random, *, slow: bool) -> None:
        self.group, self.rng, self.slow = group, rng, slow
        self.clock, self.socket = Clock(), None
        self.goals: dict[int, deque[Goal]] = {}
        self.opened: dict[int, int] = {}
        self.failed = 0
        self.greeted, self.ended = False, False
        self._track, self._step = Track(), rng.getrandbits(16)
        self._due_ns, self._arrived_s, self._messages = 0, 0.0, 0
        self._rows = [(verb, np.arange(k, group.plan.channels, len(group.verbs))) for k, verb in enumerate(group.verbs)]

    socket: WebSocket | None

    # ── requests ─────────────────────────────────────────────────────────────────────────────────────────────────

    def open_channels(self) -> None:
        """Send the messages that open all channels."""
        self.send(*(self._open_message(channel) for channel in range(self.group.plan.channels)))
        if self.group.plan.budget_kbps:
            self.send({"op": "view", "budget_kbps": self.group.plan.budget_kbps})

    def _open_message(self, channel: int) -> dict[str, Any]:
        plan, verb = self.group.plan, self.group.verbs[channel % len(self.group.verbs)]
        message: dict[str, Any] = {
            "op": "open", "channel": channel, "verb": verb.name, "encoding": plan.encoding, "fps": plan.fps,
            "loop": True, "phase": round(self.rng.random(), 6), "half_life": plan.half_life_s, "events": plan.events,
            "adverbs": verb.goals.adverbs(self._step + STRIDE * channel),
        }  # fmt: skip
        if plan.method:
            message["method"] = plan.method
        if self.group.measures(channel) and verb.effector is not None:
            message |= {"phase": verb.effector.phase, "speed": SLOW, "half_life": 0.0}
            first = verb.row(self._step + STRIDE * channel).astype(np.float64)
            self.goals[channel] = deque([Goal(float("nan"), first)], maxlen=MAX_GOALS)
        return message

    def steer(self, due_s: float) -> None:
        """Send the next goals of all channels, which were scheduled for ``due_s``."""
        socket, counts = self.socket, self.group.counts
        if socket is None or not socket.alive or socket.full:
            counts.add(due_s, "goals_held_back")
            return
        self._step += 1
        messages: list[bytes] = []
        for verb, channels in self._rows:
            if not channels.size:
                continue
            steps = self._step + STRIDE * channels
            if self.group.plan.goals == "jump":
                steps = np.array([self.rng.getrandbits(20) for _ in channels])
            rows = verb.goals.rows[steps % len(verb.goals.rows)]
            messages += encode_bulk_adverbs(channels, rows)
            for channel, row in zip(channels[: self.group.plan.measured].tolist(), rows, strict=False):
                if channel in self.goals:
                    self.goals[channel].append(Goal(due_s, row.astype(np.float64)))
        socket.send(frames.BINARY, *messages)
        counts.add(due_s, "goals_sent")

    def ping(self) -> None:
        """Ping the server, to compare clocks."""
        self.send({"op": "ping", "t": time.monotonic_ns() * 1e-9})

    def send(self, *messages: Mapping[str, Any]) -> None:
        """Send text messages."""
        if self.socket is not None:
            self.socket.send(frames.TEXT, *(json.dumps(message).encode() for message in messages))

    # ── received messages ────────────────────────────────────────────────────────────────────────────────────────

    def binary(self, content: bytes, now_ns: int) -> None:
        """Count a pose message."""
        now_s, group = now_ns * 1e-9, self.group
        try:
            op, wire, records, sequence, due_ns, dropped = MESSAGE_HEADER.unpack_from(content)
        except struct.error:
            group.fault(now_s, f"a binary message of {len(content)} bytes")
            return
        if op != POSES or wire != WIRE:
            group.fault(now_s, f"message 0x{op:02x} of wire version {wire}")
            return
        missing, reported = self._track.step(sequence, dropped)
        counts = group.counts
        counts.add(now_s, "frames")
        counts.add(now_s, "poses", records)
        counts.add(now_s, "bytes", len(content))
        counts.add(now_s, "gaps", missing)
        counts.add(now_s, "dropped_slow" if self.slow else "dropped", reported)
        if not self.slow:
            self._late(due_ns, now_s, reported)
        self._due_ns, self._arrived_s = due_ns, now_s
        self._messages += 1
        if self.goals or self._messages % SPOT_EVERY == 0:
            self._records(content, records, now_s)

    def _late(self, due_ns: int, now_s: float, reported: int) -> None:
        """Add the lateness of a frame, and of those that were due since the last one and did not arrive."""
        if not self.clock.known:
            return
        group, due_s = self.group, due_ns * 1e-9 - self.clock.offset_s
        group.lateness.add(due_s, max(now_s - due_s, 0.0))
        if not self._due_ns:
            return
        group.spacing.add(now_s, now_s - self._arrived_s)
        interval_s = 1.0 / group.plan.fps
        missed = round((due_ns - self._due_ns) * 1e-9 / interval_s) - 1
        for k in range(1, min(missed, MAX_MISSED) + 1):
            group.lateness.add(due_s - k * interval_s, now_s - due_s + k * interval_s)
        group.counts.add(now_s, "skipped", max(missed - reported, 0))

    def waits(self, end_s: float) -> bool:
        """Whether a frame that was due before ``end_s`` has not arrived; never of slow readers and closed sockets."""
        return self._counts_lateness and self._last_due_s + 1.5 / self.group.plan.fps < end_s

    def end(self, end_s: float, now_s: float) -> None:
        """Add frames due, and goals sent, before ``end_s`` that have not arrived by now: they are at least as late."""
        if not self._counts_lateness:
            return
        group, interval_s = self.group, 1.0 / self.group.plan.fps
        missed = min(max(int((end_s - self._last_due_s) * group.plan.fps + 0.5) - 1, 0), MAX_MISSED)
        for k in range(1, missed + 1):
            due_s = self._last_due_s + k * interval_s
            group.lateness.add(due_s, now_s - due_s)
        group.counts.add(end_s - 0.5 * interval_s, "skipped", missed)
        if missed:
            for goal in (goal for goals in self.goals.values() for goal in goals):
                if self._arrived_s < goal.due_s < end_s:
                    group.response.add(goal.due_s, now_s - goal.due_s)

    @property
    def _counts_lateness(self) -> bool:
        alive = self.socket is not None and self.socket.alive
        return alive and not self.slow and self.clock.known and self._due_ns > 0

    @property
    def _last_due_s(self) -> float:
        """When the last frame was due, on this program's clock."""
        return self._due_ns * 1e-9 - self.clock.offset_s

    def _records(self, content: bytes, records: int, now_s: float) -> None:
        """Parse the heads of records; keep those of measured channels."""
        group, at, end = self.group, MESSAGE_HEADER.size, len(content)
        sizes = set(self.opened.values())
        if len(sizes) == 1 and end - at == records * next(iter(sizes)):
            self._same_size(content, next(iter(sizes)), now_s)
            return
        while at + HEADER.itemsize <= end:
            head = np.frombuffer(content, HEADER, 1, at)[0]
            size = self.opened.get(int(head["channel"]), 0)
            if not size or at + size > end:
                break
            self._head(head, content, at, size, now_s)
            at += size
        if at != end:
            group.fault(now_s, f"{end - at} bytes of a message are no record of an open channel")

    def _same_size(self, content: bytes, size: int, now_s: float) -> None:
        rows = np.frombuffer(content, np.uint8, offset=MESSAGE_HEADER.size).reshape(-1, size)
        heads = np.ascontiguousarray(rows[:, : HEADER.itemsize]).view(HEADER)[:, 0]
        clamped = heads["flags"] & CLAMPED != 0
        errors = heads["error"][~clamped]
        if np.isfinite(errors).any():
            self.group.stated_m = max(self.group.stated_m, float(np.nanmax(errors)))
        self.group.counts.add(now_s, "heads", len(heads))
        self.group.counts.add(now_s, "clamped", int(clamped.sum()))
        for row in np.flatnonzero(heads["channel"] < self.group.plan.measured).tolist():
            self._arrival(heads[row], content, MESSAGE_HEADER.size + row * size, size, now_s)

    def _head(self, head: Any, content: bytes, at: int, size: int, now_s: float) -> None:
        error, clamped = float(head["error"]), int(head["flags"]) & CLAMPED
        if error > self.group.stated_m and not clamped:
            self.group.stated_m = error
        self.group.counts.add(now_s, "heads")
        self.group.counts.add(now_s, "clamped", clamped)
        self._arrival(head, content, at, size, now_s)

    def _arrival(self, head: Any, content: bytes, at: int, size: int, now_s: float) -> None:
        channel = int(head["channel"])
        goals = self.goals.get(channel)
        if goals is not None and not self.slow and not int(head["flags"]) & CLAMPED:
            verb = channel % len(self.group.verbs)
            self.group.arrivals.append(Arrival(goals, verb, now_s, float(head["error"]), content[at : at + size]))

    def text(self, content: bytes, now_ns: int) -> None:
        """Handle a text message."""
        if content.startswith(b'{"op":"events"'):
            return
        now_s = now_ns * 1e-9
        try:
            message = parse_message(content.decode("utf-8", "replace"))
        except DecodeError as err:
            self.group.fault(now_s, err.detail)
            return
        if isinstance(message, Hello):
            self.greeted, self._track = True, Track()
        elif isinstance(message, ChannelOpened):
            self.opened[message.channel] = message.layout.record_bytes
        elif isinstance(message, Pong):
            self.clock.add(message.t, now_s, message.server_time_ns)
        elif isinstance(message, CommandRejected):
            self.failed += 1
            self.group.errors.add(now_s, message.error.code)

    def closed(self, code: int, reason: str) -> None:
        """Count the end of the connection, unless this program has closed it."""
        del reason
        if not self.ended:
            self.group.errors.add(time.monotonic(), f"closed {code}")
