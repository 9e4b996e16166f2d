"""Runs a profile against a server, and returns the report."""

from __future__ import annotations

import asyncio
import gc
import os
import platform
import random
import signal
import sys
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from adverb_load.goals import RequestError
from adverb_load.profile import Profile
from adverb_load.request_load import RequestLoad
from adverb_load.series import Series
from adverb_load.stream_load import StreamLoad
from adverb_load.target import Target

__all__ = ["FORMAT", "run"]

FORMAT = "adverb-load/1"
SWEEP_S, LAG_S = 0.1, 0.02
TAIL_S, SHORT_TAIL_S = 5.0, 1.0
"""Longest wait after the end of a run for what was due in it, seconds: responses that are still missing count as
errors, frames and goals as at least as late. The second is that of an interrupted run."""

Report = dict[str, Any]
Progress = Callable[[str], None]


def run(profile: Profile, target: Target, *, seed: int, progress: Progress = lambda text: None) -> Report:
    """Run a profile; Ctrl+C ends it early, with a report of what ran.

    Its intervals become as long as divides the duration evenly.

    Raises
    ------
    RequestError
        If the server cannot be reached, lacks a verb, or opens no stream.
    """
    intervals = max(1, round(profile.duration_s / profile.interval_s))
    profile = replace(profile, interval_s=profile.duration_s / intervals)
    gc.collect()
    gc.disable()  # a collection delays arrivals
    try:
        return _loop()(_Run(profile, target, seed, progress).play())
    finally:
        gc.enable()


def _loop() -> Callable[[Coroutine[Any, Any, Report]], Report]:
    try:
        import uvloop
    except ImportError:
        return asyncio.run
    return uvloop.run


class _Run:
    def __init__(self, profile: Profile, target: Target, seed: int, progress: Progress) -> None:
        seeds = random.Random(seed)
        self.profile, self.target, self.seed, self.progress = profile, target, seed, progress
        self.streams = [StreamLoad(plan, target, seeds.getrandbits(32), profile.interval_s) for plan in profile.streams]
        self.requests = [
            RequestLoad(plan, target, seeds.getrandbits(32), profile.interval_s) for plan in profile.requests
        ]
        self.loads: list[StreamLoad | RequestLoad] = [*self.streams, *self.requests]
        self.lag = Series(profile.interval_s)

    async def play(self) -> Report:
        loop, stop = asyncio.get_running_loop(), asyncio.Event()
        with suppress(NotImplementedError, ValueError, RuntimeError):  # other threads, and loops of Windows
            loop.add_signal_handler(signal.SIGINT, stop.set)
            loop.add_signal_handler(signal.SIGTERM, stop.set)
        try:
            self.progress("connecting")
            for load in self.streams:
                await load.open()
                if not load.live:
                    raise RequestError(f"no stream of '{load.plan.name}' was opened: {load.failed}")
            return await self._measured(stop)
        finally:
            for one in self.loads:
                await one.close()

    async def _measured(self, stop: asyncio.Event) -> Report:
        profile = self.profile
        begin_s = time.monotonic()
        start_s = begin_s + profile.warmup_s
        self.lag.window(start_s, profile.duration_s)
        for load in self.loads:
            load.window(start_s, profile.duration_s)
        schedules = [task for load in self.loads for task in load.tasks(begin_s)]
        helpers = [asyncio.create_task(work) for work in (self._sweep(), self._watch(), self._show(start_s))]
        started = datetime.now(UTC)
        cpu = _Cpu()
        await _until(stop, start_s)
        cpu.begin()
        await _until(stop, start_s + profile.duration_s)
        share = cpu.share()
        seconds = max(time.monotonic() - start_s, 0.0) if stop.is_set() else profile.duration_s
        for task in schedules:
            task.cancel()
        await self._tail(start_s + seconds, TAIL_S if not stop.is_set() else SHORT_TAIL_S)
        for task in helpers:
            task.cancel()
        for problem in await asyncio.gather(*schedules, *helpers, return_exceptions=True):
            if isinstance(problem, Exception):
                raise problem
        for one in self.requests:
            await one.close()  # those without a response count as errors
        for load in self.loads:
            load.sweep()
        for load in self.streams:
            load.end(start_s + seconds)
        if stop.is_set() and seconds < profile.interval_s:
            raise RequestError(f"interrupted after {seconds:.1f} s, before the first interval was complete")
        whole = profile.interval_s * int(seconds / profile.interval_s) if stop.is_set() else seconds
        return self._report(whole, share, started, interrupted=stop.is_set())

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_S)
            for load in self.loads:
                load.sweep()

    async def _watch(self) -> None:
        """Measure how late this program itself is."""
        due_s = time.monotonic()
        while True:
            due_s += LAG_S
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            self.lag.add(due_s, max(time.monotonic() - due_s, 0.0))

    async def _show(self, start_s: float) -> None:
        end_s = start_s + self.profile.duration_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            phase = "warm-up" if time.monotonic() < start_s else "running"
            self.progress(f"{phase}: {left_s:.0f} s left, {sum(load.live for load in self.streams)} streams")
            await asyncio.sleep(1.0)

    async def _tail(self, end_s: float, most_s: float) -> None:
        """Wait for what was due before ``end_s``."""
        last_s = time.monotonic() + most_s
        while time.monotonic() < last_s:
            if not any(load.unfinished(end_s) for load in self.loads):
                return
            await asyncio.sleep(0.02)

    def _report(self, seconds: float, share: float, started: datetime, *, interrupted: bool) -> Report:
        lag = self.lag.whole(seconds)
        return {
            "format": FORMAT,
            "profile": self.profile.to_json(),
            "server": self.target.url,
            "started": started.isoformat(timespec="seconds"),
            "seconds": round(seconds, 3),
            "interval_s": self.profile.interval_s,
            "interrupted": interrupted,
            "seed": self.seed,
            "client": {
                "cpu_share": round(share, 3),
                "lag_s": lag.summary(),
                "cores": os.cpu_count(),
                "python": platform.python_version(),
                "system": f"{platform.system()} {platform.machine()}",
                "loop": "uvloop" if "uvloop" in sys.modules else "asyncio",
            },
            "streams": [load.result(seconds) for load in self.streams],
            "requests": [load.result(seconds) for load in self.requests],
        }


class _Cpu:
    """Share of one core that this process uses."""

    def begin(self) -> None:
        self._cpu_s, self._wall_s = time.process_time(), time.monotonic()

    def share(self) -> float:
        if not hasattr(self, "_cpu_s"):
            return 0.0
        return (time.process_time() - self._cpu_s) / max(time.monotonic() - self._wall_s, 1e-9)


async def _until(stop: asyncio.Event, end_s: float) -> None:
    """Wait until a time, or until the run is to stop."""
    with suppress(TimeoutError):
        async with asyncio.timeout(max(end_s - time.monotonic(), 0.0)):
            await stop.wait()
