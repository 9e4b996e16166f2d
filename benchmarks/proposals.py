"""Proposals for captured sets whose verb.toml is hidden, against the annotated sources.

    python -m benchmarks.proposals [--annotated 3] [SET …]

For each set: measure and effector guessed; difference of the inner keytimes from the annotated ones, without any
annotation and with one annotated clip (each in turn); leave-one-out joint error of the annotated verb, of the
proposal without annotation, and of proposals with one annotated clip (the first ``--annotated`` of a shuffle).
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

from verbs.authoring.fit import assemble
from verbs.authoring.source import read
from verbs.io import bvh
from verbs.proposal.clips import read_folder
from verbs.proposal.features import features_of
from verbs.proposal.keytimes import from_annotated
from verbs.proposal.propose import propose
from verbs.proposal.result import Options
from verbs.quality.leave_one_out import left_out_errors

DATA = Path(os.environ.get("ADVERB_TEST_DATA", "../shared/data")) / "mocap"
SETS = ("reach", "reach_left", "punch", "kick", "jump", "locomotion")


def hidden(name: str, folder: Path) -> dict[str, tuple[float, ...]]:
    """Copy the clips of a set without its verb.toml; its annotated keytimes by file."""
    table = tomllib.loads((DATA / name / "verb.toml").read_text())
    for row in table["example"]:
        shutil.copy(DATA / name / row["file"], folder / row["file"])
    return {row["file"]: tuple(row["keytimes"]) for row in table["example"]}


def annotated_error(name: str) -> float:
    """Leave-one-out joint error of the annotated source, degrees."""
    source = read(DATA / name)
    verb = assemble(source, [bvh.read(example.file) for example in source.examples]).verb
    return float(np.degrees(left_out_errors(verb, ("corrected",))[0].mean()))


def gaps(names: tuple[str, ...], found: tuple[float, ...], marks: tuple[float, ...]) -> list[float]:
    """Differences of inner keytimes, seconds; the apex of a jump has no annotation."""
    own = [time for name, time in zip(names, found, strict=True) if len(found) == len(marks) or name != "apex"]
    return [abs(a - b) for a, b in zip(own[1:-1], marks[1:-1], strict=True)]


def spread(seconds: list[float]) -> str:
    """Median and 90th percentile in milliseconds."""
    return f"median {1000 * np.median(seconds):.0f} ms, p90 {1000 * np.percentile(seconds, 90):.0f}"


def one(name: str, draws: int) -> None:
    """Print the figures of one set."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / name
        folder.mkdir()
        marks = hidden(name, folder)
        started = time.perf_counter()
        plain = propose(folder)
        seconds = time.perf_counter() - started
        head = plain.head
        alone = [gap for row in plain.rows
                 for gap in gaps(head.keytime_names, row.keytimes.times, marks[row.file])]  # fmt: skip
        print(f"{name}: {head.measure} {head.effector}; {sum(not row.excluded for row in plain.rows)} of {len(marks)} "
              f"clips kept; {seconds:.1f} s")  # fmt: skip
        print(f"  keytimes, none annotated: {spread(alone)}")
        clips, _ = read_folder(folder, unit="m", report=lambda stage, done, total: None)
        effector = clips[0].motion.skeleton.index(head.effector) if head.effector else 0
        features, medians, every = features_of(clips), [], []
        for k, clip in enumerate(clips):
            found = from_annotated(clips, features, {k: marks[clip.name]}, effector=effector, cyclic=head.looping)
            own = [abs(a - b) for i, other in enumerate(clips) if i != k
                   for a, b in zip(found[i].times[1:-1], marks[other.name][1:-1], strict=True)]  # fmt: skip
            medians.append(float(np.median(own)))
            every += own
        print(f"  keytimes, one annotated: {spread(every)}; by annotated clip ", end="")
        low, high, middle = (1000 * figure for figure in (min(medians), max(medians), np.median(medians)))
        print(f"{low:.0f} to {high:.0f} (median {middle:.0f})")
        base, own = annotated_error(name), float(np.mean(list(plain.left_out_deg.values())))
        print(f"  leave-one-out: annotated {base:.2f}°, proposal {own:.2f}° ({100 * (own / base - 1):+.1f} %)")
        shares = []
        for k in np.random.default_rng(3).permutation(len(clips))[:draws]:
            file = clips[k].name
            made = propose(folder, Options(annotated={file: marks[file]}))
            shares.append(100 * (float(np.mean(list(made.left_out_deg.values()))) / base - 1))
        if shares:
            print(f"  leave-one-out with one annotated: {', '.join(f'{share:+.1f} %' for share in shares)}")


def main() -> None:
    """Print the figures of the sets that are named, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", default=list(SETS))
    parser.add_argument("--annotated", type=int, default=3)
    arguments = parser.parse_args()
    for name in arguments.sets:
        one(name, arguments.annotated)


if __name__ == "__main__":
    main()
