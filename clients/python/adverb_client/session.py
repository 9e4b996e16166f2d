"""The state of a stream's session, without I/O: takes messages, gives events, poses and messages to send.

States: disconnected → resuming (``resume`` is sent, the answer is incomplete) → live.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from adverb_client.channel import Channel
from adverb_client.clock import Clock, Lateness
from adverb_client.errors import AdverbError, ChannelInUse, DecodeError, NotReady, UnknownChannel, UnknownSession
from adverb_client.messages import (
    BudgetReport,
    ChannelOpened,
    CommandRejected,
    ConnectionLost,
    ConnectionRestored,
    Hello,
    KeytimesPassed,
    MotionEnded,
    Pong,
    ServerDraining,
    StreamEnded,
    StreamEvent,
    VersionChanged,
    parse_message,
)
from adverb_client.records import WEIGHTS
from adverb_client.wire import Layout, decode_message

__all__ = ["Session", "Stats"]

MAX_PINGS = 64


@dataclass(slots=True)
class Stats:
    """Counters of a stream.

    Parameters
    ----------
    messages, records, bytes : int
        Pose messages, records in them, and bytes of all received messages.
    gaps, missing : int
        Jumps of the sequence number, and the sequence numbers that are missing.
    stale : int
        Pose messages that arrived after a newer one and were ignored.
    dropped : int
        Messages that the server reports as not sent, or as lost with a connection.
    decode_errors : int
        Malformed messages; ``last_error`` is the reason of the last one.
    reconnects, resumes : int
        Connections after the first, and those of them that resumed the session.
    events_dropped : int
        Events that were discarded because the queue was full.
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
    events_dropped: int = 0
    last_error: str = ""


