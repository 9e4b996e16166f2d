"""A bounded soak: mixed load with clients that come and go; memory must stay flat and nothing may be left behind.

Beside single clients, a crowd is opened, streamed for some seconds and closed, again and again: in turn at rest and
with goals that move in every tick, in every encoding.

The server has core 0, clients have core 1. Everything goes over loopback and ends after ``--minutes``.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

import httpx
import numpy as np
import uvloop
from adverb_load.churn import Churn
from adverb_load.client import Load
from adverb_load.crowd import run_crowd
from adverb_load.crowd_report import CrowdReport
from adverb_load.goals import Goals
from adverb_load.process import Served, pinned
from adverb_load.tally import lateness_of, offset_ns_of

from benchmarks.streams import CLIENT_CORE, VERB, NoCapture, capture, say, served
from benchmarks.timing import machine

GRACE_S, SLOW_S = 3.0, 4.0
"""Settings of the server, short so that a soak goes through many of each."""

STAYING, MOVING, SLOW, ASKING = 6, 8, 2, 2
CROWD_CHANNELS = 100
"""Characters of a socket of the crowd."""

ROUND_S, SETTLE_S = 20.0, 3.0
"""Time for which a crowd streams, and before that until it has opened, seconds."""

SAMPLES = 40
AT_REST = 0.15
"""Share of the run after which memory must not grow any more."""

FLAT = 1.05
AVERAGED = 5
REST_S = 0.05

EXPECTED = {"unknown_session", "unknown_channel"}
"""Error codes that clients may see who come back too late."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The server at an instant."""

    at_s: float
    rss_mib: float
    threads: int
    files: int
    streams: float
    channels: float
    tasks: float
    p99_ms: float

    def line(self) -> str:
        """One line of the table."""
        return (
            f"  {self.at_s:>8.0f}{self.rss_mib:>10.1f}{self.threads:>9}{self.files:>7}"
            f"{self.streams:>9.0f}{self.channels:>10.0f}{self.tasks:>7.0f}{self.p99_ms:>10.2f}"
        )


HEADING = f"  {'s':>8}{'RSS MiB':>10}{'threads':>9}{'files':>7}{'streams':>9}{'channels':>10}{'tasks':>7}{'p99 ms':>10}"


