"""Find when the feet of a verb's examples stand: by height above the ground and speed, with hysteresis.

The curves are judged, not the files: what is stored describes the motion that is blended, in its own canonical time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.authoring import curves
from verbs.clips.feet import BALL, FOOT, HEEL, Point, feet, leg_length, point_positions
from verbs.contacts import PARTS, Contacts
from verbs.conventions import F32, F64, I64
from verbs.errors import UnknownName
from verbs.kernels import quat
from verbs.kernels.easing import smootherstep
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.ground import from_ground
from verbs.runtime.whole_motion import MIDDLE, RATE_HZ, examples, sampled_rotations
from verbs.verb import Verb

__all__ = ["RAMP_S", "Clip", "Stated", "assemble", "clips", "find", "point_positions", "runs", "standing"]

Flags = npt.NDArray[np.bool_]

ON_M, OFF_M = 0.025, 0.035
"""Heights above the standing height below which a contact may begin, and continues."""

ON_M_S, OFF_M_S = 0.15, 0.25
"""Speeds below which a contact begins, and continues, while the root rests."""

ON_SHARE, OFF_SHARE = 0.12, 0.25
"""Shares of the root's speed that are added to these speeds: feet of a run hardly stop."""

LEG_M = 0.85
"""Length of a leg to which the limits belong; they scale with the leg."""

SHORTEST_GAP_S, SHORTEST_S = 0.060, 0.080
"""Gaps shorter than the first are closed, then contacts shorter than the second dropped."""

FLAT_SHARE, SLOPE_RAD = 0.15, np.radians(50.0)
"""A foot is flat in this share of its contact, in which its ankle is lowest. A foot that then rises steeper than this
to its ankle walks on its toes and has no heel."""

HEEL_SHARE = 0.3
"""Distance of the heel behind the ankle, as a share of that of the ball before it."""

ROOT_WINDOW_S = 0.5
"""Length of the mean of the root's speed."""

MOST_NUMBERS = 12_000_000
"""Coordinates of all joints that are looked at together to find the feet; of longer examples, every second frame or
fewer."""

RAMP_S = 0.080
"""Length of the ramps of the stored values."""


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """Contacts that an author states: a joint, a part or (None) all, and intervals (R, 2) of canonical time by example.

    Examples that are not named keep what detection finds.
    """

    joint: int
    part: int | None
    intervals: Mapping[int, F64]


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """One example at 60 Hz, of a loop three cycles.

    Parameters
    ----------
    phases : (F,) float64
    rotations : (F, J, 4) float64
        Global rotations.
    positions : (F, J, 3) float64
        Joint positions, metres.
    """

    phases: F64
    rotations: F64
    positions: F64

    def path(self, point: Point) -> F64:
        """Positions (F, 3) of a point."""
        return point_positions(self.rotations, self.positions, point.joint, point.offset)


def clips(evaluator: Evaluator) -> list[Clip]:
    """Examples of a verb, sampled, and rotated so that their ground is level."""
    found = []
    for blend in examples(evaluator):
        phases, rotations, positions = sampled_rotations(evaluator, blend)
        found.append(Clip(phases, *from_ground(evaluator, blend, phases, rotations, positions)))
    return found


def find(verb: Verb, stated: Sequence[Stated] = ()) -> Contacts | None:
    """Contacts of a verb's examples; None where its skeleton has no feet and none are stated.

    Heights, speeds and durations are those of this module. The ground of a verb is level, or the inclined plane
    along which its examples climb; its height is where feet stand, in each example of its own.

    Parameters
    ----------
    verb : Verb
    stated : sequence of Stated
        Contacts that replace those that are found.

    Raises
    ------
    UnknownName
        A stated part that its foot does not have.
    """
    sampled = clips(Evaluator(verb))
    points, heights = stand(verb, sampled)
    found = {
        (i, p): intervals(clip, detect(verb, clip, point, heights[i, p]), looping=verb.looping)
        for i, clip in enumerate(sampled)
        for p, point in enumerate(points)
    }
    for one in stated:
        chosen, heights = _points_of(one, verb.skeleton.names[one.joint], sampled, points, heights)
        for p in chosen:
            for i in range(len(sampled)):
                found[i, p] = one.intervals.get(i, found.get((i, p), np.zeros((0, 2))))
    return assemble(verb, points, heights, found) if points else None


