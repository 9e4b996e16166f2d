"""``make bench-crowd``: crowds of up to 10,000 characters at 60 fps.

The server has core 0, a light client core 1. Loads of all servers alternate; the least of all rounds is shown. With
``--before DIR``, another checkout with its own ``.venv`` plays the same loads in the same run. It gets goals by one
message for each character, ten times a second where the others get them in every tick.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

from adverb_load.client import Load
from adverb_load.crowd import run_crowd
from adverb_load.crowd_report import CrowdReport
from adverb_load.frames import FrameError
from adverb_load.goals import RequestError, fetch
from adverb_load.process import Served, StartError, pinned

from benchmarks.rounds import Rounds
from benchmarks.streams import (
    CLIENT_CORE,
    METHOD,
    QUIET,
    STEER_HZ,
    VERB,
    NoCapture,
    bare,
    build_verb,
    capture,
    say,
    served,
)
from benchmarks.timing import machine

FPS = 60
LARGE, MOVING, MANY, WIDE = (100, 100), (30, 100), (50, 60), (600, 1)
"""Sockets and channels."""

CHARACTERS = "200000"
FRAME_MS = 1_000.0 / FPS
GOALS = {"rest": 1 / 5, "rest q48": 1 / 5, "moving": 1 / 12}
"""Largest ratio of CPU per pose to that of the other checkout."""

BARE_GOALS = {"wide": 1.3, "wide steered": 2.0}
"""Largest ratio of CPU per message to that of the bare push loop."""


@dataclass(slots=True)
class Row(Rounds[CrowdReport]):
    """Rounds of a load of crowds, as a line of the table; ``failure`` is why one could not be played."""

    failure: str = ""

    def play(self, seconds: float) -> None:
        """Run one round."""
        try:
            Rounds.play(self, seconds)
        except (RequestError, FrameError, OSError, TimeoutError) as err:
            self.failure = f"{type(err).__name__}: {err}"

    def run(self, seconds: float, probe: Callable[[], float]) -> CrowdReport:
        """Play the load."""
        return run_crowd(self.load, seconds=seconds, probe=probe, walk_goals=self.walk)

    def most(self, figure: Callable[[CrowdReport], float]) -> float:
        """The greatest of all rounds; NaN without one."""
        return max((figure(report) for report in self.reports), default=nan)

    def us_per_pose(self) -> float:
        """Server CPU per pose."""
        return self.least(lambda report: report.us_per_pose)

    def p50_ms(self) -> float:
        """Median lateness."""
        return self.least(lambda report: report.lateness_ms.p50)

    def line(self) -> str:
        """One line of the table."""
        if not self.reports:
            return f"  {self.name:<46} not played: {self.failure}"
        late = [self.least(lambda report, q=q: getattr(report.lateness_ms, q)) for q in ("p50", "p99", "max")]  # type: ignore[misc]
        gaps = sum(report.gaps + report.wrong for report in self.reports) if self.walk else 0
        measured = self.most(lambda report: report.measured_m)
        return (
            f"  {self.name:<46}{100 * self.most(lambda r: r.share):>8.2f}{late[0]:>8.2f}{late[1]:>8.2f}{late[2]:>8.1f}"
            f"{gaps:>6}{sum(r.dropped for r in self.reports):>8}{self.us_per_pose():>9.2f}"
            f"{self.least(lambda r: 100 * r.server_cpu_s / r.seconds):>8.0f}{100 * min(self.waited):>8.0f}"
            f"{self.most(lambda r: 100 * r.reader_cpu):>8.0f}{self._goals_per_s():>10.0f}"
            f"{1e3 * self.most(lambda r: r.stated_m):>10.5f}{1e3 * measured:>10.5f}"
            f"{'  a round failed' if self.failure else ''}"
        )

    def _goals_per_s(self) -> float:
        return self.most(lambda report: report.steered / report.seconds)


HEADING = (
    f"  {'':<46}{'poses':>8}{'p50':>8}{'p99':>8}{'max':>8}{'gaps':>6}{'dropped':>8}{'µs/pose':>9}{'server':>8}"
    f"{'kept':>8}{'reader':>8}{'goals':>10}{'stated':>10}{'measured':>10}\n"
    f"  {'':<46}{'%':>8}{'ms':>8}{'ms':>8}{'ms':>8}{'':>6}{'messages':>8}{'CPU':>9}{'core %':>8}"
    f"{'out %':>8}{'core %':>8}{'per s':>10}{'error mm':>10}{'error mm':>10}"
)


def loads(url: str, *, bulk: bool, scale: float) -> dict[str, tuple[str, Load]]:
    """Name and load by key; without ``bulk`` each character's goals are one message, at most ten times a second."""

    def load(size: tuple[int, int], **other: object) -> Load:
        sockets, channels = size
        whole = Load(url, VERB, method=METHOD, sockets=max(1, round(scale * sockets)), channels=channels, fps=FPS)
        return replace(whole, **other)  # type: ignore[arg-type]

    hz, how = (float(FPS), "in every tick") if bulk else (STEER_HZ, f"at {STEER_HZ:g} Hz by 0x10")
    steered = f"steered at {STEER_HZ:g} Hz by 0x10"
    named = {
        "rest": ("at rest, f32", load(LARGE)),
        "rest q48": ("at rest, q48", load(LARGE, encoding="q48")),
        "moving": (f"moving {how}", load(MOVING, steer_hz=hz, bulk=bulk)),
        "many": (steered, load(MANY, steer_hz=STEER_HZ)),
        "wide": ("at rest", load(WIDE)),
        "wide steered": (steered, load(WIDE, steer_hz=STEER_HZ)),
        "two": (f"moving {how}, 2 processes", load(LARGE, steer_hz=hz, bulk=bulk)),
    }
    return {key: (f"{load.sockets} × {load.channels} {name}", load) for key, (name, load) in named.items()}


