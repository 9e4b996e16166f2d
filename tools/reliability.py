"""Write docs/reliability.md: each promise, the tests that show it, and their last figures; `make reliability`.

The tests run here; figures of fuzzing and of chaos are taken from the tables of recorded runs: for chaos, of the
section "Last run" of docs/chaos.md. A check that fails in the section "One hour" is stated beside the figure.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from benchmarks import idle
from benchmarks.timing import machine

PROJECT = Path(__file__).resolve().parents[1]
FILE = PROJECT / "docs" / "reliability.md"
FAILS = "**fails**: "
START, END = "<!-- table: start -->", "<!-- table: end -->"

Figure = Callable[["Results"], str]


@dataclass(slots=True)
class Results:
    """What was found: tests that passed and properties that they recorded, by file; tables of recorded runs."""

    passed: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)
    properties: dict[str, list[str]] = field(default_factory=dict)
    chaos: dict[str, str] = field(default_factory=dict)
    hour: dict[str, str] = field(default_factory=dict)
    chaos_head: str = ""
    fuzz: list[tuple[int, int]] = field(default_factory=list)
    idle: idle.Idle | None = None


@dataclass(frozen=True, slots=True)
class Promise:
    """One row: what holds, the files of tests that show it, and a figure of a recorded run."""

    text: str
    tests: tuple[str, ...] = ()
    figure: Figure | None = None
    by: str = ""


def of_chaos(check: str) -> Figure:
    """What the last recorded run of chaos found in one of its checks, and the hour where it fails there."""

    def figure(found: Results) -> str:
        text = found.chaos[check]
        if found.hour.get(check, "").startswith(FAILS):
            text += f"; [one hour](chaos.md#one-hour) fails this check: {found.hour[check].removeprefix(FAILS)}"
        return text

    return figure


def fuzzed(found: Results) -> str:
    """Inputs and failures of all parsers."""
    inputs = [row[0] for row in found.fuzz]
    many = sum(count >= 1_000_000 for count in inputs)
    return (
        f"{sum(inputs):,} inputs, {sum(row[1] for row in found.fuzz)} failures; "
        f"{many} of {len(inputs)} targets with 1,000,000 or more, the fewest {min(inputs):,}"
    )


def held(found: Results) -> str:
    """Streams that were open at once, and the memory of each."""
    assert found.idle is not None  # measured before the table is made
    return f"{found.idle.streams:,} streams held, {found.idle.kb_each:.1f} kB each"


CHAOS = "`make chaos` ([chaos.md](chaos.md))"

SECTIONS: dict[str, list[Promise]] = {
    "Nothing is lost": [
        Promise(
            "What was answered survives a power failure between any two writes; nothing is half there.",
            ("service/faults/test_power.py",),
        ),
        Promise(
            "A process that is killed at any step leaves nothing half done.",
            ("service/store/test_crash.py", "service/catalog/test_killed.py", "service/drafts/test_survival.py"),
        ),
        Promise("Every acknowledged version is there and intact after chaos.", (), of_chaos("versions"), CHAOS),
        Promise(
            "Every refinement ends or continues.",
            ("service/refinement/test_takeover.py",),
            of_chaos("refinements"),
            CHAOS,
        ),
        Promise("A damaged artifact is never served, and reported.", ("service/faults/test_damage.py",)),
        Promise(
            "A backup that is made while serving is complete, and restores everything.", ("service/cli/test_backup.py",)
        ),
        Promise(
            "Data folders and artifacts of earlier layouts are served.",
            ("service/faults/test_upgrade.py", "service/store/test_migrations.py"),
        ),
        Promise("No pose message is missing without being counted.", (), of_chaos("sequence numbers"), CHAOS),
    ],
    "It stays up": [
        Promise(
            "Poses and streams continue without the database.",
            ("service/catalog/test_outage.py", "service/store/test_unavailable.py"),
        ),
        Promise("A full or read-only disk refuses changes only.", ("service/faults/test_full.py",)),
        Promise(
            "Killed and stopped processes lose their own streams only, and are replaced.",
            ("service/faults/test_servers.py", "service/run/test_supervisor.py"),
        ),
        Promise(
            "All clients recover by themselves.", ("clients/python/test_reconnection.py",), of_chaos("streams"), CHAOS
        ),
        Promise("Requests fail around a fault only, with documented errors.", (), of_chaos("answers"), CHAOS),
        Promise("No answer is wrong: the client measures it again.", (), of_chaos("measured values"), CHAOS),
        Promise("Memory is flat.", (), of_chaos("memory"), CHAOS),
        Promise("Files and descriptors are returned.", (), of_chaos("files"), CHAOS),
        Promise("A worker without memory fails its job only.", ("service/faults/test_memory.py",)),
        Promise("The clock may jump.", ("service/faults/test_clock.py",)),
        Promise(
            "Half-open and slow connections, and a lack of descriptors, disturb no other client.",
            ("service/faults/test_sockets.py", "service/run/test_http_protocol.py"),
        ),
        Promise("An idle stream needs less than 40 kB.", ("benchmarks/test_idle.py",), held, "`make bench-idle`"),
    ],
    "It lets no one in": [
        Promise(
            "Each route answers each kind of key as stated; keys work and end at once on every process.",
            ("service/access/test_routes.py", "service/access/test_keys.py", "service/access/test_tokens.py"),
        ),
        Promise("Limits of keys and addresses hold.", ("service/access/test_limits.py",)),
        Promise(
            "Answers fit the OpenAPI document, with and without a key.",
            ("service/access/test_document.py", "service/http/test_openapi.py"),
        ),
        Promise(
            "A page of another site can neither read nor change anything.",
            ("dashboard/test_origins.py", "service/http/test_guard.py"),
        ),
        Promise(
            "No bytes of clients crash, exhaust or escape a parser.",
            ("fuzz/test_corpus.py",),
            fuzzed,
            "`make fuzz` ([fuzz.md](fuzz.md))",
        ),
        Promise(
            "Uploads are built in a sandbox and cannot leave it.",
            ("service/upload/test_sandbox.py", "service/upload/test_building.py"),
        ),
    ],
    "It can be seen": [
        Promise(
            "Each alert fires on its series, and none on normal ones.",
            ("deploy/test_alerts.py", "deploy/test_dashboards.py"),
        ),
        Promise("Requests and streams are found in the log and in traces.", ("service/test_tracing.py",)),
        Promise("Metrics of several processes add up.", ("service/test_metrics.py", "service/run/test_supervisor.py")),
    ],
}


def promises() -> list[Promise]:
    """All rows."""
    return [promise for rows in SECTIONS.values() for promise in rows]


def run_tests(found: Results) -> int:
    """Run the tests of all rows; return pytest's exit code."""
    files = sorted({f"tests/{test}" for promise in promises() for test in promise.tests})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", "-n", "2", f"--junitxml={report}", *files]
        code = subprocess.run(command, cwd=PROJECT, check=False).returncode
        for case in ElementTree.parse(report).iter("testcase"):
            name = case.get("classname", "").removeprefix("tests.").replace(".", "/") + ".py"
            if case.find("skipped") is not None:
                found.skipped[name] += 1
            elif case.find("failure") is None and case.find("error") is None:
                found.passed[name] += 1
            for row in case.iter("property"):
                number = str(row.get("value"))
                value = f"{int(number):,}" if number.isdigit() else number
                found.properties.setdefault(name, []).append(f"{value} {row.get('name')}")
    return code


