"""``make bench-scaling``: a model of streaming servers, fitted to small loads and checked at three other sizes.

Parameters come from loads of up to 4,000 characters on a server that is pinned to one core. The model then predicts CPU
time, bandwidth, delivered messages and lateness of mixed loads of 500, 2,500 and 8,000 characters, and the same loads
are measured. ``--write docs/scaling.md`` replaces the tables between the marks of that file.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients" / "load"))

from adverb_load.client import Load
from adverb_load.crowd import Crowd
from adverb_load.crowd_report import CrowdReport
from adverb_load.process import Served, StartError, pinned

from benchmarks import scaling_model as model
from benchmarks.scaling_model import FPS, Group, Model, Plan, Shape, Size
from benchmarks.streams import CLIENT_CORE, METHOD, VERB, NoCapture, build_verb, capture, say, served
from benchmarks.timing import machine
from service.settings import Settings
from service.store.tables import CONNECTIONS
from verbs.io import artifact

FIRST, LAST = "<!-- measured -->", "<!-- /measured -->"

SMALL = [
    [Group(1, 1)],
    [Group(100, 1)],
    [Group(300, 1)],
    [Group(5, 60)],
    [Group(20, 60)],
    *([Group(20, 60, encoding)] for encoding in ("q48", "q32", "weights")),
    [Group(5, 60, "q48")],
    [Group(40, 100)],
    [Group(40, 100, "q48")],
    [Group(5, 60, steer_hz=10.0)],
    [Group(20, 60, steer_hz=10.0)],
    [Group(10, 60, steer_hz=60.0)],
    [Group(100, 1, steer_hz=10.0, bulk=False)],
    [Group(10, 60, steer_hz=10.0, bulk=False)],
]
"""Loads that the parameters are fitted to."""

SIZES = {
    500: [Group(100, 1), Group(10, 20, "q48", 10.0, bulk=False), Group(4, 50, "weights")],
    2_500: [Group(300, 1), Group(20, 60, "q48", 30.0), Group(10, 100)],
    8_000: [Group(30, 100), Group(20, 150, "q48"), Group(10, 200, "q32", 10.0)],
}
"""Loads that are predicted, by their number of characters."""

ENCODINGS = ("f32", "q48", "q32", "weights")
CHARACTERS = (1_000, 10_000, 100_000, 1_000_000)
PORTS, FILES, POSTGRES = 64_511, 1_048_576, 100
"""Ports of one address above 1,023; the kernel's default limit of files of a process; default of PostgreSQL (A14)."""


@dataclass(slots=True)
class Measured:
    """What one round of a load gave.

    Parameters
    ----------
    cpu, reader : float
        Share of a core.
    kept : float
        Share of the time in which the server could have run, and others had its core.
    delivered : float
    payload : float
        Bytes of pose messages per second.
    late_ms : list of (p50, p99)
        Of each group.
    delays_s : list of (share, seconds)
        Quantiles of lateness of the first group.
    rss_mib : float
    """

    cpu: float
    reader: float
    kept: float
    delivered: float
    payload: float
    late_ms: list[tuple[float, float]]
    delays_s: list[tuple[float, float]]
    rss_mib: float

    @classmethod
    def of(cls, reports: Sequence[CrowdReport], waited_s: float, rss_mib: float) -> Measured:
        """Join what the readers of one load report; the first one measured the server."""
        due = sum(report.load.sockets * round(report.seconds * FPS) for report in reports)
        late = reports[0].lateness_ms
        quantiles = [(0.0, late.p50), (0.5, late.p50), (0.95, late.p95), (0.99, late.p99), (1.0, late.max)]
        return cls(
            reports[0].server_cpu_s / reports[0].seconds,
            sum(report.reader_cpu for report in reports),
            waited_s / reports[0].seconds,
            sum(report.messages for report in reports) / due,
            sum(report.bytes / report.seconds for report in reports),
            [(report.lateness_ms.p50, report.lateness_ms.p99) for report in reports],
            [(share, 1e-3 * ms) for share, ms in quantiles],
            rss_mib,
        )


