"""One more example for the source of a verb, with keytimes aligned from the others where none are given."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.upload.drafting.changes import checked_keytimes
from service.upload.drafting.document import Json
from service.upload.drafting.errors import InvalidDraft
from verbs.authoring.fit import Built, build
from verbs.authoring.mending import mended
from verbs.authoring.reading import read_motions
from verbs.authoring.source import Source, parse
from verbs.authoring.toml_text import toml_dump
from verbs.io import motion_files
from verbs.io.motion_files import ENDINGS
from verbs.proposal.clips import clip_of
from verbs.proposal.features import distances, features_of
from verbs.proposal.keytimes import Keytimes, from_annotated

__all__ = ["add_example"]

MOST_ANNOTATED = 8
"""Number of the nearest examples from which keytimes are aligned."""


def add_example(root: Path, upload: Path, request: Mapping[str, Any]) -> tuple[Built, Json]:
    """Add a clip to the source in a folder, and build it.

    Parameters
    ----------
    root : Path
        Folder of the source; the clip and its row are added.
    upload : Path
        The clip.
    request : mapping
        ``file``, the name of the clip; ``keytimes`` in seconds, or None; ``styles``, values by name.

    Returns
    -------
    built : Built
    example : dict
        Name, keytimes, confidence, adverbs of the new example.

    Raises
    ------
    InvalidDraft
        A name, keytimes or style values are invalid.
    VerbError
        The clip cannot be read, or the examples make no verb.
    """
    table = tomllib.loads((root / "verb.toml").read_text("utf-8-sig"))
    source = parse(root / "verb.toml", table)
    file = _checked_file(str(request["file"]), source)
    shutil.copyfile(upload, root / file)
    motion = motion_files.read(
        root / file, unit=source.length_unit, root=source.root, stretch_m=source.stretch_m
    ).motion
    styles = _checked_styles(request["styles"], source)
    values = [styles.get(adverb.name, 0.0) for adverb in source.adverbs]
    times = request["keytimes"] or np.linspace(0.0, motion.duration_s, len(source.keytime_names)).tolist()
    problem = checked_keytimes(times, list(source.keytime_names), 0.0, motion.duration_s, looping=source.looping)
    if problem:
        raise InvalidDraft([{"at": "keytimes", "problem": problem}])
    keytimes = tuple(min(float(time), motion.duration_s) for time in times)
    row: Json = {"file": file, "keytimes": list(keytimes), "adverb_values": values}
    table["example"] = [*table["example"], row]
    table.pop("simplices", None)
    table.pop("tetrahedra", None)
    count = len(times)
    marks = Keytimes(keytimes, (1.0,) * count, ("given",) * count)
    if not request["keytimes"]:
        marks = _aligned(parse(root / "verb.toml", table))
        row["keytimes"] = list(marks.times)
    _write(root, table)
    made = build(root)
    names = [adverb.name for adverb in made.verb.adverbs]
    row["adverb_values"] = made.verb.values[-1].tolist()
    _write(root, table)
    return made, {
        "name": Path(file).stem,
        "keytimes": row["keytimes"],
        "confidence": list(marks.confidence),
        "adverbs": dict(zip(names, row["adverb_values"], strict=True)),
    }


def _aligned(source: Source) -> Keytimes:
    """Keytimes of the last example, from those of the examples that are nearest to it."""
    motions, _, _, tolerance_m = read_motions(source, lambda stage, done, total: None)
    fixed = mended(source, motions, tolerance_m=tolerance_m)
    clips = [clip_of(row.file, motion) for row, motion in zip(fixed.source.examples, fixed.motions, strict=True)]
    features = features_of(clips)
    last = len(clips) - 1
    near = np.argsort(distances(features)[last][:last], kind="stable")[:MOST_ANNOTATED]
    chosen = sorted(int(k) for k in near)
    skeleton = fixed.motions[0].skeleton
    found = from_annotated(
        [*(clips[k] for k in chosen), clips[last]],
        [*(features[k] for k in chosen), features[last]],
        {k: fixed.source.examples[own].keytimes for k, own in enumerate(chosen)},
        effector=skeleton.index(source.effector) if source.effector else 0,
        cyclic=source.looping,
    )
    return found[-1]


def _checked_file(name: str, source: Source) -> str:
    path = Path(name)
    problem = ""
    if path.name != name or name.startswith(".") or not name.isprintable() or len(name) > 120:
        problem = "must be the name of a file, without a folder"
    elif path.suffix.lower() not in ENDINGS:
        problem = f"must end in {', '.join(ENDINGS)}"
    elif path.stem in {example.name for example in source.examples} or (source.path.parent / name).exists():
        problem = f"the verb has an example '{path.stem}' already; give the clip another name"
    if problem:
        raise InvalidDraft([{"at": "file", "problem": problem}])
    return name


def _checked_styles(given: Mapping[str, float], source: Source) -> dict[str, float]:
    styles = [adverb.name for adverb in source.adverbs if adverb.style]
    missing = [name for name in styles if name not in given]
    other = [name for name in given if name not in styles]
    if missing:
        raise InvalidDraft(
            [{"at": "style", "problem": f"style adverb '{missing[0]}' is missing; give style=NAME:VALUE"}]
        )
    if other:
        known = ", ".join(styles) or "the verb has none"
        raise InvalidDraft([{"at": "style", "problem": f"'{other[0][:60]}' is no style adverb; known: {known}"}])
    return dict(given)


def _write(root: Path, table: Mapping[str, Any]) -> None:
    (root / "verb.toml").write_text(toml_dump(table), "utf-8")