def _points_of(one: Stated, name: str, sampled: list[Clip], points: list[Point], heights: F64) -> tuple[list[int], F64]:
    """Points that a stated contact is about; a joint that is no foot becomes one, and its height is that at contact."""
    own = [p for p, point in enumerate(points) if point.foot == one.joint]
    if own:
        chosen = [p for p in own if one.part in (None, points[p].part)]
        if not chosen:
            raise UnknownName(f"part of '{name}'", PARTS[one.part or 0], [PARTS[points[p].part] for p in own])
        return chosen, heights
    if one.part not in (None, FOOT):
        raise UnknownName(f"part of '{name}'", PARTS[one.part], [PARTS[FOOT]])
    point = Point(one.joint, FOOT, one.joint, np.zeros(3))
    rows = [_inside(sampled[i].phases, spans) for i, spans in one.intervals.items()]
    paths = [sampled[i].path(point)[row, 1] for i, row in zip(one.intervals, rows, strict=True) if row.any()]
    height = float(np.median(np.concatenate(paths))) if paths else min(_level(clip.path(point)) for clip in sampled)
    points.append(point)
    return [len(points) - 1], np.concatenate([heights, _figures(np.full((len(sampled), 1), height))], axis=1)


def _inside(phases: F64, spans: F64) -> Flags:
    """Whether phases (F,) lie in one of the spans (R, 2), in any cycle."""
    local = phases[:, None] % 1.0 if len(phases) and phases[-1] > 1.0 else phases[:, None]
    return np.asarray(
        (((local >= spans[:, 0]) & (local <= spans[:, 1])) | (local + 1.0 <= spans[:, 1])).any(axis=1), np.bool_
    )


def stand(verb: Verb, sampled: list[Clip]) -> tuple[list[Point], F64]:
    """Points of all feet, and the height (N, P) of each in each example while it stands."""
    step = 1 + sum(clip.positions.size for clip in sampled) // MOST_NUMBERS
    rotations = np.concatenate([clip.rotations[::step] for clip in sampled])
    positions = np.concatenate([clip.positions[::step] for clip in sampled])
    found = feet(verb.skeleton, rotations, positions)
    if not found:
        return [], np.zeros((len(sampled), 0))
    balls = [foot[0] for foot in found]
    levels = np.array([[_level(clip.path(ball)) for ball in balls] for clip in sampled])
    usual = np.median(levels, axis=0)
    ground = (levels - usual).min(axis=1)  # of the foot that stands; the other may be in the air all the time
    above = np.repeat(ground, [len(clip.phases[::step]) for clip in sampled])
    points: list[Point] = []
    heights: list[float] = []
    for ball, level, foot in zip(balls, usual, found, strict=True):
        flat = _flat(verb, ball, level, rotations, positions, above)
        heel = _heel(ball, rotations[flat], positions[flat])
        for point in [*heel, *foot]:
            path = point_positions(rotations[flat], positions[flat], point.joint, point.offset)
            points.append(point)
            heights.append(float(np.median(path[:, 1] - above[flat])))
    return points, _figures(np.array(heights) + ground[:, None])


def _figures(metres: F64) -> F64:
    """Lengths to 0.1 µm, without negative zeros: digits below depend on the order of sums."""
    return np.asarray(np.round(metres, 7) + 0.0)


def _level(path: F64) -> float:
    """Height at which a point stands: low among its slow frames."""
    speeds = _speeds(path)
    slow = path[speeds <= max(ON_M_S, float(np.percentile(speeds, 30.0))), 1]
    return float(np.percentile(slow, 20.0))


