"""Changes of a draft that a client requests, checked and made in its document."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from service.upload.drafting.document import EXCLUDED, INCLUDED, Json, clip_named, head_of, refreshed
from service.upload.drafting.errors import InvalidDraft
from verbs.clips.mends import KINDS
from verbs.units import KNOWN
from verbs.verb import NAME

__all__ = ["Changed", "apply", "checked_keytimes"]

SLACK_S = 1e-3
"""Keytimes may lie this far outside of their clip: clients and files round."""

GAP_S = 1e-3
"""Smallest distance of two keytimes, seconds."""

_TEXTS = ("name", "description", "looping", "measure", "effector")


class Changed:
    """A changed document, and what has to be done.

    Attributes
    ----------
    document : dict
    motions : bool
        Whether clips have other mends, so that they have to be read again.
    proposes : bool
        Whether measure, effector and keytimes are proposed again.
    """

    def __init__(self, document: Json, *, motions: bool, proposes: bool) -> None:
        self.document, self.motions, self.proposes = document, motions, proposes


def apply(document: Json, change: Mapping[str, Any]) -> Changed:
    """Make changes in a document; raises :class:`InvalidDraft` with all mistakes, and nothing is changed then."""
    head, clips = head_of(document), [dict(clip) for clip in document["clips"]]
    errors: list[dict[str, str]] = []
    for key, known in (("measure", document["measures"]), ("effector", document["joints"])):
        if change.get(key) not in (None, document[key], *known):
            errors.append({"at": key, "problem": f"must be one of {', '.join(known)}"[:1_000]})
    _change_head(head, change, errors)
    _change_adverbs(head, clips, change.get("adverbs"), errors)
    motions = False
    for name, row in (change.get("clips") or {}).items():
        clip = clip_named(clips, name)
        if clip is None or not clip["readable"]:
            problem = "is no clip of this draft" if clip is None else f"cannot be changed: {clip['problem']}"
            errors.append({"at": f"clips.{name}"[:200], "problem": problem})
            continue
        motions |= _change_clip(clip, row, head, errors)
    if errors:
        raise InvalidDraft(errors[:16])
    other = {key for key in ("measure", "effector") if change.get(key) not in (None, document[key])}
    if "measure" in other:
        for clip in clips:
            clip["set"] = False
    return Changed(
        refreshed({**document, "clips": clips}, head),
        motions=motions,
        proposes=bool(other) or bool(change.get("propose")),
    )


def checked_keytimes(times: list[float], names: list[str], start: float, end: float, *, looping: bool) -> str:
    """What is wrong with keytimes of a clip from ``start`` to ``end``; empty where nothing is."""
    if len(times) != len(names):
        return f"{len(times)} keytimes; there are {len(names)}: {', '.join(names)}"
    for (first, second), (name, following) in zip(pairwise(times), pairwise(names), strict=True):
        if second - first < GAP_S:
            return f"must rise: '{following}' ({second:g} s) comes after '{name}' ({first:g} s)"
    if times[0] < start - SLACK_S or times[-1] > end + SLACK_S:
        return f"must lie from {start:.3f} to {end:.3f} s"
    if looping and (times[0] > start + SLACK_S or times[-1] < end - SLACK_S):
        return f"must span the whole cycle, {start:.3f} to {end:.3f} s"
    return ""


def _change_head(head: Json, change: Mapping[str, Any], errors: list[dict[str, str]]) -> None:
    for key in _TEXTS:
        if change.get(key) is not None:
            head[key] = change[key]
    if not NAME.fullmatch(head["name"]):
        problem = "must be lower-case letters, digits, '-' and '_', at most 63, a letter first"
        errors.append({"at": "name", "problem": problem})
    count = len(head["keytime_names"])
    names = change.get("keytime_names")
    if names is not None and len(names) != count:
        errors.append({"at": "keytime_names", "problem": f"{len(names)} names for {count} keytimes"})
    elif names is not None:
        if len(set(names)) != count or not all(name.strip() for name in names):
            errors.append({"at": "keytime_names", "problem": "must be different, and none empty"})
        head["keytime_names"] = list(names)
    index = change.get("effector_keytime_index")
    if index is not None:
        if not -1 <= index < count:
            errors.append({"at": "effector_keytime_index", "problem": f"must be 0 to {count - 1}"})
        head["effector_keytime_index"] = index


def _change_adverbs(
    head: Json, clips: list[Json], rows: list[Mapping[str, Any]] | None, errors: list[dict[str, str]]
) -> None:
    """Rename adverbs, and add style adverbs after them."""
    if rows is None:
        return
    before = [dict(row) for row in head["adverb"]]
    if len(rows) < len(before):
        known = ", ".join(row["name"] for row in before)
        errors.append({"at": "adverbs", "problem": f"{len(rows)} rows; list all {len(before)}: {known}"})
        return
    after = []
    for k, row in enumerate(rows):
        old = before[k] if k < len(before) else {"unit": "none", "style": True}
        if k >= len(before) and not row.get("style"):
            errors.append({"at": f"adverbs.{k}", "problem": "only style adverbs can be added; set style to true"})
        new = old | {key: row[key] for key in ("name", "unit", "description") if row.get(key) is not None}
        if new["unit"] not in KNOWN and new["unit"] != old["unit"]:
            errors.append({"at": f"adverbs.{k}.unit", "problem": f"must be one of {', '.join(KNOWN)}"})
        after.append(new)
    names = [row["name"] for row in after]
    if len(set(names)) != len(names):
        errors.append({"at": "adverbs", "problem": f"names must differ: {', '.join(names)}"})
    head["adverb"] = after
    for clip in clips:
        if clip["adverbs"] is not None:
            values = [*clip["adverbs"].values(), *[0.0] * (len(after) - len(before))]
            clip["adverbs"] = dict(zip(names, values, strict=False))


def _change_clip(clip: Json, row: Mapping[str, Any], head: Json, errors: list[dict[str, str]]) -> bool:
    """Change one clip; whether its mends change."""
    where, names = f"clips.{clip['name']}", list(head["keytime_names"])
    changes = _change_mends(clip, row["mends"], where, errors) if row.get("mends") is not None else False
    if "keytimes" in row:
        _change_keytimes(clip, row["keytimes"], names, where, errors, looping=bool(head.get("looping")))
    if row.get("excluded") is not None and row["excluded"] != clip["excluded"]:
        clip |= {"excluded": row["excluded"], "reason": EXCLUDED if row["excluded"] else INCLUDED}
    styles = {adverb["name"] for adverb in head["adverb"] if adverb.get("style")}
    for name, value in (row.get("adverbs") or {}).items():
        if name not in styles:
            known = ", ".join(sorted(styles)) or "there are none"
            errors.append({"at": f"{where}.adverbs.{name}"[:200], "problem": f"is no style adverb; known: {known}"})
        else:
            clip["adverbs"] = {**clip["adverbs"], name: value}
    return changes


def _change_keytimes(
    clip: Json, times: list[float] | None, names: list[str], where: str, errors: list[dict[str, str]], *, looping: bool
) -> None:
    if times is None:
        clip["set"] = False
        return
    if problem := checked_keytimes(times, names, clip["start"], clip["end"], looping=looping):
        errors.append({"at": f"{where}.keytimes", "problem": problem})
        return
    kept = [abs(a - b) < 1e-6 for a, b in zip(times, clip["keytimes"], strict=True)]
    clip |= {
        "keytimes": [min(max(time, clip["start"]), clip["end"]) for time in times],
        "confidence": [sure if same else 1.0 for sure, same in zip(clip["confidence"], kept, strict=True)],
        "evidence": [why if same else "set" for why, same in zip(clip["evidence"], kept, strict=True)],
        "set": True,
    }


def _change_mends(clip: Json, rows: list[Mapping[str, Any]], where: str, errors: list[dict[str, str]]) -> bool:
    mends = [dict(mend) for mend in clip["mends"]]
    for k, row in enumerate(rows):
        at, index = f"{where}.mends.{k}", row.get("index")
        if index is not None:
            if index >= len(mends):
                errors.append({"at": f"{at}.index", "problem": f"must be less than {len(mends)}"})
            else:
                mends[index]["apply"] = row.get("apply", True)
        elif row.get("kind") not in KINDS:
            errors.append({"at": f"{at}.kind", "problem": f"must be one of {', '.join(KINDS)}"})
        elif problem := _wrong_mend(row):
            errors.append({"at": at, "problem": problem})
        else:
            place = {key: row.get(key) for key in ("joint", "start", "end")}
            text = f"mend of kind '{row['kind']}', added by hand"
            mends.append({"index": len(mends), "kind": row["kind"], **place, "options": dict(row.get("options") or {}),
                          "text": text, "apply": row.get("apply", True)})  # fmt: skip
    changes = [mend["apply"] for mend in mends] != [mend["apply"] for mend in clip["mends"]]
    clip["mends"] = mends
    return changes


def _wrong_mend(row: Mapping[str, Any]) -> str:
    """What is wrong with the fields of an added mend."""
    kind, start, end = KINDS[row["kind"]], row.get("start"), row.get("end")
    unknown = [key for key in row.get("options") or {} if key not in kind.options]
    if unknown:
        return f"unknown option '{unknown[0]}'; known: {', '.join(kind.options) or 'none'}"
    if row.get("joint") is not None and not kind.has_joint:
        return f"a mend of kind '{row['kind']}' is of the whole clip; leave 'joint' out"
    if (start, end) != (None, None):
        if not kind.has_stretch:
            return f"a mend of kind '{row['kind']}' has no start and end"
        if start is None or end is None or not 0.0 <= start <= end:
            return "needs both start and end, in seconds of the file, with 0 ≤ start ≤ end"
        if row.get("joint") is None and row["kind"] in ("spin", "spike"):
            return "with a start and an end it needs a joint too"
    return ""
