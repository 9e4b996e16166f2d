"""Read the motions of a source's examples, and state what reading changed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

from verbs.authoring.source import Source, SourceExample
from verbs.clips import orientation
from verbs.errors import MotionFileError, SourceError
from verbs.io import motion_files
from verbs.io.motion_files import CHANGES, MotionFile
from verbs.motion import Motion

__all__ = ["Progress", "read_motions"]

ROUNDING_M = 1e-4
"""Offsets differ by this between files that round."""

UP_CONFIDENCE = 0.6
"""Confidence from which on all motions must show the same axis up for it to be reported."""

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, the steps done and the steps there are."""


def read_motions(
    source: Source, report: Progress, *, inspect: bool = True
) -> tuple[list[Motion], list[str], list[str], float]:
    """Read the motions of all examples.

    Parameters
    ----------
    source : Source
    report : callable
        Called with the name of a stage, the steps done and the steps there are.
    inspect : bool
        Whether to look for another axis up.

    Returns
    -------
    motions : list of Motion, length N
    digests : list of str, length N
        SHA-256 of the files.
    warnings : list of str
        What reading changed.
    tolerance_m : float
        Offsets of joints may differ by this between the motions: files round, and stretching joints have mean offsets.

    Raises
    ------
    SourceError
        A file is missing or invalid; names the example.
    """
    files: list[MotionFile] = []
    for k, example in enumerate(source.examples):
        report("reading motions", k, len(source.examples))
        if not example.file.is_file():
            raise SourceError(source.path, f"its file '{example.file.name}' does not exist", example=example.name)
        files.append(_read_motion(source, example, source.root))
    roots = [file.motion.skeleton.names[0] for file in files if file.report.folded]
    for k, (example, file) in enumerate(zip(source.examples, files, strict=True)):
        if roots and roots[0] in file.motion.skeleton.names[1:]:  # hips that happen to stay in this clip
            files[k] = _read_motion(source, example, roots[0])
    motions = [file.motion for file in files]
    digests = [hashlib.sha256(example.file.read_bytes()).hexdigest() for example in source.examples]
    report("reading motions", len(source.examples), len(source.examples))
    stretches = any(file.report.of("stretch") for file in files)
    tolerance_m = max(source.stretch_m, ROUNDING_M) if stretches else ROUNDING_M
    return motions, digests, [*(_axes(files) if inspect else []), *_notes(source, files)], tolerance_m


def _read_motion(source: Source, example: SourceExample, root: str | None) -> MotionFile:
    """The file of an example, its motion with +Y up and +Z forward."""
    try:
        clip, stretch_m = example.clip or None, source.stretch_m
        file = motion_files.read(example.file, unit=source.length_unit, root=root, stretch_m=stretch_m, clip=clip)
    except MotionFileError as err:
        raise SourceError(source.path, f"its motion cannot be read: {err}", example=example.name) from err
    if source.axes == ("+Y", "+Z"):
        return file
    up, forward = source.axes
    return replace(file, motion=orientation.convert(file.motion, up=up, forward=forward))


def _notes(source: Source, files: list[MotionFile]) -> list[str]:
    """What reading changed, each sentence once with the examples that it is about."""
    about: dict[str, list[str]] = {}
    stretches: list[tuple[float, str, str]] = []
    for example, file in zip(source.examples, files, strict=True):
        stretches += [(note.amount, note.subject, example.name) for note in file.report.of("stretch")]
        for note in file.report.notes:
            if note.kind in CHANGES and note.kind != "stretch":
                about.setdefault(note.text, []).append(example.name)
    others = [f" and {len(names) - 1} others" * (len(names) > 1) for names in about.values()]
    lines = [f"example '{names[0]}'{more}: {text}" for (text, names), more in zip(about.items(), others, strict=True)]
    if stretches:
        most, joint, name = max(stretches)
        count = len({joint for _, joint, _ in stretches})
        verb = "joint stretches" if count == 1 else "joints stretch"
        where = f"'{joint}' in example '{name}'"
        lines.append(f"{count} {verb} by up to {1000.0 * most:.2f} mm ({where}); mean offsets are kept")
    return lines


def _axes(files: list[MotionFile]) -> list[str]:
    """Advice where all motions seem to have another axis up."""
    found = [orientation.find(file.motion) for file in files]
    ups = {orientation.axis_name(one.up) for one in found}
    if "+Y" not in ups and len(ups) == 1 and min(one.confidence for one in found) >= UP_CONFIDENCE:
        up = f"the motions seem to have another axis up: {found[0].text} ({found[0].evidence[0]}); set up_axis and "
        return [f"{up}forward_axis"]
    return []