def _flat(verb: Verb, ball: Point, level: float, rotations: F64, positions: F64, above: F64) -> Flags:
    """Frames (F,) in which a foot is flat on the ground: the ball is low, and the ankle as low as it gets then."""
    height = point_positions(rotations, positions, ball.joint, ball.offset)[:, 1] - above
    low = np.abs(height - level) <= ON_M * leg_length(verb.skeleton, ball.foot) / LEG_M
    if not low.any():
        low = height <= np.percentile(height, 5.0)
    ankle = positions[:, ball.foot, 1] - above
    return np.asarray(low & (ankle <= np.percentile(ankle[low], 100.0 * FLAT_SHARE)))


def _heel(ball: Point, rotations: F64, positions: F64) -> list[Point]:
    """The heel of a flat foot: below and behind the ankle, on the level of the ball; none of a foot on its toes."""
    if ball.part != BALL:
        return []
    inverse = quat.conjugate(rotations[:, ball.foot])
    up = np.median(quat.rotate(inverse, np.array([0.0, 1.0, 0.0])), axis=0)
    up /= np.linalg.norm(up)
    reach = np.median(quat.rotate(inverse, positions[:, ball.joint] - positions[:, ball.foot]), axis=0)
    drop = float(reach @ up)
    ahead = reach - drop * up
    if -drop > np.tan(SLOPE_RAD) * np.linalg.norm(ahead):
        return []
    return [Point(ball.foot, HEEL, ball.foot, _figures(drop * up - HEEL_SHARE * ahead))]


def _speeds(path: F64) -> F64:
    """Speeds (F,) of a path (F, 3) at 60 Hz, over two frames."""
    if len(path) < 2:
        return np.zeros(len(path))
    return np.asarray(np.linalg.norm(np.gradient(path, 1.0 / RATE_HZ, axis=0), axis=1))


def _root_speeds(clip: Clip) -> F64:
    """Mean speed (F,) of the root over the ground, in a window."""
    path = clip.positions[:, 0] * np.array([1.0, 0.0, 1.0])
    half = int(0.5 * ROOT_WINDOW_S * RATE_HZ)
    frames = np.arange(len(path))
    first, last = np.maximum(frames - half, 0), np.minimum(frames + half, len(path) - 1)
    return np.asarray(np.linalg.norm(path[last] - path[first], axis=1) * RATE_HZ / np.maximum(last - first, 1))


def detect(verb: Verb, clip: Clip, point: Point, height: float) -> Flags:
    """Frames (F,) in which a point stands, given its standing height."""
    path = clip.path(point)
    scale = leg_length(verb.skeleton, point.foot) / LEG_M
    return standing(_speeds(path), path[:, 1] - height, _root_speeds(clip), scale or 1.0)


def standing(speeds: F64, heights: F64, root_speeds: F64, scale: float = 1.0) -> Flags:
    """Detect contact with hysteresis.

    Parameters
    ----------
    speeds, heights : (F,) float64
        Speed (m/s) of a point, and height above its standing height (m), at 60 Hz.
    root_speeds : (F,) float64
        Mean speed of the root, m/s.
    scale : float
        Length of the leg relative to that of a human.

    Returns
    -------
    standing : (F,) bool
    """
    begins = (speeds < scale * ON_M_S + ON_SHARE * root_speeds) & (heights < scale * ON_M)
    continues = (speeds < scale * OFF_M_S + OFF_SHARE * root_speeds) & (heights < scale * OFF_M)
    out = np.zeros(len(speeds), np.bool_)
    for first, last in runs(continues):
        out[first:last] = begins[first:last].any()
    return _tidied(out)


