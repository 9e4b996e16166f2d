"""Planted feet of a verb: places where the feet of its examples stand, and the legs that reach them.

Source: ``docs/math.md``, section "Planted feet".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from verbs.contacts import PARTS, Contacts
from verbs.conventions import F32, F64, I64
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels import quat
from verbs.kernels.crowd_pose import blend_sorted, curves_of
from verbs.kernels.easing import smootherstep
from verbs.kernels.legs import Legs
from verbs.kernels.stances import COLUMNS, I8, Plants
from verbs.verb import Verb

__all__ = ["Planting", "planting_of"]

Flags = npt.NDArray[np.bool_]

RATE_HZ = 40.0
"""Samples per second of the longest example."""

LEAST, MOST = 32, 600
"""Fewest and most samples."""

INNER_S, OUTER_S = 0.04, 0.2
"""Times over which heights of points are taken over within a contact, and given back outside."""

FOLLOW_S = 0.15
"""Time over which a path of an example passes from its own to that of a standing point."""

QUIET_S, FREE_S = 0.6, 0.1
"""Times before and after the effector's keytime in which the pelvis stays where it is, and a foot that carries the
effector is free."""

_HEEL, _BALL, _TOE, _FOOT = range(len(PARTS))
_PARTS = (_HEEL, _BALL, _TOE)


@dataclass(frozen=True, slots=True, eq=False)
class Planting:
    """Feet of a verb, prepared.

    Parameters
    ----------
    plants : Plants
    legs : Legs
    joints : (F,) int64
        Joint that is each foot.
    levels : (F, 3) float64
        Standing heights of heel, ball and tip, metres; the mean of the examples.
    """

    plants: Plants
    legs: Legs
    joints: I64
    levels: F64


def planting_of(verb: Verb) -> Planting:
    """Prepare the feet of a verb; none where it has no contacts, or no foot has a hip and a knee."""
    contacts = verb.contacts
    known = [] if contacts is None else dict.fromkeys(contacts.feet.tolist())
    feet = [foot for foot in known if len(verb.skeleton.chain(foot)) >= 4]
    if contacts is None or not feet:
        return _no_feet(verb)
    samples = int(np.clip(np.ceil(RATE_HZ * verb.keytimes[:, -1].max()), LEAST, MOST))
    clips = [_Clip.of(verb, example, samples) for example in range(len(verb.examples))]
    points = [_points(contacts, foot) for foot in feet]
    legs = _legs(verb, contacts, feet, points, clips)
    flat = np.array([_flat(contacts, *each) for each in zip(points, legs.points, legs.known, strict=True)])
    rises = np.zeros((len(verb.examples), len(feet), 2))
    contact = np.zeros((len(feet), samples + 1, 3, len(verb.examples)), np.float32)
    track = np.zeros((len(feet), samples + 1, len(verb.examples), COLUMNS), np.float32)
    for f, own in enumerate(points):
        for i, clip in enumerate(clips):
            source = _Source(verb, contacts, own, clip, i, samples)
            contact[f, :, :, i] = source.contact
            track[f, :, i], rises[i, f] = _tracked(source, legs.sides[f], flat[f])
    quiet, effector = _quiet(verb, legs)
    plants = Plants(contact, _sure(contact), track, flat, rises, verb.strides, verb.looping, quiet, effector)
    levels = [[contacts.heights[:, own.get(part, own[_BALL])].mean() for part in _PARTS] for own in points]
    return Planting(plants, legs, np.array(feet, np.int64), np.array(levels))


def _sure(contact: F32) -> I8:
    """Where all examples stand (1) or none does (-1); see :class:`verbs.kernels.stances.Plants`."""
    stands, lifted = np.any(np.all(contact >= 1.0, axis=3), axis=2), np.all(contact <= 0.0, axis=(2, 3))
    return np.asarray(stands.astype(np.int8) - lifted.astype(np.int8), np.int8)


def _no_feet(verb: Verb) -> Planting:
    """Empty arrays of the same types."""
    count = len(verb.examples)
    contact, track = np.zeros((0, 2, 3, count), np.float32), np.zeros((0, 2, count, COLUMNS), np.float32)
    flat, rises = np.zeros((0, 2)), np.zeros((count, 0, 2))
    plants = Plants(contact, _sure(contact), track, flat, rises, verb.strides, verb.looping, np.zeros(3), -1)
    chains, known = np.zeros((0, 4), np.int64), np.zeros((0, 3), np.int64)
    legs = Legs(chains, np.zeros((0, 3, 3)), known, np.zeros((0, 3)), np.zeros((0, 3)), verb.skeleton.offsets)
    return Planting(plants, legs, np.zeros(0, np.int64), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class _Clip:
    """One example at the sample phases, of a loop in its first three cycles, placed as it travels.

    Parameters
    ----------
    phases : (F,) float64
    rotations, positions : (F, J, 4), (F, J, 3) float64
        Global.
    places : (F, 4) float64
        x, z (m), heading (rad) and height (m) of the root's frame; zero where the root does not stride.
    """

    phases: F64
    rotations: F64
    positions: F64
    places: F64

    @classmethod
    def of(cls, verb: Verb, example: int, samples: int) -> _Clip:
        size = (3 if verb.looping else 1) * samples + 1
        phases = np.arange(size) / samples
        weights = np.zeros((size, len(verb.examples)))
        weights[:, example] = 1.0
        root, rotations = np.empty((size, 3)), np.empty((size, len(verb.skeleton), 4))
        curves = curves_of(verb.curves, verb.rotation_mode, verb.references)
        blend_sorted(weights, phases % 1.0 if verb.looping else phases, curves, root, rotations)
        places = np.zeros((size, 4))
        if verb.root_motion == poses.STRIDE:
            places = poses.travelled(weights, verb.strides, phases, looping=verb.looping)
            poses.travel(weights, verb.strides, phases, verb.looping, True, root, rotations)
        found = np.empty_like(rotations), np.empty((*rotations.shape[:2], 3))
        poses.forward(root, rotations, verb.skeleton.parents, verb.skeleton.offsets, *found)
        return cls(phases, *found, places)

    def path(self, joint: int, offset: F64) -> F64:
        """Positions (F, 3) of a point that a joint carries."""
        return np.asarray(self.positions[:, joint] + quat.rotate(self.rotations[:, joint], offset))


def _points(contacts: Contacts, foot: int) -> dict[int, int]:
    """Points of a foot by part; the point of a foot without a toe joint counts as its ball."""
    found = {int(contacts.parts[p]): p for p in np.flatnonzero(contacts.feet == foot).tolist()}
    if _BALL not in found:
        found[_BALL] = found[_FOOT] if _FOOT in found else next(iter(found.values()))
    return found


def _legs(verb: Verb, contacts: Contacts, feet: list[int], points: list[dict[int, int]], clips: list[_Clip]) -> Legs:
    """Chains, points and sizes of the feet; see :class:`verbs.kernels.legs.Legs`."""
    chains, sides = [], []
    places, known = np.zeros((len(feet), 3, 3)), np.zeros((len(feet), 3), np.int64)
    for f, (foot, own) in enumerate(zip(feet, points, strict=True)):
        ball = own[_BALL]
        toe = int(contacts.joints[own[_TOE]]) if _TOE in own else -1
        toe = toe if toe >= 0 and verb.skeleton.parents[toe] == foot else -1
        chains.append([*verb.skeleton.chain(foot).tolist(), toe])
        places[f, 1] = _in_ankle(contacts, foot, ball, clips)
        known[f, 1] = 1
        if _HEEL in own:
            places[f, 0], known[f, 0] = _in_ankle(contacts, foot, own[_HEEL], clips), 1
        if _TOE in own:
            known[f, 2] = 1
            places[f, 2] = contacts.offsets[own[_TOE]] if toe >= 0 else _in_ankle(contacts, foot, own[_TOE], clips)
        sides.append(_side(contacts, foot, ball, places[f], clips))
    longest = max(len(chain) for chain in chains)
    padded = np.array([[-1] * (longest - len(chain)) + chain for chain in chains], np.int64)
    hinges = np.array([_hinge(chain, clips) for chain in padded])
    return Legs(padded, places, known, np.array(sides), hinges, verb.skeleton.offsets)


def _in_ankle(contacts: Contacts, foot: int, point: int, clips: list[_Clip]) -> F64:
    """Position (3,) of a point in the frame of the ankle: the median of all frames, where other joints carry it."""
    joint, offset = int(contacts.joints[point]), contacts.offsets[point]
    if joint == foot:
        return np.asarray(offset)
    found = [
        quat.rotate(quat.conjugate(clip.rotations[:, foot]), clip.path(joint, offset) - clip.positions[:, foot])
        for clip in clips
    ]
    return np.asarray(np.median(np.concatenate(found), axis=0))


def _hinge(chain: I64, clips: list[_Clip]) -> F64:
    """Unit axis (3,) in the frame of the hip about which a knee bends, as in the frames in which it is bent."""
    hip, knee, ankle = chain[-4:-1]
    total = np.zeros(3)
    for clip in clips:
        upper = clip.positions[:, knee] - clip.positions[:, hip]
        lower = clip.positions[:, ankle] - clip.positions[:, knee]
        total += quat.rotate(quat.conjugate(clip.rotations[:, hip]), np.cross(upper, lower)).sum(axis=0)
    size = float(np.linalg.norm(total))
    return total / size if size > 1e-9 else np.array([1.0, 0.0, 0.0])


def _side(contacts: Contacts, foot: int, ball: int, places: F64, clips: list[_Clip]) -> F64:
    """Unit axis (3,) to the left of a foot in the ankle's frame, from the frames in which its ball is lowest."""
    rotations = np.concatenate([clip.rotations[:, foot] for clip in clips])
    heights = np.concatenate([clip.path(int(contacts.joints[ball]), contacts.offsets[ball])[:, 1] for clip in clips])
    low = rotations[heights <= np.percentile(heights, 30.0)]
    up = np.median(quat.rotate(quat.conjugate(low), np.array([0.0, 1.0, 0.0])), axis=0)
    forward = places[1] - places[0]  # from heel to ball; from the ankle where there is no heel
    side = np.cross(up, forward)
    size = float(np.linalg.norm(side))
    return np.asarray(side / size) if size > 1e-6 else np.array([1.0, 0.0, 0.0])


