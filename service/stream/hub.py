"""All streams of one server process: sessions, groups of characters, and the tick loop.

One loop runs all ticks, on an absolute schedule. Sessions are spread over several tickers, whose ticks are spread
evenly over a frame, so that each tick is short.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence

import numpy as np

from service.catalog.catalog import Catalog, Entry
from service.errors import ChannelInUse, TooManyChannels, UnknownChannel, UnknownSession
from service.metrics import Metrics
from service.refinement.usage import Usage
from service.settings import Settings
from service.stream.channel import layout_of, opened
from service.stream.connection import Connection
from service.stream.group import Group
from service.stream.messages import Open, Set, Switch
from service.stream.sampling import CharacterSampler
from service.stream.session import Channel, Session
from service.stream.ticker import Ticker
from service.wire import NEW_VERSION
from verbs.errors import VerbError
from verbs.runtime.characters import VERSION_S

__all__ = ["Hub"]

TICKERS = 8
"""Tickers whose ticks are spread evenly over a frame of 60 fps, about two milliseconds apart."""

TICKER_OFFSET_S = 1.0 / 60.0 / TICKERS
CROWDED = 64
"""Characters of a ticker from which on new sessions go to another one."""

EARLY_S = 0.0003
"""A tick may run this much early, since timers have a resolution of one millisecond."""

SWEEP_S = 0.5

MAX_ADVERB = 1e9
"""Largest magnitude of an adverb."""


class Hub:
    """Sessions and their characters.

    Parameters
    ----------
    settings : Settings
    metrics : Metrics
    catalog : callable
        Gives the verbs that are served now; raises :class:`service.errors.NotReady`.
    usage : Usage
        Records twice a second what every character is requested for.
    """

    def __init__(self, settings: Settings, metrics: Metrics, catalog: Callable[[], Catalog], usage: Usage) -> None:
        self.settings, self.metrics, self._catalog = settings, metrics, catalog
        self._sampler = CharacterSampler(usage)
        self.sessions: dict[str, Session] = {}
        self.draining = False
        self._groups: dict[tuple[str, int, str], Group] = {}
        self._wake = asyncio.Event()
        self._next_catalog: Catalog | None = None
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        now = time.monotonic()
        self._tickers = [Ticker(now + TICKER_OFFSET_S * _spread(k), metrics) for k in range(TICKERS)]
        self._ticker_of: dict[Session, Ticker] = {}

    # ── clock ────────────────────────────────────────────────────────────────────────────────────────────────────

    def server_time_ns(self) -> int:
        """The server's clock: ns since 1970, set at the start and monotonic since."""
        return self._epoch_ns + time.monotonic_ns()

    async def run(self) -> None:
        """Run ticks until cancelled."""
        sweep_at = time.monotonic() + SWEEP_S
        while True:
            busy = await self._tick()
            if self._next_catalog is not None:
                offered, self._next_catalog = self._next_catalog, None
                await self._renew_all(offered)
            now = time.monotonic()
            if now >= sweep_at:
                await self._sweep(now)
                sweep_at = now + SWEEP_S
            if busy:
                await asyncio.sleep(0)
                continue
            dues = [due for ticker in self._tickers if (due := ticker.due_s()) is not None]
            await self._sleep(min([sweep_at, *dues]) - now)

    async def _tick(self) -> bool:
        """Run every tick that is due; return whether one was."""
        ready = False
        for ticker in self._tickers:
            due, now = ticker.due_s(), time.monotonic()
            if due is not None and due - EARLY_S <= now:
                ready = True
                await ticker.tick(max(now, due), self._epoch_ns)
        return ready

    async def _sleep(self, seconds: float) -> None:
        """Sleep, or until a channel is opened."""
        self._wake.clear()
        timer = asyncio.get_running_loop().call_later(max(seconds, 0.0), self._wake.set)
        try:
            await self._wake.wait()
        finally:
            timer.cancel()

    # ── sessions ─────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def full(self) -> bool:
        """Whether the server has its maximum number of streams."""
        return sum(session.connected for session in self.sessions.values()) >= self.settings.streams

    @property
    def characters(self) -> int:
        """Characters of all sessions."""
        return sum(len(ticker) for ticker in self._tickers)

    def join(self, connection: Connection) -> Session:
        """A new session for a connection."""
        session = Session(slow_s=self.settings.stream_slow_s)
        session.attach(connection)
        ticker = self._ticker_of[session] = self._least_loaded()
        ticker.sessions += 1
        self.sessions[session.id] = session
        return session

    async def resume(self, session: Session, session_id: str, last_seq: int) -> Session:
        """Attach a connection to another session; raises :class:`UnknownSession`."""
        found = self.sessions.get(session_id)
        if found is None or found is session:
            raise UnknownSession("this server has no such session; open the channels again")
        connection = session.connection
        assert connection is not None  # it sent the request
        await self.forget(session)
        ticker = self._ticker_of[found]
        async with ticker.lock:
            found.count_lost(last_seq)
            found.attach(connection)
            ticker.changed()
            for channel in found.channels.values():
                found.send_text(opened(channel, resumed=True))
        return found

    async def leave(self, connection: Connection, *, for_good: bool) -> None:
        """Handle the end of a connection: keep its session for the grace time, or close it."""
        session = next((one for one in self.sessions.values() if one.connection is connection), None)
        if session is None:
            return  # another connection resumed the session
        ticker = self._ticker_of[session]
        async with ticker.lock:
            session.detach(time.monotonic())
            ticker.changed()
        if for_good or not session.channels or self.draining:
            await self.forget(session)

    async def forget(self, session: Session) -> None:
        """End a session and its characters."""
        if self.sessions.pop(session.id, None) is None:
            return
        ticker = self._ticker_of[session]
        ticker.sessions -= 1
        async with ticker.lock:
            session.connection = None
            for number in list(session.channels):
                self._close(session, number)
        del self._ticker_of[session]

    def drain(self) -> None:
        """Send ``drain`` to every client and close the connections."""
        self.draining = True
        for session in list(self.sessions.values()):
            session.send_text({"op": "drain", "detail": "the server is stopping", "reconnect_after_s": 1.0})
            if session.connection is not None:
                session.connection.end(1012, "the server is stopping")

    # ── channels ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self, session: Session, request: Open) -> None:
        """Start a character."""
        if request.channel in session.channels:
            raise ChannelInUse(f"channel {request.channel} is already open; close it first, or switch it")
        if len(session.channels) >= self.settings.stream_channels:
            raise TooManyChannels(f"a stream may have at most {self.settings.stream_channels} channels")
        if self.characters >= self.settings.stream_characters:
            raise TooManyChannels(f"the server has its maximum of {self.settings.stream_characters} channels")
        entry = self._catalog().entry(request.verb)
        layout, group = layout_of(entry, request), self._group(entry, request.method)
        async with self._ticker_of[session].lock:
            slot = group.characters.add(
                request.adverbs,
                phase=request.phase,
                speed=request.speed,
                playing=request.play,
                looping=request.loop,
                half_life_s=request.half_life,
                following=request.follow,
            )
            channel = Channel(request.channel, session, group, slot, request.fps, layout, request)
            session.channels[request.channel] = channel
            self._ticker_of[session].add(channel, time.monotonic())
            session.send_text(opened(channel))
        self._wake.set()

    async def set(self, session: Session, request: Set) -> None:
        """Change a character."""
        channel = self._channel(session, request.channel)
        async with self._ticker_of[session].lock:
            characters, slot = channel.group.characters, channel.slot
            row = None
            if request.adverbs is not None:
                names = [adverb.name for adverb in characters.verb.adverbs]
                now = dict(zip(names, characters.goals[slot].tolist(), strict=True))
                row = characters.row({**now, **request.adverbs})
            characters.set(
                slot,
                phase=request.phase,
                speed=request.speed,
                playing=request.play,
                looping=request.loop,
                half_life_s=request.half_life,
                following=request.follow,
            )
            if row is not None:
                characters.aim(slot, row)
            if request.fps is not None and request.fps != channel.fps:
                self._ticker_of[session].drop(channel)
                channel.fps = request.fps
                self._ticker_of[session].add(channel, time.monotonic())
        self._wake.set()

    def set_adverbs(self, session: Session, number: int, row: Sequence[float]) -> None:
        """Set the goal of a character. A running tick uses either the old or the new adverbs."""
        channel = self._channel(session, number)
        characters = channel.group.characters
        if len(row) != len(characters.verb.adverbs) or not all(-MAX_ADVERB <= value <= MAX_ADVERB for value in row):
            characters.row(np.array(row, np.float64))  # raises with the reason
        characters.goals[channel.slot] = row

    async def switch(self, session: Session, request: Switch) -> None:
        """Switch a character to another verb."""
        self._channel(session, request.channel)
        entry = self._catalog().entry(request.verb)
        group = self._group(entry, request.method)
        async with self._ticker_of[session].lock:
            channel = self._channel(session, request.channel)
            layout = layout_of(entry, channel.request)
            slot = group.characters.go_on(
                *(channel.group.characters, channel.slot, request.adverbs),
                phase=request.phase,
                transition_s=request.transition_s,
            )
            self._move(channel, group, slot)
            channel.layout = layout
            session.send_text(opened(channel))

    async def close(self, session: Session, number: int) -> None:
        """End a character."""
        self._channel(session, number)
        async with self._ticker_of[session].lock:
            self._close(session, number)

    # ── versions ─────────────────────────────────────────────────────────────────────────────────────────────────

    def set_catalog(self, catalog: Catalog) -> None:
        """Continue characters, from the next tick on, with the versions of a new catalog."""
        self._next_catalog = catalog
        self._wake.set()

    async def _renew_all(self, catalog: Catalog) -> None:
        for ticker in self._tickers:
            async with ticker.lock:
                for some in list(ticker.channels.values()):
                    for channel in some:
                        self._renew(channel, catalog)
        used = {channel.group.key for session in self.sessions.values() for channel in session.channels.values()}
        self._groups = {key: group for key, group in self._groups.items() if key in used}

    def _renew(self, channel: Channel, catalog: Catalog) -> None:
        was = channel.group
        entry = catalog.entries.get(was.entry.verb.name)
        if entry is None or entry is was.entry:
            return  # a verb that is no longer served plays to its end
        try:
            layout, group = layout_of(entry, channel.request), self._group(entry, was.characters.method)
            if _names(entry) != _names(was.entry):
                raise VerbError(f"its adverbs are {', '.join(_names(entry))}")
            slot = group.characters.go_on(was.characters, channel.slot, transition_s=VERSION_S, same=True)
        except VerbError as err:
            channel.session.send_text(
                {
                    "op": "error",
                    "channel": channel.number,
                    "code": "bad_request",
                    "detail": f"version {entry.version} of '{entry.verb.name}' cannot continue this channel: {err}",
                }
            )
            return
        self._move(channel, group, slot)
        channel.layout = layout
        channel.flags |= NEW_VERSION
        channel.session.send_text(
            {
                "op": "version",
                "channel": channel.number,
                "version": entry.version,
                "record_bytes": 4 * layout.words,
            }
        )

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _move(self, channel: Channel, group: Group, slot: int) -> None:
        channel.group.characters.remove(channel.slot)
        channel.group, channel.slot = group, slot
        self._ticker_of[channel.session].changed()

    def _close(self, session: Session, number: int) -> None:
        channel = session.channels.pop(number)
        self._ticker_of[session].drop(channel)
        channel.group.characters.remove(channel.slot)

    def _channel(self, session: Session, number: int) -> Channel:
        found = session.channels.get(number)
        if found is None:
            raise UnknownChannel(f"channel {number} is not open")
        return found

    def _group(self, entry: Entry, method: str | None) -> Group:
        entry.check(method=method)
        name = entry.evaluator.method(method)[0]
        whole = entry.verb.name, entry.version, name
        found = self._groups.get(whole)
        if found is None or found.entry is not entry:
            found = self._groups[whole] = Group(entry, name)
        return found

    def _least_loaded(self) -> Ticker:
        """The first ticker with room, else the one with the fewest characters."""
        for ticker in self._tickers:
            if ticker.load < CROWDED:
                return ticker
        return min(self._tickers, key=lambda ticker: ticker.load)

    async def _sweep(self, now_s: float) -> None:
        """Close sessions whose grace time has passed."""
        over = now_s - self.settings.stream_grace_s
        for session in [one for one in self.sessions.values() if one.lost_at is not None and one.lost_at < over]:
            await self.forget(session)
        self.metrics.set_streams(sum(one.connected for one in self.sessions.values()), self.characters)
        self._sampler.sample(self._groups.values())


def _names(entry: Entry) -> list[str]:
    return [adverb.name for adverb in entry.verb.adverbs]


def _spread(k: int) -> int:
    """Reverse the bits of k, so that the ticks of the first few tickers lie far apart."""
    return int(f"{k:03b}"[::-1], 2)
