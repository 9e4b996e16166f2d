"""Apply the mends and the retargeting of a source to its motions, before its keytimes are checked.

Keytimes and intervals of contacts are seconds of the files; where a clip is trimmed they are shifted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from verbs.authoring.source import Source, SourceExample
from verbs.authoring.source_contacts import SourceContact, Spans
from verbs.authoring.source_mends import SourceMend
from verbs.clips import mends, retarget
from verbs.clips.reports import Report, toml_text
from verbs.errors import SkeletonMismatch, SourceError, UnknownName, VerbError
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["MendedSource", "mended"]

FAULTS = ("spike", "spin", "cut")
"""Kinds that are looked for at every build; a warning shows the table that mends each."""

MOST_WARNINGS = 20


@dataclass(frozen=True, slots=True, eq=False)
class MendedSource:
    """A source whose motions are mended.

    Parameters
    ----------
    source : Source
        Keytimes and contacts in seconds of the mended motions.
    motions : list of Motion
        All with one skeleton.
    rows : list of dict
        What was done, for the provenance of the verb: example, kind, found, done, figure, unit.
    warnings : tuple of str
        Faults that are left.
    """

    source: Source
    motions: list[Motion]
    rows: list[dict[str, Any]]
    warnings: tuple[str, ...]


def mended(
    source: Source, motions: Sequence[Motion], *, tolerance_m: float = 1e-4, inspect: bool = True
) -> MendedSource:
    """Mend the motions of a source, retarget them, and check that they share one skeleton.

    Parameters
    ----------
    source : Source
    motions : sequence of Motion, length N
    tolerance_m : float
        Offsets of joints may differ by this, metres.
    inspect : bool
        Whether to search the motions for other faults.

    Raises
    ------
    SourceError
        A mend that cannot be applied to its clip, or a keytime in a part that is trimmed.
    SkeletonMismatch
        Two motions have different skeletons; the message has the ``[retarget]`` table where that helps.
    """
    done: list[Motion] = []
    rows: list[dict[str, Any]] = []
    warnings: list[str] = []
    examples, contacts = list(source.examples), source.contacts
    for k, (example, motion) in enumerate(zip(source.examples, motions, strict=True)):
        own = [one for one in source.mends if example.name in one.examples]
        fixed, faults = _mended(source.path, example.name, motion, own, FAULTS if inspect else ())
        rows += [{"example": example.name, **report.row()} for report in fixed.reports]
        warnings += [_warning(example.name, report) for report in faults]
        done.append(fixed.motion)
        if fixed.start_s > 0.0 or fixed.end_s < motion.duration_s:
            examples[k] = _shifted(source, example, fixed)
            contacts = tuple(_shifted_contact(contact, example.name, fixed) for contact in contacts)
    retargeted, more = _retargeted(source, done)
    _check_skeletons(source, retargeted, tolerance_m)
    source = replace(source, examples=tuple(examples), contacts=contacts)
    left = len(warnings) - MOST_WARNINGS
    warnings = warnings[:MOST_WARNINGS] + [f"{left} more faults"] * (left > 0)
    return MendedSource(source, retargeted, rows + more, tuple(warnings))


def _mended(
    path: Path, name: str, motion: Motion, own: Sequence[SourceMend], kinds: Sequence[str]
) -> tuple[mends.Mended, list[Report]]:
    """A mended clip, and its other faults of these kinds but those that a table with ``apply = false`` leaves."""
    wanted = [one.mend for one in own if one.applies]
    trimmed = any(mend.kind in mends.TRIMS for mend in wanted)
    accepted = {(one.mend.kind, one.mend.joint) for one in own if not one.applies}
    try:
        first = mends.apply(motion, [mend for mend in wanted if mends.KINDS[mend.kind].has_joint])
        faults = [
            report
            for report in mends.find(first.motion, kinds)
            if not {(report.mend.kind, report.mend.joint), (report.mend.kind, None)} & accepted
            and not (trimmed and report.mend.kind in mends.TRIMS)
        ]
        rest = mends.apply(first.motion, [mend for mend in wanted if not mends.KINDS[mend.kind].has_joint])
    except VerbError as err:
        raise SourceError(path, f"[[mend]]: {err}", example=name) from err
    return replace(rest, reports=(*first.reports, *rest.reports)), faults


def _warning(name: str, report: Report) -> str:
    return f"example '{name}': {report.found}; mend it in verb.toml with\n{toml_text(report.mend, name)}"


def _shifted(source: Source, example: SourceExample, fixed: mends.Mended) -> SourceExample:
    """An example with its keytimes in seconds of the trimmed clip; the first and the last stay inside it."""
    end = fixed.motion.duration_s
    marks = np.array(example.keytimes) - fixed.start_s
    for name, mark, given in zip(source.keytime_names[1:-1], marks[1:-1], example.keytimes[1:-1], strict=True):
        if not 0.0 < mark < end:
            raise SourceError(
                source.path,
                f"keytime '{name}' ({given} s) lies in a part that a [[mend]] trims; "
                f"{fixed.start_s:.3f} to {fixed.end_s:.3f} s are left",
                example=example.name,
            )
    marks[0], marks[-1] = max(marks[0], 0.0), min(marks[-1], end)
    return replace(example, keytimes=tuple(float(mark) for mark in marks))


def _shifted_contact(contact: SourceContact, name: str, fixed: mends.Mended) -> SourceContact:
    """A contact with the intervals of one example in seconds of the trimmed clip."""
    if name not in contact.intervals:
        return contact
    end = fixed.motion.duration_s
    moved = ((max(a - fixed.start_s, 0.0), min(b - fixed.start_s, end)) for a, b in contact.intervals[name])
    spans: Spans = tuple((a, b) for a, b in moved if a < b)
    return replace(contact, intervals={**contact.intervals, name: spans})


def _retargeted(source: Source, motions: list[Motion]) -> tuple[list[Motion], list[dict[str, Any]]]:
    """Motions on the skeleton that ``[retarget]`` names, and rows for the provenance."""
    if source.retarget is None:
        return motions, []
    names = [example.name for example in source.examples]
    wanted = motions[names.index(source.retarget.skeleton)].skeleton
    out, rows = [], []
    for name, motion in zip(names, motions, strict=True):
        bones = [] if _other_joints(wanted, motion.skeleton) else retarget.bone_reports(motion.skeleton, wanted)
        if not bones or name not in source.retarget.examples:
            out.append(motion)
            continue
        effector = _effector(source, wanted) if source.retarget.effector else None
        done = retarget.retarget(motion, wanted, effector=effector, plant=source.retarget.feet)
        lengths = {str(bone.mend.joint): round(bone.figure, 3) for bone in bones}
        rows.append({"example": name, **done.report(source.retarget.skeleton, bones).row(), "bones_mm": lengths})
        out.append(done.motion)
    return out, rows


def _effector(source: Source, skeleton: Skeleton) -> int | None:
    try:
        return skeleton.index(source.effector) if source.effector else None
    except UnknownName as err:
        raise SourceError(source.path, f"effector: {err}") from err


def _other_joints(wanted: Skeleton, skeleton: Skeleton) -> bool:
    return wanted.names != skeleton.names or not np.array_equal(wanted.parents, skeleton.parents)


def _check_skeletons(source: Source, motions: list[Motion], tolerance_m: float) -> None:
    first = motions[0].skeleton
    for example, motion in zip(source.examples[1:], motions[1:], strict=True):
        gap = first.difference(motion.skeleton, tolerance_m=tolerance_m)
        if gap:
            own = source.examples[0].name
            advice = (
                "rename its joints, or leave it out"
                if _other_joints(first, motion.skeleton)
                else f'adapt its bones in verb.toml with\n[retarget]\nskeleton = "{own}"\nor leave it out'
            )
            raise SkeletonMismatch(
                f"{source.path}, example '{example.name}': its skeleton differs from that of '{own}': it {gap}; "
                f"{advice}"
            )
