"""The document of a draft: JSON values that clients read, from which its ``verb.toml`` is written.

Made from a proposal, or from a ``verb.toml`` that came with the clips. ``docs/rest.md`` describes its fields.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from verbs.authoring.source import Source
from verbs.authoring.toml_text import toml_dump
from verbs.clips.reports import Mend
from verbs.errors import VerbError
from verbs.io import motion_files
from verbs.io.motion_files import ENDINGS
from verbs.proposal.measures import ADVERBS
from verbs.proposal.result import Proposal
from verbs.proposal.toml_writer import Row

__all__ = [
    "CYCLES",
    "EXCLUDED",
    "INCLUDED",
    "Json",
    "clip_named",
    "from_proposal",
    "from_source",
    "head_of",
    "mend_of",
    "mend_row",
    "refreshed",
    "toml_of",
]

Json = dict[str, Any]

CYCLES = "cycles"
"""Folder of the cycles that are cut from clips, beside the clips."""

EXCLUDED, INCLUDED = "excluded by hand", "included by hand"
"""Reasons of decisions that a further proposal keeps."""

_BY_NAMES = ("simplices", "tetrahedra", "contact", "retarget")
"""Keys of a ``verb.toml`` that refer to examples by index or name."""


def from_proposal(proposal: Proposal) -> Json:
    """The document of a proposal, without what is found by reading and building."""
    head = _without(tomllib.loads(proposal.text), "example", "mend")
    names = [name for name, *_ in proposal.head.adverbs]
    clips = [_of_row(row, names, cut=row.file in proposal.cuts) for row in proposal.rows]
    clips += [_unreadable(odd.name, f"{odd.problem}; {odd.advice}") for odd in proposal.refused]
    for clip in clips:
        clip["left_out"] = proposal.left_out_deg.get(Path(clip["file"]).name)
    evidence = {key: text for key, text in proposal.head.evidence.items() if text}
    return _document(head, clips, evidence)


def from_source(source: Source, table: Mapping[str, Any], folder: Path) -> Json:
    """The document of a ``verb.toml`` and its clips; clips that it does not name are excluded."""
    clips = []
    names = [adverb.name for adverb in source.adverbs]
    for example in source.examples:
        count = len(example.keytimes)
        clip = _clip(example.name, example.file.relative_to(source.path.parent).as_posix())
        clip |= {
            "animation": example.clip,
            "keytimes": list(example.keytimes),
            "confidence": [1.0] * count,
            "evidence": ["given"] * count,
            "set": True,
            "adverbs": dict(zip(names, example.values, strict=True)),
        }
        own = [row for row in source.mends if example.name in row.examples]
        clip["mends"] = [{**mend_row(row.mend, k, "given"), "apply": row.applies} for k, row in enumerate(own)]
        clips.append(_readable(clip, folder, source))
    named = {clip["file"] for clip in clips}
    others = (path.name for path in sorted(folder.iterdir()) if path.suffix.lower() in ENDINGS)
    problem = "is not named in verb.toml; add an [[example]] for it"
    clips += [_unreadable(file, problem) for file in others if file not in named]
    head = _without(table, "example", "mend")
    return _document(head, clips, {})


def head_of(document: Mapping[str, Any]) -> Json:
    """The tables of a draft's ``verb.toml``, without examples and mends."""
    return _without(tomllib.loads(document["toml"]), "example", "mend")


def toml_of(head: Mapping[str, Any], clips: list[Json], *, every: bool = False) -> str:
    """The text of ``verb.toml``; with the clips that are not excluded, or with ``every`` readable clip."""
    chosen = [clip for clip in clips if clip["readable"] and (every or not clip["excluded"])]
    names = [adverb["name"] for adverb in head["adverb"]]
    table = dict(head)
    if every or len(chosen) < len(clips):
        table = _without(table, *(_BY_NAMES if every else _BY_NAMES[:2]))
    rows = [_example(clip, names) for clip in chosen]
    mends = [_mend_table(mend, clip["name"]) for clip in chosen for mend in clip["mends"] if _is_stated(mend)]
    return toml_dump(table | ({"example": rows} if rows else {}) | ({"mend": mends} if mends and not every else {}))


def clip_named(clips: list[Json], name: str) -> Json | None:
    """A clip by name."""
    return next((clip for clip in clips if clip["name"] == name), None)


def mend_row(mend: Mend, index: int, text: str) -> Json:
    """A mend as a document has it, applied."""
    place = {"joint": mend.joint, "start": mend.start_s, "end": mend.end_s}
    return {"index": index, "kind": mend.kind, **place, "options": dict(mend.options), "text": text, "apply": True}


def mend_of(row: Mapping[str, Any]) -> Mend:
    """The inverse of :func:`mend_row`."""
    return Mend(row["kind"], row["joint"], row["start"], row["end"], row["options"])