def _flat(contacts: Contacts, own: dict[int, int], places: F64, known: I64) -> tuple[float, float]:
    """Distances over the ground from heel to ball and from ball to tip of a flat foot."""
    heights = contacts.heights.mean(axis=0)
    back = ahead = 0.0
    if known[0]:
        length = float(np.linalg.norm(places[1] - places[0]))
        back = float(np.sqrt(max(length**2 - (heights[own[_BALL]] - heights[own[_HEEL]]) ** 2, 0.0)))
    if known[2]:
        length = float(np.linalg.norm(places[2]))
        ahead = float(np.sqrt(max(length**2 - (heights[own[_TOE]] - heights[own[_BALL]]) ** 2, 0.0)))
    return back, ahead


class _Source:
    """One foot in one example.

    Parameters
    ----------
    verb : Verb
    contacts : Contacts
    own : dict of int to int
        Points of the foot by part.
    clip : _Clip
    example, samples : int

    Attributes
    ----------
    contact : (M + 1, 3) float32
        Of heel, ball and tip.
    standing : (F,) bool
        Whether any of them stands, over all cycles of the clip.
    second : float
        Seconds of one sample, on average.
    """

    def __init__(
        self, verb: Verb, contacts: Contacts, own: dict[int, int], clip: _Clip, example: int, samples: int
    ) -> None:
        self.verb, self.contacts, self.own, self.clip, self.example = verb, contacts, own, clip, example
        self.grid = np.arange(samples + 1) / samples
        self.length_s = float(verb.keytimes[example, -1])
        self.second = self.length_s / samples
        self.contact = np.zeros((samples + 1, 3), np.float32)
        keys = np.arange(contacts.values.shape[0]) / (contacts.values.shape[0] - 1)
        for k, part in enumerate(_PARTS):
            if part in own:
                self.contact[:, k] = np.interp(self.grid, keys, contacts.values[:, example, own[part]])
        self._cycle = np.arange(len(clip.phases)) % samples
        self._cycle[-1] = 0 if verb.looping else samples
        self.standing = self.contact.max(axis=1)[self._cycle] >= 0.5
        self.rows = np.arange(samples + 1) + (samples if verb.looping else 0)
        self.at = clip.places[self.rows]

    def stands(self, part: int) -> Flags:
        """Whether a point stands (F,); the ball where the foot does not have it."""
        k = _PARTS.index(part if part in self.own else _BALL)
        return np.asarray(self.contact[:, k][self._cycle] >= 0.5)

    def path(self, part: int) -> F64:
        """Path (F, 3) of a point; that of the ball where the foot does not have it."""
        point = self.own.get(part, self.own[_BALL])
        return self.clip.path(int(self.contacts.joints[point]), self.contacts.offsets[point])

    def level(self, part: int) -> F64:
        """Height (F,) of the ground under a point, where it stands, and on the straight way from stance to stance."""
        point, path = self.own.get(part, self.own[_BALL]), self.path(part)
        if not self.verb.strides[:, :, 3].any():  # level ground
            return np.full(len(path), self.contacts.heights[self.example, point])
        stands = self.stands(part)
        if not stands.any():
            return path[:, 1]
        return _ground(path, _places(path, stands, stands), np.flatnonzero(stands))


