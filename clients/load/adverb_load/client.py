"""One stream and what its client knows: the channels' layouts, the numbering, the clock."""

from __future__ import annotations

import asyncio
import json
import random
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from adverb_load import frames
from adverb_load.goals import Goals
from adverb_load.records import HEADER, POSES, WIRE, DecodeError, Layout, decode, layout_of
from adverb_load.tally import Clock, Tally, Track
from adverb_load.websocket import Link, connect

__all__ = ["SAMPLE", "Asked", "Player"]

SAMPLE = 64
"""One pose message of so many is read in full."""

PINGS = 4
STRIDE = 37
"""Steps of the walk between two channels of a stream."""

_AIM = struct.Struct("<BBH")
AIM = 0x10
FENCE = -1.0
"""What the ping behind a resume carries."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a load is made of.

    Parameters
    ----------
    url, verb, encoding : str
    sockets, channels, fps : int
        Channels of each socket, frames per second of each channel.
    method : str or None
        The verb's own where None.
    steer_hz : float
        How often every channel gets other adverbs.
    seed : int
    """

    url: str
    verb: str
    encoding: str = "f32"
    sockets: int = 1
    channels: int = 1
    fps: int = 60
    method: str | None = None
    steer_hz: float = 0.0
    seed: int = 1


@dataclass(slots=True)
class Player:
    """A stream.

    Parameters
    ----------
    asked : Asked
    tally : Tally
    clock : Clock
        Of the process: all streams go to one server.
    rng : random.Random
    goals : Goals or None
        Adverbs stay in the middle of the domain where there is no walk.
    """

    asked: Asked
    tally: Tally
    clock: Clock
    rng: random.Random
    goals: Goals | None
    link: Link | None = None
    session: str = ""
    track: Track = field(default_factory=Track)
    layouts: dict[int, Layout] = field(default_factory=dict)
    at: int = 0
    due_ns: int = 0
    steered: int = 0
    held_back: int = 0
    resuming: tuple[str, Track] | None = None
    resumed: int = 0
    hello: asyncio.Event = field(default_factory=asyncio.Event)
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    # ── what comes ───────────────────────────────────────────────────────────────────────────────────────────────

    def binary(self, content: bytes, now_ns: int) -> None:
        """Count a pose message."""
        tally = self.tally
        try:
            op, wire, records, sequence, due_ns, dropped = HEADER.unpack_from(content)
        except struct.error:
            tally.fault(f"a binary message of {len(content)} bytes")
            return
        if op != POSES or wire != WIRE:
            tally.fault(f"message 0x{op:02x} of wire {wire}")
            return
        missing, reported = self.track.step(sequence, dropped)
        if missing or reported:
            tally.lost(due_ns, missing, reported)
        self.due_ns = due_ns
        tally.message(due_ns, now_ns, records, len(content))
        if tally.messages % SAMPLE == 0:
            self._doubt(content)

    def text(self, content: str | bytes, now_ns: int) -> None:
        """Note what the server says."""
        try:
            said: dict[str, Any] = json.loads(content)
            op = said["op"]
        except (ValueError, TypeError, KeyError):
            self.tally.fault(f"a text message that is no JSON object with an op: {content[:80]!r}")
            return
        self.tally.ops[op] += 1
        if op == "hello":
            self._begin(said["session"])
        elif op == "opened":
            self._opened(said)
        elif op == "version":
            self._renewed(said)
        elif op == "pong":
            self._pong(said["t"], now_ns, said["server_time_ns"])
        elif op == "error":
            self.tally.codes[said["code"]] += 1
            if said["code"] == "unknown_session":
                self.resuming = None
            self.tally.note(f"error {said['code']}: {said['detail'][:200]}")
            self.changed.set()

    def closed(self, code: int, reason: str) -> None:
        """Note that the connection is over."""
        self.tally.closes[code] += 1
        self.changed.set()

    # ── what is asked ────────────────────────────────────────────────────────────────────────────────────────────

    async def start(self) -> None:
        """Connect, compare clocks and open all channels; returns when the server has opened them."""
        await self.join()
        for _ in range(PINGS):
            self.ping()
            await asyncio.sleep(0)
        self.say(*(self.opening(channel) for channel in range(self.asked.channels)))
        async with asyncio.timeout(30.0):
            while len(self.layouts) < self.asked.channels:
                self.changed.clear()
                await self.changed.wait()
                self._check()

    async def join(self) -> None:
        """Connect; returns with the server's hello."""
        self.hello.clear()
        self.link = await connect(self.asked.url, self, self.rng)
        async with asyncio.timeout(10.0):
            await self.hello.wait()

    def resume(self, session: str, track: Track) -> None:
        """Ask for another session, whose messages came as far as the track says; one at a time.

        A session without channels is taken over without a word. So a ping follows, whose answer ends the wait.
        """
        if self.resuming is not None:
            return
        self.resuming = session, replace(track)
        self.say(
            {"op": "resume", "session": session, "last_seq": track.sequence},
            {"op": "ping", "t": FENCE},
        )

    def opening(self, channel: int, **other: Any) -> dict[str, Any]:
        """The message that opens a channel."""
        asked: dict[str, Any] = {
            "op": "open",
            "channel": channel,
            "verb": self.asked.verb,
            "encoding": self.asked.encoding,
            "fps": self.asked.fps,
            "loop": True,
            "phase": round(self.rng.random(), 6),
        }
        if self.asked.method is not None:
            asked["method"] = self.asked.method
        if self.goals is not None:
            asked["adverbs"] = self.goals.adverbs(self.at + STRIDE * channel)
        return asked | other

    def say(self, *messages: Mapping[str, Any]) -> None:
        """Send text messages."""
        if self.link is not None:
            self.link.send(frames.TEXT, *(json.dumps(message).encode() for message in messages))

    def ping(self) -> None:
        """Ask for the server's clock."""
        self.say({"op": "ping", "t": time.monotonic_ns() * 1e-9})

    def steer(self) -> None:
        """Give every channel the next adverbs of the walk."""
        if self.goals is None or self.link is None or not self.link.alive:
            return
        if self.link.full:
            self.held_back += len(self.layouts)
            return
        self.at += 1
        packed = self.goals.packed
        self.link.send(
            frames.BINARY,
            *(
                _AIM.pack(AIM, 0, channel) + packed[(self.at + STRIDE * channel) % len(packed)]
                for channel in self.layouts
            ),
        )
        self.steered += len(self.layouts)

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _begin(self, session: str) -> None:
        self.session, self.track, self.layouts, self.resuming = session, Track(), {}, None
        self.hello.set()

    def _opened(self, said: Mapping[str, Any]) -> None:
        if said["resumed"]:
            self._adopt()
        try:
            self.layouts[said["channel"]] = layout_of(said)
        except DecodeError as err:
            self.tally.fault(str(err))
        self.changed.set()

    def _adopt(self) -> None:
        """Go on with the session that was asked for."""
        if self.resuming is not None:
            (self.session, self.track), self.layouts, self.resuming = self.resuming, {}, None
            self.resumed += 1

    def _pong(self, t: float, now_ns: int, server_time_ns: int) -> None:
        if t == FENCE:
            self._adopt()  # no error came
        else:
            self.clock.add(round(t * 1e9), now_ns, server_time_ns)

    def _renewed(self, said: Mapping[str, Any]) -> None:
        was = self.layouts[said["channel"]]
        self.layouts[said["channel"]] = Layout(was.encoding, was.joints, said["record_bytes"])

    def _doubt(self, content: bytes) -> None:
        self.tally.decoded += 1
        try:
            decode(content, self.layouts)
        except DecodeError as err:
            self.tally.fault(str(err))

    def _check(self) -> None:
        if self.link is None or self.link.gone.is_set():
            raise frames.FrameError("the server ended the connection while channels were opened")
        if self.tally.codes:
            raise frames.FrameError(f"channels were not opened: {self.tally.problems[0]}")
