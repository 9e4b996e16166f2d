"""Many streams at once, open loop: arrivals are compared with the server's schedule."""

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
from adverb_client import Clock

from adverb_load.client import Load, LoadClient
from adverb_load.goals import Goals, base_of
from adverb_load.tally import Lateness, Tally, lateness_of, offset_ns_of

__all__ = ["Fleet", "Report", "play", "run"]

TOGETHER = 40
"""Number of connections that are opened concurrently."""

TAIL_LOOKS = 50
"""Number of waits of 20 ms for late messages that are due within the window."""

SLOT_S = 0.004
"""Time between two groups of streams that get adverbs."""


@dataclass(frozen=True, slots=True)
class Report:
    """Result of a load within the window.

    Parameters
    ----------
    load : Load
    seconds : float
    delivered, expected : int
        Pose messages.
    dropped, gaps : int
        Missing messages: reported by the server, and unreported.
    decode_errors, decoded : int
        Messages with errors; messages that were decoded in full.
    lateness_ms : Lateness
        Its uncertainty is half of ``round_trip_ms``.
    records, payload_bytes : int
    steered, held_back : int
        Adverbs that were sent, and those held back because the server did not read.
    server_cpu_s, client_cpu : float
        CPU seconds by the probe; share of a core that this process used.
    codes, closes, ops : dict
    problems : list of str
    """

    load: Load
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
        """Bytes per pose, including a share of the message header."""
        return self.payload_bytes / self.records if self.records else float("nan")

    @property
    def sound(self) -> bool:
        """Whether there is no unreported gap, decode error, error message or closed connection."""
        return self.gaps == 0 and self.decode_errors == 0 and not self.codes and not self.closes

    @property
    def holds(self) -> bool:
        """Whether the server keeps up: sound, 99 % of due messages delivered, p99 lateness within one frame."""
        enough = self.delivered >= 0.99 * self.expected
        return self.sound and enough and self.lateness_ms.p99 <= 1_000.0 / self.load.fps

    def to_json(self) -> dict[str, object]:
        """The report as a JSON object."""
        return dataclasses.asdict(self) | {
            "bytes_per_pose": round(self.bytes_per_pose, 2),
            "sound": self.sound,
            "holds": self.holds,
        }


class Fleet:
    """Streams of one load.

    Parameters
    ----------
    load : Load
    goals : Goals or None
    """

    def __init__(self, load: Load, goals: Goals | None) -> None:
        self.load, self.tally, self.clock = load, Tally(), Clock()
        seeds = random.Random(load.seed)
        self.clients = [
            LoadClient(
                load, self.tally, self.clock, random.Random(seeds.getrandbits(64)), goals, at=seeds.getrandbits(16)
            )
            for _ in range(load.sockets)
        ]

    async def open(self) -> None:
        """Open all streams and channels."""
        for first in range(0, len(self.clients), TOGETHER):
            await asyncio.gather(*(client.start() for client in self.clients[first : first + TOGETHER]))

    async def measure(self, seconds: float, *, settle_s: float, probe: Callable[[], float]) -> Report:
        """Measure for some seconds; ``probe`` returns the server's CPU seconds so far."""
        tally, clock = self.tally, self.clock
        async with asyncio.TaskGroup() as group:
            workers = [group.create_task(self._steer()), group.create_task(self._ping())]
            await asyncio.sleep(settle_s)
            start_ns = time.monotonic_ns() + offset_ns_of(clock)
            tally.window(start_ns, start_ns + round(seconds * 1e9))
            steered = self._steered()
            cpu_s, own_s = probe(), time.process_time()
            await asyncio.sleep(seconds)
            cpu_s, own_s = probe() - cpu_s, time.process_time() - own_s
            sent, held = (now - then for now, then in zip(self._steered(), steered, strict=True))
            for worker in workers:
                worker.cancel()
        await self._tail()
        return self._report(seconds, cpu_s, own_s / seconds, (sent, held))

    async def close(self) -> None:
        """Close all connections; returns when the server has closed them."""
        sockets = [client.socket for client in self.clients if client.socket is not None]
        for socket in sockets:
            socket.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(5.0):
                for socket in sockets:
                    await socket.gone.wait()
        for socket in sockets:
            socket.abort()

    # ── parts ────────────────────────────────────────────────────────────────────────────────────────────────────

    def _steered(self) -> tuple[int, int]:
        return sum(client.steered for client in self.clients), sum(client.held_back for client in self.clients)

    async def _steer(self) -> None:
        """Send adverbs to every stream ``steer_hz`` times per second, in groups, on an absolute schedule."""
        if self.load.steer_hz <= 0:
            return
        interval_s = 1.0 / self.load.steer_hz
        slots = max(1, min(len(self.clients), round(interval_s / SLOT_S)))
        loop = asyncio.get_running_loop()
        start, count = loop.time(), 0
        while True:
            for client in self.clients[count % slots :: slots]:
                client.steer()
            count += 1
            await asyncio.sleep(max(start + count * interval_s / slots - loop.time(), 0.0))

    async def _ping(self) -> None:
        """Ping all streams in turn."""
        while True:
            for client in self.clients:
                client.ping()
                await asyncio.sleep(0.2)

    async def _tail(self) -> None:
        for _ in range(TAIL_LOOKS):
            if all(client.due_ns >= self.tally.stop_ns for client in self.clients):
                return
            await asyncio.sleep(0.02)

    def _report(self, seconds: float, cpu_s: float, own: float, steered: tuple[int, int]) -> Report:
        tally, clock = self.tally, self.clock
        return Report(
            load=self.load,
            seconds=seconds,
            delivered=tally.delivered,
            expected=len(self.clients) * round(seconds * self.load.fps),
            dropped=tally.dropped,
            gaps=tally.gaps,
            decode_errors=tally.wrong,
            decoded=tally.decoded,
            lateness_ms=lateness_of(tally.late_ns, offset_ns_of(clock)),
            round_trip_ms=round(1e3 * clock.round_trip_s, 3) if clock.known else 0.0,
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
    load: Load,
    *,
    seconds: float,
    settle_s: float = 0.5,
    probe: Callable[[], float] = lambda: 0.0,
    walk: bool = True,
) -> Report:
    """Open a load, measure it, close it.

    Parameters
    ----------
    load : Load
    seconds, settle_s : float
        Duration of the measurement, and of the wait before it.
    probe : callable
        Returns the server's CPU seconds so far.
    walk : bool
        Whether adverbs follow a walk through the verb's examples; otherwise they stay in the middle.

    Raises
    ------
    RequestError, FrameError, OSError, TimeoutError
        If the server cannot be reached or does not open the channels.
    """
    goals = Goals.fetch(base_of(load.url), load.verb, np.random.default_rng(load.seed)) if walk else None
    fleet = Fleet(load, goals)
    try:
        await fleet.open()
        return await fleet.measure(seconds, settle_s=settle_s, probe=probe)
    finally:
        await fleet.close()


def run(load: Load, *, seconds: float, probe: Callable[[], float] = lambda: 0.0, walk: bool = True) -> Report:
    """As :func:`play`, in a new event loop, without garbage collection."""
    gc.collect()
    gc.disable()
    try:
        return uvloop.run(play(load, seconds=seconds, probe=probe, walk=walk))
    finally:
        gc.enable()