def _ground(path: F64, places: F64, standing: I64) -> F64:
    """Height (F,) under a path (F, 3), between its places (F, 3) in the frames in which it is ``standing``."""
    heights = places[:, 1].copy()
    for first, last in zip(standing[:-1].tolist(), standing[1:].tolist(), strict=True):
        if last > first + 1:
            way = (places[last] - places[first])[[0, 2]]
            gone = (path[first : last + 1] - places[first])[:, [0, 2]] @ way / max(float(way @ way), 1e-6)
            heights[first : last + 1] += np.clip(gone, 0.0, 1.0) * (places[last, 1] - places[first, 1])
            heights[last] = places[last, 1]
            heights[first + 1 : last] += places[first, 1] - places[first + 1 : last, 1]
    return heights


def _tracked(source: _Source, side: F64, sizes: F64) -> tuple[F32, F64]:
    """Track (M + 1, 24) of one foot in one example, and its rises (2,); see :class:`verbs.kernels.stances.Plants`."""
    rows, at, standing, second = source.rows, source.at, source.standing, source.second
    left = quat.rotate(source.clip.rotations[:, int(source.contacts.feet[source.own[_BALL]])], side)
    yaw = np.unwrap(np.arctan2(-left[:, 2], left[:, 0]))
    flat = source.stands(_HEEL) & source.stands(_BALL)
    ball = _places(source.path(_BALL)[:, [0, 2]], standing, source.stands(_BALL))
    tip = _places(source.path(_TOE)[:, [0, 2]], standing, source.stands(_TOE))
    turned = _places(yaw[:, None], standing, flat)[:, 0]
    heading = _followed(yaw[:, None], turned[:, None], standing & flat, second)[:, 0]
    levels = [source.level(part) for part in _PARTS]
    out = np.zeros((len(rows), COLUMNS), np.float32)
    out[:, 9] = levels[1][rows] - at[:, 3]
    out[:, 10], out[:, 11] = _local(ball[rows], at)
    out[:, 12], out[:, 13] = _local(tip[rows], at)
    out[:, 14], out[:, 15] = np.sin(turned[rows] - at[:, 2]), np.cos(turned[rows] - at[:, 2])
    heel = ball - sizes[0] * np.stack([np.sin(turned), np.cos(turned)], axis=-1)
    for k, (part, place) in enumerate(zip(_PARTS, (heel, ball, tip), strict=True)):
        if part in source.own:
            spans = source.contacts.of(source.example, source.own[part])
            for column, after_s in ((k, OUTER_S), (3 + k, INNER_S)):
                looping = source.verb.looping
                out[:, column] = _faded(source.grid, spans, source.length_s, after_s, looping=looping)
        path, stands = source.path(part), source.stands(part)
        height = _followed(path[:, 1:2], levels[k][:, None], stands, second)[rows, 0]
        out[:, 6 + k] = height - at[:, 3]
        followed = _followed(path[:, [0, 2]], place, stands & standing, second)
        out[:, 16 + 2 * k], out[:, 17 + 2 * k] = _local(followed[rows], at)
    out[:, 22], out[:, 23] = np.sin(heading[rows] - at[:, 2]), np.cos(heading[rows] - at[:, 2])
    rises = [float(np.median((levels[k] - levels[1])[flat if flat.any() else slice(None)])) for k in (0, 2)]
    return out, np.array(rises)