class Soak:
    """One run.

    Parameters
    ----------
    server : Served
    crowd : Churn
    seconds : float
    characters : int
        Of the crowd, in whole sockets of :data:`CROWD_CHANNELS`.
    """

    def __init__(self, server: Served, crowd: Churn, seconds: float, characters: int) -> None:
        self.server, self.crowd, self.seconds, self.characters = server, crowd, seconds, characters
        self.rounds: list[CrowdReport] = []
        self.samples: list[Sample] = []
        self.answers: Counter[int] = Counter()
        self._start_s = time.monotonic()

    async def run(self) -> Sample:
        """Let everybody play; the server after all have left."""
        end_s, seeds = self._start_s + self.seconds, random.Random(1)
        crowd = self.crowd
        async with httpx.AsyncClient(base_url=self.server.base, timeout=30.0) as http:
            async with asyncio.TaskGroup() as group:
                for _ in range(STAYING):
                    group.create_task(crowd.stay(random.Random(seeds.getrandbits(64)), end_s))
                for _ in range(MOVING):
                    group.create_task(crowd.come_and_go(random.Random(seeds.getrandbits(64)), end_s))
                for _ in range(SLOW):
                    rng = random.Random(seeds.getrandbits(64))
                    group.create_task(crowd.read_slowly(rng, end_s, 2 * SLOW_S))
                for _ in range(ASKING):
                    group.create_task(self._ask(http, random.Random(seeds.getrandbits(64)), end_s))
                group.create_task(self._watch(http, end_s))
                group.create_task(asyncio.to_thread(self._play_crowds, end_s))
            await asyncio.sleep(GRACE_S + 2.0)
            last = await self._sample(http)
            if last.streams or last.channels:
                await asyncio.sleep(SLOW_S + GRACE_S)
                later = await self._sample(http)
                say(f"still there {SLOW_S + GRACE_S:g} s later: {later.streams:g} streams, {later.channels:g} channels")
            return last

    async def _ask(self, http: httpx.AsyncClient, rng: random.Random, end_s: float) -> None:
        """Ask for poses, batches and motions."""
        binary = {"Accept": "application/octet-stream"}
        while time.monotonic() < end_s:
            adverbs, phase = self.crowd.goals.adverbs(rng.getrandbits(16)), rng.random()
            path, body = rng.choice(
                [
                    ("pose", {"adverbs": adverbs, "phase": phase}),
                    ("poses", {"items": [{"adverbs": adverbs, "phase": phase}] * 50}),
                    ("sequence", {"adverbs": adverbs}),
                ]
            )
            headers = rng.choice([binary, {}])
            answer = await http.post(f"/v1/verbs/{VERB}/{path}", json=body, headers=headers)
            self.answers[answer.status_code] += 1
            await asyncio.sleep(REST_S)

    def _play_crowds(self, end_s: float) -> None:
        """Open a crowd, stream it, and close it, again and again."""
        sockets = self.characters // CROWD_CHANNELS
        loads = [
            replace(
                self.crowd.load, sockets=sockets, channels=CROWD_CHANNELS, encoding=encoding,
                steer_hz=60.0 * moving, bulk=moving,
            )
            for encoding in ("f32", "q48", "q32", "weights")
            for moving in (False, True)
        ]  # fmt: skip
        for load in cycle(loads):
            left_s = end_s - time.monotonic()
            if not sockets or left_s < 2 * SETTLE_S:
                return
            self.rounds.append(run_crowd(load, seconds=min(ROUND_S, left_s - SETTLE_S), settle_s=SETTLE_S))

    async def _watch(self, http: httpx.AsyncClient, end_s: float) -> None:
        """Take samples until the end."""
        interval_s = self.seconds / SAMPLES
        print(HEADING, flush=True)
        for k in range(1, SAMPLES + 1):
            await asyncio.sleep(max(self._start_s + k * interval_s - time.monotonic(), 0.0))
            self.samples.append(await self._sample(http))
            if k % (SAMPLES // 10) == 0:
                print(self.samples[-1].line(), flush=True)

    async def _sample(self, http: httpx.AsyncClient) -> Sample:
        """Look at the server, and at the frames since the last look."""
        tally, clock, server = self.crowd.tally, self.crowd.clock, self.server
        late = lateness_of(tally.late_ns, offset_ns_of(clock))
        now_ns = time.monotonic_ns() + offset_ns_of(clock)
        tally.window(now_ns, now_ns + 3_600_000_000_000)
        gauges = gauges_of((await http.get("/metrics")).text)
        return Sample(
            time.monotonic() - self._start_s,
            server.rss_mib(),
            server.threads(),
            server.files(),
            gauges.get("adverb_streams", float("nan")),
            gauges.get("adverb_channels", float("nan")),
            gauges.get("adverb_asyncio_tasks", float("nan")),
            late.p99,
        )


def gauges_of(text: str) -> dict[str, float]:
    """Metrics without labels in Prometheus' text form."""
    pairs = [line.split(" ") for line in text.splitlines() if line and not line.startswith("#") and "{" not in line]
    return {name: float(value) for name, value, *_ in pairs}


def growth(samples: list[Sample]) -> float:
    """Memory at the end ÷ memory when the run had settled; medians of a few samples."""
    first = int(AT_REST * len(samples))
    settled = median(sample.rss_mib for sample in samples[first : first + AVERAGED])
    return median(sample.rss_mib for sample in samples[-AVERAGED:]) / settled


def verdict(soak: Soak, last: Sample) -> list[str]:
    """What is wrong."""
    samples, wrong = soak.samples, []
    if growth(samples) > FLAT:
        wrong.append(f"memory grew by {100 * (growth(samples) - 1):.1f} %; {100 * (FLAT - 1):.0f} % are allowed")
    if last.streams or last.channels:
        wrong.append(f"{last.streams:g} streams and {last.channels:g} channels are left after all clients left")
    if not max(sample.channels for sample in samples) > 0:
        wrong.append("the gauge adverb_channels never rose, so it measures nothing")
    if last.files > samples[0].files:
        wrong.append(f"{last.files} files are open after all clients left; {samples[0].files} were early in the run")
    if set(soak.answers) != {200}:
        wrong.append(f"requests were answered {dict(soak.answers)}")
    for tally in (soak.crowd.tally, soak.crowd.slow):
        if tally.gaps or tally.wrong:
            wrong.append(f"{tally.gaps} messages missing unreported, {tally.wrong} unreadable: {tally.problems}")
        if unexpected := tally.codes.keys() - EXPECTED:
            wrong.append(f"errors {sorted(unexpected)}: {tally.problems}")
    wrong += [
        f"a crowd: {report.gaps} messages missing unreported, {report.wrong} unreadable, {report.codes}"
        for report in soak.rounds
        if report.gaps or report.wrong or report.codes
    ]
    return wrong


async def _soak(server: Served, seconds: float, characters: int) -> tuple[Soak, Sample]:
    load = Load(server.url, VERB)
    goals = await asyncio.to_thread(Goals.fetch, server.base, VERB, np.random.default_rng(1))
    soak = Soak(server, Churn(load, goals), seconds, characters)
    return soak, await soak.run()


def summary(soak: Soak, last: Sample) -> list[str]:
    """What happened."""
    tally, slow = soak.crowd.tally, soak.crowd.slow
    counts: dict[str, Counter[Any]] = {
        "did": soak.crowd.done,
        "errors": tally.codes + slow.codes,
        "closed": tally.closes + slow.closes,
    }
    return [
        "After all clients left and the grace time passed:",
        last.line(),
        f"memory     {growth(soak.samples):.3f} × that at {100 * AT_REST:.0f} % of the run   (goal ≤ {FLAT:g})",
        f"frames     {tally.messages}, and {slow.messages} of slow readers; {tally.gaps + slow.gaps} missing without "
        f"a word, {tally.wrong + slow.wrong} unreadable",
        f"crowds     {len(soak.rounds)} of {soak.characters} characters, {sum(one.delivered for one in soak.rounds)} "
        f"poses: {100 * median([one.share for one in soak.rounds] or [0.0]):.1f} % of a round (median), least "
        f"{100 * min((one.share for one in soak.rounds), default=0.0):.1f} %",
        f"requests   {sum(soak.answers.values())}",
        *(f"{name:<11}{', '.join(f'{key} {count}' for key, count in some.items())}" for name, some in counts.items()),
    ]


def main() -> int:
    """Run a soak; 0 if the server came through, 1 if not, 2 if it cannot be run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="how long (%(default)s)")
    parser.add_argument("--characters", type=int, default=2_000, help="size of the crowd (%(default)s)")
    chosen = parser.parse_args()
    try:
        capture()
    except NoCapture as err:
        print(f"error: {err}", file=sys.stderr)
        return 2
    print(machine(), flush=True)
    settings = {"ADVERB_STREAM_GRACE_S": str(GRACE_S), "ADVERB_STREAM_SLOW_S": str(SLOW_S)}
    with TemporaryDirectory() as folder, pinned(CLIENT_CORE), served(Path(folder), **settings) as server:
        say(f"soaking for {chosen.minutes:g} minutes")
        soak, last = uvloop.run(_soak(server, 60.0 * chosen.minutes, chosen.characters))
    print("\n".join(summary(soak, last)))
    wrong = verdict(soak, last)
    print("\n".join(f"wrong      {one}" for one in wrong) if wrong else "the server came through")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
