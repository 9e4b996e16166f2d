"""Tasks on drafts, done in a sandbox: files of a folder are read and written, a few facts are answered.

Each task finds ``request.json`` in its folder, ``upload`` where there is one, and where a draft exists ``draft.json``
and, as a path in the request, its ``archive``. It writes what has changed: ``draft.json``, ``verb.verb``,
``motion.bin``, ``archive.zip`` and ``source.zip``.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.upload.archive import extract, pack, unpack, unpack_clips
from service.upload.drafting import changes
from service.upload.drafting.document import (
    CYCLES,
    EXCLUDED,
    INCLUDED,
    Json,
    clip_named,
    from_proposal,
    from_source,
    head_of,
    refreshed,
    toml_of,
)
from service.upload.drafting.errors import NotBuilt
from service.upload.drafting.motions import inspect, write_motions
from verbs.authoring import source as sources
from verbs.authoring.fit import Built, build
from verbs.conventions import METRES_PER_UNIT
from verbs.errors import IllPosedVerb, SourceError, UnknownName, VerbError
from verbs.io import artifact
from verbs.proposal.measures import ADVERBS
from verbs.proposal.propose import propose, write
from verbs.proposal.result import Options, Proposal
from verbs.quality.leave_one_out import left_out_errors
from verbs.runtime import describe
from verbs.runtime.evaluate import Evaluator

__all__ = ["TASKS", "perform"]

STORED = "stored adverbs differ"
"""Beginning of a warning that has no meaning for values that a draft measures itself."""


def perform(task: str, folder: Path) -> Json:
    """Do a task in a folder; return its answer.

    Raises
    ------
    VerbError
        With text for the client; :class:`InvalidDraft` and :class:`NotBuilt` among others.
    """
    request = json.loads((folder / "request.json").read_text("utf-8"))
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        return TASKS[task](folder, Path(scratch), request)


def create(folder: Path, scratch: Path, request: Mapping[str, Any]) -> Json:
    """Make a draft of the clips in ``upload``."""
    clips = unpack_clips(folder / "upload", scratch)
    if (clips / "verb.toml").exists():
        source = sources.read(clips)
        document = from_source(source, tomllib.loads((clips / "verb.toml").read_text("utf-8-sig")), clips)
        if request.get("name"):
            document = refreshed(document, head_of(document) | {"name": request["name"]})
        (clips / "verb.toml").unlink()
    else:
        name = request.get("name") or _slug(clips.name if clips != scratch else "")
        document = _proposed(clips, _options(clips, request, name))
    return _finished(folder, clips, document, request, look=True)


def change(folder: Path, scratch: Path, request: Mapping[str, Any]) -> Json:
    """Change a draft, and build its verb again."""
    before = _document(folder)
    changed = changes.apply(before, request["change"])
    extract(Path(request["archive"]), scratch)
    if not changed.proposes:
        return _finished(folder, scratch, changed.document, request, look=None if not changed.motions else False)
    shutil.rmtree(scratch / CYCLES, ignore_errors=True)
    other = changed.document["measure"] != before["measure"]
    proposed = _proposed(scratch, _options_again(scratch, changed.document, given=request["change"], other=other))
    return _finished(folder, scratch, _carried(proposed, changed.document), request, look=True)


def publish(folder: Path, scratch: Path, request: Mapping[str, Any]) -> Json:
    """Build the verb of a draft for publication, and pack its source."""
    document = _document(folder)
    head = head_of(document) | ({"name": request["name"]} if request.get("name") else {})
    extract(Path(request["archive"]), scratch)
    (scratch / "verb.toml").write_text(toml_of(head, document["clips"]), "utf-8")
    try:
        made = build(scratch)
    except VerbError as err:
        raise NotBuilt(_short(err, scratch)) from err
    left = {clip["file"] for clip in document["clips"] if clip["excluded"]}
    files = (path.relative_to(scratch).as_posix() for path in scratch.rglob("*") if path.is_file())
    pack(scratch, folder / "source.zip", [name for name in files if name not in left])
    return _published(made, folder)


def example(folder: Path, scratch: Path, request: Mapping[str, Any]) -> Json:
    """Add the clip in ``upload`` to a verb's source, build it, and pack the new source."""
    from service.upload.drafting.examples import add_example

    given = Path(request["source"])
    if given.is_dir():
        root = scratch / "source"
        shutil.copytree(given, root)
    else:
        root = unpack(given, scratch)
    made, added = add_example(root, folder / "upload", request)
    pack(root, folder / "source.zip")
    return {**_published(made, folder), "example": added}