class Session:
    """Channels, clocks and statistics of one stream.

    Parameters
    ----------
    send : callable
        Sends a message; called only while there is a connection.
    emit : callable
        Takes events.
    lateness : Lateness
        Shared with the channels' jitter buffers.
    """

    def __init__(
        self, *, send: Callable[[Mapping[str, Any]], None], emit: Callable[[StreamEvent], None], lateness: Lateness
    ) -> None:
        self.channels: dict[int, Channel] = {}
        self.clock, self.lateness, self.stats = Clock(), lateness, Stats()
        self.hello: Hello | None = None
        self.live = False
        self.last_age_s = math.nan
        self.view: Mapping[str, Any] | None = None  # sent on every connection
        self.pending: dict[int, Callable[[AdverbError | None], None]] = {}  # open or switch without an answer
        self._send, self._emit = send, emit
        self._session_id = ""
        self._layouts: dict[int, Layout] = {}
        self._sequence, self._dropped_before = 0, 0
        self._confirmed: set[int] = set()
        self._not_ready: set[int] = set()
        self._tokens = itertools.count(1)
        self._pings: dict[int, tuple[float, Callable[[float], None] | None]] = {}
        self._barrier: int | None = None
        self._disconnected_at_s: float | None = None

    # --- connections ---

    def connected(self, hello: Hello, now_s: float) -> None:
        """Handle a new connection: resume the session, or start one."""
        self.hello = hello
        self.lateness.clear()  # another connection may take another route
        if self._session_id and self.channels:
            self._confirmed.clear()
            self._send({"op": "resume", "session": self._session_id, "last_seq": self._sequence})
            self._barrier = self.ping(now_s)  # its pong follows the whole answer to resume
        else:
            self._begin(hello, now_s)

    def disconnected(self, detail: str, close_code: int | None, now_s: float) -> None:
        """Handle the loss of the connection."""
        if self.live:
            self._emit(ConnectionLost(detail, close_code))
        self.live, self._barrier = False, None
        self._not_ready.clear()
        if self._disconnected_at_s is None and self._session_id:
            self._disconnected_at_s = now_s
        self._pings.clear()

    def close(self, detail: str, close_code: int | None, error: AdverbError) -> None:
        """End the stream; pending requests fail with the error."""
        self.live = False
        for channel in list(self.pending):
            self._answer(channel, error)
        self._emit(StreamEnded(detail, close_code))

    def _begin(self, hello: Hello, now_s: float) -> None:
        """Start a new session and open all channels with their current settings."""
        self._dropped_before = self.stats.dropped
        self._session_id, self._sequence = hello.session, 0
        self._layouts.clear()
        self.lateness.clear()
        self.clock.clear()
        self.live = True
        self._send_view()
        for channel in self.channels.values():
            self._reopen(channel)
        self._restored(now_s, resumed=False)

    def _reopen(self, channel: Channel) -> None:
        channel.commit_switch()
        channel.buffer.restart()
        self._send(channel.open_message())
        if not channel.has_all_adverbs and (changes := channel.set_message()) is not None:
            self._send(changes)  # `open` takes all adverbs or none

    def _join(self, now_s: float) -> None:
        """Go live after a resume: apply the current settings of all channels."""
        self.live = True
        self._send_view()
        for channel in self.channels.values():
            if channel.number not in self._confirmed:
                self._reopen(channel)
                continue
            if channel.switch is not None:
                self._send(channel.switch)
            elif (changes := channel.set_message()) is not None:
                self._send(changes)
        self._restored(now_s, resumed=True)

    def _send_view(self) -> None:
        if self.view is not None:
            self._send(self.view)

    def _restored(self, now_s: float, *, resumed: bool) -> None:
        if self._disconnected_at_s is None:
            return
        self.stats.reconnects += 1
        self.stats.resumes += resumed
        self._emit(ConnectionRestored(resumed, now_s - self._disconnected_at_s))
        self._disconnected_at_s = None

    # --- pings ---

    def ping(self, now_s: float, done: Callable[[float], None] | None = None) -> int:
        """Send a ping and return its number; ``done`` is called with the round trip in seconds."""
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

    def receive(self, content: str | bytes, now_s: float) -> None:
        """Handle a message from the server; a malformed one is counted and otherwise ignored."""
        self.stats.bytes += len(content)
        try:
            if isinstance(content, bytes):
                self._poses(content, now_s)
            else:
                self._text(content, now_s)
        except DecodeError as err:
            self.stats.decode_errors += 1
            self.stats.last_error = err.detail
            if isinstance(content, str):  # it may have been the answer to a pending request
                for channel in list(self.pending):
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
        irregular = self.view is not None and "budget_kbps" in self.view
        for record in message.records():
            self.stats.records += 1
            channel = self.channels.get(record.channel)
            if channel is not None and channel.opened is not None:  # else: a record of a closed channel
                channel.buffer.push(due_s, record, irregular=irregular)
                channel.pending_phase = None
                for observer in channel.observers:
                    observer(due_s, record)

    def _text(self, content: str, now_s: float) -> None:
        message = parse_message(content)
        match message:
            case ChannelOpened():
                self._opened(message)
            case CommandRejected():
                self._rejected(message, now_s)
            case Pong():
                self._pong(message, now_s)
            case VersionChanged():
                self._version_changed(message)
            case KeytimesPassed():
                for passed in message.items:
                    self._emit(passed)
            case MotionEnded():
                if (ended := self.channels.get(message.channel)) is not None:
                    ended.buffer.end()
                self._emit(message)
            case BudgetReport() | ServerDraining():
                self._emit(message)
            case _:
                pass  # an op of a newer server, or a second hello

    def _opened(self, opened: ChannelOpened) -> None:
        self._layouts[opened.channel] = opened.layout
        channel = self.channels.get(opened.channel)
        if channel is None:  # closed, or timed out, before the answer arrived
            self._send({"op": "close", "channel": opened.channel})
            return
        self._confirmed.add(opened.channel)
        self._not_ready.discard(opened.channel)
        channel.apply_opened(opened)
        if channel.switch is None:
            self._answer(opened.channel, None)
        self._emit(opened)

    def _version_changed(self, changed: VersionChanged) -> None:
        old = self._layouts.get(changed.channel)
        if old is not None and old.encoding != WEIGHTS and old.record_bytes != changed.record_bytes:
            raise DecodeError(f"record_bytes of channel {changed.channel} changes to {changed.record_bytes}")
        self._emit(changed)

    def _rejected(self, rejected: CommandRejected, now_s: float) -> None:
        if isinstance(rejected.error, UnknownSession) and self._barrier is not None and self.hello is not None:
            self._barrier = None
            self._begin(self.hello, now_s)
            return
        channel = rejected.channel
        if isinstance(rejected.error, UnknownChannel) and channel in self.channels and not self._is_open(channel):
            return  # a setting after an `open` that was not ready; the next `open` has it
        if isinstance(rejected.error, ChannelInUse) and channel in self.channels:
            self._in_use(self.channels[channel])
            return
        known = self.channels.get(channel) if channel is not None else None
        reopening = known is not None and known.opened is not None and known.number not in self._layouts
        if known is not None and reopening and isinstance(rejected.error, NotReady):  # also while a `switch` waits
            known.error = rejected.error
            self._not_ready.add(known.number)
            return
        if channel is None and len(self.pending) == 1 and rejected.error.code == "bad_message":
            channel = next(iter(self.pending))  # there is no other request
        if channel is not None and channel in self.pending:
            self._answer(channel, rejected.error)
            return
        if known is not None and not self._is_open(known.number):
            known.error = rejected.error
            if isinstance(rejected.error, NotReady):
                return  # of a repeated `open`; the call that opens the channel repeats it again
        self._emit(rejected)

    def _is_open(self, number: int) -> bool:
        """Whether the server has opened this channel, and not only one before with its number."""
        return number in self._layouts and self.channels[number].opened is not None

    def _in_use(self, channel: Channel) -> None:
        """Handle the error of an `open` that was repeated, of this channel or of a closed one with its number."""
        if channel.opened is None:
            self._send({"op": "close", "channel": channel.number})
            self._reopen(channel)
        elif channel.switch is None:
            self._answer(channel.number, None)  # the `open` before was answered

    def retry_not_ready(self) -> None:
        """Reopen channels that the server rejected with ``not_ready``."""
        for channel in [self.channels[number] for number in self._not_ready if number in self.channels]:
            self._reopen(channel)
        self._not_ready.clear()

    def _answer(self, channel: int, error: AdverbError | None) -> None:
        done = self.pending.pop(channel, None)
        if done is not None:
            done(error)
