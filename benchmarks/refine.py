"""``make bench-refine``: what a refinement costs those who are served, how fast it goes, how soon servers swap.

Servers, workers and databases are processes as in earnest, and nothing is pinned to a core. Idle and refining rounds
take turns; only their ratio travels.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

import httpx
import numpy as np
from adverb_load.client import Load
from adverb_load.fleet import run
from adverb_load.process import Served, serve

from benchmarks.timing import machine
from tools.postgres import Postgres, programs
from verbs import library
from verbs.io import artifact

PROJECT = Path(__file__).resolve().parents[1]
GOAL, GOAL_UPLOAD_S = 1.2, 2.0
STREAMS = 30
PAUSE_S, REST_S = 0.005, 4.0
PATIENCE_S = 240.0
START = "from service.cli import main; main()"
OCTETS = {"Content-Type": "application/octet-stream"}
POSE = {"adverbs": {"x": -0.2, "y": 1.2, "z": 0.5}, "phase": 0.5}
LONG: dict[str, object] = {"max_pseudo": 2000, "target_error": 1e-6}
TWINS = ("twin-1", "twin-2")
"""Copies of arm3, so that two workers have as much to do each."""

Environment = Mapping[str, str]


def say(line: str) -> None:
    """Print the progress."""
    print(line, file=sys.stderr, flush=True)


def until(holds: Callable[[], object]) -> float:
    """Wait until something holds; the seconds that took."""
    began = time.perf_counter()
    while not holds():
        if time.perf_counter() - began > PATIENCE_S:
            raise TimeoutError("it did not happen in time")
        time.sleep(0.002)
    return time.perf_counter() - began


@contextmanager
def worker(name: str, folder: Path, environment: Environment) -> Iterator[None]:
    """A worker that is ready, and ends with the block."""
    file = folder / f"{name}.log"
    command = [sys.executable, "-c", START, "worker", "--name", name, "--data", str(folder)]
    with file.open("wb") as log:
        process = subprocess.Popen(command, cwd=PROJECT, env={**os.environ, **environment}, stderr=log)
    try:
        until(lambda: f"worker '{name}' is ready" in file.read_text())
        yield
    finally:
        process.terminate()
        process.wait()


def server(name: str, folder: Path, environment: Environment) -> AbstractContextManager[Served]:
    """A server without workers of its own."""
    own = folder / name
    own.mkdir()
    command = [sys.executable, "-c", START, "serve", "--port", "0", "--data", str(own)]
    return serve(command, core=None, cwd=PROJECT, environment={**environment, "ADVERB_REFINERS": "0"})


class Server:
    """What the benchmark asks of a server."""

    def __init__(self, served: Served) -> None:
        self.served, self.http = served, httpx.Client(base_url=served.base, timeout=PATIENCE_S)

    def get(self, path: str) -> Any:
        """A JSON answer."""
        return self.http.get(path).raise_for_status().json()

    def post(self, path: str, **options: Any) -> Any:
        """A JSON answer."""
        return self.http.post(path, **options).raise_for_status().json()

    def latencies_ms(self, seconds: float) -> list[float]:
        """Milliseconds of poses that are requested one after the other."""
        found, end = [], time.perf_counter() + seconds
        while (began := time.perf_counter()) < end:
            self.http.post("/v1/verbs/reach/pose", json=POSE).raise_for_status()
            found.append(1000.0 * (time.perf_counter() - began))
            time.sleep(PAUSE_S)
        return found

    def lateness_ms(self, seconds: float) -> float:
        """The 99th percentile over the messages of some streams, milliseconds."""
        load = Load(self.served.url, "reach", sockets=STREAMS)
        return run(load, seconds=seconds).lateness_ms.p99

    def start(self, verb: str, **requested: object) -> str:
        """Start a refinement; its path."""
        return f"/v1/refinements/{self.post(f'/v1/verbs/{verb}/refinements', json=requested)['id']}"


def interleaved(one: Server, *, rounds: int, seconds: float) -> list[str]:
    """Latency and lateness, idle and while a verb is refined, in turns."""
    names = ("pose, p50", "pose, p99", f"{STREAMS} streams, p99 lateness")
    figures: dict[str, list[tuple[float, ...]]] = {"idle": [], "refining": []}
    for number in range(rounds):
        for kind, rows in figures.items():
            say(f"round {number + 1} of {rounds}: {kind}")
            job = one.start("arm3", **LONG) if kind == "refining" else ""
            if job:
                until(lambda job=job: one.get(job)["progress"].get("pseudo", 0) > 0)  # type: ignore[misc]
            took = one.latencies_ms(seconds)
            rows.append((float(np.median(took)), float(np.percentile(took, 99)), one.lateness_ms(seconds)))
            if job:
                assert one.get(job)["state"] == "running", "the refinement ended too soon; choose fewer seconds"
                one.http.delete(job)
                until(lambda job=job: one.get(job)["state"] == "cancelled")  # type: ignore[misc]
    lines = [f"  {'ms':<30}{'idle':>10}{'refining':>10}{'ratio':>8}"]
    for column, name in enumerate(names):
        idle, busy = (median(row[column] for row in rows) for rows in figures.values())
        goal = f"   (goal ≤ {GOAL:g}×)" if "p99" in name else ""
        lines.append(f"  {name:<30}{idle:>10.2f}{busy:>10.2f}{busy / idle:>7.2f}×{goal}")
    return lines


def throughput(one: Server, pseudo: int, workers: int) -> str:
    """Pseudo-examples per minute over two jobs at once, from the first start to the last end."""
    say(f"{workers} worker{'s' * (workers > 1)}: two jobs of {pseudo} pseudo-examples")
    began = time.perf_counter()
    jobs = [one.start(verb, max_pseudo=pseudo, target_error=1e-6) for verb in TWINS]
    until(lambda: all(one.get(job)["state"] not in ("queued", "running") for job in jobs))
    minutes = (time.perf_counter() - began) / 60.0
    done = sum(one.get(job)["progress"]["pseudo"] for job in jobs)
    return f"  {workers} worker{'s' * (workers > 1):<1}{done / minutes:>12.0f} pseudo-examples/min"


def swaps(servers: list[Server], count: int) -> str:
    """Time from when a version is current to when every server serves it."""
    took_ms = []
    for k in range(count):
        number = 2 - k % 2
        servers[0].post(f"/v1/verbs/swapped/versions/{number}/activate")
        served = lambda: all(one.get("/v1/verbs/swapped")["version"] == number for one in servers)  # noqa: B023, E731
        took_ms.append(1000.0 * until(served))
        time.sleep(0.05 * (k % 3))  # not always at the same moment between two looks
    return f"p50 {median(took_ms):.0f} ms, max {max(took_ms):.0f} ms, {count} swaps, {len(servers)} servers"


def capture() -> Path:
    """The folder of motion capture that is uploaded; it is no part of the project."""
    return PROJECT / os.environ.get("ADVERB_TEST_DATA", "../shared/data") / "mocap" / "reach"


def upload(one: Server, name: str, folder: Path, **changes: object) -> None:
    """Publish arm3 under another name."""
    file = folder / f"{name}.verb"
    artifact.save(replace(library.load("arm3"), name=name, **changes), file)  # type: ignore[arg-type]
    one.post("/v1/verbs", content=file.read_bytes(), headers=OCTETS)


def replaced(one: Server, count: int) -> str:
    """Time from when a zip of a 35-example source is sent to when the verb of it is served."""
    folder, took_s = capture(), []
    for k in range(count):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(folder.iterdir()):
                content = file.read_bytes()
                if file.name == "verb.toml":  # other bytes, so that it is another version
                    content = content.replace(b'description = "', f'description = "{k} '.encode(), 1)
                archive.writestr(file.name, content)
        time.sleep(REST_S)  # authors do, and a process for the next one gets ready
        began = time.perf_counter()
        one.post("/v1/verbs", content=packed.getvalue(), headers={"Content-Type": "application/zip"})
        took_s.append(time.perf_counter() - began)
    return f"least {min(took_s):.2f} s, p50 {median(took_s):.2f} s, max {max(took_s):.2f} s, {count} uploads"


def measure(database: str, folder: Path, chosen: argparse.Namespace) -> Iterator[str]:
    """Everything with one database; lines of the report."""
    environment = {"ADVERB_DATABASE_URL": database, "ADVERB_ARTIFACT_URL": str(folder / "artifacts")}
    with ExitStack() as stack:
        both = [Server(stack.enter_context(server(name, folder, environment))) for name in ("server-1", "server-2")]
        for one in both:
            stack.callback(one.http.close)
        for description in ("first", "second"):
            upload(both[0], "swapped", folder, description=description)
        yield f"  publish to last swap: {swaps(both, chosen.swaps)}"
        if capture().is_dir():
            yield f"  35 examples, sent to served: {replaced(both[0], chosen.uploads)}   (goal ≤ {GOAL_UPLOAD_S:g} s)"
        if database.startswith("sqlite") and programs():
            return
        for name in TWINS:
            upload(both[0], name, folder)
        stack.enter_context(worker("worker-1", folder, environment))
        both[0].post("/v1/verbs/board/refinements", json={"max_pseudo": 1, "for": "error"})  # it compiles what it needs
        until(lambda: both[0].get("/v1/refinements")["refinements"][0]["state"] not in ("queued", "running"))
        yield from interleaved(both[0], rounds=chosen.rounds, seconds=chosen.seconds)
        yield throughput(both[0], chosen.pseudo, 1)
        stack.enter_context(worker("worker-2", folder, environment))
        yield throughput(both[0], chosen.pseudo, 2)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.refine", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="rounds of idle and refining (%(default)s)")
    parser.add_argument("--seconds", type=float, default=4.0, help="seconds of each figure in a round (%(default)s)")
    parser.add_argument("--pseudo", type=int, default=200, help="pseudo-examples of a job (%(default)s)")
    parser.add_argument("--swaps", type=int, default=20, help="swaps that are timed (%(default)s)")
    parser.add_argument("--uploads", type=int, default=4, help="uploads that are timed (%(default)s)")
    chosen = parser.parse_args()
    print(machine(), flush=True)
    with ExitStack() as stack:
        folders = {name: Path(stack.enter_context(TemporaryDirectory())) for name in ("SQLite", "PostgreSQL")}
        databases = {"SQLite": f"sqlite:///{folders['SQLite']}/state.db"}
        if found := programs():
            store = Postgres(found)
            stack.callback(store.remove)
            databases["PostgreSQL"] = store.address("postgres")
        for name, database in databases.items():
            print(name, flush=True)
            for line in measure(database, folders[name], chosen):
                print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
