"""The stream for programs without an event loop; the loop runs in a background thread."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Mapping, Sequence
from types import TracebackType
from typing import Any, Self, TypeVar, Unpack

import numpy as np
import numpy.typing as npt

from adverb_client.bulk import Rows
from adverb_client.channel import Channel
from adverb_client.clock import Clock
from adverb_client.errors import StreamClosed
from adverb_client.jitter import Sample
from adverb_client.messages import ChannelOpened, Hello, StreamEvent
from adverb_client.options import OpenOptions
from adverb_client.session import Stats
from adverb_client.stream import Stream

__all__ = ["SyncStream"]

T = TypeVar("T")


class SyncStream:
    """A stream of poses in a background thread; parameters, methods and errors are those of :class:`Stream`.

    ``channel.set``, ``channel.aim``, ``channel.pose``, ``aim_many`` and ``view`` never block; ``connect``, ``open``,
    ``switch`` and ``ping`` wait for the server.

    Parameters
    ----------
    url : str
        Address of the server.
    **options
        Keywords of :class:`Stream`; ``on_event`` is called in the background thread.

    Examples
    --------
    >>> with SyncStream("http://127.0.0.1:8000") as stream:
    ...     channel = stream.open("reach", fps=60)
    ...     while running:
    ...         channel.aim(goal())
    ...         draw(channel.pose())
    """

    def __init__(self, url: str = "http://127.0.0.1:8000", **options: Any) -> None:
        self._url, self._options = url, options
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="adverb stream", daemon=True)
        self._stream: Stream | None = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def connect(self, timeout_s: float = 10.0) -> None:
        """Connect; see :meth:`Stream.connect`."""
        if self._stream is not None or self._loop.is_closed():
            raise RuntimeError("a stream is connected once; it reconnects automatically")
        self._thread.start()
        self._stream = self._wait(_create(self._url, self._options))
        try:
            self._wait(self._stream.connect(timeout_s))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the stream and end its thread."""
        if self._loop.is_closed():
            return
        if self._stream is not None:
            self._wait(self._stream.close())
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        self._loop.close()

    def _wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        if self._loop.is_closed():
            coroutine.close()
            raise StreamClosed("the stream was closed by this client", 1000)
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    @property
    def _inner(self) -> Stream:
        if self._stream is None:
            raise RuntimeError("the stream is not connected yet")
        return self._stream

    @property
    def closed(self) -> bool:
        """Whether the stream has ended."""
        return self._inner.closed

    @property
    def live(self) -> bool:
        """Whether there is a connection."""
        return self._inner.live

    @property
    def stats(self) -> Stats:
        """Counters of messages, gaps and errors."""
        return self._inner.stats

    @property
    def clock(self) -> Clock:
        """Estimate of the server's clock."""
        return self._inner.clock

    @property
    def hello(self) -> Hello | None:
        """The server's first message."""
        return self._inner.hello

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Open channels by number."""
        return self._inner.channels

    @property
    def age_s(self) -> float:
        """See :attr:`Stream.age_s`."""
        return self._inner.age_s

    @property
    def lateness_s(self) -> float:
        """See :attr:`Stream.lateness_s`."""
        return self._inner.lateness_s

    def now(self) -> float:
        """The clock of the stream, seconds."""
        return self._inner.now()

    def pose(self, channel: Channel | int, at: float | None = None) -> Sample | None:
        """The pose of a channel; see :meth:`Channel.pose`."""
        return self._inner.pose(channel, at)

    def aim_many(self, channels: Sequence[Channel | int] | npt.NDArray[np.integer[Any]], adverbs: Rows) -> None:
        """Set the goals of many channels with one message; see :meth:`Stream.aim_many`."""
        self._inner.aim_many(channels, adverbs)

    def view(self, position: Sequence[float] | None = None, *, budget_kbps: float | None = None) -> None:
        """Set the viewpoint and the byte budget; see :meth:`Stream.view`."""
        self._inner.view(position, budget_kbps=budget_kbps)

    def take_events(self) -> list[StreamEvent]:
        """Take all queued events, without waiting."""
        return self._inner.take_events()

    def ping(self, timeout_s: float = 5.0) -> float:
        """Round trip of a ping, seconds; see :meth:`Stream.ping`."""
        return self._wait(self._inner.ping(timeout_s))

    def open(
        self, verb: str, *, number: int | None = None, timeout_s: float = 10.0, **options: Unpack[OpenOptions]
    ) -> Channel:
        """Open a channel; see :meth:`Stream.open`."""
        return self._wait(self._inner.open(verb, number=number, timeout_s=timeout_s, **options))

    def switch(
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
        """Switch a channel to another verb; see :meth:`Stream.switch`."""
        return self._wait(
            self._inner.switch(
                channel,
                verb,
                adverbs=adverbs,
                method=method,
                phase=phase,
                transition_s=transition_s,
                timeout_s=timeout_s,
            )
        )

    def close_channel(self, channel: Channel) -> None:
        """Close a channel; see :meth:`Stream.close_channel`."""
        self._wait(self._inner.close_channel(channel))


async def _create(url: str, options: Mapping[str, Any]) -> Stream:
    return Stream(url, **options)
