"""Streams of a load: opens the sockets, steers them on a schedule, and sums up."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from adverb_load import frames
from adverb_load.effector_errors import measure
from adverb_load.profile import Streams
from adverb_load.schedule import arrivals
from adverb_load.series import Counts, Series
from adverb_load.stream_client import Group, StreamClient
from adverb_load.target import Target
from adverb_load.websocket import connect

__all__ = ["StreamLoad", "paced"]

TOGETHER = 40
"""Connections that are opened concurrently."""

OPEN_S = 60.0
PINGS, PING_EVERY_S = 4, 2.0
READ_S = 0.05
"""How long a slow reader reads between two pauses, seconds."""

SMALL_BUFFER = 16_384


async def paced(start_s: float, rate_hz: float, kind: str, seed: int, act: Callable[[float], None]) -> None:
    """Call a function at the times of a schedule, on ``time.monotonic``; late calls follow at once and are not lost."""
    for number, since_s in enumerate(arrivals(rate_hz, kind, np.random.default_rng(seed))):
        due_s = start_s + since_s
        wait_s = due_s - time.monotonic()
        if wait_s > 0.0 or number % 64 == 0:
            await asyncio.sleep(max(wait_s, 0.0))
        act(due_s)


class StreamLoad:
    """A group of sockets.

    Parameters
    ----------
    plan : Streams
    target : Target
    seed : int
    interval_s : float
    """

    def __init__(self, plan: Streams, target: Target, seed: int, interval_s: float) -> None:
        self.plan, self._target, self._seed = plan, target, seed
        lateness, spacing, response, error = (Series(interval_s) for _ in range(4))
        self.group = Group(
            plan, [target.verb(name) for name in plan.verbs], lateness, spacing, response, error,
            Counts(interval_s), Counts(interval_s),
        )  # fmt: skip
        seeds = random.Random(seed)
        slow = round(plan.slow * plan.sockets)
        self.clients = [
            StreamClient(self.group, random.Random(seeds.getrandbits(64)), slow=k < slow) for k in range(plan.sockets)
        ]
        self._next = 0
        self.opening_s = 0.0

    async def open(self) -> None:
        """Open all sockets and channels; those that fail are counted."""
        began_s = time.monotonic()
        self.group.errors.window(began_s, OPEN_S)
        for first in range(0, len(self.clients), TOGETHER):
            await asyncio.gather(*(self._open(client) for client in self.clients[first : first + TOGETHER]))
        self.opening_s = time.monotonic() - began_s
        self.failed = {name: self.group.errors.total(name) for name in self.group.errors.names()}

    async def _open(self, client: StreamClient) -> None:
        plan = self.plan
        try:
            client.socket = await connect(
                self._target.stream_url, client, client.rng, timeout_s=OPEN_S, headers=self._target.headers,
                receive_buffer=SMALL_BUFFER if client.slow else None,
            )  # fmt: skip
        except (OSError, TimeoutError, frames.FrameError) as err:
            self.group.errors.add(time.monotonic(), f"not connected: {type(err).__name__}")
            return
        end_s = time.monotonic() + OPEN_S
        for _ in range(PINGS):
            client.ping()
            await asyncio.sleep(0)
        client.open_channels()
        while len(client.opened) + client.failed < plan.channels:
            if time.monotonic() > end_s or not client.socket.alive:
                self.group.errors.add(time.monotonic(), "not opened", plan.channels - len(client.opened))
                return
            await asyncio.sleep(0.01)

    @property
    def live(self) -> int:
        """Sockets that are open."""
        return sum(client.socket is not None and client.socket.alive for client in self.clients)

    def window(self, start_s: float, seconds: float) -> None:
        """Begin the measurement."""
        group = self.group
        for one in (group.lateness, group.spacing, group.response, group.error, group.counts, group.errors):
            one.window(start_s, seconds)
        group.stated_m = 0.0

    def tasks(self, start_s: float) -> list[asyncio.Task[None]]:
        """Start what has to be done from ``start_s`` on: steering, pings, pauses of slow readers."""
        rate_hz = self.plan.steer_hz * len(self.clients)
        works = [self._ping()]
        if rate_hz > 0.0 and self.plan.goals != "hold":
            works.append(paced(start_s, rate_hz, self.plan.arrivals, self._seed, self._steer))
        works += [self._read_slowly(client) for client in self.clients if client.slow]
        return [asyncio.get_running_loop().create_task(work) for work in works]

    def _steer(self, due_s: float) -> None:
        client = self.clients[self._next % len(self.clients)]
        self._next += 1
        client.steer(due_s)

    async def _ping(self) -> None:
        while True:
            for client in self.clients:
                client.ping()
                await asyncio.sleep(PING_EVERY_S / len(self.clients))

    async def _read_slowly(self, client: StreamClient) -> None:
        await asyncio.sleep(client.rng.random() * self.plan.slow_pause_s)
        while client.socket is not None and client.socket.alive:
            client.socket.read(on=False)
            await asyncio.sleep(self.plan.slow_pause_s)
            client.socket.read(on=True)
            await asyncio.sleep(READ_S)

    def sweep(self) -> None:
        """Measure what has arrived."""
        measure(self.group)

    def unfinished(self, end_s: float) -> int:
        """Sockets that lack a frame that was due before ``end_s``."""
        return sum(client.waits(end_s) for client in self.clients)

    def end(self, end_s: float) -> None:
        """Count what was due before ``end_s`` and has not arrived."""
        now_s = time.monotonic()
        for client in self.clients:
            client.end(end_s, now_s)

    async def close(self) -> None:
        """Close all sockets."""
        for client in self.clients:
            client.ended = True
            if client.socket is not None:
                client.socket.read(on=True)
                client.socket.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(3.0):
                for client in self.clients:
                    if client.socket is not None:
                        await client.socket.gone.wait()
        for client in self.clients:
            if client.socket is not None:
                client.socket.abort()

    def result(self, seconds: float) -> dict[str, Any]:
        """The group's part of the report, from the first seconds of the window."""
        group, plan = self.group, self.plan
        total = {name: sum(group.counts.parts(name, seconds)) for name in group.counts.names()}
        target = plan.sockets * plan.fps * seconds
        trips = [client.clock.round_trip_s for client in self.clients if client.clock.known]
        series = {
            "lateness_s": group.lateness, "spacing_s": group.spacing, "response_s": group.response,
            "error_m": group.error,
        }  # fmt: skip
        return {
            "name": plan.name,
            "plan": {"verbs": list(plan.verbs), "sockets": plan.sockets, "channels": plan.channels, "fps": plan.fps,
                     "encoding": plan.encoding},
            "opened": {"sockets": self.live, "seconds": round(self.opening_s, 3), "failed": self.failed},
            "frames": {
                "target_per_s": round(target / seconds, 2), "per_s": round(total.get("frames", 0) / seconds, 2),
                **{name: total.get(name, 0)
                   for name in ("frames", "poses", "bytes", "dropped", "dropped_slow", "skipped", "gaps", "faults")},
            },
            "goals": {"target_per_s": round(plan.sockets * plan.steer_hz * (plan.goals != "hold"), 2),
                      "per_s": round(total.get("goals_sent", 0) / seconds, 2),
                      "held_back": total.get("goals_held_back", 0)},
            "poses": {name: total.get(name, 0) for name in ("heads", "clamped", "measured", "disagree")}
            | {"stated_error_max_m": group.stated_m},
            "errors": {name: group.errors.total(name) for name in group.errors.names()},
            "clock_uncertainty_s": round(0.5 * max(trips), 6) if trips else None,
            "problems": group.problems,
            "summary": {name: one.whole(seconds).summary() for name, one in series.items()},
            "series": {name: one.to_json(seconds) for name, one in series.items()},
            "per_interval": {name: group.counts.parts(name, seconds)
                             for name in ("frames", "poses", "dropped", "dropped_slow", "skipped")},
        }  # fmt: skip
