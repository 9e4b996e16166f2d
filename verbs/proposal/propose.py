"""From a folder of clips to a proposed ``verb.toml``: read, screened, keytimes, adverbs, outliers, text."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from verbs.authoring.fit import Assembled, assemble
from verbs.authoring.source import parse
from verbs.conventions import F64, METRES_PER_UNIT
from verbs.domain import describe
from verbs.errors import IllPosedVerb, SourceError, VerbError
from verbs.io import bvh
from verbs.proposal import repairs, screening, styles, unannotated
from verbs.proposal.clips import Clip, Refused, read_folder, scaled, turned, turned_back
from verbs.proposal.cycles import Cut, one_each
from verbs.proposal.features import Features, features_of
from verbs.proposal.keytimes import Keytimes, from_annotated
from verbs.proposal.measures import ADVERBS, Guess, guess, measured, strangers
from verbs.proposal.result import Options, Proposal
from verbs.proposal.toml_writer import Head, Row, toml_text
from verbs.quality.leave_one_out import left_out_errors

__all__ = ["propose", "write"]

CONSTANT = 0.005
"""A coordinate of a position that varies less than this, metres, is no adverb."""

SAME_ADVERBS = 1e-6

BADLY = 2.5
"""A clip is predicted badly if its joint error from the others is this many times the median."""

SAMPLES = 240
"""Samples of curves while a proposal is judged; keytimes, where adverbs are measured, are among them."""

PARDON = 1.5
"""A clip whose motion seems not to belong is kept if its joint error from the others is at most this many times the
median."""

Progress = Callable[[str, int, int], None]


def propose(folder: str | Path, options: Options | None = None, *, progress: Progress | None = None) -> Proposal:
    """Propose a ``verb.toml`` for the clips of a folder; nothing is written.

    Raises
    ------
    SourceError
        No clip can be used, or an option names a file, joint or measure that does not exist.
    UnknownName
        The effector is no joint of the clips.
    """
    options, report, folder = options or Options(), progress or (lambda stage, done, total: None), Path(folder)
    clips, refused = read_folder(folder, unit=options.unit or "m", report=report)
    evidence: dict[str, str] = {}
    up, forward, evidence["axes"] = screening.axes(clips) if clips else ("+Y", "+Z", "")
    if (up, forward) != ("+Y", "+Z"):
        clips = [turned(clip, up, forward) for clip in clips]
    clips, odd = screening.screen(clips)
    refused += odd
    if not clips:
        raise SourceError(folder, f"no clip can be used; the first: {refused[0].name} {refused[0].problem}")
    unit = options.unit or "m"
    if not options.unit:
        unit, evidence["unit"] = screening.guess_unit(clips)
        clips = [scaled(clip, METRES_PER_UNIT[unit]) for clip in clips]
    clips = repairs.turned_round([repairs.repaired(clip) for clip in clips])
    found = guess(clips, measure=options.measure, effector=options.effector)
    cuts: dict[str, Cut] = {}
    count = 0
    if found.measure == "root_velocity":
        clips, odd, cuts, count = one_each(clips)
        refused += odd
        if not clips:
            raise SourceError(folder, f"no clip is a cycle; the first: {odd[0].name} {odd[0].problem}")
    report("aligning", 0, 2)
    features = features_of(clips)
    apart = {odd.name: odd.problem for odd in screening.outliers(clips, features)} | strangers(clips, found)
    report("aligning", 1, 2)
    keytimes, names = _keytimes(folder, clips, features, options, found, count)
    report("aligning", 2, 2)
    marker = _effector_keytime(clips, keytimes, names, found, options)
    evidence |= {"measure": found.evidence, "effector": found.evidence, "keytimes": _words(options, keytimes)}
    values, adverbs = _adverbs(folder, clips, keytimes, found, marker, options)
    rows = _rows(clips, keytimes, values, apart, cuts)
    effector = clips[0].motion.skeleton.names[found.effector] if found.measure == "joint_position" else ""
    kept = sum(not row.excluded for row in rows)
    head = Head(
        options.name or _name(folder), f"Proposed from {kept} clips.", found.measure == "root_velocity", found.measure,
        effector, marker, names, unit, adverbs, evidence, up, forward,
    )  # fmt: skip
    return _judged(folder, head, rows, clips, refused, cuts, report)


def write(proposal: Proposal, folder: str | Path, *, force: bool = False) -> Path:
    """Write ``verb.toml`` and the cycles that were cut; clips are never changed.

    Raises
    ------
    SourceError
        If there is a verb.toml already, and ``force`` is not given.
    """
    path = Path(folder) / "verb.toml"
    if path.exists() and not force:
        raise SourceError(path, "exists already; add --force to replace it")
    for name, cut in proposal.cuts.items():
        head = proposal.head
        clip = scaled(turned_back(cut.clip, head.up, head.forward), 1.0 / METRES_PER_UNIT[head.unit])
        bvh.write(clip.motion, Path(folder) / name)
    path.write_text(proposal.text, "utf-8")
    return path


def _name(folder: Path) -> str:
    """Name of a verb from that of its folder."""
    slug = re.sub(r"[^a-z0-9_-]+", "_", folder.resolve().name.lower()).strip("_-")[:60]
    return slug if slug[:1].isalpha() else f"verb_{slug}".rstrip("_")


def _words(options: Options, keytimes: list[Keytimes]) -> str:
    """What the keytimes rest on, in one sentence."""
    inner = [sure for own in keytimes for sure in own.confidence if sure < 1.0]
    sure = f"; confidence {np.median(inner):.2f} in the median" if inner else ""
    given = len(options.annotated)
    return (f"from {given} annotated clip{'s' * (given > 1)}" if given else "found without annotation") + sure


def _keytimes(
    folder: Path, clips: list[Clip], features: list[Features], options: Options, found: Guess, count: int
) -> tuple[list[Keytimes], tuple[str, ...]]:
    """Keytimes of all clips and their names."""
    if options.annotated:
        chosen = _annotated(folder, clips, options.annotated)
        cyclic = found.measure == "root_velocity"
        keytimes = from_annotated(clips, features, chosen, effector=found.effector, cyclic=cyclic)
        size = len(keytimes[0].times)
        if options.keytime_names and len(options.keytime_names) != size:
            raise SourceError(folder, f"{len(options.keytime_names)} keytime names for {size} annotated keytimes")
        return keytimes, options.keytime_names or _usual_names(size, found.measure)
    if found.measure == "root_velocity":
        return [unannotated.of_cycle(clip, count) for clip in clips], unannotated.stance_names(count)
    if found.measure == "jump":
        return [unannotated.of_jump(clip) for clip in clips], unannotated.JUMP_NAMES
    return [unannotated.of_position(clip, found.effector) for clip in clips], unannotated.POSITION_NAMES


def _annotated(folder: Path, clips: list[Clip], given: Mapping[str, tuple[float, ...]]) -> dict[int, tuple[float, ...]]:
    """Annotated keytimes by clip, checked."""
    index = {clip.name: k for k, clip in enumerate(clips)} | {clip.path.stem: k for k, clip in enumerate(clips)}
    chosen: dict[int, tuple[float, ...]] = {}
    for name, times in given.items():
        if name not in index:
            raise SourceError(folder, f"annotated file '{name}' is none of the clips that can be used")
        clip = clips[index[name]]
        if len(times) < 2 or any(b <= a for a, b in pairwise(times)):
            raise SourceError(folder, f"keytimes of '{name}' must be two or more, ascending")
        start, end = clip.start_s, clip.start_s + clip.duration_s
        past = 1e-3 if not any(mend.kind == "cut" for mend in clip.mends) else np.inf
        if times[0] < 0 or times[1] <= start or times[-2] >= end or times[-1] > end + past:
            raise SourceError(folder, f"keytimes of '{name}' must lie from {start:.5f} to {end:.5f} s")
        chosen[index[name]] = tuple(min(max(time - start, 0.0), clip.duration_s) for time in times)
    if len({len(times) for times in chosen.values()}) > 1:
        raise SourceError(folder, "annotated clips must have the same number of keytimes")
    return chosen


def _usual_names(size: int, measure: str) -> tuple[str, ...]:
    """Names for annotated keytimes."""
    if measure == "root_velocity" and size % 2:
        return unannotated.stance_names(size // 2)
    if measure == "jump" and size in (4, 5):
        return tuple(name for name in unannotated.JUMP_NAMES if size == 5 or name != "apex")
    return ("start", "apex", "end") if size == 3 else ("start", *(f"key {m}" for m in range(1, size - 1)), "end")


def _effector_keytime(
    clips: list[Clip], keytimes: list[Keytimes], names: tuple[str, ...], found: Guess, options: Options
) -> int:
    """Index of the keytime at which the effector is measured: where it is farthest from its start; -1 for others."""
    if found.measure != "joint_position":
        return -1
    away = np.zeros(len(names))
    for clip, own in zip(clips, keytimes, strict=True):
        path = clip.path_of(found.effector, np.array(own.times))
        away += np.linalg.norm(path - path[0], axis=1)
    return int(np.argmax(away))


def _adverbs(
    folder: Path, clips: list[Clip], keytimes: list[Keytimes], found: Guess, marker: int, options: Options
) -> tuple[F64, tuple[tuple[str, str, str, bool], ...]]:
    """Adverb values (N, D) in their units, and the adverbs: measured ones first, style adverbs after."""
    values = []
    for clip, own in zip(clips, keytimes, strict=True):
        times, at = own.times, marker
        if found.measure == "jump":
            times, at = (times[0], unannotated.of_jump(clip).times[2], times[-1]), 1
        values.append(measured(clip, found.measure, found.effector, times, at))
    table = np.array(values)
    joint = clips[0].motion.skeleton.names[found.effector]
    adverbs = []
    for k, (name, unit, words) in enumerate(ADVERBS[found.measure]):
        if found.measure == "joint_position":
            if np.ptp(table[:, k]) < CONSTANT:
                continue
            adverbs.append((k, (name, unit, f"{words} coordinate of {joint} at its keytime", False)))
        else:
            adverbs.append((k, (name, unit, words, False)))
    table = table[:, [k for k, _ in adverbs]]
    styled = styles.styles_of([clip.name for clip in clips], options.style_csv, options.pattern)
    names = sorted({name for own in styled.values() for name in own})
    rows = [[styled[clip.name][name] for name in names] for clip in clips] if names else np.zeros((len(clips), 0))
    every = tuple(adverb for _, adverb in adverbs) + tuple((name, "none", "style", True) for name in names)
    return np.concatenate([table, np.array(rows)], axis=1), every


def _rows(
    clips: list[Clip], keytimes: list[Keytimes], values: F64, apart: Mapping[str, str], cuts: Mapping[str, Cut]
) -> list[Row]:
    """One row per clip; a clip with the adverbs of an earlier one, or whose motion does not belong, is excluded."""
    rows: list[Row] = []
    for k, (clip, own) in enumerate(zip(clips, keytimes, strict=True)):
        remarks, reason = list(clip.notes), apart.get(clip.name, "")
        if clip.name in cuts:
            cut = cuts[clip.name]
            remarks.append(
                f"frames {cut.first} to {cut.last} of {clip.path.stem.removesuffix('_cycle')}.bvh; the seam of "
                f"{1000 * cut.seam.rms_m:.0f} mm RMS, {1000 * cut.seam.most_m:.0f} mm at most, is spread over the cycle"
            )
        twin = next((j for j in range(k) if not rows[j].excluded
                     and np.abs(values[j] - values[k]).max() < SAME_ADVERBS), None)  # fmt: skip
        if twin is not None and not reason:
            reason = f"has the same adverbs as {rows[twin].file}"
        rows.append(Row(clip.name, own, tuple(map(float, values[k])), tuple(remarks), reason, clip.mends, clip.start_s))
    return rows


def _judged(
    folder: Path,
    head: Head,
    rows: list[Row],
    clips: list[Clip],
    refused: list[Refused],
    cuts: Mapping[str, Cut],
    report: Progress,
) -> Proposal:
    """The proposal, with adverbs as the build measures them, its chart and domain, and leave-one-out errors."""
    report("judging", 0, 1)
    rows = _pardoned(folder, head, rows, clips)
    made, problem, left_out = _left_out(folder, head, rows, clips)
    if made is not None:
        kept = [k for k, row in enumerate(rows) if not row.excluded]
        for k, values in zip(kept, made.verb.values, strict=True):
            rows[k] = replace(rows[k], values=tuple(map(float, values)))
        head = replace(head, evidence={**head.evidence, "chart": made.chart_reason, "domain": describe(made.verb)})
    usual = float(np.median(list(left_out.values()))) if left_out else np.inf
    for k, row in enumerate(rows):
        error = left_out.get(row.file, 0.0)
        if error > BADLY * usual:
            words = f"check: the others predict it badly, {error:.1f}° per joint, {usual:.1f}° in the median"
            rows[k] = replace(row, remarks=(*row.remarks, words))
    report("judging", 1, 1)
    sentences = [f"{odd.name}: {odd.problem}; {odd.advice}" for odd in refused]
    if problem:
        sentences.append(f"This does not build yet: {problem}")
    text = toml_text(head, rows, sentences)
    return Proposal(text, head, tuple(rows), tuple(refused), cuts, made, problem, left_out)


def _left_out(
    folder: Path, head: Head, rows: list[Row], clips: list[Clip]
) -> tuple[Assembled | None, str, dict[str, float]]:
    """The verb of the rows that are not excluded, why there is none, and leave-one-out errors by file, degrees."""
    kept = [k for k, row in enumerate(rows) if not row.excluded]
    try:
        mended = [replace(row, start_s=0.0) for row in rows]
        source = parse(folder / "verb.toml", tomllib.loads(toml_text(head, mended, ())))
        source = source if head.looping else replace(source, samples=SAMPLES)
        made = assemble(source, [clips[k].motion for k in kept])
    except VerbError as err:
        return None, str(err).removeprefix(f"{folder / 'verb.toml'}").lstrip(",: "), {}
    method = "corrected" if "smooth" in made.verb.bases else "rbf"
    try:
        errors = np.degrees(left_out_errors(made.verb, (method,))[0][0])
    except IllPosedVerb:  # too few clips to leave one out
        return made, "", {}
    return made, "", {rows[k].file: float(error) for k, error in zip(kept, errors, strict=True)}


def _pardoned(folder: Path, head: Head, rows: list[Row], clips: list[Clip]) -> list[Row]:
    """Rows in which a clip that seems not to belong is kept after all, if the others predict it as well as others."""
    apart = [k for k, row in enumerate(rows) if row.excluded.startswith(screening.APART)]
    if not apart:
        return rows
    every = [replace(row, excluded="") if k in apart else row for k, row in enumerate(rows)]
    _, _, errors = _left_out(folder, head, every, clips)
    usual = [errors[row.file] for k, row in enumerate(rows) if row.file in errors and k not in apart]
    for k in apart:
        if rows[k].file in errors and errors[rows[k].file] <= PARDON * float(np.median(usual)):
            remark = f"check: {rows[k].excluded}; the others predict it well"
            rows[k] = replace(rows[k], excluded="", remarks=(*rows[k].remarks, remark))
    return rows
