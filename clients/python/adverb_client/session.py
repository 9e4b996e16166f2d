"""A session of a stream, without any network: messages in, notes, poses and messages to send out.

What a session is in: away (nothing can be sent) → joining (a resume was sent, its answer is not complete) → live.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from adverb_client.channel import Channel
from adverb_client.clock import Clock, Lateness
from adverb_client.errors import AdverbError, DecodeError, NotReady, UnknownSession
from adverb_client.messages import (
    Closed,
    Draining,
    Ended,
    Found,
    Hello,
    Lost,
    Note,
    Opened,
    Passed,
    Pong,
    Published,
    Rejected,
    read_text,
)
from adverb_client.records import WEIGHTS
from adverb_client.wire import Layout, decode_message

__all__ = ["Session", "Stats"]

MAX_PINGS = 64


@dataclass(slots=True)
class Stats:
    """What a stream has seen so far.

    Parameters
    ----------
    messages, records, bytes : int
        Pose messages, records in them, and bytes of all messages that came.
    gaps, missing : int
        How often sequence numbers jumped, and how many of them never came.
    stale : int
        Pose messages that came after a newer one; they are not shown.
    dropped : int
        Messages that the server had and did not send, or that were lost with a connection, as it says itself.
    decode_errors : int
        Messages that could not be read; ``last_error`` says why.
    reconnects, resumes : int
        Connections after the first, and those of them that found the session again.
    notes_dropped : int
        Notes that nobody fetched in time.
    """

    messages: int = 0
    records: int = 0
    bytes: int = 0
    gaps: int = 0
    missing: int = 0
    stale: int = 0
    dropped: int = 0
    decode_errors: int = 0
    reconnects: int = 0
    resumes: int = 0
    notes_dropped: int = 0
    last_error: str = ""


class Session:
    """Channels, clocks and statistics of one stream.

    Parameters
    ----------
    send : callable
        Takes messages, in order; called while there is a connection only.
    note : callable
        Takes what is worth knowing.
    lateness : Lateness
        Shared with the channels' jitter buffers.
    """

    def __init__(
        self, *, send: Callable[[Mapping[str, Any]], None], note: Callable[[Note], None], lateness: Lateness
    ) -> None:
        self.channels: dict[int, Channel] = {}
        self.clock, self.lateness, self.stats = Clock(), lateness, Stats()
        self.hello: Hello | None = None
        self.live = False
        self.last_age_s = math.nan
        self.waiting: dict[int, Callable[[AdverbError | None], None]] = {}  # open or switch that is not answered yet
        self._send, self._note = send, note
        self._name = ""
        self._layouts: dict[int, Layout] = {}
        self._sequence, self._dropped_before = 0, 0
        self._confirmed: set[int] = set()
        self._unready: set[int] = set()
        self._tokens = itertools.count(1)
        self._pings: dict[int, tuple[float, Callable[[float], None] | None]] = {}
        self._barrier: int | None = None
        self._away_since_s: float | None = None

    # --- connections ---

    def greeted(self, hello: Hello, now_s: float) -> None:
        """A connection is there: resume the session, or begin one."""
        self.hello = hello
        self.lateness.clear()  # another connection may be another way through the network
        if self._name and self.channels:
            self._confirmed.clear()
            self._send({"op": "resume", "session": self._name, "last_seq": self._sequence})
            self._barrier = self.ping(now_s)  # whatever resume has to say comes before this comes back
        else:
            self._begin(hello, now_s)

    def lost(self, detail: str, close_code: int | None, now_s: float) -> None:
        """The connection is gone."""
        if self.live:
            self._note(Lost(detail, close_code))
        self.live, self._barrier = False, None
        self._unready.clear()
        if self._away_since_s is None and self._name:
            self._away_since_s = now_s
        self._pings.clear()

    def closed(self, detail: str, close_code: int | None, error: AdverbError) -> None:
        """The stream is over; whoever waits is told so."""
        self.live = False
        for channel in list(self.waiting):
            self._answer(channel, error)
        self._note(Closed(detail, close_code))

    def _begin(self, hello: Hello, now_s: float) -> None:
        """A session of its own, with all channels as they are wanted."""
        self._dropped_before = self.stats.dropped
        self._name, self._sequence = hello.session, 0
        self._layouts.clear()
        self.lateness.clear()
        self.clock.clear()
        self.live = True
        for channel in self.channels.values():
            self._reopen(channel)
        self._back(now_s, resumed=False)

    def _reopen(self, channel: Channel) -> None:
        channel.become()
        channel.buffer.restart()
        self._send(channel.opening())
        if not channel.whole and (changes := channel.changes()) is not None:
            self._send(changes)  # an open takes all adverbs or none

    def _join(self, now_s: float) -> None:
        """The session goes on: bring what went on without us to what is wanted by now."""
        self.live = True
        for channel in self.channels.values():
            if channel.number not in self._confirmed:
                self._reopen(channel)
                continue
            if channel.switch is not None:
                self._send(channel.switch)
            elif (changes := channel.changes()) is not None:
                self._send(changes)
        self._back(now_s, resumed=True)

    def _back(self, now_s: float, *, resumed: bool) -> None:
        if self._away_since_s is None:
            return
        self.stats.reconnects += 1
        self.stats.resumes += resumed
        self._note(Found(resumed, now_s - self._away_since_s))
        self._away_since_s = None

    # --- pings ---

    def ping(self, now_s: float, done: Callable[[float], None] | None = None) -> int:
        """Send a ping; ``done`` is called with its round trip in seconds. Returns its number."""
        token = next(self._tokens)
        self._pings[token] = (now_s, done)
        if len(self._pings) > MAX_PINGS:
            del self._pings[next(iter(self._pings))]
        self._send({"op": "ping", "t": token})
        return token

    def _pong(self, pong: Pong, now_s: float) -> None:
        token = int(pong.t)
        sent_s, done = self._pings.pop(token, (math.nan, None))
        if math.isfinite(sent_s):
            self.clock.add(sent_s, now_s, pong.server_time_ns)
        if done is not None:
            done(now_s - sent_s)
        if token == self._barrier:
            self._barrier = None
            self._join(now_s)

    # --- messages ---

    def received(self, content: str | bytes, now_s: float) -> None:
        """Take a message from the server; one that cannot be read is counted and changes nothing."""
        self.stats.bytes += len(content)
        try:
            if isinstance(content, bytes):
                self._poses(content, now_s)
            else:
                self._text(content, now_s)
        except DecodeError as err:
            self.stats.decode_errors += 1
            self.stats.last_error = err.detail
            if isinstance(content, str):  # it may have been what somebody waits for
                for channel in list(self.waiting):
                    self._answer(channel, err)

    def _poses(self, content: bytes, now_s: float) -> None:
        message = decode_message(content, self._layouts)
        self.stats.messages += 1
        self.stats.dropped = self._dropped_before + message.dropped
        step = (message.sequence - self._sequence) % 2**32
        if step == 0 or step >= 2**31:
            self.stats.stale += 1
            return
        if step > 1 and self._sequence:
            self.stats.gaps += 1
            self.stats.missing += step - 1
        self._sequence = message.sequence
        due_s = message.time_ns * 1e-9
        self.lateness.add(now_s, due_s)
        self.last_age_s = self.clock.age_s(now_s, due_s)
        for record in message.records():
            self.stats.records += 1
            channel = self.channels.get(record.channel)
            if channel is not None and channel.opened is not None:  # else it is of a closed one with this number
                channel.buffer.push(due_s, record)
                channel.jump = None

    def _text(self, content: str, now_s: float) -> None:
        message = read_text(content)
        match message:
            case Opened():
                self._opened(message)
            case Rejected():
                self._rejected(message, now_s)
            case Pong():
                self._pong(message, now_s)
            case Published():
                self._published(message)
            case Passed() | Ended() | Draining():
                self._note(message)
            case _:
                pass  # an op of a newer server, or a hello that says nothing new

    def _opened(self, opened: Opened) -> None:
        self._layouts[opened.channel] = opened.layout
        channel = self.channels.get(opened.channel)
        if channel is None:  # closed, or given up, while the answer was under way
            self._send({"op": "close", "channel": opened.channel})
            return
        self._confirmed.add(opened.channel)
        channel.answered(opened)
        if channel.switch is None:
            self._answer(opened.channel, None)
        self._note(opened)

    def _published(self, published: Published) -> None:
        old = self._layouts.get(published.channel)
        if old is not None and old.encoding != WEIGHTS and old.record_bytes != published.record_bytes:
            raise DecodeError(f"channel {published.channel} has {published.record_bytes} bytes in its new version")
        self._note(published)

    def _rejected(self, rejected: Rejected, now_s: float) -> None:
        if isinstance(rejected.error, UnknownSession) and self._barrier is not None and self.hello is not None:
            self._barrier = None
            self._begin(self.hello, now_s)
            return
        channel = rejected.channel
        if channel is None and len(self.waiting) == 1 and rejected.error.code == "bad_message":
            channel = next(iter(self.waiting))  # nothing else was asked
        if channel is not None and channel in self.waiting:
            self._answer(channel, rejected.error)
            return
        known = self.channels.get(channel) if channel is not None else None
        if known is not None and known.number not in self._layouts:
            known.refused = rejected.error
            if isinstance(rejected.error, NotReady):
                self._unready.add(known.number)
                return
        self._note(rejected)

    def knock(self) -> None:
        """Ask again for channels that the server could not open since it was loading its verbs."""
        for channel in [self.channels[number] for number in self._unready if number in self.channels]:
            self._reopen(channel)
        self._unready.clear()

    def _answer(self, channel: int, error: AdverbError | None) -> None:
        done = self.waiting.pop(channel, None)
        if done is not None:
            done(error)