def _local(path: F64, at: F64) -> tuple[F64, F64]:
    """X and z (M + 1,) of a path (M + 1, 2) in frames at places (M + 1, 3)."""
    cosine, sine = np.cos(at[:, 2]), np.sin(at[:, 2])
    x, z = path[:, 0] - at[:, 0], path[:, 1] - at[:, 1]
    return x * cosine - z * sine, x * sine + z * cosine


def _followed(path: F64, held: F64, standing: Flags, step_s: float) -> F64:
    """A path (F, d) that is ``held`` (F, d) while a point stands, and passes to it smoothly before and after."""
    out, edges = path.copy(), np.diff(np.concatenate([[0], standing.astype(np.int64), [0]]))
    spans = list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
    reach = max(1, round(FOLLOW_S / step_s))
    for k, (first, last) in enumerate(spans):
        out[first : last + 1] = held[first : last + 1]
        before = spans[k - 1][1] if k else -1
        after = spans[k + 1][0] if k + 1 < len(spans) else len(path)
        for edge, end in ((first, max(before, first - reach)), (last, min(after, last + reach))):
            steps = np.arange(1, abs(end - edge))
            rows = edge + np.sign(end - edge) * steps
            fall = 1.0 - smootherstep(steps / max(abs(end - edge), 1))
            out[rows] += fall[:, None] * (held[edge] - path[edge])
    return out


