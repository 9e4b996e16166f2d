"""Streams of the Python client: they reconnect by themselves, and everything they receive is checked."""

from __future__ import annotations

import asyncio
import math
import random
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from adverb_client import (
    AdverbError,
    Channel,
    ChannelOpened,
    CommandRejected,
    ConnectionLost,
    ConnectionRestored,
    MotionEnded,
    Stream,
    StreamEnded,
    TimedOut,
)
from adverb_client.errors import NotReady, TransportError
from adverb_client.records import CLAMPED, IN_TRANSITION
from adverb_client.wire import MESSAGE_HEADER, Record
from adverb_load.effector import Effector
from adverb_load.goals import Goals
from adverb_load.tally import Track

from benchmarks.chaos.ledger import Ledger, Outage, Stall
from benchmarks.chaos.plan import StreamPlan

__all__ = ["STALL_S", "TOLERANCES_M", "Watched"]

STALL_S = 30.0
"""A stream or channel without a frame for this time, in which a server runs, has not recovered; seconds."""
CONNECT_S = 60.0
"""Longest wait for the first connection and for the answer to ``open``, seconds."""
PONG_S = 10.0
SETTLED_S = 1.5
"""Time after which a held channel has reached its goal, seconds: transitions take up to 1 s, goals none."""
START_EVERY_S = 0.02
ACT_S = (0.5, 3.0)
"""Time from one start of a stream to the next; shortest and longest time between two actions of a client, seconds."""

TOLERANCES_M = {"f32": 1e-5, "q48": 1e-3, "q32": 3e-2}
"""Largest difference of the effector from the goal, less the reported error, metres. Angles of q48 are within
0.00015 rad and of q32 within 0.0048 rad; they add up over a chain of up to eight joints."""


