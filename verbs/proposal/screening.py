"""Clips that do not fit the others: skeleton, unit, duplicates, motions that do not belong; axes and facing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from verbs.clips import orientation
from verbs.conventions import F64, METRES_PER_UNIT
from verbs.proposal.clips import Clip, Refused
from verbs.proposal.features import Features, distances, stature
from verbs.skeleton import Skeleton

__all__ = ["APART", "axes", "facing", "guess_unit", "outliers", "screen"]

BODY_M = (1.2, 2.2)
"""Height of the joints of a body, metres, by which a unit is guessed: people of 1.5 to 2.0 m, crouching too."""

SCALES = (100.0, 10.0, 1000.0, 39.37, 30.48, 2.54, 3.28)
"""Ratios of units that are in use; each is looked for both ways."""

CERTAIN = 0.5
"""Confidence from which on an orientation counts."""

NEIGHBOURS, OUTLIER_Z, OUTLIER_RATIO = 3, 7.0, 1.6
"""A clip does not belong if its mean distance to its nearest clips is this many deviations above, and this many times,
the median."""

APART = "its motion does not belong"
"""Beginning of the reason for an outlier."""

SAME_M = 1e-3
"""Clips whose joints differ less than this at every frame are the same."""

Checked = tuple[list[Clip], list[Refused]]


def guess_unit(clips: list[Clip]) -> tuple[str, str]:
    """Unit of length of clips that were read as metres, with the evidence."""
    height = float(np.median([stature(clip) for clip in clips]))
    fitting = [unit for unit in ("m", "cm", "in", "mm", "ft", "dm")
               if BODY_M[0] <= height * METRES_PER_UNIT[unit] <= BODY_M[1]]  # fmt: skip
    if not fitting:
        return "m", f"joints span {height:.3g} units of height, which is no person in any unit: check this"
    unit = fitting[0]
    metres = "" if unit == "m" else f", {height * METRES_PER_UNIT[unit]:.2f} m"
    return unit, f"joints span {height:.3g} {unit} of height{metres}: a person"


def screen(clips: list[Clip]) -> Checked:
    """Clips that may share a verb, and the others, each with what is wrong and what to do."""
    refused: list[Refused] = []
    for check in (_skeletons, _still, _duplicates):
        clips, odd = _split(clips, check) if clips else (clips, [])
        refused += odd
    return clips, refused


def _split(clips: list[Clip], check: Callable[[list[Clip]], list[tuple[str, str] | None]]) -> Checked:
    verdicts = check(clips)
    kept = [clip for clip, odd in zip(clips, verdicts, strict=True) if odd is None]
    return kept, [Refused(clip.name, *odd) for clip, odd in zip(clips, verdicts, strict=True) if odd]


def _skeletons(clips: list[Clip]) -> list[tuple[str, str] | None]:
    """Clips whose skeleton is not that of most."""
    groups: list[tuple[Skeleton, list[int]]] = []
    for k, clip in enumerate(clips):
        for skeleton, members in groups:
            if skeleton.difference(clip.motion.skeleton) is None:
                members.append(k)
                break
        else:
            groups.append((clip.motion.skeleton, [k]))
    usual, members = max(groups, key=lambda group: len(group[1]))
    return [None if k in members else _skeleton_problem(usual, clip.motion.skeleton) for k, clip in enumerate(clips)]


def _skeleton_problem(usual: Skeleton, own: Skeleton) -> tuple[str, str]:
    missing = [name for name in usual.names if name not in own.names]
    extra = [name for name in own.names if name not in usual.names]
    if len(missing) == len(extra) and missing and len(own) == len(usual):
        pairs = ", ".join(f"'{new}' where the others have '{old}'" for old, new in zip(missing, extra, strict=True))
        return f"names joint {pairs}", f"rename it to '{missing[0]}' in the file"
    if not missing and not extra and np.array_equal(usual.parents, own.parents):
        lengths = [np.linalg.norm(one.offsets[1:], axis=1) for one in (usual, own)]
        ratios = lengths[1][lengths[0] > 1e-6] / lengths[0][lengths[0] > 1e-6]
        ratio = float(np.median(ratios)) if len(ratios) else 1.0
        for scale in (*SCALES, *(1.0 / scale for scale in SCALES)):
            if abs(ratio / scale - 1.0) < 0.02 and np.ptp(ratios) < 0.05 * ratio:
                return (f"its bones are {ratio:.4g} × as long as those of the others: another unit of length",
                        f"scale its lengths by {1.0 / ratio:.4g}")  # fmt: skip
    return f"its skeleton {usual.difference(own)}", "retarget it to the skeleton of the others, or leave it out"


def _still(clips: list[Clip]) -> list[tuple[str, str] | None]:
    """Clips that are too short to hold a motion."""
    return [None if len(clip.motion) >= 4 else (f"has {len(clip.motion)} frames", "export the whole motion")
            for clip in clips]  # fmt: skip


def axes(clips: list[Clip]) -> tuple[str, str, str]:
    """Axes that are up and forward in most files, and the evidence; +Y and +Z where the bodies show nothing."""
    found = [orientation.find(clip.motion) for clip in clips]
    sure = [one for one in found if one.confidence >= CERTAIN]
    if len(sure) <= len(clips) / 2:
        return "+Y", "+Z", f"taken for granted: {len(sure)} of {len(clips)} clips show their axes"
    usual, count = Counter(one.text for one in sure).most_common(1)[0]
    first = next(one for one in sure if one.text == usual)
    words = f"{usual} in {count} of {len(clips)} clips: {', '.join(first.evidence)}"
    return orientation.axis_name(first.up), orientation.axis_name(first.forward), words


def facing(clip: Clip) -> float | None:
    """Angle from +Z, radians, of where a body faces at its first frame; None where that is not known."""
    found = orientation.find(clip.motion, up="+Y")
    if found.confidence < CERTAIN:
        return None
    return float(np.arctan2(found.facing[0], found.facing[2]))


def _duplicates(clips: list[Clip]) -> list[tuple[str, str] | None]:
    """Clips that equal an earlier one."""
    problems: list[tuple[str, str] | None] = []
    for k, clip in enumerate(clips):
        twin = next((other.name for other in clips[:k] if other.positions.shape == clip.positions.shape
                     and np.abs(other.positions[::7] - clip.positions[::7]).max() < SAME_M), None)  # fmt: skip
        problems.append((f"is the same motion as {twin}", "leave one out") if twin else None)
    return problems


def outliers(clips: list[Clip], features: list[Features]) -> list[Refused]:
    """Clips whose motion does not belong: far from their nearest clips, as distances among the others go."""
    if len(clips) < NEIGHBOURS + 2:
        return []
    between: F64 = distances(features)
    np.fill_diagonal(between, np.inf)
    near = np.sort(between, axis=1)[:, :NEIGHBOURS].mean(axis=1)
    usual = float(np.median(near))
    spread = max(1.4826 * float(np.median(np.abs(near - usual))), 0.08 * usual)
    return [
        Refused(clip.name, f"{APART}: {own / usual:.1f} × as far from its nearest clips as usual",
                "leave it out, or trim it to the same action")
        for clip, own in zip(clips, near, strict=True)
        if own > usual + OUTLIER_Z * spread and own > OUTLIER_RATIO * usual
    ]  # fmt: skip