TASKS: dict[str, Callable[[Path, Path, Mapping[str, Any]], Json]] = {
    "create": create,
    "change": change,
    "publish": publish,
    "example": example,
}


def _document(folder: Path) -> Json:
    document: Json = json.loads((folder / "draft.json").read_text("utf-8"))
    return document


def _slug(text: str) -> str:
    """Name of a verb from that of a folder."""
    slug = re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_-")[:60]
    return slug if slug[:1].isalpha() else f"draft_{slug}".rstrip("_")


def _options(clips: Path, request: Mapping[str, Any], name: str) -> Options:
    """Options of a proposal from the query of a request."""
    unit, measure = request.get("unit"), request.get("measure")
    if unit is not None and unit not in METRES_PER_UNIT:
        raise UnknownName("unit", unit, METRES_PER_UNIT)
    if measure is not None and measure not in ADVERBS:
        raise UnknownName("measure", measure, ADVERBS)
    tables = sorted(path for path in clips.iterdir() if path.suffix.lower() == ".csv")
    if len(tables) > 1:
        raise SourceError(clips, f"the archive has {len(tables)} CSV files; one may have the style adverbs")
    annotated = {row["file"]: tuple(row["keytimes"]) for row in request.get("annotated", ())}
    names = tuple(request.get("keytime_names", ()))
    return Options(
        *(request.get("effector"), measure, unit, name, annotated, names),
        *(tables[0] if tables else None, request.get("pattern")),
    )


def _options_again(clips: Path, document: Json, *, given: Mapping[str, Any], other: bool) -> Options:
    """Options of a further proposal: what the draft has, and the keytimes that were set as annotated ones."""
    rows = [clip for clip in document["clips"] if clip["readable"] and clip["set"]]
    annotated = {} if other else {Path(clip["file"]).name: tuple(clip["keytimes"]) for clip in rows}
    tables = sorted(path for path in clips.iterdir() if path.suffix.lower() == ".csv")
    effector = given.get("effector") or (None if other else document["effector"])
    measure = document["measure"] if document["measure"] in ADVERBS else None
    names = tuple(document["keytime_names"]) if annotated else ()
    return Options(
        *(effector, measure, document["unit"], document["name"], annotated, names),
        *(tables[0] if tables else None, None),
    )


def _proposed(clips: Path, options: Options) -> Json:
    """The document of a proposal; cycles that it cuts are written beside the clips."""
    proposal: Proposal = propose(clips, options)
    write(proposal, clips, force=True)
    (clips / "verb.toml").unlink()
    for name in proposal.cuts:
        (clips / CYCLES).mkdir(exist_ok=True)
        (clips / name).rename(clips / CYCLES / name)
    return from_proposal(proposal)


