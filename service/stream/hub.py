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
"""Timers come whole milliseconds apart; a tick may come so much too early."""

SWEEP_S = 0.5

MOST = 1e9
"""Largest adverb that is taken."""


class Hub:
    """Sessions and their characters.

    Parameters
    ----------
    settings : Settings
    metrics : Metrics
    catalog : callable
        Gives the verbs that are served now; raises :class:`service.errors.NotReady`.
    usage : Usage
        Told twice a second what every character is asked for.
    """

    def __init__(self, settings: Settings, metrics: Metrics, catalog: Callable[[], Catalog], usage: Usage) -> None:
        self.settings, self.metrics, self._catalog = settings, metrics, catalog
        self._sampler = CharacterSampler(usage)
        self.sessions: dict[str, Session] = {}
        self.draining = False
        self._groups: dict[tuple[str, int, str], Group] = {}
        self._wake = asyncio.Event()
        self._offered: Catalog | None = None
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        now = time.monotonic()
        self._tickers = [Ticker(now + TICKER_OFFSET_S * _spread(k), metrics) for k in range(TICKERS)]
        self._ticker_of: dict[Session, Ticker] = {}

    # ── clock ────────────────────────────────────────────────────────────────────────────────────────────────────

    def server_time_ns(self) -> int:
        """The server's clock: ns since 1970 as it was at the start, never stepping."""
        return self._epoch_ns + time.monotonic_ns()

    async def run(self) -> None:
        """Tick for ever."""
        sweep_at = time.monotonic() + SWEEP_S
        while True:
            busy = await self._tick()
            if self._offered is not None:
                offered, self._offered = self._offered, None
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
        """Whether no further stream is taken."""
        return sum(session.connected for session in self.sessions.values()) >= self.settings.streams

    @property
    def characters(self) -> int:
        """Characters of all sessions."""
        return sum(len(ticker) for ticker in self._tickers)

    def join(self, connection: Connection) -> Session:
        """A new session for a connection."""
        session = Session(slow_s=self.settings.stream_slow_s)
        session.attach(connection)
        ticker = self._ticker_of[session] = self._roomiest()
        ticker.sessions += 1
        self.sessions[session.id] = session
        return session

    async def resume(self, session: Session, session_id: str, last_seq: int) -> Session:
        """Let a connection take over another session; raises :class:`UnknownSession`."""
        found = self.sessions.get(session_id)
        if found is None or found is session:
            raise UnknownSession("this server does not have that session, or no longer; open the channels anew")
        connection = session.connection
        assert connection is not None  # it is the one that asks
        await self.forget(session)
        ticker = self._ticker_of[found]
        async with ticker.lock:
            found.lost(last_seq)
            found.attach(connection)
            ticker.changed()
            for channel in found.channels.values():
                found.say(opened(channel, resumed=True))
        return found

    async def leave(self, connection: Connection, *, for_good: bool) -> None:
        """A connection is over: keep its session for the grace time, or not."""
        session = next((one for one in self.sessions.values() if one.connection is connection), None)
        if session is None:
            return  # another connection has it
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
        """Tell every client that the server is about to stop."""
        self.draining = True
        for session in list(self.sessions.values()):
            session.say({"op": "drain", "detail": "the server is stopping", "reconnect_after_s": 1.0})
            if session.connection is not None:
                session.connection.end(1012, "the server is stopping")

    # ── channels ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self, session: Session, asked: Open) -> None:
        """Start a character."""
        if asked.channel in session.channels:
            raise ChannelInUse(f"channel {asked.channel} is open already; close it first, or switch it")
        if len(session.channels) >= self.settings.stream_channels:
            raise TooManyChannels(f"a stream may have {self.settings.stream_channels} channels")
        if self.characters >= self.settings.stream_characters:
            raise TooManyChannels(f"the server may have {self.settings.stream_characters} channels, and has them")
        entry = self._catalog().entry(asked.verb)
        layout, group = layout_of(entry, asked), self._group(entry, asked.method)
        async with self._ticker_of[session].lock:
            slot = group.characters.add(
                asked.adverbs,
                phase=asked.phase,
                speed=asked.speed,
                playing=asked.play,
                looping=asked.loop,
                half_life_s=asked.half_life,
                following=asked.follow,
            )
            channel = Channel(asked.channel, session, group, slot, asked.fps, layout, asked)
            session.channels[asked.channel] = channel
            self._ticker_of[session].add(channel, time.monotonic())
            session.say(opened(channel))
        self._wake.set()

    async def set(self, session: Session, asked: Set) -> None:
        """Change a character."""
        channel = self._channel(session, asked.channel)
        async with self._ticker_of[session].lock:
            characters, slot = channel.group.characters, channel.slot
            row = None
            if asked.adverbs is not None:
                names = [adverb.name for adverb in characters.verb.adverbs]
                now = dict(zip(names, characters.goals[slot].tolist(), strict=True))
                row = characters.row({**now, **asked.adverbs})
            characters.set(
                slot,
                phase=asked.phase,
                speed=asked.speed,
                playing=asked.play,
                looping=asked.loop,
                half_life_s=asked.half_life,
                following=asked.follow,
            )
            if row is not None:
                characters.aim(slot, row)
            if asked.fps is not None and asked.fps != channel.fps:
                self._ticker_of[session].drop(channel)
                channel.fps = asked.fps
                self._ticker_of[session].add(channel, time.monotonic())
        self._wake.set()

    def aim(self, session: Session, number: int, row: Sequence[float]) -> None:
        """Give a character other adverbs. A tick that is under way may see them, or the ones before."""
        channel = self._channel(session, number)
        characters = channel.group.characters
        if len(row) != len(characters.verb.adverbs) or not all(-MOST <= value <= MOST for value in row):
            characters.row(np.array(row, np.float64))  # which says what is wrong
        characters.goals[channel.slot] = row

    async def switch(self, session: Session, asked: Switch) -> None:
        """Pass to another verb."""
        self._channel(session, asked.channel)
        entry = self._catalog().entry(asked.verb)
        group = self._group(entry, asked.method)
        async with self._ticker_of[session].lock:
            channel = self._channel(session, asked.channel)
            layout = layout_of(entry, channel.asked)
            slot = group.characters.go_on(
                *(channel.group.characters, channel.slot, asked.adverbs),
                phase=asked.phase,
                transition_s=asked.transition_s,
            )
            self._move(channel, group, slot)
            channel.layout = layout
            session.say(opened(channel))

    async def close(self, session: Session, number: int) -> None:
        """End a character."""
        self._channel(session, number)
        async with self._ticker_of[session].lock:
            self._close(session, number)

    # ── versions ─────────────────────────────────────────────────────────────────────────────────────────────────

    def set_catalog(self, catalog: Catalog) -> None:
        """Let characters go on, from the next tick, with the verbs of a new catalog where these are other versions."""
        self._offered = catalog
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
            return  # a verb that is no longer served is played to its end
        try:
            layout, group = layout_of(entry, channel.asked), self._group(entry, was.characters.method)
            if _names(entry) != _names(was.entry):
                raise VerbError(f"its adverbs are {', '.join(_names(entry))}")
            slot = group.characters.go_on(was.characters, channel.slot, transition_s=VERSION_S, same=True)
        except VerbError as err:
            channel.session.say(
                {
                    "op": "error",
                    "channel": channel.number,
                    "code": "bad_request",
                    "detail": f"version {entry.version} of verb '{entry.verb.name}' cannot go on here: {err}",
                }
            )
            return
        self._move(channel, group, slot)
        channel.layout = layout
        channel.flags |= NEW_VERSION
        channel.session.say(
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

    def _roomiest(self) -> Ticker:
        """The first ticker that is not crowded, or else the one with the fewest characters."""
        for ticker in self._tickers:
            if ticker.load < CROWDED:
                return ticker
        return min(self._tickers, key=lambda ticker: ticker.load)

    async def _sweep(self, now_s: float) -> None:
        """Forget sessions whose grace time is over."""
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