def read_runs(found: Results) -> None:
    """Read the tables of docs/fuzz.md and docs/chaos.md; raises :class:`ValueError` where one has no rows."""
    fuzz = (PROJECT / "docs" / "fuzz.md").read_text(encoding="utf-8")
    for row in re.findall(r"^\| \w+ \|.*\| ([\d,]+) \| \d+ \| \d+ \| \d+ \| (\d+) \|$", fuzz, re.MULTILINE):
        found.fuzz.append((int(row[0].replace(",", "")), int(row[1])))
    chaos = (PROJECT / "docs" / "chaos.md").read_text(encoding="utf-8")
    found.chaos, found.chaos_head = run_of(chaos, "Last run")
    found.hour, _ = run_of(chaos, "One hour")
    if not found.fuzz or not found.chaos:
        raise ValueError("docs/fuzz.md or docs/chaos.md has no recorded run; run make fuzz and make chaos with --write")


def run_of(document: str, title: str) -> tuple[dict[str, str], str]:
    """Figures of the run in a section of docs/chaos.md, by check, and its first line; both empty without one."""
    section = document.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| ([\w ]+) \| (holds|\*\*fails\*\*) \| (.*) \|$", section, re.MULTILINE)
    figures = {name: ("" if holds == "holds" else FAILS) + text for name, holds, text in rows}
    return figures, next((line for line in section.splitlines() if line.startswith("`")), "")


def row_of(promise: Promise, found: Results) -> str:
    """One row of the table."""
    shown = [f"`tests/{test}`" for test in promise.tests] + ([promise.by] if promise.by else [])
    figures = [promise.figure(found)] if promise.figure else []
    passed, skipped = (sum(counts[test] for test in promise.tests) for counts in (found.passed, found.skipped))
    if promise.tests:
        count = "1 test passes" if passed == 1 else f"{passed} tests pass"
        figures.append(count + (f", {skipped} skipped" if skipped else ""))
    figures += [text for test in promise.tests for text in found.properties.get(test, [])]
    return f"| {promise.text} | {', '.join(shown)} | {'; '.join(figures)} |"


def text_of(found: Results) -> str:
    """The tables."""
    parts = [
        f"Tests: {time.strftime('%Y-%m-%d')}, {machine()}. Chaos, [last run](chaos.md#last-run): {found.chaos_head}"
    ]
    for title, rows in SECTIONS.items():
        parts += ["", f"## {title}", "", "| promise | shown by | last figure |", "| --- | --- | --- |"]
        parts += [row_of(promise, found) for promise in rows]
    return "\n".join(parts)


def main() -> None:
    """Run the tests, measure, and replace the tables; ends with pytest's exit code."""
    found = Results()
    read_runs(found)
    found.idle = idle.measure(5_000)
    code = run_tests(found)
    before, _, rest = FILE.read_text(encoding="utf-8").partition(START)
    _, mark, after = rest.partition(END)
    if code == 0 and mark:
        FILE.write_text(f"{before}{START}\n{text_of(found)}\n{END}{after}", encoding="utf-8")
        print(f"{FILE.relative_to(PROJECT)} is written")
    sys.exit(code if mark else f"{FILE} has no marks {START} and {END}")


if __name__ == "__main__":
    main()