def _carried(proposed: Json, before: Json) -> Json:
    """A further proposal with what was decided by hand: description, exclusions, mends, style values."""
    styles = [row for row in before["adverbs"] if row["style"]]
    head = head_of(proposed) | {"description": before["description"]}
    present = {row["name"] for row in head["adverb"]}
    head["adverb"] = [*head["adverb"], *(row for row in styles if row["name"] not in present)]
    for clip in proposed["clips"]:
        old = clip_named(before["clips"], clip["name"])
        if old is None or not (old["readable"] and clip["readable"]):
            continue
        if old["reason"] in (EXCLUDED, INCLUDED):
            clip |= {"excluded": old["excluded"], "reason": old["reason"]}
        clip["mends"] = old["mends"]
    for clip in proposed["clips"]:
        old = clip_named(before["clips"], clip["name"]) or {}
        if clip["adverbs"] is not None:
            values = old.get("adverbs") or {}
            clip["adverbs"] = clip["adverbs"] | {row["name"]: values.get(row["name"], 0.0) for row in styles}
    return refreshed(proposed, head)


def _finished(folder: Path, clips: Path, document: Json, request: Mapping[str, Any], *, look: bool | None) -> Json:
    """Write a draft's files: its motions (unless ``look`` is None), archive, verb and document."""
    head = head_of(document)
    if look is not None:
        done = inspect(clips, head, document["clips"], look=look)
        document |= {
            "motion": write_motions(done, folder / "motion.bin"),
            "joints": list(done[0][1].motion.skeleton.names),
        }
    if look:
        pack(clips, folder / "archive.zip")
    document = _built(folder, clips, refreshed(document, head), revision=int(request["revision"]))
    (folder / "draft.json").write_text(json.dumps(document, allow_nan=False, separators=(",", ":")), "utf-8")
    kept = sum(not clip["excluded"] for clip in document["clips"])
    return {"name": document["name"], "clips": kept, "excluded": len(document["clips"]) - kept}


def _built(folder: Path, clips: Path, document: Json, *, revision: int) -> Json:
    """The document with the verb that its clips make, or why they make none."""
    nothing: Json = {"verb": None, "problem": None, "warnings": [], "left_out_mean": None}
    (clips / "verb.toml").write_text(document["toml"], "utf-8")
    try:
        made = build(clips, inspect=False)  # faults are among the clips' mends
    except VerbError as err:
        problem = {"code": "draft_not_built", "detail": _short(err, clips)}
        for clip in document["clips"]:
            clip["left_out"] = None
        return document | nothing | {"problem": problem}
    verb, names = made.verb, [adverb.name for adverb in made.verb.adverbs]
    artifact.save(verb, folder / "verb.verb")
    left_out = _left_out(made)
    for clip in document["clips"]:
        clip["left_out"] = left_out.get(clip["name"])
        if clip["name"] in verb.examples and not clip["excluded"]:
            values = verb.values[verb.examples.index(clip["name"])].tolist()
            clip["adverbs"] = dict(zip(names, values, strict=True))
    return refreshed(document, head_of(document)) | {
        "verb": _plain(describe.describe(verb, version=revision)),
        "problem": None,
        "warnings": [line for line in made.warnings if not line.startswith(STORED)],
        "left_out_mean": float(np.mean(list(left_out.values()))) if left_out else None,
    }


def _left_out(made: Built) -> dict[str, float]:
    """Mean joint angle between each example and its prediction from the others, degrees."""
    method = "corrected" if "smooth" in made.verb.bases else "rbf"
    try:
        angles = np.degrees(left_out_errors(made.verb, (method,))[0][0])
    except IllPosedVerb:  # too few to leave one out
        return {}
    return {name: float(angle) for name, angle in zip(made.verb.examples, angles, strict=True)}


def _published(made: Built, folder: Path) -> Json:
    artifact.save(made.verb, folder / "verb.verb")
    Evaluator(made.verb).warm()
    lines = [line for line in made.warnings if not line.startswith(STORED)]
    return {"verb": made.verb.name, "quality": dict(made.verb.quality), "warnings": lines}


def _plain(value: Any) -> Any:
    """JSON values: arrays as lists."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _short(err: VerbError, folder: Path) -> str:
    """The text of an error without the folder."""
    return str(err).replace(f"{folder}/", "").removeprefix("verb.toml").lstrip(",: ")