def _tidied(flags: Flags) -> Flags:
    """Contact (F,) at 60 Hz with short gaps closed, then short contacts dropped."""
    out = flags.copy()
    for first, last in runs(~out):
        if first > 0 and last < len(out) and last - first < SHORTEST_GAP_S * RATE_HZ:
            out[first:last] = True
    for first, last in runs(out):
        if last - first < SHORTEST_S * RATE_HZ and last - first < len(out):
            out[first:last] = False
    return out


def runs(flags: Flags) -> I64:
    """First frames, and frames after the last, (R, 2) of the runs in which flags (F,) are set."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int64), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def intervals(clip: Clip, flags: Flags, *, looping: bool) -> F64:
    """Intervals (R, 2) of canonical time of the runs of flags (F,); of a loop, those that begin in its middle cycle."""
    found = []
    for first, last in runs(flags):
        begin, end = clip.phases[first], clip.phases[last - 1]
        if looping:
            if first == 0 and last == len(flags):
                return np.array([[0.0, 1.0]])
            if begin // 1.0 == MIDDLE:
                found.append((begin - MIDDLE, min(end, begin + 1.0) - MIDDLE))
        else:
            found.append((begin if first else 0.0, end if last < len(flags) else 1.0))
    return np.round(np.array(found, np.float64).reshape(-1, 2), 9)


def assemble(verb: Verb, points: list[Point], heights: F64, found: Mapping[tuple[int, int], F64]) -> Contacts:
    """Contacts of intervals (R, 2) by example and point, with their values over canonical time."""
    count = len(verb.examples)
    values = np.zeros((verb.intervals + 1, count, len(points)), np.float32)
    grid = np.arange(verb.intervals + 1) / verb.intervals
    rows: list[F64] = []
    owners: list[tuple[int, int]] = []
    for i in range(count):
        clock = _Clock(verb, i)
        seconds = clock.seconds(grid)
        for p in range(len(points)):
            own = found[i, p]
            rows.append(own)
            owners += [(i, p)] * len(own)
            values[:, i, p] = ramps(seconds, clock.seconds(own), verb.keytimes[i, -1], looping=verb.looping)
    return Contacts(
        feet=np.array([point.foot for point in points], np.int64),
        joints=np.array([point.joint for point in points], np.int64),
        parts=np.array([point.part for point in points], np.int64),
        offsets=np.array([point.offset for point in points], np.float64),
        heights=heights,
        values=values,
        intervals=np.concatenate(rows),
        owners=np.array(owners, np.int64).reshape(-1, 2),
    )


@dataclass(frozen=True, slots=True)
class _Clock:
    """Canonical time and seconds of one example."""

    verb: Verb
    example: int

    def seconds(self, phases: F64) -> F64:
        """Seconds from the first keytime at phases of any shape, beyond 1 too."""
        marks, cycles = self.verb.keytimes[self.example], np.floor(phases)
        local = (phases - cycles).ravel()
        at = curves.warp(marks, self.verb.phases, local, looping=self.verb.looping).reshape(phases.shape)
        return np.asarray(at + cycles * marks[-1])


def ramps(seconds: F64, spans: F64, length_s: float, *, looping: bool) -> F32:
    """Values (K + 1,) at seconds (K + 1,): 1 inside the spans (R, 2), 0 outside, smooth ramps around their ends.

    A ramp is 1/2 at the end of its span, and at most as long as the span. There is none at the ends of a motion that
    does not loop.
    """
    out = np.zeros(len(seconds))
    for begin, end in spans:
        if looping and end - begin >= length_s - 1e-9:
            return np.ones(len(seconds), np.float32)
        width = min(RAMP_S, end - begin)
        for shift in (-length_s, 0.0, length_s) if looping else (0.0,):
            up = smootherstep((seconds - begin - shift) / width + 0.5)
            down = smootherstep((end + shift - seconds) / width + 0.5)
            at_start = not looping and begin <= 1e-9
            at_end = not looping and end >= length_s - 1e-9
            out += (1.0 if at_start else up) * (1.0 if at_end else down)
    return np.clip(out, 0.0, 1.0).astype(np.float32)
