"""``make bench-streams``: how many streams one core serves, how late frames are, what a pose costs.

The server has core 0, the client core 1. Every figure is taken beside a bare push loop: the same web server with the
same settings, which sends the same number of bytes and animates nothing. Rounds are interleaved, the least is shown.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

from adverb_load.client import Load
from adverb_load.fleet import Report, run
from adverb_load.goals import fetch
from adverb_load.process import Served, pinned, serve

from benchmarks.rounds import Rounds
from benchmarks.timing import machine

PROJECT = Path(__file__).resolve().parents[1]
SERVER_CORE, CLIENT_CORE = 0, 1
VERB, METHOD = "reach", "corrected"
STEER_HZ = 10.0
WIDE, MANY = (600, 1), (50, 60)
"""Sockets and channels: every client one character, and a few clients with a crowd each."""

MOST_SOCKETS, MOST_CHANNELS = 1_600, 128
STEPS, TRIES = 5, 2
QUIET = 0.1
"""Share of the time for which others may keep the server off its core before figures are doubted."""

GOAL_RATIO, GOAL_BYTES = 1.5, 0.45


class NoCapture(Exception):
    """There is no motion capture to build the verb of."""


@dataclass(slots=True)
class Row(Rounds[Report]):
    """Rounds of a load of single streams, as a line of the table."""

    def run(self, seconds: float, probe: Callable[[], float]) -> Report:
        """Play the load."""
        return run(self.load, seconds=seconds, probe=probe, walk=self.walk)

    def us_per_message(self) -> float:
        """Server CPU per message."""
        return self.least(lambda report: 1e6 * report.server_cpu_s / report.delivered if report.delivered else inf)

    def _sum(self, figure: str) -> str:
        """Of all rounds; the bare loop counts ticks, not messages, so its numbers mean nothing."""
        return str(sum(getattr(report, figure) for report in self.reports)) if self.walk else "–"

    def line(self) -> str:
        """One line of the table."""
        share = max(report.delivered / report.expected for report in self.reports)
        pose = self.least(lambda report: 1e6 * report.server_cpu_s / report.records if report.records else inf)
        cpu = self.least(lambda report: 100.0 * report.server_cpu_s / report.seconds)
        own = self.least(lambda report: 100.0 * report.client_cpu)
        late = [self.least(lambda report, q=q: getattr(report.lateness_ms, q)) for q in ("p50", "p95", "p99", "max")]  # type: ignore[misc]
        return (
            f"  {self.name:<28}{100 * share:>8.2f}{late[0]:>8.2f}{late[1]:>8.2f}{late[2]:>8.2f}{late[3]:>8.2f}"
            f"{self._sum('gaps'):>6}{self._sum('decode_errors'):>8}"
            f"{pose:>9.1f}{self.us_per_message():>9.1f}{cpu:>8.0f}{100 * min(self.waited):>8.0f}{own:>8.0f}"
        )


HEADING = (
    f"  {'':<28}{'frames':>8}{'p50':>8}{'p95':>8}{'p99':>8}{'max':>8}{'gaps':>6}{'decode':>8}"
    f"{'µs/pose':>9}{'µs/msg':>9}{'server':>8}{'kept':>8}{'client':>8}\n"
    f"  {'':<28}{'%':>8}{'ms':>8}{'ms':>8}{'ms':>8}{'ms':>8}{'':>6}{'errors':>8}{'CPU':>9}{'CPU':>9}"
    f"{'core %':>8}{'out %':>8}{'core %':>8}"
)


def capture() -> Path:
    """The folder of motion capture that the verb is built of; raises :class:`NoCapture`."""
    folder = PROJECT / os.environ.get("ADVERB_TEST_DATA", "../shared/data") / "mocap" / VERB
    if not folder.is_dir():
        raise NoCapture(f"no motion capture at {folder}; point ADVERB_TEST_DATA at a folder that holds mocap/{VERB}")
    return folder


def build_verb(folder: Path) -> None:
    """Build the verb of motion capture into a folder; raises :class:`NoCapture`."""
    from verbs.authoring.fit import build
    from verbs.io import artifact

    artifact.save(build(capture()).verb, folder / f"{VERB}.verb")


@contextmanager
def served(
    folder: Path, *, project: Path = PROJECT, core: int | None = SERVER_CORE, workers: int = 1, **environment: str
) -> Iterator[Served]:
    """A server of the verb that is built of motion capture, on its own core.

    Parameters
    ----------
    folder : Path
        Its data; the verb is built if it is not there.
    project : Path
        This checkout, or another one with its own ``.venv``.
    core : int or None
        Core to run on; any if None.
    workers : int
        Server processes.
    **environment
        Settings.
    """
    if not (folder / f"{VERB}.verb").exists():
        build_verb(folder)
    python = sys.executable if project == PROJECT else str(project / ".venv" / "bin" / "python")
    start = "from service.cli import main; main()"
    command = [python, "-c", start, "serve", "--port", "0", "--data", str(folder), "--workers", str(workers)]
    own = {"ADVERB_REFINERS": "0", "NUMBA_CACHE_DIR": str(project / ".cache" / "numba")}  # workers would share the core
    with serve(command, core=core, cwd=project, environment=own | environment) as found:
        yield found


@contextmanager
def bare(joints: int) -> Iterator[Served]:
    """A bare push loop with records of this number of joints."""
    command = [sys.executable, "-m", "adverb_load.bare", "--joints", str(joints)]
    path = {"PYTHONPATH": str(PROJECT / "clients" / "load")}
    with serve(command, core=SERVER_CORE, cwd=PROJECT, environment=path) as found:
        yield found


def compare(server: Served, floor: Served, *, rounds: int, seconds: float) -> dict[str, Row]:
    """Play every load in every round."""
    whole = Load(server.url, VERB, method=METHOD)
    wide, many = (replace(whole, sockets=sockets, channels=channels) for sockets, channels in (WIDE, MANY))
    rows = {
        "bare": Row("600 × 1, bare push loop", replace(wide, url=floor.url), floor, walk=False),
        "wide": Row("600 × 1, at rest", wide, server),
        "wide steered": Row("600 × 1, steered at 10 Hz", replace(wide, steer_hz=STEER_HZ), server),
        "many": Row("50 × 60, at rest", many, server),
        "many steered": Row("50 × 60, steered at 10 Hz", replace(many, steer_hz=STEER_HZ), server),
    }
    for number in range(rounds):
        for row in rows.values():
            say(f"round {number + 1} of {rounds}: {row.name}")
            row.play(seconds)
    return rows


def largest(name: str, server: Served, load_of: Callable[[int], Load], most: int, *, seconds: float) -> str:
    """Bisect for the largest load that holds; a line with the result."""
    low, high, late = 0, most + 1, float("nan")
    for _ in range(STEPS):
        middle = (low + high) // 2
        say(f"largest load, {name}: trying {middle}")
        reports = (run(load_of(middle), seconds=seconds, probe=server.cpu_s) for _ in range(TRIES))
        held = next((report for report in reports if report.holds), None)
        if held is not None:
            low, late = middle, held.lateness_ms.p99
        else:
            high = middle
    bound = "or more" if low == most else f"({high} did not hold)"
    return f"  {name:<28}{low:>8} {bound}, p99 {late:.1f} ms"


def encodings(server: Served) -> list[str]:
    """Bytes of a pose in each encoding, alone in a message and among 60."""
    lines, full = [], (0.0, 0.0)
    for encoding in ("f32", "q48", "q32", "weights"):
        sizes = []
        for channels in (1, 60):
            load = Load(server.url, VERB, encoding=encoding, channels=channels, method=METHOD)
            sizes.append(run(load, seconds=0.5).bytes_per_pose)
        full = full if full[0] else (sizes[0], sizes[1])
        ratio = sizes[1] / full[1]
        goal = f"   (goal ≤ {100 * GOAL_BYTES:.0f} %)" if encoding == "q48" else ""
        lines.append(f"  {encoding:<12}{sizes[0]:>8.1f} alone{sizes[1]:>8.1f} of 60   {100 * ratio:.1f} % of f32{goal}")
    return lines


def say(line: str) -> None:
    """Print the progress."""
    print(line, file=sys.stderr, flush=True)


def measure(chosen: argparse.Namespace, folder: Path) -> None:
    """Measure everything and print it."""
    with served(folder) as server:
        joints = len(fetch(server.base, f"/v1/verbs/{VERB}")["skeleton"]["names"])
        with bare(joints) as floor:
            rows = compare(server, floor, rounds=chosen.rounds, seconds=chosen.seconds)
        whole = Load(server.url, VERB, method=METHOD)
        limits = [
            largest(
                "sockets × 1", server, lambda k: replace(whole, sockets=k), MOST_SOCKETS, seconds=chosen.limit_seconds
            ),
            largest(
                "50 sockets × channels",
                server,
                lambda k: replace(whole, sockets=MANY[0], channels=k),
                MOST_CHANNELS,
                seconds=chosen.limit_seconds,
            ),
        ]
        sizes = encodings(server)
    print(f"Streams at 60 fps, verb '{VERB}' of motion capture ({joints} joints), method '{METHOD}', f32")
    print(HEADING)
    print("\n".join(row.line() for row in rows.values()))
    ratio = rows["wide"].us_per_message() / rows["bare"].us_per_message()
    shown = f"{ratio:.2f}" if 0.0 < ratio < inf else "?"
    print(f"CPU per message, 600 × 1: {shown}× the bare push loop   (goal ≤ {GOAL_RATIO:g}×)")
    busy = max(min(row.waited) for row in rows.values())
    if busy > QUIET:
        print(
            f"Others kept the server off its core for up to {100 * busy:.0f} % of the time: doubt lateness and limits."
        )
    print("Largest load that holds (p99 within one frame, 99 % of frames, no gaps)")
    print("\n".join(limits))
    print("Bytes of a pose, heads included")
    print("\n".join(sizes))


def main() -> int:
    """Run the comparison; 2 where it cannot be run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.streams", description=__doc__)
    parser.add_argument("--rounds", type=int, default=2, help="rounds of the comparison (%(default)s)")
    parser.add_argument("--seconds", type=float, default=4.0, help="seconds of each load (%(default)s)")
    parser.add_argument("--limit-seconds", type=float, default=3.0, help="seconds of a step of bisection (%(default)s)")
    chosen = parser.parse_args()
    try:
        capture()
    except NoCapture as err:
        print(f"error: {err}", file=sys.stderr)
        return 2
    print(machine(), flush=True)
    with TemporaryDirectory() as folder, pinned(CLIENT_CORE):
        measure(chosen, Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
