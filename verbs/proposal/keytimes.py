"""Keytimes of clips, proposed from annotated clips: alignment, then the landmark that the annotation marks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from verbs.conventions import F64
from verbs.proposal.clips import Clip
from verbs.proposal.features import Features, Path, align
from verbs.proposal.landmarks import Landmark, landmarks

__all__ = ["Keytimes", "from_annotated", "in_order"]

NEAR_S = 0.25
"""A landmark farther than this from a keytime has nothing to do with it."""

WINDOW_SHARE = 0.15
"""Landmarks are looked for within this share of the clip, and NEAR_S at least, about the mapped instant."""

OFFSET_PRIOR = 0.5
"""Annotations that a landmark counts for, against the annotated offset from it."""

END_S = 0.05
"""A keytime this near to an end of its clip marks the end."""

LEAST_GAP_S = 0.02

AGREEMENT_S = 0.1
"""Spread of the proposals at which confidence has fallen to 1/e."""

SECONDARY_S = 0.05
"""Handicap of a landmark without prominence, against one of full prominence, at the choice for a keytime."""


@dataclass(frozen=True, slots=True)
class Keytimes:
    """Keytimes (M,) of a clip in seconds, the confidence of each, 0 to 1, and what each rests on."""

    times: tuple[float, ...]
    confidence: tuple[float, ...]
    evidence: tuple[str, ...]


def from_annotated(
    clips: list[Clip],
    features: list[Features],
    annotated: Mapping[int, tuple[float, ...]],
    *,
    effector: int,
    cyclic: bool,
) -> list[Keytimes]:
    """Keytimes of every clip from those of the annotated ones, which keep theirs.

    Parameters
    ----------
    clips : list of Clip
    features : list of Features
        Of the clips.
    annotated : mapping of int to tuple of float
        Keytimes by clip, the same number in all.
    effector : int
        Joint whose path has the landmarks.
    cyclic : bool
        Whether the clips are cycles, whose keytimes span the file and are placed by the alignment alone.
    """
    marks = [landmarks(clip, effector) if not cyclic else [] for clip in clips]
    kinds = [_kind(m, annotated, marks) for m in range(len(next(iter(annotated.values()))))]
    found = []
    for i, clip in enumerate(clips):
        if i in annotated:
            count = len(annotated[i])
            found.append(Keytimes(tuple(annotated[i]), (1.0,) * count, ("annotated",) * count))
            continue
        paths = {a: align(features[a], features[i]) for a in annotated}
        rows = [
            _ends(m, clip, clips, annotated, cyclic)
            or _proposed(m, clip, clips, marks[i], kind, annotated, paths, cyclic)
            for m, kind in enumerate(kinds)
        ]
        times, confidence, evidence = zip(*rows, strict=True)
        found.append(Keytimes(in_order(times, clip.duration_s), tuple(confidence), tuple(evidence)))
    return found


def _kind(m: int, annotated: Mapping[int, tuple[float, ...]], marks: list[list[Landmark]]) -> tuple[str, float] | None:
    """Kind of landmark that keytime m marks in the annotated clips, and the offset from it, shrunk; None for none."""
    best: tuple[float, str, list[float]] | None = None
    for kind in sorted({mark.kind for a in annotated for mark in marks[a]}):
        offsets, price = [], 0.0
        for a, times in annotated.items():
            own = [mark for mark in marks[a] if mark.kind == kind]
            if not own:
                break
            near = min(own, key=lambda mark: _price(mark, times[m]))
            offsets.append(times[m] - near.time)
            price += _price(near, times[m])
        if len(offsets) == len(annotated) and (best is None or price < best[0]):
            best = (price, kind, offsets)
    if best is None or max(map(abs, best[2])) > NEAR_S:
        return None
    return best[1], sum(best[2]) / (len(best[2]) + OFFSET_PRIOR)


def _price(mark: Landmark, time: float) -> float:
    """How badly a landmark explains a keytime, seconds."""
    return abs(mark.time - time) + SECONDARY_S * (1.0 - mark.share)


def _ends(
    m: int, clip: Clip, clips: list[Clip], annotated: Mapping[int, tuple[float, ...]], cyclic: bool
) -> tuple[float, float, str] | None:
    """The clip's first or last instant, where the keytime marks that in the annotated clips."""
    count = len(next(iter(annotated.values())))
    if (cyclic and m == 0) or all(times[m] <= END_S for times in annotated.values()):
        return 0.0, 1.0, "start of the clip"
    if (cyclic and m == count - 1) or all(times[m] >= clips[a].duration_s - END_S for a, times in annotated.items()):
        return clip.duration_s, 1.0, "end of the clip"
    return None


def _proposed(
    m: int,
    clip: Clip,
    clips: list[Clip],
    marks: list[Landmark],
    kind: tuple[str, float] | None,
    annotated: Mapping[int, tuple[float, ...]],
    paths: Mapping[int, Path],
    cyclic: bool,
) -> tuple[float, float, str]:
    """Instant, confidence and evidence of one keytime."""
    mapped, slopes, weights = [], [], []
    for a, times in annotated.items():
        to, slope = paths[a].mapped(times[m])
        mapped.append(to)
        slopes.append(slope * clips[a].duration_s / max(clip.duration_s, 1e-9))
        weights.append(1.0 / max(paths[a].cost, 1e-9))
    middle = float(np.average(mapped, weights=weights))
    steady = float(np.mean([min(s, 1.0 / max(s, 1e-3)) for s in np.maximum(slopes, 1e-3)]))
    sure = float(np.exp(-np.std(mapped) / AGREEMENT_S)) * (0.5 + 0.5 * steady)
    names = f"aligned with {len(annotated)} annotated clip{'s' * (len(annotated) > 1)}"
    window = max(NEAR_S, WINDOW_SHARE * clip.duration_s)
    near = [mark for mark in marks if kind and mark.kind == kind[0] and abs(mark.time - middle) <= window]
    if cyclic:
        return _in_cycle(m, clip, clips, annotated, middle, sure)
    if kind is None or not near:
        return middle, (0.7 if kind is None else 0.4) * sure, names
    chosen = max(near, key=lambda mark: mark.share - abs(mark.time - middle) / window)
    gap = abs(chosen.time + kind[1] - middle)
    share = min(1.0, 0.5 + chosen.share)
    return chosen.time + kind[1], share * float(np.exp(-gap / window)) * (0.5 + 0.5 * sure), f"{names}, {chosen.kind}"


def _in_cycle(
    m: int, clip: Clip, clips: list[Clip], annotated: Mapping[int, tuple[float, ...]], aligned: float, sure: float
) -> tuple[float, float, str]:
    """A keytime of a cycle: halfway between the alignment and the annotated share of the cycle."""
    shares = [times[m] / clips[a].duration_s for a, times in annotated.items()]
    even = float(np.mean(shares)) * clip.duration_s
    agreed = float(np.exp(-abs(aligned - even) / AGREEMENT_S))
    return 0.5 * (aligned + even), sure * (0.5 + 0.5 * agreed), "alignment and share of the cycle"


def in_order(times: tuple[float, ...], duration_s: float) -> tuple[float, ...]:
    """Keytimes made ascending, a little apart, inside the clip."""
    marks: F64 = np.clip(np.array(times), 0.0, duration_s)
    for m in range(1, len(marks)):
        marks[m] = max(marks[m], marks[m - 1] + LEAST_GAP_S)
    marks[-1] = min(marks[-1], duration_s)
    for m in range(len(marks) - 2, -1, -1):
        marks[m] = min(marks[m], marks[m + 1] - LEAST_GAP_S)
    return tuple(float(mark) for mark in marks)
