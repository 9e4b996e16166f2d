"""The kinds of mends in the order in which they apply, and what they find in a clip.

No mend changes a file; each gives a new motion and reports on what it did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from verbs.clips import cuts, gaps, idle, jitter, mirror, placement, spikes, spins
from verbs.clips.reports import Mend, Report
from verbs.errors import UnknownName
from verbs.motion import Motion

__all__ = ["KINDS", "TRIMS", "Kind", "Mended", "apply", "find"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of mend: what finds it, what applies it, and its parameters in ``[[mend]]`` apart from ``example``."""

    find: Callable[[Motion], list[Report]]
    mend: Callable[[Motion, Mend], tuple[Motion, list[Report]]]
    has_joint: bool = False
    has_stretch: bool = False
    options: tuple[str, ...] = ()


KINDS: dict[str, Kind] = {
    gaps.KIND: Kind(gaps.find, gaps.mend, has_joint=True, has_stretch=True),
    spikes.KIND: Kind(spikes.find, spikes.mend, has_joint=True, has_stretch=True),
    spins.KIND: Kind(spins.find, spins.mend, has_joint=True, has_stretch=True),
    jitter.KIND: Kind(jitter.find, jitter.mend, has_joint=True, options=("cutoff_hz",)),
    mirror.KIND: Kind(mirror.find, mirror.mend),
    cuts.KIND: Kind(cuts.find, cuts.mend, has_stretch=True),
    idle.KIND: Kind(idle.find, idle.mend, has_stretch=True, options=("speed", "margin")),
    "ground": Kind(placement.find_ground, placement.mend_ground, options=("height",)),
    "heading": Kind(placement.find_heading, placement.mend_heading, options=("degrees",)),
    "start": Kind(placement.find_start, placement.mend_start),
}
"""Kinds by name, in the order in which they apply: times and joints of the first four are those of the file."""


TRIMS = (cuts.KIND, idle.KIND)
"""Kinds that shorten a clip; ``start`` and ``end`` are seconds of the clip as the mends before leave it."""


@dataclass(frozen=True, slots=True, eq=False)
class Mended:
    """A mended motion.

    Parameters
    ----------
    motion : Motion
    reports : tuple of Report
        What was done, in the order in which it was done.
    start_s, end_s : float
        The stretch of the file that is left, seconds.
    """

    motion: Motion
    reports: tuple[Report, ...]
    start_s: float
    end_s: float


def find(motion: Motion, kinds: Iterable[str] = tuple(KINDS)) -> list[Report]:
    """What is wrong in a clip: reports in the order of the kinds; ``report.mend`` is the mend of each.

    Each kind looks at the clip as the mends of the kinds before it leave it, except that nothing is trimmed or moved.

    Parameters
    ----------
    motion : Motion
    kinds : iterable of str
        Kinds that are looked for; by default all.

    Raises
    ------
    UnknownName
        An unknown kind.
    """
    wanted = set(kinds)
    for name in wanted - KINDS.keys():
        raise UnknownName("kind of mend", name, KINDS)
    found: list[Report] = []
    for name, kind in KINDS.items():
        if name in wanted:
            reports = kind.find(motion)
            found += reports
            if kind.has_joint:
                for report in (report for report in reports if report.proposed):
                    motion, _ = kind.mend(motion, report.mend)
    return found


def apply(motion: Motion, mends: Sequence[Mend]) -> Mended:
    """Apply mends in the order of :data:`KINDS`; those of one kind in their own order.

    Parameters
    ----------
    motion : Motion
    mends : sequence of Mend

    Raises
    ------
    UnknownName
        An unknown kind or joint.
    OutOfRange
        A parameter outside its bounds.
    """
    for one in mends:
        if one.kind not in KINDS:
            raise UnknownName("kind of mend", one.kind, KINDS)
    reports: list[Report] = []
    start, end = 0.0, motion.duration_s
    for name, kind in KINDS.items():
        for one in (one for one in mends if one.kind == name):
            motion, done = kind.mend(motion, one)
            if name in TRIMS and done:
                kept = done[0].mend
                start, end = start + float(kept.start_s or 0.0), start + float(kept.end_s or 0.0)
            reports += done
    return Mended(motion, tuple(reports), start, end)
