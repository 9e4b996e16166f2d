"""Measures that adverbs name for themselves, resolved: joints and phases by number, references from the examples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from verbs.adverb_measure import AdverbMeasure, Span
from verbs.authoring.source import Source, SourceAdverb
from verbs.authoring.source_measures import SourceMeasure
from verbs.contacts import PARTS, Contacts
from verbs.conventions import F64, I64
from verbs.errors import SourceError, UnknownName
from verbs.goal import Goal
from verbs.kernels import fk, quat
from verbs.kernels import measure as measures
from verbs.motion import Motion
from verbs.skeleton import Skeleton
from verbs.units import si
from verbs.verb import Measure, Verb

__all__ = ["centred", "needs_stances", "own_measure", "stances_of"]

LEAST_KNOTS = 2
"""Shortest stance that a speed of the feet is measured over, in intervals of canonical time."""

ROOTED = ("root_motion", "foot_speed")
"""Kinds that need the heading of the root."""

BONES = ("azimuth", "elevation")


def needs_stances(source: Source) -> bool:
    """Whether an adverb is the speed of the feet in the stances that the build finds."""
    return any(a.measure is not None and a.measure.kind == "foot_speed" and a.measure.begin < 0 for a in source.adverbs)


def stances_of(contacts: Contacts | None) -> tuple[Span, ...]:
    """Where a foot stands in every example: its ball joint, and the phases of begin and end."""
    if contacts is None:
        return ()
    spans, intervals = [], len(contacts.values) - 1
    for foot in dict.fromkeys(contacts.feet.tolist()):
        points = np.flatnonzero(contacts.feet == foot)
        balls = [p for p in points if PARTS[contacts.parts[p]] == "ball"]
        point = int((balls or points)[0])
        stands = np.concatenate([[False], contacts.values[:, :, point].min(axis=1) > 0.5, [False]])
        edges = np.flatnonzero(np.diff(stands.astype(np.int8))).reshape(-1, 2)
        spans += [
            Span(int(contacts.joints[point]), int(begin) / intervals, int(end - 1) / intervals)
            for begin, end in edges
            if end - 1 - begin >= LEAST_KNOTS
        ]
    return tuple(spans)


def own_measure(
    source: Source, motions: list[Motion], keytimes: F64, phases: F64, effector: int, stances: tuple[Span, ...]
) -> Measure:
    """The measure of a verb whose adverbs name measures of their own.

    The three coordinates of one joint at one keytime, and nothing else, are the measure ``joint_position``.

    Parameters
    ----------
    source : Source
    motions : list of Motion, length N
    keytimes : (N, M) float64
        Seconds from the start of each file.
    phases : (M,) float64
        Canonical phases of the keytimes.
    effector : int
        The verb's effector.
    stances : tuple of Span
        Those of :func:`stances_of`.

    Raises
    ------
    SourceError
        A joint does not exist, or no foot stands in every example.
    """
    resolver = _Resolver(source, motions[0].skeleton, _mean_start(motions, keytimes), phases, stances)
    axes = np.array([k for k, adverb in enumerate(source.adverbs) if adverb.measure is not None], np.int64)
    rows = tuple(resolver.row(k) for k in axes.tolist())
    zero = np.zeros(3)
    order = _coordinates(source, rows)
    if order is not None:
        (joint, begin), factors = order[0], np.array([rows[r].factor for r in order[1]])
        keytime = int(np.argmin(np.abs(phases - begin)))
        return Measure(measures.POSITION, joint, keytime, axes[order[1]], zero, np.diag(factors))
    return Measure(measures.ADVERBS, effector, -1, axes, zero, np.zeros((3, len(axes))), rows)


def centred(verb: Verb) -> Verb:
    """The verb with each measured angle cut in the widest gap between its examples, opposite to its centre.

    The centre stays as near as whole turns allow to the mean of the stated angles.
    """
    if not any(row.dimension == "angle" for row in verb.measure.rows):
        return verb
    points = Goal.of_verb(verb).measured(np.eye(len(verb.examples)))
    rows = [_recentred(row, points[:, k]) for k, row in enumerate(verb.measure.rows)]
    return replace(verb, measure=replace(verb.measure, rows=tuple(rows)))


def _recentred(row: AdverbMeasure, angles: F64) -> AdverbMeasure:
    if row.dimension != "angle":
        return row
    turn = 2.0 * np.pi
    found = np.sort(angles % turn)
    gaps = np.diff(np.concatenate([found, found[:1] + turn]))
    widest = int(np.argmax(gaps))
    opposite = float(found[widest] + 0.5 * gaps[widest] + np.pi)
    return replace(row, center=opposite + turn * round((row.center - opposite) / turn))


def _coordinates(source: Source, rows: tuple[AdverbMeasure, ...]) -> tuple[tuple[int, float], list[int]] | None:
    """Joint, phase and the rows of x, y and z, where rows are the coordinates of one joint at one keytime."""
    spans = {(row.spans[0].joint, row.spans[0].begin) for row in rows}
    names = [row.axis for row in rows]
    alike = len(spans) == 1 and all(row.kind == "position" for row in rows)
    if source.looping or not alike or sorted(names) != ["x", "y", "z"]:
        return None
    return spans.pop(), [names.index(axis) for axis in "xyz"]


def _mean_start(motions: list[Motion], keytimes: F64) -> F64:
    """Mean global rotations (J, 4) of the examples at their first keytime."""
    found = []
    for motion, marks in zip(motions, keytimes, strict=True):
        frame = min(round(float(marks[0]) * motion.fps), len(motion) - 1)
        skeleton = motion.skeleton
        found.append(fk.forward(motion.root[frame], motion.rotations[frame], skeleton.parents, skeleton.offsets)[0])
    return quat.principal(np.array(found))


@dataclass(frozen=True, slots=True, eq=False)
class _Resolver:
    """Resolves names of joints and keytimes; ``start`` (J, 4) are the mean global rotations at the start."""

    source: Source
    skeleton: Skeleton
    start: F64
    phases: F64
    stances: tuple[Span, ...]

    def row(self, k: int) -> AdverbMeasure:
        """The measure of adverb ``k``."""
        adverb = self.source.adverbs[k]
        given = adverb.measure
        assert given is not None
        factor, center = si(adverb.unit), 0.0
        spans = self._spans(adverb, given)
        row = AdverbMeasure(given.kind, given.axis, spans, factor)
        if row.dimension == "angle":
            center = factor * float(np.mean([example.values[k] for example in self.source.examples]))
        return AdverbMeasure(given.kind, given.axis, spans, factor, center, self._base(adverb, given, spans[0].joint))

    def _spans(self, adverb: SourceAdverb, given: SourceMeasure) -> tuple[Span, ...]:
        if given.begin < 0:
            if not self.stances:
                raise SourceError(
                    self.source.path, f"measure of adverb '{adverb.name}': no foot stands at the same phases in all "
                    "examples; give the joint and between = [two keytimes] of its stance"
                )  # fmt: skip
            return self.stances
        joint = self._joint(adverb, given.joint) if given.joint else 0
        end = float(self.phases[given.end]) if given.end >= 0 else None
        return (Span(joint, float(self.phases[given.begin]), end),)

    def _joint(self, adverb: SourceAdverb, name: str) -> int:
        try:
            return self.skeleton.index(name)
        except UnknownName as err:
            raise SourceError(self.source.path, f"measure of adverb '{adverb.name}': {err}") from err

    def _base(self, adverb: SourceAdverb, given: SourceMeasure, joint: int) -> tuple[float, float, float, float]:
        if given.axis in BONES:
            x, y, z = (float(number) for number in self._bone(adverb, given, joint))
            return x, y, z, 0.0
        if given.kind != "orientation" and given.kind not in ROOTED:
            return 0.0, 0.0, 0.0, 1.0
        x, y, z, w = quat.conjugate(self.start[0 if given.kind in ROOTED else joint]).tolist()
        return x, y, z, w

    def _bone(self, adverb: SourceAdverb, given: SourceMeasure, joint: int) -> F64:
        """Direction (3,) of a bone in its joint's frame: toward a child that is named, the first one, or the tip."""
        skeleton, name = self.skeleton, self.skeleton.names[joint]
        children: I64 = np.flatnonzero(skeleton.parents == joint)
        if given.kind != "orientation":
            return np.array([0.0, 0.0, 1.0])
        if given.toward:
            children = children[children == self._joint(adverb, given.toward)]
            if not len(children):
                below = ", ".join(skeleton.names[c] for c in np.flatnonzero(skeleton.parents == joint)) or "none"
                raise SourceError(
                    self.source.path, f"measure of adverb '{adverb.name}': '{given.toward}' is no child of '{name}'; "
                    f"its children: {below}"
                )  # fmt: skip
        tips = skeleton.tip_offsets[skeleton.tip_parents == joint]
        found = [*skeleton.offsets[children], *tips]
        length = float(np.linalg.norm(found[0])) if found else 0.0
        if length < 1e-9:
            raise SourceError(
                self.source.path, f"measure of adverb '{adverb.name}': joint '{name}' has no bone; name another joint"
            )
        return np.asarray(found[0] / length)
