"""One run: start the clients, let the faults happen, wait for the recovery, and check."""

from __future__ import annotations

import asyncio
import random
import sys
import time
from collections import Counter
from typing import Any

import numpy as np
from adverb_load.goals import Goals, fetch

from benchmarks.chaos.authors import Author, Uploads
from benchmarks.chaos.cluster import Cluster
from benchmarks.chaos.inspection import ENDED, collected, inspect, job_states
from benchmarks.chaos.ledger import Happened, Ledger
from benchmarks.chaos.plan import CUT, NETWORK, OWN, Fault, Plan
from benchmarks.chaos.requests import Cutter, Requester
from benchmarks.chaos.streams import Watched
from benchmarks.chaos.verdict import (
    MORE_FILES,
    Check,
    check_answers,
    check_files,
    check_jobs,
    check_log,
    check_measured,
    check_memory,
    check_numbers,
    check_streams,
    check_versions,
)

__all__ = ["run"]

REQUESTERS, CUTTERS = 6, 2
SAMPLE_S, PRINT_S = 2.0, 30.0
RECOVERY_S = (20.0, 180.0)
"""Shortest and longest time after the run in which everything recovers without faults, seconds; less in a short run."""
FRESH_S = 5.0
"""A stream that has recovered has a frame that is not older, seconds."""
CLOSED_S = 20.0
"""Longest time after the last client has left in which servers close their sockets, seconds."""
SHOWN = 3
"""Largest number of problems that are shown each time."""
_CHECKED = ("reach", "punch", "kick")


def progress(line: str) -> None:
    """Print progress."""
    print(line, file=sys.stderr, flush=True)