def _read(load: Load, seconds: float, server: Served | None, ready: Any, channel: Connection) -> None:
    """One reader, a process: open a load, wait for the other readers, measure."""
    waited_s: list[float] = []

    def probe() -> float:
        waited_s.append(server.waited_s() if server is not None else 0.0)
        return server.cpu_s() if server is not None else 0.0

    try:
        crowd = Crowd(load)
        crowd.open()
        gc.collect()
        gc.disable()
        ready.wait(timeout=240.0)
        report = crowd.measure(seconds, settle_s=1.0, probe=probe)
        channel.send((report, waited_s[-1] - waited_s[0], server.rss_mib() if server is not None else 0.0))
        ready.wait(timeout=60.0)  # a reader that leaves early would lighten the load of the others
        crowd.close()
    except Exception as err:
        ready.abort()
        channel.send(err)


def play(server: Served, groups: Sequence[Group], seconds: float) -> Measured:
    """Measure all groups together, one reader process each; raises what a reader raised."""
    context = multiprocessing.get_context("fork")
    ready, readers = context.Barrier(len(groups)), []
    for number, group in enumerate(groups):
        load = Load(server.url, VERB, group.encoding, group.sockets, group.channels, FPS, METHOD, group.steer_hz,
                    bulk=group.bulk, events=False, seed=1 + number)  # fmt: skip
        here, there = context.Pipe(duplex=False)
        options = (load, seconds, None if number else server, ready, there)
        readers.append((context.Process(target=_read, args=options, daemon=True), here))
        readers[-1][0].start()
    found = [here.recv() for _, here in readers]
    for process, _ in readers:
        process.join(30.0)
    for failure in found:
        if isinstance(failure, Exception):
            raise failure
    return Measured.of([report for report, *_ in found], *found[0][1:])


def measured_model(server: Served, shape: Shape, rounds: int, seconds: float) -> tuple[Model, list[float]]:
    """Fit the model to the small loads; also predicted ÷ measured CPU of each."""
    best: list[Measured | None] = [None] * len(SMALL)
    for number in range(rounds):
        for k, groups in enumerate(SMALL):
            say(f"round {number + 1} of {rounds}: {named(groups)}")
            found, before = play(server, groups, seconds), best[k]
            best[k] = found if before is None or found.cpu < before.cpu else before
    kept = [(groups, found) for groups, found in zip(SMALL, best, strict=True) if found and found.delivered > 0.98]
    points = [(model.rates(groups, shape), found.cpu) for groups, found in kept]
    costs = model.fit(points)
    reader = model.fit([(model.reader_rates(groups, shape), found.reader) for groups, found in kept])
    first = kept[0][1]
    return Model(shape, costs, reader, first.delays_s), [model.total(row, costs) / cpu for row, cpu in points]


# ── tables ────────────────────────────────────────────────────────────────────────────────────────────────────────


