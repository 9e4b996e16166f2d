"""Fuzz targets and record the runs: ``python -m tests.fuzz [TARGET…] [options]``.

A run starts from the kept corpus and generated seeds. ``--keep`` adds inputs with new coverage to the kept corpus.
``--write`` replaces the rows of these targets in the table of a document.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz import bounds
from tests.fuzz.targets import TARGETS, Target

CORPUS = Path(__file__).parent / "corpus"
KEPT_BYTES = 96 * 1024
"""Most bytes of the kept corpus of one target."""

KEPT_FILES = 150


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run: inputs, seconds, edges of the code covered, peak memory (MiB), places that broke the contract."""

    inputs: int
    seconds: float
    coverage: int
    memory: int
    failures: list[Path]

    def row(self, name: str, target: Target) -> str:
        """The row of the table."""
        date = datetime.datetime.now(datetime.UTC).date()
        found = f"{date} | {self.inputs:,} | {self.seconds:.0f} | {self.coverage:,} | {self.memory} | "
        return f"| {name} | {target.parser} | {found}{len(self.failures)} |"


def main() -> int:
    """Run what the command line names; 1 if anything broke a contract."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="Coverage-guided fuzzing of parsers.")
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="most inputs of each target")
    parser.add_argument("--seconds", type=int, default=120, help="most seconds of each target; 0: no limit")
    parser.add_argument("--keep", action="store_true", help="add what was found to the kept corpus")
    parser.add_argument("--write", type=Path, metavar="FILE", help="document whose table gets the rows")
    options = parser.parse_args()
    unknown = sorted(set(options.targets) - set(TARGETS))
    if unknown:
        parser.error(f"unknown targets {', '.join(unknown)}; known: {', '.join(TARGETS)}")
    failed = 0
    for name in options.targets or TARGETS:
        with tempfile.TemporaryDirectory(prefix="fuzz") as work:
            run = fuzz(name, Path(work), options.inputs, options.seconds)
            row = run.row(name, TARGETS[name])
            print(row, flush=True)
            failed += len(run.failures)
            if options.write:
                options.write.write_text(replaced(options.write.read_text("utf-8"), name, row), "utf-8")
            if options.keep:
                keep(name, Path(work, "corpus"))
    return int(failed > 0)


def fuzz(name: str, work: Path, inputs: int, seconds: int) -> Run:
    """Run one target; its corpus is ``work / "corpus"``, and failures are copied below the build folder."""
    target, corpus, failures = TARGETS[name], work / "corpus", Path("build", "fuzz", name)
    corpus.mkdir()
    shutil.rmtree(failures, ignore_errors=True)
    failures.mkdir(parents=True)
    for number, data in enumerate(target.first()):
        (corpus / f"seed{number}").write_bytes(data)
    kept = [str(CORPUS / name)] if (CORPUS / name).is_dir() else []
    limits = [
        f"-runs={inputs}",
        f"-max_total_time={seconds}",
        f"-max_len={target.longest}",
        "-rss_limit_mb=4096",
        "-timeout=60",
    ]
    limits.append(f"-artifact_prefix={failures}/")
    started_s = time.monotonic()
    log = _libfuzzer(name, failures, *limits, "-print_final_stats=1", str(corpus), *kept)
    seconds_used = time.monotonic() - started_s
    numbers = dict(re.findall(r"stat::(\w+):\s+(\d+)", log))
    coverage = re.findall(r"\bcov: (\d+)", log)
    if "number_of_executed_units" not in numbers:
        (failures / "died").write_text(log[-20_000:])
        executed = re.findall(r"^#(\d+)", log, re.MULTILINE)
        numbers = {"number_of_executed_units": executed[-1] if executed else "0", "peak_rss_mb": "0"}
    return Run(
        int(numbers["number_of_executed_units"]),
        seconds_used,
        int(coverage[-1]) if coverage else 0,
        int(numbers["peak_rss_mb"]),
        sorted(path for path in failures.iterdir() if path.suffix != ".txt"),
    )


def keep(name: str, found: Path) -> None:
    """Keep inputs of every length, of the kept corpus and of a run, whose folder holds those with new coverage."""
    kept = CORPUS / name
    kept.mkdir(parents=True, exist_ok=True)
    inputs = {path.read_bytes() for folder in (kept, found) for path in folder.iterdir()}
    shutil.rmtree(kept)
    kept.mkdir()
    total, ordered = 0, sorted(inputs, key=lambda data: (len(data), data))
    for data in ordered[:: max(1, -(-len(ordered) // KEPT_FILES))]:
        total += len(data)
        if total > KEPT_BYTES:
            break
        (kept / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)


def replaced(text: str, name: str, row: str) -> str:
    """A document with the row of a target in its table."""
    lines = text.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("| --- |"))
    end = next((k for k in range(at + 1, len(lines)) if not lines[k].startswith("|")), len(lines))
    rows = {line.split("|")[1].strip(): line for line in lines[at + 1 : end]} | {name: row}
    ordered = [rows[known] for known in TARGETS if known in rows]
    return "\n".join([*lines[: at + 1], *ordered, *lines[end:]]) + "\n"


def _libfuzzer(name: str, failures: Path, *options: str) -> str:
    """Run the child; returns what libFuzzer reported. Its output also shows what it does meanwhile."""
    command = [sys.executable, "-m", "tests.fuzz.runner", name, str(failures), *options]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, errors="replace", check=False, env=os.environ)
    if done.returncode:
        print(done.stderr[-4_000:], file=sys.stderr, flush=True)
    return done.stderr


if __name__ == "__main__":
    print(f"bounds of one input: {bounds.CPU_S:g} s of processor time, {bounds.MEMORY_BYTES >> 20} MiB", flush=True)
    sys.exit(main())
