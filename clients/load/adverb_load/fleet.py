"""Many streams at once, in an open loop: the server's schedule is compared with what arrives."""

from __future__ import annotations

import asyncio
import dataclasses
import gc
import random
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import uvloop

from adverb_load.client import Asked, Player
from adverb_load.goals import Goals, base_of
from adverb_load.tally import Clock, Lateness, Tally, lateness_of

__all__ = ["Fleet", "Report", "play", "run"]

TOGETHER = 40
"""Connections that are opened at a time."""

TAIL_LOOKS = 50
"""How often to look, 20 ms apart, for messages that are due within the window and late."""

SLOT_S = 0.004
"""Time between two groups of streams that are steered."""


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a load within the window.

    Parameters
    ----------
    asked : Asked
    seconds : float
    delivered, expected : int
        Pose messages.
    dropped, gaps : int
        Messages that are missing: reported by the server, and not.
    decode_errors, decoded : int
        Of messages that were read in full; and of all messages' heads.
    lateness_ms : Lateness
        Half of ``round_trip_ms`` is the doubt in it.
    records, payload_bytes : int
    steered, held_back : int
        Adverbs that were sent, and that were not since the server did not read.
    server_cpu_s, client_cpu : float
        CPU seconds of what the probe reads; share of a core that this process used.
    codes, closes, ops : dict
    problems : list of str
    """

    asked: Asked
    seconds: float
    delivered: int
    expected: int
    dropped: int
    gaps: int
    decode_errors: int
    decoded: int
    lateness_ms: Lateness
    round_trip_ms: float
    records: int
    payload_bytes: int
    steered: int
    held_back: int
    server_cpu_s: float
    client_cpu: float
    codes: dict[str, int]
    closes: dict[int, int]
    ops: dict[str, int]
    problems: list[str]

    @property
    def bytes_per_pose(self) -> float:
        """Payload bytes, message heads shared out."""
        return self.payload_bytes / self.records if self.records else float("nan")

    @property
    def sound(self) -> bool:
        """Whether nothing is missing unreported, nothing unreadable and nobody was cut off."""
        return self.gaps == 0 and self.decode_errors == 0 and not self.codes and not self.closes

    @property
    def holds(self) -> bool:
        """Whether the server keeps up: sound, 99 % of what is due, p99 within one frame."""
        enough = self.delivered >= 0.99 * self.expected
        return self.sound and enough and self.lateness_ms.p99 <= 1_000.0 / self.asked.fps

    def to_json(self) -> dict[str, object]:
        """Everything as JSON has it."""
        return dataclasses.asdict(self) | {
            "bytes_per_pose": round(self.bytes_per_pose, 2),
            "sound": self.sound,
            "holds": self.holds,
        }


class Fleet:
    """Streams of one load.

    Parameters
    ----------
    asked : Asked
    goals : Goals or None
    """

    def __init__(self, asked: Asked, goals: Goals | None) -> None:
        self.asked, self.tally, self.clock = asked, Tally(), Clock()
        seeds = random.Random(asked.seed)
        self.players = [
            Player(asked, self.tally, self.clock, random.Random(seeds.getrandbits(64)), goals, at=seeds.getrandbits(16))
            for _ in range(asked.sockets)
        ]

    async def open(self) -> None:
        """Open all streams and channels."""
        for first in range(0, len(self.players), TOGETHER):
            await asyncio.gather(*(player.start() for player in self.players[first : first + TOGETHER]))

    async def measure(self, seconds: float, *, settle_s: float, probe: Callable[[], float]) -> Report:
        """Watch for some seconds. ``probe`` gives the server's CPU seconds so far."""
        tally, clock = self.tally, self.clock
        async with asyncio.TaskGroup() as group:
            chores = [group.create_task(self._steer()), group.create_task(self._ping())]
            await asyncio.sleep(settle_s)
            start_ns = time.monotonic_ns() + clock.offset_ns
            tally.window(start_ns, start_ns + round(seconds * 1e9))
            steered = self._steered()
            cpu_s, own_s = probe(), time.process_time()
            await asyncio.sleep(seconds)
            cpu_s, own_s = probe() - cpu_s, time.process_time() - own_s
            sent, held = (now - then for now, then in zip(self._steered(), steered, strict=True))
            for chore in chores:
                chore.cancel()
        await self._tail()
        return self._report(seconds, cpu_s, own_s / seconds, (sent, held))

    async def close(self) -> None:
        """Leave; returns when the server let go."""
        links = [player.link for player in self.players if player.link is not None]
        for link in links:
            link.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(5.0):
                for link in links:
                    await link.gone.wait()
        for link in links:
            link.abort()

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _steered(self) -> tuple[int, int]:
        return sum(player.steered for player in self.players), sum(player.held_back for player in self.players)

    async def _steer(self) -> None:
        """Steer every stream ``steer_hz`` times a second, a few at a time, on an absolute schedule."""
        if self.asked.steer_hz <= 0:
            return
        interval_s = 1.0 / self.asked.steer_hz
        slots = max(1, min(len(self.players), round(interval_s / SLOT_S)))
        loop = asyncio.get_running_loop()
        start, count = loop.time(), 0
        while True:
            for player in self.players[count % slots :: slots]:
                player.steer()
            count += 1
            await asyncio.sleep(max(start + count * interval_s / slots - loop.time(), 0.0))

    async def _ping(self) -> None:
        """Keep comparing clocks."""
        while True:
            for player in self.players:
                player.ping()
                await asyncio.sleep(0.2)

    async def _tail(self) -> None:
        for _ in range(TAIL_LOOKS):
            if all(player.due_ns >= self.tally.stop_ns for player in self.players):
                return
            await asyncio.sleep(0.02)

    def _report(self, seconds: float, cpu_s: float, own: float, steered: tuple[int, int]) -> Report:
        tally, clock = self.tally, self.clock
        return Report(
            asked=self.asked,
            seconds=seconds,
            delivered=tally.delivered,
            expected=len(self.players) * round(seconds * self.asked.fps),
            dropped=tally.dropped,
            gaps=tally.gaps,
            decode_errors=tally.wrong,
            decoded=tally.decoded,
            lateness_ms=lateness_of(tally.late_ns, clock.offset_ns),
            round_trip_ms=round((clock.round_trip_ns or 0) * 1e-6, 3),
            records=tally.records,
            payload_bytes=tally.payload_bytes,
            steered=steered[0],
            held_back=steered[1],
            server_cpu_s=cpu_s,
            client_cpu=own,
            codes=dict(tally.codes),
            closes=dict(tally.closes),
            ops=dict(tally.ops),
            problems=list(tally.problems),
        )


