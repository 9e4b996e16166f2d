"""One load client: a stream with the channels' layouts, the message numbering and the clock."""

from __future__ import annotations

import asyncio
import json
import random
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from adverb_client import (
    ChannelOpened,
    Clock,
    CommandRejected,
    DecodeError,
    Hello,
    Layout,
    VersionChanged,
    decode_message,
    encode_adverbs,
    encode_bulk_adverbs,
)
from adverb_client.messages import Pong, parse_message
from adverb_client.records import WEIGHTS
from adverb_client.wire import MESSAGE_HEADER, POSES, WIRE

from adverb_load import frames
from adverb_load.checks import check_message
from adverb_load.goals import Goals
from adverb_load.tally import Tally, Track
from adverb_load.websocket import WebSocket, connect

__all__ = ["SAMPLE", "Load", "LoadClient"]

SAMPLE = 64
"""One pose message of this number is decoded in full."""

PINGS = 4
STRIDE = 37
"""Steps of the walk between two channels of a stream."""

FENCE = -1.0
"""What the ping after a ``resume`` carries."""


@dataclass(frozen=True, slots=True)
class Load:
    """Parameters of a load.

    Parameters
    ----------
    url, verb, encoding : str
    sockets, channels, fps : int
        Number of sockets, channels per socket, frames per second of each channel.
    method : str or None
        Blending method; the verb's default if None.
    steer_hz : float
        Rate of new adverbs per channel.
    bulk : bool
        Whether one message has the adverbs of all channels of a socket.
    events : bool
        Whether keytimes are reported.
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
    bulk: bool = False
    events: bool = True
    seed: int = 1


@dataclass(slots=True)
class LoadClient:
    """A stream.

    Parameters
    ----------
    load : Load
    tally : Tally
    clock : Clock
        Shared by the process: all streams use one server.
    rng : random.Random
    goals : Goals or None
        Adverbs stay in the middle of the domain if None.
    """

    load: Load
    tally: Tally
    clock: Clock
    rng: random.Random
    goals: Goals | None
    socket: WebSocket | None = None
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

    # ── received messages ────────────────────────────────────────────────────────────────────────────────────────

    def binary(self, content: bytes, now_ns: int) -> None:
        """Count a pose message; decode one of :data:`SAMPLE`."""
        tally = self.tally
        try:
            op, wire, records, sequence, due_ns, dropped = MESSAGE_HEADER.unpack_from(content)
        except struct.error:
            tally.fault(f"a binary message of {len(content)} bytes")
            return
        if op != POSES or wire != WIRE:
            tally.fault(f"message 0x{op:02x} of wire version {wire}")
            return
        missing, reported = self.track.step(sequence, dropped)
        if missing or reported:
            tally.lost(due_ns, missing, reported)
        self.due_ns = due_ns
        tally.message(due_ns, now_ns, records, len(content))
        if tally.messages % SAMPLE == 0:
            self._check_records(content)

    def text(self, content: str | bytes, now_ns: int) -> None:
        """Handle a text message of the server."""
        text = content if isinstance(content, str) else content.decode("utf-8", "replace")
        try:
            message = parse_message(text)
        except DecodeError as err:
            self.tally.fault(err.detail)
            return
        self.tally.ops["unknown" if message is None else type(message).__name__] += 1
        if isinstance(message, Hello):
            self._begin(message.session)
        elif isinstance(message, ChannelOpened):
            self._opened(message)
        elif isinstance(message, VersionChanged):
            self._version_changed(message)
        elif isinstance(message, Pong):
            self._pong(message, now_ns)
        elif isinstance(message, CommandRejected):
            self._rejected(message)

    def closed(self, code: int, reason: str) -> None:
        """Count the end of the connection."""
        self.tally.closes[code] += 1
        self.changed.set()

    # ── requests ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def start(self) -> None:
        """Connect, compare clocks and open all channels; returns when the server has opened them."""
        await self.join()
        for _ in range(PINGS):
            self.ping()
            await asyncio.sleep(0)
        self.send(*(self.open_message(channel) for channel in range(self.load.channels)))
        async with asyncio.timeout(30.0):
            while len(self.layouts) < self.load.channels:
                self.changed.clear()
                await self.changed.wait()
                self._check_opening()

    async def join(self) -> None:
        """Connect; returns after the server's ``hello``."""
        self.hello.clear()
        self.socket = await connect(self.load.url, self, self.rng)
        async with asyncio.timeout(10.0):
            await self.hello.wait()

    def resume(self, session: str, track: Track) -> None:
        """Resume another session, of which the messages up to the track's have arrived; one at a time.

        The resume of a session without channels has no answer. So a ping follows; its pong ends the wait.
        """
        if self.resuming is not None:
            return
        self.resuming = session, replace(track)
        self.send(
            {"op": "resume", "session": session, "last_seq": track.sequence},
            {"op": "ping", "t": FENCE},
        )

    def open_message(self, channel: int, **other: Any) -> dict[str, Any]:
        """The message that opens a channel."""
        message: dict[str, Any] = {
            "op": "open",
            "channel": channel,
            "verb": self.load.verb,
            "encoding": self.load.encoding,
            "fps": self.load.fps,
            "loop": True,
            "phase": round(self.rng.random(), 6),
        }
        if self.load.method is not None:
            message["method"] = self.load.method
        if not self.load.events:
            message["events"] = False
        if self.goals is not None:
            message["adverbs"] = self.goals.adverbs(self.at + STRIDE * channel)
        return message | other

    def send(self, *messages: Mapping[str, Any]) -> None:
        """Send text messages."""
        if self.socket is not None:
            self.socket.send(frames.TEXT, *(json.dumps(message).encode() for message in messages))

    def ping(self) -> None:
        """Ping the server, to compare clocks."""
        self.send({"op": "ping", "t": time.monotonic_ns() * 1e-9})

    def steer(self) -> None:
        """Send the next adverbs of the walk to every channel."""
        if self.goals is None or self.socket is None or not self.socket.alive:
            return
        if self.socket.full:
            self.held_back += len(self.layouts)
            return
        self.at += 1
        channels = list(self.layouts)
        steps = [(self.at + STRIDE * channel) % len(self.goals.packed) for channel in channels]
        if self.load.bulk:
            messages = encode_bulk_adverbs(channels, self.goals.rows[steps])
        else:
            packed = self.goals.packed
            messages = [adverbs_header(channel) + packed[step] for channel, step in zip(channels, steps, strict=True)]
        self.socket.send(frames.BINARY, *messages)
        self.steered += len(channels)

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _begin(self, session: str) -> None:
        self.session, self.track, self.layouts, self.resuming = session, Track(), {}, None
        self.hello.set()

    def _opened(self, opened: ChannelOpened) -> None:
        if opened.resumed:
            self._adopt()
        self.layouts[opened.channel] = opened.layout
        self.changed.set()

    def _adopt(self) -> None:
        """Continue with the requested session."""
        if self.resuming is not None:
            (self.session, self.track), self.layouts, self.resuming = self.resuming, {}, None
            self.resumed += 1

    def _pong(self, pong: Pong, now_ns: int) -> None:
        if pong.t == FENCE:
            self._adopt()  # there was no error
        else:
            self.clock.add(pong.t, now_ns * 1e-9, pong.server_time_ns)

    def _rejected(self, rejected: CommandRejected) -> None:
        error = rejected.error
        self.tally.codes[error.code] += 1
        if error.code == "unknown_session":
            self.resuming = None
        self.tally.note(f"error {error.code}: {error.detail[:200]}")
        self.changed.set()

    def _version_changed(self, changed: VersionChanged) -> None:
        old = self.layouts[changed.channel]
        try:
            if old.encoding == WEIGHTS:
                self.layouts[changed.channel] = Layout.from_opened("weights", 0, changed.record_bytes)
            elif old.record_bytes != changed.record_bytes:
                raise DecodeError(f"record_bytes of channel {changed.channel} changes to {changed.record_bytes}")
        except DecodeError as err:
            self.tally.fault(err.detail)

    def _check_records(self, content: bytes) -> None:
        self.tally.decoded += 1
        try:
            check_message(decode_message(content, self.layouts), self.layouts)
        except DecodeError as err:
            self.tally.fault(err.detail)

    def _check_opening(self) -> None:
        if self.socket is None or self.socket.gone.is_set():
            raise frames.FrameError("the server ended the connection while channels were opened")
        if self.tally.codes:
            raise frames.FrameError(f"channels were not opened: {self.tally.problems[0]}")


_HEADERS: dict[int, bytes] = {}


def adverbs_header(channel: int) -> bytes:
    """The first four bytes of a binary message with adverbs, as the client library encodes them; cached."""
    if channel not in _HEADERS:
        _HEADERS[channel] = encode_adverbs(channel, ())
    return _HEADERS[channel]