class Run:
    """A run on a cluster.

    Parameters
    ----------
    plan : Plan
    cluster : Cluster
    """

    def __init__(self, plan: Plan, cluster: Cluster) -> None:
        self.plan, self.cluster, self.ledger = plan, cluster, Ledger()
        self.streams: list[Watched] = []
        self.moving: set[str] = set()
        self.files = cluster.files()
        self._stop, self._authors_stop = asyncio.Event(), asyncio.Event()

    async def play(self) -> int:
        """Run everything, wait for the recovery and close all clients; the number of streams with frames then."""
        base, rng = self.cluster.base, random.Random(f"{self.plan.seed} clients")
        names = sorted({row.verb for row in self.plan.streams} | set(_CHECKED))
        verbs = {name: await asyncio.to_thread(fetch, base, f"/v1/verbs/{name}") for name in names}
        goals = {name: Goals.of(verb, np.random.default_rng(self.plan.seed)) for name, verb in verbs.items()}
        checked = {name: verbs[name] for name in _CHECKED}
        uploads = await asyncio.to_thread(Uploads, self.plan)
        self.ledger.start_s = time.monotonic()
        url = base.replace("http", "ws", 1)
        self.streams = [
            Watched(number, url, row, self.ledger, goals[row.verb], verbs[row.verb], self.cluster.owner_of)
            for number, row in enumerate(self.plan.streams)
        ]
        async with asyncio.TaskGroup() as group:
            clients: list[Any] = [
                *self.streams,
                *(
                    Requester(base, checked, goals, random.Random(rng.getrandbits(64)), self.ledger)
                    for _ in range(REQUESTERS)
                ),
                *(Cutter(base, random.Random(rng.getrandbits(64)), self.ledger) for _ in range(CUTTERS)),
            ]
            tasks = [group.create_task(client.run(self._stop)) for client in clients]
            authors = [
                group.create_task(Author(number, base, self.plan, uploads, self.ledger).run(self._authors_stop))
                for number in range(len(OWN) + 1)
            ]
            watch = group.create_task(self._watch())
            await self._strike()
            await asyncio.sleep(max(self.plan.seconds - self.ledger.now_s(), 0.0))
            self._authors_stop.set()
            await asyncio.wait(authors)
            alive = await self._recover()
            watch.cancel()
            self._stop.set()
            await asyncio.wait(tasks)
        for stream in self.streams:
            await stream.finish()
        await self._close()
        return alive

    async def _strike(self) -> None:
        """Let all faults happen at their times."""
        for fault in self.plan.faults:
            await asyncio.sleep(max(fault.at_s - self.ledger.now_s(), 0.0))
            progress(f"{self.ledger.now_s():7.1f} s  {fault.name}")
            if fault.kind in NETWORK:
                self._cut(fault)
            else:
                await self.cluster.strike(fault, self.ledger)

    def _cut(self, fault: Fault) -> None:
        """Cut the connections of some streams."""
        now_s = self.ledger.now_s()
        self.ledger.faults.append(Happened(fault, now_s, now_s))
        for stream in self.streams[fault.pick % CUT :: CUT]:
            stream.cut()

    async def _watch(self) -> None:
        """Sample processes and print progress until cancelled."""
        printed_s, printed = 0.0, 0
        while True:
            await asyncio.to_thread(self.cluster.sample, self.ledger)
            if self.ledger.now_s() - printed_s > PRINT_S:
                printed_s, ledger = self.ledger.now_s(), self.ledger
                live = sum(stream.alive(FRESH_S) for stream in self.streams)
                progress(
                    f"{printed_s:7.1f} s  {live} streams with frames, {ledger.messages} messages, "
                    f"{len(ledger.versions)} versions, {len(ledger.jobs)} refinements, {len(ledger.wrong)} wrong"
                )
                for problem in ledger.wrong[printed : printed + SHOWN]:
                    progress(f"           wrong: {problem[:400]}")
                printed = len(ledger.wrong)
            await asyncio.sleep(SAMPLE_S)

    async def _recover(self) -> int:
        """Wait until all streams have frames and all refinements have ended; the number of streams with frames."""
        began_s, shortest_s = self.ledger.now_s(), min(RECOVERY_S[0], 0.3 * self.plan.seconds)
        before = await asyncio.to_thread(job_states, self.cluster, self.ledger)
        while True:
            passed_s = self.ledger.now_s() - began_s
            states = await asyncio.to_thread(job_states, self.cluster, self.ledger)
            self.moving |= {id for id, row in states.items() if id in before and row[1] > before[id][1]}
            alive = sum(stream.alive(FRESH_S) for stream in self.streams)
            done = alive == len(self.streams) and all(state in ENDED for state, _ in states.values())
            if passed_s > shortest_s and (done or passed_s > RECOVERY_S[1]):
                progress(f"{self.ledger.now_s():7.1f} s  recovered: {alive} streams with frames")
                return alive
            await asyncio.sleep(1.0)

    async def _close(self) -> None:
        """Wait until the servers have closed the files of clients that left and of versions that were replaced."""
        end_s, idle = self.ledger.now_s() + CLOSED_S, Counter(self.files["server"])
        while self.ledger.now_s() < end_s:
            more = Counter(self.cluster.files()["server"]) - idle
            if max(more["socket:"], more["artifacts"]) <= MORE_FILES:
                return
            await asyncio.sleep(0.5)

    def checks(self, alive: int) -> list[Check]:
        """All rows of the table."""
        after = self.cluster.files()
        found = inspect(self.cluster, self.ledger)
        left = collected(self.cluster, {verb for verb, _ in found.versions})
        return [
            check_versions(self.ledger, found),
            check_jobs(self.ledger, found, ENDED, self.moving),
            check_measured(self.ledger),
            check_numbers(self.ledger),
            check_streams(self.ledger, len(self.streams), alive),
            check_answers(self.ledger),
            check_memory(self.ledger, self.plan.seconds),
            check_log(self.ledger, self.cluster.log.read_text(errors="replace").splitlines()),
            check_files(self.files, after, left, verbs=len(found.current)),
        ]


def run(plan: Plan, cluster: Cluster) -> tuple[Ledger, list[Check]]:
    """A whole run.

    Parameters
    ----------
    plan : Plan
    cluster : Cluster

    Returns
    -------
    ledger : Ledger
    checks : list of Check
    """
    import uvloop

    made = Run(plan, cluster)
    alive = uvloop.run(made.play())
    return made.ledger, made.checks(alive)