async def play(
    asked: Asked,
    *,
    seconds: float,
    settle_s: float = 0.5,
    probe: Callable[[], float] = lambda: 0.0,
    walk: bool = True,
) -> Report:
    """Open a load, watch it, leave.

    Parameters
    ----------
    asked : Asked
    seconds, settle_s : float
        How long to watch, and how long to wait before.
    probe : callable
        Gives CPU seconds so far of the server.
    walk : bool
        Whether adverbs come from a walk through the verb's examples; else they stay in the middle.

    Raises
    ------
    CannotAsk, FrameError, OSError, TimeoutError
        If the server cannot be reached or does not open the channels.
    """
    goals = Goals.ask(base_of(asked.url), asked.verb, np.random.default_rng(asked.seed)) if walk else None
    fleet = Fleet(asked, goals)
    try:
        await fleet.open()
        return await fleet.measure(seconds, settle_s=settle_s, probe=probe)
    finally:
        await fleet.close()


def run(asked: Asked, *, seconds: float, probe: Callable[[], float] = lambda: 0.0, walk: bool = True) -> Report:
    """As :func:`play`, in an event loop of its own; garbage is not looked for meanwhile."""
    gc.collect()
    gc.disable()
    try:
        return uvloop.run(play(asked, seconds=seconds, probe=probe, walk=walk))
    finally:
        gc.enable()
