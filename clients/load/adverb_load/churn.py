"""Clients that come and go: some stay, some leave, some are cut off and resume, some read slowly."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from dataclasses import dataclass, field

from adverb_client import Clock

from adverb_load import frames
from adverb_load.client import Load, LoadClient
from adverb_load.goals import Goals
from adverb_load.tally import Tally

__all__ = ["Churn"]

STEER_S = 0.2
STAY = 8
"""Channels of a client that stays."""

MOST = 6
"""Largest number of channels of a client that comes and goes."""


@dataclass(slots=True)
class Churn:
    """Clients of one server.

    Parameters
    ----------
    load : Load
        Its numbers of sockets and channels are not used.
    goals : Goals
    tally, slow : Tally
        Of clients that read, and of those that read slowly, whose messages are late.
    clock : Clock
    done : Counter
        Actions of clients, by name.
    """

    load: Load
    goals: Goals
    tally: Tally = field(default_factory=Tally)
    slow: Tally = field(default_factory=Tally)
    clock: Clock = field(default_factory=Clock)
    done: Counter[str] = field(default_factory=Counter)

    def client(self, rng: random.Random, tally: Tally) -> LoadClient:
        """A client, not connected."""
        return LoadClient(self.load, tally, self.clock, rng, self.goals, at=rng.getrandbits(16))

    async def stay(self, rng: random.Random, end_s: float) -> None:
        """Steer a few channels all the time."""
        client = self.client(rng, self.tally)
        await client.join()
        self._open(client, STAY)
        while time.monotonic() < end_s:
            client.steer()
            client.ping()
            await asyncio.sleep(STEER_S)
        await self._leave(client, politely=True)

    async def come_and_go(self, rng: random.Random, end_s: float) -> None:
        """Stay for a while, then close, abort, or abort and resume."""
        while time.monotonic() < end_s:
            client = self.client(rng, self.tally)
            await client.join()
            self._open(client, rng.randint(1, MOST))
            await self._live(client, rng, end_s)
            while rng.random() < 0.5 and time.monotonic() < end_s:
                await self._come_back(client, rng)
                await self._live(client, rng, end_s)
            await self._leave(client, politely=rng.random() < 0.5)

    async def read_slowly(self, rng: random.Random, end_s: float, longest_s: float) -> None:
        """Pause reading repeatedly; the server closes the connection after too long a pause."""
        while time.monotonic() < end_s:
            client = self.client(rng, self.slow)
            await client.join()
            self._open(client, 2 * STAY)
            socket = client.socket
            while socket is not None and socket.alive and time.monotonic() < end_s:
                socket.read(on=False)
                await asyncio.sleep(min(rng.uniform(0.2, longest_s), max(end_s - time.monotonic(), 0.0)))
                socket.read(on=True)
                self.done["paused"] += 1
                await asyncio.sleep(rng.uniform(0.2, 1.0))
            await self._leave(client, politely=True)

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _open(self, client: LoadClient, count: int) -> None:
        self.done["stream"] += 1
        encodings = ["f32", "q48", "q32", "weights"]
        client.send(*(client.open_message(channel, encoding=client.rng.choice(encodings)) for channel in range(count)))

    async def _live(self, client: LoadClient, rng: random.Random, end_s: float) -> None:
        until = min(time.monotonic() + rng.uniform(0.5, 4.0), end_s)
        while time.monotonic() < until:
            client.steer()
            await asyncio.sleep(STEER_S)
        if client.layouts and rng.random() < 0.5:
            number = rng.choice(list(client.layouts))
            client.send({"op": "switch", "channel": number, "verb": self.load.verb})
            self.done["switch"] += 1

    async def _come_back(self, client: LoadClient, rng: random.Random) -> None:
        """Lose the connection and resume the session."""
        if client.socket is not None:
            client.socket.abort()
        await asyncio.sleep(rng.uniform(0.0, 0.5))
        session, track = client.session, client.track
        await client.join()
        client.resume(session, track)
        self.done["resume"] += 1

    async def _leave(self, client: LoadClient, *, politely: bool) -> None:
        socket = client.socket
        if socket is None:
            return
        self.done["leave" if politely else "vanish"] += 1
        if politely and socket.alive:
            for number in client.layouts:
                client.send({"op": "close", "channel": number})
            socket.close()
            try:
                async with asyncio.timeout(5.0):
                    await socket.gone.wait()
            except TimeoutError:
                raise frames.FrameError("the server did not close the connection of a client that left") from None
        socket.abort()