class Watched:
    """One stream.

    Parameters
    ----------
    number : int
    url : str
    plan : StreamPlan
    ledger : Ledger
    goals : Goals
    verb : dict
        Description of its verb.
    owner_of : callable
        Id of the server process that holds the connection of a local port.
    """

    def __init__(
        self, number: int, url: str, plan: StreamPlan, ledger: Ledger, goals: Goals, verb: dict[str, Any],
        owner_of: Callable[[int], int | None],
    ) -> None:  # fmt: skip
        self.number, self.plan, self.ledger, self.goals, self._owner_of = number, plan, ledger, goals, owner_of
        self.stream = Stream(url, on_event=self._event)
        self.channels: list[Channel] = []
        self.frames, self.last_frame_s, self.ended_s = 0, 0.0, 0.0
        self._rng, self._track = random.Random(plan.seed), Track()
        self._phase = _phase(verb) if plan.held else 0.0
        self._effector = Effector.of(verb) if plan.held else None
        self._events: deque[str] = deque(maxlen=12)
        self._lost_s: float | None = None
        self._resumed = False
        self._newest: dict[int, tuple[float, Record | None]] = {}  # time and newest frame of each channel
        self._goal: dict[int, tuple[float, list[float]]] = {}  # goals, and since when the server has them, s since 1970
        self._doubted: dict[int, float] = {}  # time of the goal that the effector of a channel was not on
        self._stalled = False
        self._receive = self.stream._session.receive
        self.stream._session.receive = self._tap

    # ── received messages ────────────────────────────────────────────────────────────────────────────────────────

    def _tap(self, content: str | bytes, now_s: float) -> None:
        """Look at a message before the client library does."""
        if isinstance(content, bytes):
            self._numbers(content)
            self._receive(content, now_s)
            return
        if '"pong"' not in content and '"events"' not in content:
            self._events.append(f"{self.ledger.now_s():.1f} s received {content[:160]}")
        self._receive(content, now_s)

    def _numbers(self, content: bytes) -> None:
        """Compare sequence number and count of dropped messages with those of the message before."""
        try:
            *_, sequence, _, dropped = MESSAGE_HEADER.unpack_from(content)
        except struct.error:
            self.ledger.fault(f"stream {self.number}: a binary message of {len(content)} bytes")
            return
        before = self._track.sequence, self._track.dropped
        missing, reported = self._track.step(sequence, dropped)
        self.ledger.messages += 1
        self.ledger.dropped += reported if reported < 1 << 31 else 0
        if missing:
            self.ledger.gaps += missing
            self.ledger.fault(
                f"stream {self.number}: sequence {before[0]} to {sequence}, dropped {before[1]} to {dropped}, "
                f"{missing} not counted; {' | '.join(self._events)}"
            )
        self.frames, self.last_frame_s = self.frames + 1, self.ledger.now_s()
        if self._lost_s is not None and self.stream.live:
            self.ledger.outages.append(Outage(self.number, self._lost_s, self.last_frame_s, self._resumed))
            self._lost_s = None

    def _event(self, event: Any) -> None:
        now_s = self.ledger.now_s()
        if isinstance(event, ConnectionLost):
            self._lost_s = now_s if self._lost_s is None else self._lost_s
            self._events.append(f"{now_s:.1f} s lost: {event.close_code} {event.detail}")
        elif isinstance(event, ConnectionRestored):
            self._resumed = event.resumed
            if not event.resumed:
                self._track = Track()
            self.ledger.done["streams resumed" if event.resumed else "streams opened again"] += 1
            self._events.append(f"{now_s:.1f} s restored, resumed: {event.resumed}")
            self._confirm()
        elif isinstance(event, MotionEnded):
            self.ended_s = now_s
            self.ledger.done["motions ended"] += 1
        elif isinstance(event, CommandRejected):
            self.ledger.fault(f"stream {self.number}: {event.error.code} {event.error.detail[:200]}")
        elif isinstance(event, StreamEnded) and event.close_code != 1000:
            self.ledger.fault(f"stream {self.number} ended: {event.close_code} {event.detail}; {self._story()}")
        elif isinstance(event, ChannelOpened):
            self._confirm()

    def _confirm(self) -> None:
        """Note that the server has all goals by now."""
        self._goal = {number: (time.time(), goal) for number, (_, goal) in self._goal.items()}

    # ── the client ───────────────────────────────────────────────────────────────────────────────────────────────

    async def run(self, stop: asyncio.Event) -> None:
        """Connect, open all channels, and act until the end; the stream stays open."""
        await asyncio.sleep(START_EVERY_S * self.number)
        try:
            await self.stream.connect(CONNECT_S)
            for number in range(self.plan.channels):
                self.channels.append(await self._open(number))
        except AdverbError as err:
            self.ledger.fault(f"stream {self.number} did not start: {type(err).__name__} {err}; {self._story()}")
            return
        while not stop.is_set():
            await asyncio.sleep(self._rng.uniform(*ACT_S))
            self._inspect()
            if self._stalled or self.stream.closed:
                continue
            try:
                await self._act()
            except (AdverbError, ValueError) as err:
                if not isinstance(err, TimedOut | NotReady) or self.stream.live:
                    self.ledger.fault(f"stream {self.number}: {type(err).__name__} {err}; {self._story()}")

    async def _open(self, number: int) -> Channel:
        goal = self.goals.adverbs(self._rng.getrandbits(10))
        options: dict[str, Any] = {"encoding": self.plan.encoding, "fps": self.plan.fps, "adverbs": goal}
        if self.plan.held:
            options |= {"play": False, "phase": self._phase, "half_life": 0.0, "method": "corrected"}
        else:
            options |= {"loop": self._rng.random() < 0.5, "phase": self._rng.random()}
        channel = await self.stream.open(self.plan.verb, number=number, timeout_s=CONNECT_S, **options)
        self._goal[number] = time.time(), list(goal.values())
        self._newest[number] = self.ledger.now_s(), None
        return channel

    async def _act(self) -> None:
        """One action; held channels get goals only."""
        index = self._rng.randrange(len(self.channels))
        channel, chance = self.channels[index], self._rng.random()
        if self.plan.held or chance < 0.6:
            if self.plan.held and time.time() - self._goal[channel.number][0] < 2 * SETTLED_S:
                return
            goal = list(self.goals.adverbs(self._rng.getrandbits(10)).values())
            channel.aim(goal)
            self._goal[channel.number] = math.inf, goal
            with suppress(TransportError):  # another connection begins with this goal
                await self.stream.ping(PONG_S)
                self._confirm()
        elif chance < 0.9:
            channel.set(phase=self._rng.random(), play=True, speed=self._rng.choice((0.5, 1.0, 1.0, 2.0, -1.0)))
        else:
            await self.stream.close_channel(channel)
            self.channels[index] = await self._open(channel.number)
            self.ledger.done["channels opened again"] += 1

    def _inspect(self) -> None:
        """Check the newest frame of each channel, and whether frames still come."""
        now_s, since_s = self.ledger.now_s(), self.last_frame_s
        for channel in self.channels:
            record, (seen_s, before) = channel.buffer.last, self._newest[channel.number]
            if record is not None and record is not before:
                self._newest[channel.number] = now_s, record
                self._check(channel, record)
            else:
                since_s = min(since_s, seen_s)
        since_s = max(since_s, self.ledger.last_down_s)
        stalled, self._stalled = self._stalled, now_s - since_s > STALL_S
        if self._stalled and not stalled:
            self.ledger.stalls.append(Stall(self.number, now_s, (self._story(), *self._events)))

    def _check(self, channel: Channel, record: Record) -> None:
        """Plausible numbers; of a held channel at rest, the effector against its goal.

        What counts is the time of the tick: an overloaded machine delays goals and frames.
        """
        if not 0.0 <= record.phase <= 1.0 or not np.isfinite(record.time_s):
            self.ledger.fault(f"stream {self.number}: phase {record.phase}, time {record.time_s}")
        if record.weights is not None:
            if abs(float(record.weights.sum(dtype=np.float64)) - 1.0) > 1e-4:
                self.ledger.fault(f"stream {self.number}: weights sum to {record.weights.sum()}")
            return
        assert record.root is not None
        assert record.rotations is not None
        lengths = np.linalg.norm(record.rotations.astype(np.float64), axis=1)
        if not np.isfinite(record.root).all() or not np.allclose(lengths, 1.0, atol=1e-5):
            self.ledger.fault(f"stream {self.number}: root {record.root}, rotations of length {lengths.min()}")
        settled_s, goal = self._goal[channel.number]
        unsettled = record.flags & (CLAMPED | IN_TRANSITION) or channel.buffer._times[-1] - settled_s < SETTLED_S
        if self._effector is None or unsettled or not self.stream.live or self.ledger.now_s() - self.last_frame_s > 1:
            return
        root, rotations = record.root.astype(np.float64), record.rotations.astype(np.float64)
        apart = float(self._effector.errors(np.array(goal), root, rotations))
        self._compare(channel.number, abs(apart - record.error), record)

    def _compare(self, number: int, difference_m: float, record: Record) -> None:
        """A difference is wrong if a later frame has it for the same goal: on a busy machine, a goal arrives late.

        Without such a frame it is counted as doubted.
        """
        settled_s, close = self._goal[number][0], difference_m <= TOLERANCES_M[self.plan.encoding]
        if not close and self._doubted.get(number) != settled_s:
            self._doubted[number] = settled_s
            self.ledger.doubted[f"stream {self.plan.encoding}"] += 1
            return
        self.ledger.compare(f"stream {self.plan.encoding}", difference_m)
        if not close:
            self.ledger.fault(
                f"stream {self.number} ({self.plan.verb}, {self.plan.encoding}): the effector is {difference_m:.3g} m "
                f"from where the record has it, version {record.version}; {self._story()}"
            )

    def _story(self) -> str:
        """Where the stream stands."""
        connection = self.stream._connection
        port, session = None, self.stream._session._session_id
        if connection is not None and connection.socket is not None:
            address = connection.socket.local_address
            port = address[1] if address else None
        stats = self.stream.stats
        return (
            f"stream {self.number} {self.plan}: live {self.stream.live}, session {session}, port {port}, server "
            f"{self._owner_of(port) if port else None}, last frame at {self.last_frame_s:.1f} s, last `end` at "
            f"{self.ended_s:.1f} s, {stats.reconnects} reconnections, {stats.resumes} resumed, "
            f"{connection.failure if connection else ''}, {stats.last_error}, "
            f"channels {[(row.number, str(row.error)) for row in self.channels if row.error]}"
        )

    def cut(self) -> None:
        """Lose the connection without a word to the server."""
        connection = self.stream._connection
        if connection is not None and connection.socket is not None:
            connection.socket.transport.abort()

    async def finish(self) -> None:
        """Check the whole stream, and close it."""
        if self.stream.stats.decode_errors:
            self.ledger.fault(f"stream {self.number}: {self.stream.stats.last_error}; {self._story()}")
        await self.stream.close()

    def alive(self, within_s: float) -> bool:
        """Whether a frame came within this time."""
        return bool(self.frames) and self.ledger.now_s() - self.last_frame_s < within_s


def _phase(verb: dict[str, Any]) -> float:
    """Canonical time of the effector's keytime."""
    return float(verb["keytime_phases"][verb["keytime_names"].index(verb["measure"]["keytime"])])