def _faded(grid: F64, spans: F64, length_s: float, after_s: float, *, looping: bool) -> F64:
    """Contact (M + 1,) at phases (M + 1,) that is 1/2 at the ends of spans (R, 2), rises inside and fades out.

    It fades in within :data:`OUTER_S`, and out within ``after_s``.
    """
    out = np.zeros(len(grid))
    for begin, end in spans:
        if looping and end - begin >= 1.0 - 1e-9:
            return np.ones(len(grid))
        for shift in (-1.0, 0.0, 1.0) if looping else (0.0,):
            first = -np.inf if not looping and begin <= 1e-9 else begin + shift
            last = np.inf if not looping and end >= 1.0 - 1e-9 else end + shift
            inside = np.minimum(grid - first, last - grid) * length_s
            outer = np.where(grid < first, OUTER_S, after_s)
            rising, fading = 0.5 + 0.5 * smootherstep(inside / INNER_S), 0.5 * (1.0 - smootherstep(-inside / outer))
            out = np.maximum(out, np.where(inside >= 0.0, rising, fading))
    return out


def _places(path: F64, standing: Flags, chosen: Flags) -> F64:
    """Mean of a path (F, d) in the nearest stance, at every sample; the path where there is none.

    The mean is that of the first run of ``chosen`` (F,) frames of the stance, if it has any.
    """
    out, edges = path.copy(), np.diff(np.concatenate([[0], standing.astype(np.int64), [0]]))
    stances = np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1], axis=1)
    if not len(stances):
        return out
    frames = np.arange(len(path))
    nearest = np.argmin(np.maximum(np.maximum(stances[:, :1] - frames, frames - stances[:, 1:]), 0), axis=0)
    for k, (first, last) in enumerate(stances.tolist()):
        inside = np.zeros(len(path), np.bool_)
        inside[first : last + 1] = chosen[first : last + 1] if chosen[first : last + 1].any() else True
        begin = int(np.argmax(inside))
        run = begin + (int(np.argmin(inside[begin:])) or len(path))
        out[nearest == k] = path[begin:run].mean(axis=0)
    return out


def _quiet(verb: Verb, legs: Legs) -> tuple[F64, int]:
    """Phase and width of the effector's keytime, and the foot that carries the effector.

    Where adverbs name measures of their own, the first position among them counts.
    """
    measure = verb.measure
    placed = [row.spans[0] for row in measure.rows if row.kind == "position"]
    if measure.kind != measures.POSITION and not placed:
        return np.zeros(3), -1
    phase = placed[0].begin if placed else float(verb.phases[measure.keytime])
    effector = placed[0].joint if placed else measure.effector
    carried = [f for f, chain in enumerate(legs.chains) if effector in chain.tolist()]
    widths = np.array([QUIET_S, FREE_S]) / float(np.median(verb.keytimes[:, -1]))
    return np.array([phase, *widths]), carried[0] if carried else -1
