"""Mends of raw clips: spins, spikes, calibration poses, and clips that face the other way; none changes a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from verbs.clips import mends
from verbs.clips.reports import Mend
from verbs.proposal.clips import Clip, clip_of
from verbs.proposal.screening import facing

__all__ = ["repaired", "turned_round"]

KINDS = ("spike", "spin", "cut")

POSTURE_DEG = 20.0
"""Headings of clips may differ this much by posture."""

BACKWARDS_RAD = np.radians(120.0)
"""A clip that starts facing farther than this from the others is turned."""


def repaired(clip: Clip) -> Clip:
    """A clip whose spikes, spins and cuts are mended, with the mends and a note for each."""
    found = [report.mend for report in mends.find(clip.motion, KINDS) if report.proposed]
    return _mended(clip, found) if found else clip


def turned_round(clips: list[Clip]) -> list[Clip]:
    """Clips of which those that start facing the other way than most are turned about +Y."""
    found = [facing(clip) for clip in clips]
    known = [angle for angle in found if angle is not None]
    if not known:
        return clips
    usual = float(np.angle(np.median(np.cos(known)) + 1j * np.median(np.sin(known))))
    turned = []
    for clip, angle in zip(clips, found, strict=True):
        off = 0.0 if angle is None else float(np.angle(np.exp(1j * (angle - usual))))
        mend = Mend("heading", options={"degrees": _snapped(float(np.degrees(off)))})
        turned.append(_mended(clip, [mend]) if abs(off) > BACKWARDS_RAD else clip)
    return turned


def _snapped(degrees: float) -> float:
    """An angle, or the quarter turn next to it: a few degrees are posture."""
    quarter = 90.0 * round(degrees / 90.0)
    return quarter if abs(degrees - quarter) < POSTURE_DEG else round(degrees, 1)


def _mended(clip: Clip, wanted: list[Mend]) -> Clip:
    """A clip with mends applied and noted."""
    done = mends.apply(clip.motion, wanted)
    notes = tuple(f"mended: {report.found}; {report.done}" for report in done.reports)
    made = clip_of(clip.path, done.motion, (*clip.notes, *notes))
    return replace(made, mends=(*clip.mends, *wanted), start_s=clip.start_s + done.start_s)