def rows_of(servers: Mapping[str, Served], chosen: argparse.Namespace) -> dict[str, Row]:
    """All rows, in the order in which a round plays them."""
    rows: dict[str, Row] = {}
    older = loads("", bulk=False, scale=chosen.scale)
    for key, (name, load) in loads(servers["now"].url, bulk=chosen.bulk, scale=chosen.scale).items():
        if key not in chosen.rows:
            continue
        server = servers["two"] if key == "two" else servers["now"]
        rows[key] = Row(name, replace(load, url=server.url), server)
        if "before" in servers and key != "two":
            before = servers["before"]
            rows[f"before {key}"] = Row(f"before: {older[key][0]}", replace(older[key][1], url=before.url), before)
        if key == "wide":
            floor = servers["bare"]
            rows["bare"] = Row(f"{load.sockets} × 1 bare push loop", replace(load, url=floor.url), floor, walk=False)
    return rows


def ratios(rows: Mapping[str, Row]) -> list[str]:
    """Lines that compare rows of one run."""
    lines = []
    for key, row in rows.items():
        before = rows.get(f"before {key}")
        if before is not None and row.reports and before.reports:
            cpu, late = row.us_per_pose() / before.us_per_pose(), row.p50_ms() / before.p50_ms()
            goal = f"   (goal ≤ {GOALS[key]:.3f})" if key in GOALS else ""
            lines.append(f"  {row.name:<46}CPU per pose {cpu:.3f}, p50 lateness {late:.2f} of before{goal}")
        if key in BARE_GOALS and "bare" in rows and row.reports and rows["bare"].reports:
            ratio = row.us_per_pose() / rows["bare"].us_per_pose()
            shown = f"{ratio:.2f}" if 0.0 < ratio < inf else "?"
            lines.append(f"  {row.name:<46}CPU per message {shown} × the bare push loop   (goal ≤ {BARE_GOALS[key]:g})")
    return lines


def measure(chosen: argparse.Namespace, folder: Path) -> None:
    """Measure everything and print it."""
    build_verb(folder)
    with ExitStack() as stack:

        def start(name: str, **options: object) -> Served:
            own = folder / name  # servers keep versions in their folders
            own.mkdir()
            shutil.copy(folder / f"{VERB}.verb", own)
            limit = {"ADVERB_STREAM_CHARACTERS": CHARACTERS}
            return stack.enter_context(served(own, **options, **limit))  # type: ignore[arg-type]

        servers = {"now": start("now")}
        if chosen.before is not None:
            servers["before"] = start("before", project=chosen.before.resolve())
        if "two" in chosen.rows:
            servers["two"] = start("two", core=None, workers=2)
        skeleton = fetch(servers["now"].base, f"/v1/verbs/{VERB}")["skeleton"]
        joints = len(skeleton["names"])
        if "wide" in chosen.rows:
            servers["bare"] = stack.enter_context(bare(joints))
        rows = rows_of(servers, chosen)
        for number in range(chosen.rounds):
            for row in rows.values():
                say(f"round {number + 1} of {chosen.rounds}: {row.name}")
                row.play(chosen.seconds)
    print(f"Crowds at {FPS} fps, verb '{VERB}' of motion capture ({joints} joints), method '{METHOD}'")
    print(HEADING)
    print("\n".join(row.line() for row in rows.values()))
    if lines := ratios(rows):
        print("Ratios of one run")
        print("\n".join(lines))
    samples = sum(report.samples for row in rows.values() for report in row.reports)
    clock = max((report.clock_ms for row in rows.values() for report in row.reports), default=nan)
    print(f"Errors: {samples:,} sampled records, measured by forward kinematics. Lateness: ± {clock:.2f} ms at most.")
    busy = max((min(row.waited) for row in rows.values() if row.waited), default=0.0)
    if busy > QUIET:
        print(f"Others kept a server off its core for up to {100 * busy:.0f} % of the time: doubt lateness and shares.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; 2 where it cannot be run."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.crowds", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    keys = list(loads("", bulk=True, scale=1.0))
    parser.add_argument("--rounds", type=int, default=2, help="rounds of the comparison (%(default)s)")
    parser.add_argument("--seconds", type=float, default=5.0, help="seconds of each load (%(default)s)")
    parser.add_argument("--scale", type=float, default=1.0, help="factor of the number of sockets (%(default)s)")
    parser.add_argument("--rows", nargs="+", choices=keys, default=keys, help="only these loads (all)")
    parser.add_argument("--before", type=Path, metavar="DIR", help="another checkout, with its .venv, to compare with")
    parser.add_argument(
        "--no-bulk", dest="bulk", action="store_false", help="goals by 0x10 at 10 Hz, for servers without 0x11"
    )
    chosen = parser.parse_args(arguments)
    try:
        capture()
        print(machine(), flush=True)
        with TemporaryDirectory() as folder, pinned(CLIENT_CORE):
            measure(chosen, Path(folder))
    except (NoCapture, StartError) as err:
        print(f"error: {err}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
