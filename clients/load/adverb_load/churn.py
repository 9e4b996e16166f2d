"""Clients that come and go as real ones do: some stay, some leave, some are cut off and come back, some read slowly."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from dataclasses import dataclass, field

from adverb_load import frames
from adverb_load.client import Asked, Player
from adverb_load.goals import Goals
from adverb_load.tally import Clock, Tally

__all__ = ["Crowd"]

STEER_S = 0.2
STAY = 8
"""Characters of a client that stays."""

MOST = 6
"""Most characters of a client that comes and goes."""


@dataclass(slots=True)
class Crowd:
    """Clients of one server.

    Parameters
    ----------
    asked : Asked
        Sockets and channels of it are of no account.
    goals : Goals
    tally, slow : Tally
        Of clients that read, and of those that read slowly: these are late by themselves.
    clock : Clock
    done : Counter
        What clients did, by name.
    """

    asked: Asked
    goals: Goals
    tally: Tally = field(default_factory=Tally)
    slow: Tally = field(default_factory=Tally)
    clock: Clock = field(default_factory=Clock)
    done: Counter[str] = field(default_factory=Counter)

    def player(self, rng: random.Random, tally: Tally) -> Player:
        """A client that has not connected yet."""
        return Player(self.asked, tally, self.clock, rng, self.goals, at=rng.getrandbits(16))

    async def stay(self, rng: random.Random, end_s: float) -> None:
        """Steer a few characters all the time."""
        player = self.player(rng, self.tally)
        await player.join()
        self._open(player, STAY)
        while time.monotonic() < end_s:
            player.steer()
            player.ping()
            await asyncio.sleep(STEER_S)
        await self._leave(player, politely=True)

    async def come_and_go(self, rng: random.Random, end_s: float) -> None:
        """Stay a while, then leave: politely, for ever without a word, or to come back."""
        while time.monotonic() < end_s:
            player = self.player(rng, self.tally)
            await player.join()
            self._open(player, rng.randint(1, MOST))
            await self._live(player, rng, end_s)
            while rng.random() < 0.5 and time.monotonic() < end_s:
                await self._come_back(player, rng)
                await self._live(player, rng, end_s)
            await self._leave(player, politely=rng.random() < 0.5)

    async def read_slowly(self, rng: random.Random, end_s: float, longest_s: float) -> None:
        """Stop reading for some seconds, again and again; be cut off if that was too long."""
        while time.monotonic() < end_s:
            player = self.player(rng, self.slow)
            await player.join()
            self._open(player, 2 * STAY)
            link = player.link
            while link is not None and link.alive and time.monotonic() < end_s:
                link.read(on=False)
                await asyncio.sleep(min(rng.uniform(0.2, longest_s), max(end_s - time.monotonic(), 0.0)))
                link.read(on=True)
                self.done["paused"] += 1
                await asyncio.sleep(rng.uniform(0.2, 1.0))
            await self._leave(player, politely=True)

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _open(self, player: Player, count: int) -> None:
        self.done["stream"] += 1
        encodings = ["f32", "q48", "weights"]
        player.say(*(player.opening(channel, encoding=player.rng.choice(encodings)) for channel in range(count)))

    async def _live(self, player: Player, rng: random.Random, end_s: float) -> None:
        until = min(time.monotonic() + rng.uniform(0.5, 4.0), end_s)
        while time.monotonic() < until:
            player.steer()
            await asyncio.sleep(STEER_S)
        if player.layouts and rng.random() < 0.5:
            number = rng.choice(list(player.layouts))
            player.say({"op": "switch", "channel": number, "verb": self.asked.verb})
            self.done["switch"] += 1

    async def _come_back(self, player: Player, rng: random.Random) -> None:
        """Lose the connection and resume the session."""
        if player.link is not None:
            player.link.abort()
        await asyncio.sleep(rng.uniform(0.0, 0.5))
        session, track = player.session, player.track
        await player.join()
        player.resume(session, track)
        self.done["resume"] += 1

    async def _leave(self, player: Player, *, politely: bool) -> None:
        link = player.link
        if link is None:
            return
        self.done["leave" if politely else "vanish"] += 1
        if politely and link.alive:
            for number in player.layouts:
                player.say({"op": "close", "channel": number})
            link.close()
            try:
                async with asyncio.timeout(5.0):
                    await link.gone.wait()
            except TimeoutError:
                raise frames.FrameError("the server did not let go of a client that left") from None
        link.abort()