def _document(head: Json, clips: list[Json], evidence: Mapping[str, str]) -> Json:
    seen: dict[str, str] = {}
    for clip in sorted(clips, key=lambda clip: not clip["readable"]):
        first = seen.setdefault(clip["name"], clip["file"])
        if first != clip["file"]:
            clip.update(_unreadable(clip["file"], f"has the name of '{first}'; give it another one"))
            clip["name"] = clip["file"]
    clips = sorted(clips, key=lambda clip: str(clip["file"]).removeprefix(f"{CYCLES}/"))
    return {**_head_fields(head), "measures": list(ADVERBS), "evidence": dict(evidence), "clips": clips,
            "toml": toml_of(head, clips)}  # fmt: skip


def _head_fields(head: Mapping[str, Any]) -> Json:
    """Fields of a document that repeat those of ``verb.toml``."""
    units = head.get("units", {})
    keys = ("name", "unit", "description", "style")
    usual = {"unit": "none", "description": "", "style": False}
    return {
        "name": head["name"],
        "description": head.get("description", ""),
        "measure": head.get("measure", "none"),
        "effector": head.get("effector") or None,
        "effector_keytime_index": head.get("effector_keytime_index", -1),
        "looping": head.get("looping", False),
        "keytime_names": list(head["keytime_names"]),
        "unit": units.get("length", "m"),
        "up_axis": units.get("up_axis", head.get("up_axis", "+Y")),
        "forward_axis": units.get("forward_axis", head.get("forward_axis", "+Z")),
        "adverbs": [{key: row.get(key, usual.get(key)) for key in keys} for row in head["adverb"]],
    }


def refreshed(document: Json, head: Json) -> Json:
    """A document whose head fields and text are those of ``head`` and of its clips."""
    return document | _head_fields(head) | {"toml": toml_of(head, document["clips"])}


def _clip(name: str, file: str) -> Json:
    nothing = ("frames", "fps", "duration", "start", "end", "keytimes", "confidence", "evidence", "adverbs", "left_out")
    return {
        **{"name": name, "file": file, "animation": "", "readable": True, "problem": ""},
        **dict.fromkeys(nothing),
        **{"set": False, "excluded": False, "reason": "", "mends": [], "warnings": []},
    }


def _unreadable(file: str, problem: str) -> Json:
    return {**_clip(Path(file).stem, file), "readable": False, "problem": problem, "excluded": True}


def _of_row(row: Row, names: list[str], *, cut: bool) -> Json:
    clip = _clip(Path(row.file).stem, f"{CYCLES}/{row.file}" if cut else row.file)
    marks = row.keytimes
    return clip | {
        "keytimes": [round(time, 5) for time in marks.times],  # as `adverb init` writes them
        "confidence": list(marks.confidence),
        "evidence": list(marks.evidence),
        "set": "annotated" in marks.evidence,
        "adverbs": dict(zip(names, row.values, strict=True)),
        "excluded": bool(row.excluded),
        "reason": row.excluded,
        "mends": [mend_row(mend, k, "") for k, mend in enumerate(row.mends)],
        "warnings": [remark for remark in row.remarks if not remark.startswith("mended: ")],
    }


def _readable(clip: Json, folder: Path, source: Source) -> Json:
    """A clip, or where its file cannot be read the reason."""
    try:
        animation = clip["animation"] or None
        motion_files.read(
            folder / clip["file"], unit=source.length_unit, root=source.root, stretch_m=source.stretch_m, clip=animation
        )
    except VerbError as err:
        problem = str(err).replace(f"{folder}/", "").removeprefix(clip["file"]).lstrip(":, ")
        return {**_unreadable(clip["file"], f"cannot be read: {problem}"), "name": clip["name"]}
    return clip


def _example(clip: Mapping[str, Any], names: list[str]) -> Json:
    values = [float(clip["adverbs"][name]) for name in names]
    animation = {"clip": clip["animation"]} if clip["animation"] else {}
    return {
        "file": clip["file"],
        **animation,
        "keytimes": [float(t) for t in clip["keytimes"]],
        "adverb_values": values,
    }


def _is_stated(mend: Mapping[str, Any]) -> bool:
    """Whether a mend has a table: it is applied, or a fault that is left on purpose."""
    return bool(mend["apply"]) or mend["kind"] in ("spike", "spin")


def _mend_table(mend: Mapping[str, Any], example: str) -> Json:
    place = {key: mend[key] for key in ("joint", "start", "end") if mend[key] is not None}
    switch = {} if mend["apply"] else {"apply": False}
    return {"kind": mend["kind"], "example": example, **place, **mend["options"], **switch}


def _without(table: Mapping[str, Any], *keys: str) -> Json:
    return {key: value for key, value in table.items() if key not in keys}