def named(groups: Sequence[Group]) -> str:
    """A load in words."""
    parts = []
    for group in groups:
        how = f"{group.steer_hz:g} Hz by {'0x11' if group.bulk else '0x10'}" if group.steer_hz else "at rest"
        parts.append(f"{group.sockets} × {group.channels} {group.encoding} {how}")
    return ", ".join(parts)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table; the first column is text."""
    ruled = ["---", *["---:"] * (len(head) - 1)]
    return [f"| {' | '.join(row)} |" for row in (head, ruled, *rows)]


def parameters(found: Model, ratios: Sequence[float]) -> Iterator[str]:
    """The fitted costs."""
    costs = {name: 1e6 * cost for name, cost in found.costs.items()}
    texts = {name: f"{name} (1 s of a process)" if name == "process" else f"`{name}`" for name in costs}
    yield from table(("cost", "µs"), [(texts[name], f"{cost:,.2f}") for name, cost in costs.items()])
    off = 100.0 * (np.array(ratios) - 1.0)
    rms = np.sqrt(np.mean(off**2))
    yield f"\nThe fit meets its {len(off)} loads within {np.abs(off).max():.0f} % of CPU time (rms {rms:.0f} %)."


def checks(server: Served, found: Model, rounds: int, seconds: float) -> Iterator[str]:
    """Prediction, measurement and difference of each size; yields lines, then the memory of a character.

    The round in which others took least of the core counts, and what they took is given to the model (A15).
    """
    rows, memory = [], []
    for characters, groups in SIZES.items():
        say(f"{characters:,} characters: {named(groups)}")
        seen = min((play(server, groups, seconds) for _ in range(rounds)), key=lambda round_: round_.kept)
        expected = model.simulate(groups, found, kept=seen.kept)
        rows.append((f"{characters:,}: core taken by others, %", "given", f"{100 * seen.kept:.1f}", ""))
        memory.append((characters, seen.rss_mib))
        late = [[max(row[k] for row in rows_) for k in range(2)] for rows_ in (expected.late_ms, seen.late_ms)]
        figures = [
            ("CPU, % of a core", 100 * expected.cpu, 100 * seen.cpu),
            ("pose messages, MB/s", 1e-6 * expected.payload, 1e-6 * seen.payload),
            ("delivered, %", 100 * expected.delivered, 100 * seen.delivered),
            ("p50 lateness, ms", late[0][0], late[1][0]),
            ("p99 lateness, ms", late[0][1], late[1][1]),
        ]
        for name, one, other in figures:
            rows.append((f"{characters:,}: {name}", f"{one:.1f}", f"{other:.1f}", f"{one - other:+.1f}"))
    yield from table(("", "predicted", "measured", "difference"), rows)
    (few, low), (many, high) = memory[0], memory[-1]
    yield f"{1_024.0 * max(high - low, 0.0) / (many - few):.2f}"


def sizing(found: Model, kib: float, plan: Plan) -> Iterator[str]:
    """Capacity of a process by encoding, and sizes up to the largest number of characters."""
    held = {encoding: model.capacity(plan, encoding, found) for encoding in ENCODINGS}
    alone = {encoding: model.capacity(Plan(channels=1), encoding, found) for encoding in ENCODINGS}
    rows = []
    for encoding, (each, cpu) in held.items():
        wire = FPS * found.shape.wire_bytes(Group(1, plan.channels, encoding)) / plan.channels
        figures = (found.shape.record_bytes(encoding), 8e-3 * wire, each, 100 * cpu, alone[encoding][0])
        rows.append((f"`{encoding}`", *(f"{figure:,.0f}" for figure in figures)))
    yield from table(
        (
            "encoding",
            "bytes of a record",
            "kbit/s of a character on the wire",
            f"characters of a process, {plan.channels} a socket",
            "its core, %",
            "characters of a process, 1 a socket",
        ),
        rows,
    )
    yield ""
    lines = []
    for characters in CHARACTERS:
        sizes = [model.size(plan, encoding, characters, held[encoding][0] or 1, kib, found) for encoding in ENCODINGS]
        lines += [size_row(row, plan) for row in [*sizes, model.recipe(plan, characters, kib, found)]]
    head = ("characters, encoding", "cores", "hosts", "Gbit/s", "memory, GB", "cores, $/h", "traffic, $/h")
    yield from table(head, lines)
    yield ""
    yield from limits(found, plan, held["f32"][0], held["q48"][0])


def size_row(row: Size, plan: Plan) -> list[str]:
    """Cells of a size; hosts by cores or by network, whichever needs more."""
    name = f"{row.characters:,}, `{row.encoding}`" + (" (estimate)" if row.encoding == "recipe" else "")
    hosts = max(row.cores / plan.host_cores, row.gbit_s / (plan.headroom * plan.host_gbit_s))
    whole = [f"{row.cores:,}", f"{int(np.ceil(hosts)):,}"]
    return [name, *whole, *(f"{x:,.2f}" for x in (row.gbit_s, row.memory_gb, row.cores_per_hour, row.traffic_per_hour))]


def limits(found: Model, plan: Plan, f32: int, q48: int) -> Iterator[str]:
    """What is exhausted first, and at how many characters."""
    settings = Settings()
    gbit = 1e9 * plan.host_gbit_s / (8 * FPS)
    rows = [("engine thread of a process", "a core", f"{f32:,} (`f32`), {q48:,} (`q48`)")]
    for encoding in ("f32", "q48"):
        each = found.shape.wire_bytes(Group(1, plan.channels, encoding)) / plan.channels
        cores = gbit / each / max({"f32": f32, "q48": q48}[encoding], 1)
        rows.append((f"network of a host, `{encoding}`", f"{plan.host_gbit_s:g} Gbit/s",
                     f"{gbit / each:,.0f}, {cores:.0f} cores"))  # fmt: skip
    bytes_ = 2 * 4 * found.shape.record_bytes("f32")
    rows += [
        ("memory traffic of a host", f"{copy_gb_s():.0f} GB/s copied by a core here",
         f"{FPS * bytes_ * f32 * 1e-9:.1f} GB/s a core (4 copies of a record, read and written)"),
        ("`ADVERB_STREAM_CHARACTERS`", f"{settings.stream_characters:,} a process", f"{settings.stream_characters:,}"),
        ("`ADVERB_STREAMS`", f"{settings.streams:,} sockets a process",
         f"{settings.streams * plan.channels:,}; {settings.streams:,} with one a socket"),
        ("files of a process", f"{FILES:,}", f"{FILES:,} with one a socket"),
        ("ports between a proxy and a server", f"{PORTS:,} an address pair",
         f"{PORTS * plan.channels:,}; {PORTS:,} with one a socket"),
        ("connections of PostgreSQL", f"{POSTGRES}; {CONNECTIONS + 2} a process at most",
         f"{POSTGRES // (CONNECTIONS + 2) * f32:,} (`f32`)"),
    ]  # fmt: skip
    yield from table(("limit", "value", "characters"), rows)


def copy_gb_s() -> float:
    """Bytes that one core copies per second, in GB: the most of some rounds."""
    source = np.ones(1 << 25)
    target, best = np.empty_like(source), 0.0
    for _ in range(5):
        started = perf_counter()
        np.copyto(target, source)
        best = max(best, source.nbytes * 1e-9 / (perf_counter() - started))
    return best


def report(server: Served, shape: Shape, chosen: argparse.Namespace) -> Iterator[str]:
    """All tables."""
    plan = Plan()
    found, ratios = measured_model(server, shape, chosen.rounds, chosen.seconds)
    yield f"\nMeasured with `{command(chosen)}` on {machine()}. The verb has {shape.joints} joints, {shape.examples} "
    yield f"examples and {shape.intervals} knot intervals.\n\n### Costs\n"
    yield from parameters(found, ratios)
    yield "\n### Prediction and measurement\n"
    *lines, kib = checks(server, found, chosen.rounds, chosen.seconds)
    yield from lines
    yield f"\nMemory: {kib} KiB a character, buffers of messages included.\n\n### Sizes\n"
    yield from sizing(found, float(kib), plan)
    yield ""


def command(chosen: argparse.Namespace) -> str:
    """How these figures were measured."""
    return f"python -m benchmarks.scaling --rounds {chosen.rounds} --seconds {chosen.seconds:g}"


@contextmanager
def started(folder: Path) -> Iterator[tuple[Served, Shape]]:
    """The server on its core, and the shape of its verb."""
    build_verb(folder)
    verb = artifact.load(folder / f"{VERB}.verb")
    with served(folder, ADVERB_STREAM_CHARACTERS="200000") as server:
        yield server, Shape(len(verb.skeleton), len(verb.examples), len(verb.curves) - 3)


def write(path: Path, text: str) -> None:
    """Replace what stands between the marks of a file; :class:`ValueError` without marks."""
    before, first, rest = path.read_text(encoding="utf-8").partition(FIRST)
    _, last, after = rest.partition(LAST)
    if not (first and last):
        raise ValueError(f"{path} has no marks {FIRST} and {LAST}")
    path.write_text(f"{before}{first}\n{text}{last}{after}", encoding="utf-8")


def main(arguments: Sequence[str] | None = None, out: Callable[[str], None] = print) -> int:
    """Measure, print, and write where wanted; 2 where it cannot be measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=__doc__)
    parser.add_argument("--rounds", type=int, default=2, help="rounds of the small loads (%(default)s)")
    parser.add_argument("--seconds", type=float, default=4.0, help="seconds of each load (%(default)s)")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the tables between the marks of this file")
    chosen = parser.parse_args(arguments)
    lines: list[str] = []
    try:
        capture()
        with TemporaryDirectory() as folder, pinned(CLIENT_CORE), started(Path(folder)) as (server, shape):
            for line in report(server, shape, chosen):
                out(line)
                lines.append(line)
        if chosen.write is not None:
            write(chosen.write, "\n".join(lines) + "\n")
    except (NoCapture, StartError) as err:
        print(f"error: {err}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
