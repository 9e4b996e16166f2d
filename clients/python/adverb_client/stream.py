"""A stream of poses: one WebSocket, which reconnects automatically."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import Any, Self, Unpack

import numpy as np
import numpy.typing as npt

from adverb_client.backoff import Backoff
from adverb_client.bulk import BulkGoals, Rows
from adverb_client.channel import Channel
from adverb_client.clock import Clock, Lateness
from adverb_client.connection import Connection, stream_url
from adverb_client.errors import AdverbError, NotReady, StreamClosed, TimedOut, TransportError
from adverb_client.jitter import Delays, JitterBuffer, Sample
from adverb_client.messages import ChannelOpened, Hello, ServerDraining, StreamEnded, StreamEvent
from adverb_client.options import OpenOptions, checked
from adverb_client.outbox import Outbox
from adverb_client.session import Session, Stats

__all__ = ["Stream"]

DEFAULT_FPS = 60.0


class Stream:
    """A stream of poses.

    Parameters
    ----------
    url : str
        Address of the server: ``http://``, ``https://``, ``ws://`` or ``wss://``; the path is optional.
    api_key : str, optional
    delays : Delays, optional
        Bounds of the jitter buffers.
    on_event : callable, optional
        Called with each :data:`StreamEvent` in the event loop; it must not block. Without it, events are queued for
        iteration over the stream and for ``take_events``.
    max_events : int
        Length of the queue of events; the oldest are discarded and counted.
    reconnect_timeout_s : float
        How long to try to reconnect after a lost connection, seconds.
    backoff : Backoff, optional
        Delays between attempts.
    now : callable
        A monotonic clock, seconds.

    Examples
    --------
    >>> async with Stream("http://127.0.0.1:8000") as stream:
    ...     channel = await stream.open("reach", adverbs={"x": -0.3, "y": 1.2, "z": 0.4}, fps=60)
    ...     channel.aim([-0.2, 1.3, 0.4])
    ...     sample = channel.pose()
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        api_key: str | None = None,
        delays: Delays | None = None,
        on_event: Callable[[StreamEvent], None] | None = None,
        max_events: int = 1024,
        reconnect_timeout_s: float = 120.0,
        backoff: Backoff | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.url, self.now = stream_url(url), now
        self._headers = {"authorization": f"Bearer {api_key}"} if api_key else {}
        self._delays, self._reconnect_timeout_s, self._backoff = (
            delays or Delays(),
            reconnect_timeout_s,
            backoff or Backoff(),
        )
        self._lateness = Lateness()
        self._session = Session(send=self._send, emit=self._add_event, lateness=self._lateness)
        self._bulk = BulkGoals(self._session.channels, self._post)
        self._events: deque[StreamEvent] = deque()
        self._max_events, self._on_event, self._event_added = max_events, on_event, asyncio.Event()
        self._outbox: Outbox | None = None
        self._task: asyncio.Task[None] | None = None
        self._connection: Connection | None = None
        self._next = 0

    # --- lifetime ---

    async def __aenter__(self) -> Self:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self, timeout_s: float = 10.0) -> None:
        """Connect; attempts are repeated until the timeout.

        Raises
        ------
        TimedOut
            If there is no connection in time.
        StreamClosed
            If the server does not support this protocol or rejects the key.
        """
        if self._task is not None:
            raise RuntimeError("a stream is connected once; it reconnects automatically")
        self._outbox = Outbox(asyncio.get_running_loop())
        self._connection = Connection(
            self.url,
            self._headers,
            self._session,
            self._outbox,
            backoff=self._backoff,
            reconnect_timeout_s=self._reconnect_timeout_s,
            now=self.now,
        )
        self._task = asyncio.create_task(self._connection.run(), name="adverb stream")
        self._task.add_done_callback(lambda task: task.cancelled() or task.exception())  # an event reports it
        ready = asyncio.create_task(self._connection.ready.wait())
        await asyncio.wait((ready, self._task), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        ready.cancel()
        if self._task.done():
            self._task.result()  # raises the error that ended it
        if not self._connection.ready.is_set():
            await self.close()
            raise TimedOut(f"{self.url}: no stream within {timeout_s:g} s: {self._failure}")

    async def close(self) -> None:
        """Close the stream and all its channels; received poses stay readable."""
        task = self._task
        if task is None or task.done():
            return
        task.cancel()
        await asyncio.wait((task,))

    @property
    def closed(self) -> bool:
        """Whether the stream has ended."""
        return self._task is not None and self._task.done()

    @property
    def _failure(self) -> str:
        return "not connected" if self._connection is None else self._connection.failure

    @property
    def live(self) -> bool:
        """Whether there is a connection."""
        return self._session.live

    # --- state ---

    @property
    def stats(self) -> Stats:
        """Counters of messages, gaps and errors."""
        return self._session.stats

    @property
    def clock(self) -> Clock:
        """Estimate of the server's clock."""
        return self._session.clock

    @property
    def hello(self) -> Hello | None:
        """The server's first message."""
        return self._session.hello

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Open channels by number."""
        return self._session.channels

    @property
    def age_s(self) -> float:
        """Age of the newest pose message at its arrival, seconds; NaN before the first pong."""
        return self._session.last_age_s

    @property
    def lateness_s(self) -> float:
        """The 98 % quantile of transit times minus the smallest, seconds; NaN before the first message."""
        measured = self._lateness.measured()
        return math.nan if measured is None else measured[1]

    def pose(self, channel: Channel | int, at: float | None = None) -> Sample | None:
        """The pose of a channel; see :meth:`Channel.pose`."""
        return (channel if isinstance(channel, Channel) else self._session.channels[channel]).pose(at)

    async def ping(self, timeout_s: float = 5.0) -> float:
        """Round trip time of a ping, seconds.

        Raises
        ------
        TransportError
            If there is no connection.
        TimedOut
            If there is no pong in time.
        """
        back: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        if not self._session.live:
            raise TransportError(f"no connection: {self._failure}")
        self._session.ping(self.now(), lambda trip_s: None if back.done() else back.set_result(trip_s))
        try:
            async with asyncio.timeout(timeout_s):
                return await back
        except TimeoutError as err:
            raise TimedOut(f"no pong within {timeout_s:g} s") from err

    def aim_many(self, channels: Sequence[Channel | int] | npt.NDArray[np.integer[Any]], adverbs: Rows) -> None:
        """Set the goals of many channels with one message, of 4 + B·(4 + 4·D) bytes; never blocks.

        It costs the client and the server a fraction of B calls of :meth:`Channel.aim`, above all if channels and
        adverbs are arrays. Rows of different lengths, and more than 64 KiB, take several messages.

        Parameters
        ----------
        channels : (B,) channels or their numbers
        adverbs : (B, D) numbers
            Of each channel, in the order of its ``info.adverbs``, in their units.

        Raises
        ------
        ValueError
            If a channel is not open, the number of its adverbs is another, or a number is not finite or exceeds 1e9.
        """
        self._bulk.aim(channels, adverbs)

    def view(self, position: Sequence[float] | None = None, *, budget_kbps: float | None = None) -> None:
        """Set the viewpoint and the byte budget of the stream; replaces both, also after a reconnection.

        With a budget, channels that do not fit are left out of a message; near ones, and those with a higher
        ``priority``, are sent more often. :class:`BudgetReport` reports what was sent.

        Parameters
        ----------
        position : (3,) numbers, optional
            Viewpoint in metres, +Y up.
        budget_kbps : float, optional
            Limit of pose messages, 1000 bit/s, 1 to 10,000,000; unlimited by default.

        Raises
        ------
        ValueError
            If a number is out of range.
        """
        place = {} if position is None else dict(zip("xyz", position, strict=True))
        self._session.view = {"op": "view", **checked({**place, "budget_kbps": budget_kbps})}
        self._post(("view", 0), self._session.view)

    # --- events ---

    def take_events(self) -> list[StreamEvent]:
        """Take all queued events, without waiting."""
        taken = []
        while self._events:
            taken.append(self._events.popleft())
        return taken

    async def __aiter__(self) -> AsyncIterator[StreamEvent]:
        """Events as they occur; ends after :class:`StreamEnded`."""
        while True:
            while self._events:
                event = self._events.popleft()
                yield event
                if isinstance(event, StreamEnded):
                    return
            if self.closed:
                return
            self._event_added.clear()
            await self._event_added.wait()

    def _add_event(self, event: StreamEvent) -> None:
        if isinstance(event, ChannelOpened):
            self._bulk.channels_changed()
        if isinstance(event, ServerDraining) and self._connection is not None:
            self._connection.drain_wait_s = event.reconnect_after_s
        if self._on_event is not None:
            self._on_event(event)
            return
        if len(self._events) >= self._max_events:
            self._events.popleft()
            self.stats.events_dropped += 1
        self._events.append(event)
        self._event_added.set()

    # --- channels ---

    async def open(
        self, verb: str, *, number: int | None = None, timeout_s: float = 10.0, **options: Unpack[OpenOptions]
    ) -> Channel:
        """Open a channel: one character that plays a verb.

        Parameters
        ----------
        verb : str
        number : int, optional
            Channel number, 0 … 65,535; the next free one by default.
        timeout_s : float
            How long to wait for the answer, including the time in which the server loads its verbs.
        **options
            See :class:`OpenOptions`.

        Raises
        ------
        ValueError
            If the number is in use or an option is invalid; nothing is sent.
        ResponseError
            If the server rejects the request.
        TimedOut
            If there is no answer in time.
        StreamClosed
            If the stream has ended.
        """
        taken = self._session.channels
        number = self._free() if number is None else number
        if not 0 <= number <= 65_535 or number in taken:
            raise ValueError(f"channel {number} is " + ("open already" if number in taken else "not 0 to 65,535"))
        settings = checked(options)
        buffer = JitterBuffer(self._lateness, 1.0 / settings.get("fps", DEFAULT_FPS), self._delays)
        self._bulk.take(number)  # of an earlier channel
        channel = Channel(
            number, verb, options, buffer=buffer, post=self._post, now=self.now, bulk_goal=self._bulk.take
        )
        taken[number] = channel
        try:
            async with channel.lock:
                await self._exchange(channel, channel.open_message(), timeout_s, retry_not_ready=True)
        except BaseException:
            taken.pop(number, None)
            raise
        return channel

    async def switch(
        self,
        channel: Channel,
        verb: str,
        *,
        adverbs: Mapping[str, float] | None = None,
        method: str | None = None,
        phase: float | None = None,
        transition_s: float | None = None,
        timeout_s: float = 10.0,
    ) -> ChannelOpened:
        """Switch a channel to another verb, with a continuous transition.

        Parameters
        ----------
        channel : Channel
        verb : str
        adverbs, method, phase
            Of the new verb; the server's defaults where omitted.
        transition_s : float, optional
            Length of the transition, 0–5 s.
        timeout_s : float

        Raises
        ------
        ValueError, ResponseError, TimedOut, StreamClosed
            As :meth:`open`; the channel keeps its verb.
        """
        fields = {"adverbs": adverbs, "method": method, "phase": phase, "transition_s": transition_s}
        given = checked(fields)
        async with channel.lock:
            self._bulk.channels_changed()
            channel.switch = {"op": "switch", "channel": channel.number, "verb": verb, **given}
            try:
                await self._exchange(channel, channel.switch, timeout_s)
            finally:
                channel.clear_switch()
        return channel.info

    async def close_channel(self, channel: Channel) -> None:
        """Close a channel; its received poses stay readable."""
        async with channel.lock:
            self._bulk.channels_changed()
            if self._session.channels.pop(channel.number, None) is not None:
                self._post(("close", channel.number), {"op": "close", "channel": channel.number})

    def _free(self) -> int:
        taken = self._session.channels
        for _ in range(65_536):
            number, self._next = self._next, (self._next + 1) % 65_536
            if number not in taken:
                return number
        raise ValueError("all 65,536 channels are open")

    async def _exchange(
        self, channel: Channel, message: Mapping[str, Any], timeout_s: float, *, retry_not_ready: bool = False
    ) -> None:
        """Send a request and wait for its answer, also across a reconnection."""
        pending, loop = self._session.pending, asyncio.get_running_loop()
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    if self._task is None or self.closed:
                        raise StreamClosed(f"the stream is closed: {self._failure}")
                    answer: asyncio.Future[AdverbError | None] = loop.create_future()
                    pending[channel.number] = partial(_resolve, answer)
                    self._post(None, message)
                    error = await answer
                    if error is None:
                        return
                    if not (retry_not_ready and isinstance(error, NotReady)):
                        raise error
                    await asyncio.sleep(0.25)
        except TimeoutError as err:
            raise TimedOut(f"no answer to {message['op']} of channel {channel.number} within {timeout_s:g} s") from err
        finally:
            pending.pop(channel.number, None)

    # --- the connection ---

    def _post(self, key: tuple[str, int | bytes] | None, message: Mapping[str, Any] | bytes) -> None:
        if self._outbox is not None and self._session.live:  # otherwise settings are sent after the reconnection
            self._outbox.put(key, message)

    def _send(self, message: Mapping[str, Any]) -> None:
        if self._outbox is not None:
            self._outbox.put(None, message)


def _resolve(answer: asyncio.Future[AdverbError | None], error: AdverbError | None) -> None:
    if not answer.done():
        answer.set_result(error)
