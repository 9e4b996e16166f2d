"""Motions of a draft's clips: read, looked at for faults, mended, and sampled for display."""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path

import numpy as np

from service.upload.drafting.changes import SLACK_S
from service.upload.drafting.document import Json, mend_of, mend_row, toml_of
from service.upload.drafting.errors import InvalidDraft
from verbs.authoring.reading import read_motions
from verbs.authoring.source import parse
from verbs.clips import mends
from verbs.clips.mends import Mended
from verbs.clips.reports import Mend
from verbs.conventions import F64
from verbs.errors import SourceError, VerbError
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

__all__ = ["inspect", "write_motions"]

LOOKED_FOR = ("gap", "spike", "spin", "jitter", "idle", "ground", "heading")
"""Kinds of mends that are offered for each clip."""

MOST_MENDS = 20
"""Largest number of mends that are offered for a clip."""

SAMPLES = 91
"""Largest number of poses of a clip that are displayed."""

MAX_BYTES = 8 * 1024 * 1024
"""Largest size of all of them."""

NEAR_S = 0.05
"""Starts of two mends of one kind and joint that are the same."""


def inspect(folder: Path, head: Json, clips: list[Json], *, look: bool) -> list[tuple[Json, Mended]]:
    """Read and mend every readable clip, and state frames, duration and mends in its row.

    Parameters
    ----------
    folder : Path
        With the clips.
    head : dict
    clips : list of dict
        Changed in place; a clip with another skeleton than most is not readable any more.
    look : bool
        Whether to look for faults, which takes longer.

    Raises
    ------
    InvalidDraft
        A mend cannot be applied.
    SourceError
        Fewer than two clips are readable, or one is invalid.
    """
    rows = [clip for clip in clips if clip["readable"]]
    if len(rows) < 2:
        found = next((f"{clip['file']} {clip['problem']}" for clip in clips if not clip["readable"]), "no other clip")
        raise SourceError(folder, f"a verb blends at least two clips; {len(rows)} can be used; {found}")
    source = parse(folder / "verb.toml", tomllib.loads(toml_of(head, rows, every=True)))
    motions, _, _, _ = read_motions(source, lambda stage, done, total: None)
    usual = _usual(motions)
    done: list[tuple[Json, Mended]] = []
    for clip, motion in zip(rows, motions, strict=True):
        if (motion.skeleton.names, motion.skeleton.parents.tolist()) != usual:
            clip.update(
                readable=False, excluded=True, problem="its joints differ from those of the others; rename them"
            )
            continue
        if look:
            clip["mends"] = _offered(motion, clip["mends"], looping=bool(head.get("looping")))
        clip |= {"frames": len(motion), "fps": motion.fps, "duration": motion.duration_s}
        mended = _applied(clip, motion)
        clip["keytimes"] = _fitted(clip, mended)
        clip |= {"start": mended.start_s, "end": mended.end_s}
        done.append((clip, mended))
    return done


def _fitted(clip: Json, mended: Mended) -> list[float] | None:
    """Keytimes within the mended motion; those at its earlier start or end stay there."""
    if clip["keytimes"] is None:
        return None
    ends = [(clip["start"], mended.start_s), (clip["end"], mended.end_s)]
    times = [
        next((new for old, new in ends if old is not None and abs(time - old) < SLACK_S), time)
        for time in clip["keytimes"]
    ]
    return [min(max(time, mended.start_s), mended.end_s) for time in times]


def write_motions(done: list[tuple[Json, Mended]], path: Path) -> str:
    """Write the motions for display; return a tag of the content."""
    joints = len(done[0][1].motion.skeleton)
    pose_bytes = 4 * (3 + 4 * joints)
    most = max(2, min(SAMPLES, MAX_BYTES // (pose_bytes * len(done))))
    rows, parts = [], []
    for clip, mended in done:
        count = max(2, min(len(mended.motion), most))
        rows.append({"name": clip["name"], "samples": count, "start": mended.start_s, "end": mended.end_s})
        parts.append(_sampled(mended.motion, count).astype("<f4").tobytes())
    head = {"joints": joints, "skeleton": _skeleton(done[0][1].motion.skeleton), "clips": rows}
    line = json.dumps(head, separators=(",", ":")).encode()
    content = line + b" " * (-(len(line) + 1) % 4) + b"\n" + b"".join(parts)
    path.write_bytes(content)
    return hashlib.sha256(content).hexdigest()[:32]


def _skeleton(skeleton: Skeleton) -> Json:
    tips = zip(skeleton.tip_parents.tolist(), skeleton.tip_offsets.tolist(), strict=True)
    return {
        "names": list(skeleton.names),
        "parents": skeleton.parents.tolist(),
        "offsets": skeleton.offsets.tolist(),
        "tips": [{"parent": parent, "offset": offset} for parent, offset in tips],
    }


def _usual(motions: list[Motion]) -> tuple[tuple[str, ...], list[int]]:
    """Names and parents of the joints that most motions have."""
    found = [(motion.skeleton.names, motion.skeleton.parents.tolist()) for motion in motions]
    return max(found, key=found.count)


def _offered(motion: Motion, own: list[Json], *, looping: bool) -> list[Json]:
    """Mends of a clip: its own, then what else is found, not applied."""
    kinds = [kind for kind in LOOKED_FOR if not (looping and kind == "idle")]
    reports = mends.find(motion, kinds)
    rows = []
    for row in own:
        mend = mend_of(row)
        known = next((report for report in reports if _same(report.mend, mend)), None)
        text = row["text"] or (f"{known.found}; {known.done}" if known else f"mend of kind '{mend.kind}'")
        rows.append({**row, "text": text})
    others = [report for report in reports if not any(_same(report.mend, mend_of(row)) for row in own)]
    rows += [{**mend_row(one.mend, 0, f"{one.found}; {one.done}"), "apply": False} for one in others[:MOST_MENDS]]
    return [{**row, "index": k} for k, row in enumerate(rows)]


def _same(found: Mend, own: Mend) -> bool:
    if found.kind != own.kind or own.joint not in (None, found.joint):
        return False
    return own.start_s is None or abs((found.start_s or 0.0) - own.start_s) < NEAR_S


def _applied(clip: Json, motion: Motion) -> Mended:
    try:
        return mends.apply(motion, [mend_of(row) for row in clip["mends"] if row["apply"]])
    except VerbError as err:
        raise InvalidDraft([{"at": f"clips.{clip['name']}.mends", "problem": str(err)}]) from err


def _sampled(motion: Motion, count: int) -> F64:
    """Poses (count, 3 + 4·J) at uniform times: root position, then local rotations; linear between frames."""
    at = np.linspace(0.0, len(motion) - 1.0, count)
    low = np.minimum(at.astype(np.int64), max(len(motion) - 2, 0))
    high = np.minimum(low + 1, len(motion) - 1)
    share = (at - low)[:, None]
    root = (1.0 - share) * motion.root[low] + share * motion.root[high]
    first, second = np.asarray(motion.rotations[low], np.float64), np.asarray(motion.rotations[high], np.float64)
    second = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -second, second)
    rotations = quat.normalize((1.0 - share[..., None]) * first + share[..., None] * second)
    return np.concatenate([root, rotations.reshape(count, -1)], axis=1)
