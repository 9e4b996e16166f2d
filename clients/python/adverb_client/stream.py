"""A stream of poses: one WebSocket that comes back by itself."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from types import TracebackType
from typing import Any, Self, Unpack

from adverb_client.backoff import Backoff
from adverb_client.channel import Channel, OpenOptions
from adverb_client.clock import Clock, Lateness
from adverb_client.connection import Link, stream_url
from adverb_client.errors import AdverbError, NotReady, StreamClosed, TimedOut, TransportError
from adverb_client.jitter import Delays, JitterBuffer, Sample
from adverb_client.messages import Closed, Draining, Hello, Note, Opened
from adverb_client.outbox import Outbox
from adverb_client.session import Session, Stats

__all__ = ["Stream"]

DEFAULT_FPS = 60.0


class Stream:
    """A stream of poses.

    Parameters
    ----------
    url : str
        Where the server is: ``http://``, ``https://``, ``ws://`` or ``wss://``; the path may be left out.
    api_key : str, optional
    delays : Delays, optional
        Bounds of the jitter buffers.
    on_note : callable, optional
        Called with each :data:`Note`, in the event loop; it must not wait. Without it, notes are kept for whoever
        iterates over the stream.
    max_notes : int
        Notes that are kept; the oldest go first, and are counted.
    give_up_s : float
        How long to try to come back after a lost connection, seconds.
    backoff : Backoff, optional
        Waits between two tries.
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
        on_note: Callable[[Note], None] | None = None,
        max_notes: int = 1024,
        give_up_s: float = 120.0,
        backoff: Backoff | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.url, self.now = stream_url(url), now
        self._headers = {"authorization": f"Bearer {api_key}"} if api_key else {}
        self._delays, self._give_up_s, self._backoff = delays or Delays(), give_up_s, backoff or Backoff()
        self._lateness = Lateness()
        self._session = Session(send=self._send, note=self._noted, lateness=self._lateness)
        self._notes: deque[Note] = deque()
        self._max_notes, self._on_note, self._noted_event = max_notes, on_note, asyncio.Event()
        self._outbox: Outbox | None = None
        self._task: asyncio.Task[None] | None = None
        self._link: Link | None = None
        self._next = 0

    # --- life ---

    async def __aenter__(self) -> Self:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self, timeout_s: float = 10.0) -> None:
        """Connect; a server that is not there yet is tried again until the time is over.

        Raises
        ------
        TimedOut
            If it is not there in time.
        StreamClosed
            If it does not speak this protocol, or wants another key.
        """
        if self._task is not None:
            raise RuntimeError("a stream is connected once; it comes back by itself")
        self._outbox = Outbox(asyncio.get_running_loop())
        self._link = Link(
            self.url,
            self._headers,
            self._session,
            self._outbox,
            backoff=self._backoff,
            give_up_s=self._give_up_s,
            now=self.now,
        )
        self._task = asyncio.create_task(self._link.run(), name="adverb stream")
        self._task.add_done_callback(lambda task: task.cancelled() or task.exception())  # notes have told it
        ready = asyncio.create_task(self._link.ready.wait())
        await asyncio.wait((ready, self._task), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        ready.cancel()
        if self._task.done():
            self._task.result()  # raises what ended it
        if not self._link.ready.is_set():
            await self.close()
            raise TimedOut(f"{self.url}: no stream within {timeout_s:g} s: {self._failure}")

    async def close(self) -> None:
        """Close the stream and all its channels; what was received can still be looked at."""
        task = self._task
        if task is None or task.done():
            return
        task.cancel()
        await asyncio.wait((task,))

    @property
    def closed(self) -> bool:
        """Whether it is over."""
        return self._task is not None and self._task.done()

    @property
    def _failure(self) -> str:
        return "not connected" if self._link is None else self._link.failure

    @property
    def live(self) -> bool:
        """Whether there is a connection."""
        return self._session.live

    # --- what it knows ---

    @property
    def stats(self) -> Stats:
        """Counts of what was received."""
        return self._session.stats

    @property
    def clock(self) -> Clock:
        """The server's clock as seen from here."""
        return self._session.clock

    @property
    def hello(self) -> Hello | None:
        """What the server said first."""
        return self._session.hello

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Open channels by number."""
        return self._session.channels

    @property
    def age_s(self) -> float:
        """How old the newest pose message was when it came, by both clocks, seconds; NaN before the first ping."""
        return self._session.last_age_s

    @property
    def lateness_s(self) -> float:
        """How much later than the earliest nearly all messages come, seconds; NaN before the first."""
        measured = self._lateness.measured()
        return math.nan if measured is None else measured[1]

    def pose(self, channel: Channel | int, at: float | None = None) -> Sample | None:
        """The pose of a channel; see :meth:`Channel.pose`."""
        return (channel if isinstance(channel, Channel) else self._session.channels[channel]).pose(at)

    async def ping(self, timeout_s: float = 5.0) -> float:
        """Round trip of a ping, seconds.

        Raises
        ------
        TimedOut
            If it does not come back in time.
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

    # --- notes ---

    def take_notes(self) -> list[Note]:
        """All notes that nobody has seen yet, without waiting."""
        taken = []
        while self._notes:
            taken.append(self._notes.popleft())
        return taken

    async def __aiter__(self) -> AsyncIterator[Note]:
        """Notes as they come; ends after :class:`Closed`."""
        while True:
            while self._notes:
                note = self._notes.popleft()
                yield note
                if isinstance(note, Closed):
                    return
            if self.closed:
                return
            self._noted_event.clear()
            await self._noted_event.wait()

    def _noted(self, note: Note) -> None:
        if isinstance(note, Draining) and self._link is not None:
            self._link.wait_first_s = note.reconnect_after_s
        if self._on_note is not None:
            self._on_note(note)
            return
        if len(self._notes) >= self._max_notes:
            self._notes.popleft()
            self.stats.notes_dropped += 1
        self._notes.append(note)
        self._noted_event.set()

    # --- channels ---

    async def open(
        self, verb: str, *, number: int | None = None, timeout_s: float = 10.0, **options: Unpack[OpenOptions]
    ) -> Channel:
        """Open a channel: a character that moves by a verb.

        Parameters
        ----------
        verb : str
        number : int, optional
            0 … 65,535; the next free one by default.
        timeout_s : float
            How long to wait for the answer, a server that still loads its verbs included.
        **options
            See :class:`OpenOptions`.

        Raises
        ------
        Refused
            If the server says no.
        TimedOut
            If it does not answer in time.
        StreamClosed
            If the stream is over.
        """
        taken = self._session.channels
        number = self._free() if number is None else number
        if not 0 <= number <= 65_535 or number in taken:
            raise ValueError(f"channel {number} is " + ("open already" if number in taken else "not 0 to 65,535"))
        buffer = JitterBuffer(self._lateness, 1.0 / options.get("fps", DEFAULT_FPS), self._delays)
        channel = Channel(number, verb, options, buffer=buffer, post=self._post, now=self.now)
        taken[number] = channel
        try:
            async with channel.lock:
                await self._asked(channel, channel.opening(), timeout_s, patient=True)
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
    ) -> Opened:
        """Let a channel go over to another verb without a jump.

        Parameters
        ----------
        channel : Channel
        verb : str
        adverbs, method, phase
            Of the new verb; the server's defaults where left out.
        transition_s : float, optional
            0–5 s.
        timeout_s : float

        Raises
        ------
        Refused, TimedOut, StreamClosed
            As :meth:`open`; the old verb goes on.
        """
        fields = {"adverbs": adverbs, "method": method, "phase": phase, "transition_s": transition_s}
        given = {name: value for name, value in fields.items() if value is not None}
        if adverbs is not None:
            given["adverbs"] = {name: float(number) for name, number in adverbs.items()}
        async with channel.lock:
            channel.switch = {"op": "switch", "channel": channel.number, "verb": verb, **given}
            try:
                await self._asked(channel, channel.switch, timeout_s)
            finally:
                channel.forget_switch()
        return channel.told

    async def close_channel(self, channel: Channel) -> None:
        """Close a channel; its last poses can still be looked at."""
        async with channel.lock:
            if self._session.channels.pop(channel.number, None) is not None:
                self._post(("close", channel.number), {"op": "close", "channel": channel.number})

    def _free(self) -> int:
        taken = self._session.channels
        for _ in range(65_536):
            number, self._next = self._next, (self._next + 1) % 65_536
            if number not in taken:
                return number
        raise ValueError("all 65,536 channels are open")

    async def _asked(
        self, channel: Channel, message: Mapping[str, Any], timeout_s: float, *, patient: bool = False
    ) -> None:
        """Send what has an answer, and wait for it; a lost connection in between is not the end."""
        waiting, loop = self._session.waiting, asyncio.get_running_loop()
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    if self._task is None or self.closed:
                        raise StreamClosed(f"the stream is closed: {self._failure}")
                    answer: asyncio.Future[AdverbError | None] = loop.create_future()
                    waiting[channel.number] = partial(_tell, answer)
                    self._post(None, message)
                    error = await answer
                    if error is None:
                        return
                    if not (patient and isinstance(error, NotReady)):
                        raise error
                    await asyncio.sleep(0.25)
        except TimeoutError as err:
            raise TimedOut(f"no answer to {message['op']} of channel {channel.number} within {timeout_s:g} s") from err
        finally:
            waiting.pop(channel.number, None)

    # --- the connection ---

    def _post(self, key: tuple[str, int] | None, message: Mapping[str, Any] | bytes) -> None:
        if self._outbox is not None and self._session.live:  # else what is wanted is told when the connection is back
            self._outbox.put(key, message)

    def _send(self, message: Mapping[str, Any]) -> None:
        if self._outbox is not None:
            self._outbox.put(None, message)


def _tell(answer: asyncio.Future[AdverbError | None], error: AdverbError | None) -> None:
    if not answer.done():
        answer.set_result(error)
