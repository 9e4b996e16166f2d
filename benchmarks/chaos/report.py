"""The table of a run, for the terminal and for docs/chaos.md."""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from benchmarks.chaos.ledger import Ledger
from benchmarks.chaos.plan import Plan
from benchmarks.chaos.verdict import Check, recoveries
from benchmarks.timing import machine

__all__ = ["lines", "markdown", "save", "write"]

START, END = "<!-- run: start -->", "<!-- run: end -->"


def lines(checks: list[Check]) -> list[str]:
    """The table as text, with what is wrong below each row."""
    found = []
    for check in checks:
        found.append(f"{'FAILS' if check.wrong else 'holds':<6} {check.name:<18} {check.fact}")
        found += [f"       wrong: {problem}" for problem in check.wrong]
    return found


def faults(ledger: Ledger) -> list[tuple[str, int, int, float, float]]:
    """For each kind of fault: how often, streams that lost their connection, and the recovery, p50 and max, seconds."""
    kinds: dict[str, list[float]] = {}
    for happened, seconds in recoveries(ledger.faults, ledger.outages):
        kinds.setdefault(happened.fault.kind, []).extend(seconds)
    counts = Counter(row.fault.kind for row in ledger.faults)
    rows = []
    for kind, seconds in sorted(kinds.items()):
        ordered = sorted(seconds) or [0.0]
        rows.append((kind, counts[kind], len(seconds), ordered[len(ordered) // 2], ordered[-1]))
    return rows


def markdown(plan: Plan, ledger: Ledger, checks: list[Check], command: str) -> str:
    """The tables of a run with its command, machine and date."""
    table = [
        f"| {check.name} | {'**fails**' if check.wrong else 'holds'} | {check.fact.replace('|', '/')} |"
        for check in checks
    ]
    kinds = [
        f"| {kind} | {count} | {streams} | " + (f"{p50:.2f} s | {worst:.2f} s |" if streams else "– | – |")
        for kind, count, streams, p50, worst in faults(ledger)
    ]
    done = ", ".join(f"{name} {count}" for name, count in sorted(ledger.done.items()))
    return "\n".join(
        [
            f"`{command}`, {time.strftime('%Y-%m-%d')}, {machine()}. Seed {plan.seed}, {plan.seconds / 60:g} minutes, "
            f"{len(plan.streams)} streams with {sum(row.channels for row in plan.streams)} channels, "
            f"{len(ledger.faults)} faults.",
            "",
            "| check | | found |",
            "| --- | --- | --- |",
            *table,
            "",
            "| fault | times | streams that lost their connection | fault to next frame, p50 | max |",
            "| --- | ---: | ---: | ---: | ---: |",
            *kinds,
            "",
            f"Succeeded: {done}.",
        ]
    )


def write(path: Path, text: str) -> None:
    """Replace the tables in a document, between its two marks."""
    before, _, rest = path.read_text(encoding="utf-8").partition(START)
    _, found, after = rest.partition(END)
    if not found:
        raise ValueError(f"{path} has no marks {START} and {END}")
    path.write_text(f"{before}{START}\n{text}\n{END}{after}", encoding="utf-8")


def save(path: Path, plan: Plan, ledger: Ledger, checks: list[Check]) -> None:
    """Write everything that was recorded as JSON."""
    content = {
        "seed": plan.seed,
        "seconds": plan.seconds,
        "machine": machine(),
        "checks": [asdict(check) for check in checks],
        "faults": [asdict(row) for row in ledger.faults],
        "outages": [asdict(row) for row in ledger.outages],
        "stalls": [asdict(row) for row in ledger.stalls],
        "failed": [asdict(row) for row in ledger.answers],
        "wrong": ledger.wrong,
        "done": dict(ledger.done),
        "samples": [asdict(row) for row in ledger.samples],
        "jobs": ledger.jobs,
    }
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
