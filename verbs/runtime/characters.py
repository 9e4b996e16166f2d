"""Moving characters of one verb, each with goal, phase, position and transition, stepped together.

A server's tick and a game's frame are one call of :meth:`Characters.step`: adverbs follow their goals, phases advance,
poses result, in a few compiled calls for any number of characters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from verbs.blend.corrected import Corrected
from verbs.conventions import F32, F64, I64
from verbs.errors import OutOfRange
from verbs.kernels import character_state, inertialization
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.character_state import PROGRESS, Advanced, Crowd, Records
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Blended
from verbs.kernels.following import NO_WINDOW, FollowProblem, follow
from verbs.runtime import transition
from verbs.runtime.character_pool import CharacterPool, Frames, Step
from verbs.runtime.evaluate import Blend, Evaluator, blend_poses

__all__ = ["HALF_LIFE_S", "MAX_SPEED", "MAX_TRANSITION_S", "RESTART_S", "VERSION_S", "Characters", "Frames", "Step"]

_steer, _gather, _keep = (direct(one) for one in (character_state.steer, character_state.gather, character_state.keep))
_advance, _follow, _walk = (direct(one) for one in (character_state.advance, follow, character_state.walk))
_copy_single, _copy_double = direct(character_state.copy_rows), direct(character_state.copy_rows)
_poses = direct(inertialization.poses)
_apply, _redisplay = direct(inertialization.apply), direct(inertialization.redisplay)
_restart = direct(inertialization.restart)

HALF_LIFE_S = 0.1
MAX_SPEED = 10.0
MAX_TRANSITION_S = 5.0
VERSION_S = 0.15
"""Length of the transition from one version of a verb to the next."""
RESTART_S = 0.3
"""Length of the transition with which a motion that does not loop starts over."""

_HALVED = 1.6783469900166605
"""Where (1 + x) · exp(-x) is one half: a critically damped spring from rest has covered half its distance."""


class Characters(CharacterPool):
    """Characters of one verb and method.

    Parameters
    ----------
    evaluator : Evaluator
    method : str, optional
        The verb's own unless given.

    Examples
    --------
    >>> import numpy as np
    >>> from verbs import Characters, Evaluator, library
    >>> people = Characters(Evaluator(library.load("reach")))
    >>> anna = people.add({"x": -0.3, "y": 1.2, "z": 0.5})
    >>> frames = people.step(np.array([anna]), 1 / 60)
    >>> frames.root.shape, frames.rotations.shape
    ((1, 3), (1, 28, 4))
    """

    def __init__(self, evaluator: Evaluator, method: str | None = None) -> None:
        super().__init__(evaluator.verb)
        self.evaluator = evaluator
        self.method, prepared = evaluator.method(method)
        self.window = evaluator.follow_window() if isinstance(prepared, Corrected) else None
        self.striding = self.verb.root_motion == poses.STRIDE
        self.curves = evaluator.curves
        joints, count = len(self.verb.skeleton), len(self.verb.examples)
        self._nothing = np.zeros((0, count)), np.zeros((0, 3)), np.zeros((0, joints, 4))
        self._following: FollowProblem | None = None
        if self.window and isinstance(prepared, Corrected):
            self._following = _follow_problem(prepared, self.window)

    def add(
        self,
        adverbs: Mapping[str, float] | F64 | None = None,
        *,
        phase: float = 0.0,
        speed: float = 1.0,
        playing: bool = True,
        looping: bool | None = None,
        half_life_s: float = HALF_LIFE_S,
        following: bool = True,
    ) -> int:
        """A new character; return its slot.

        Parameters
        ----------
        adverbs : mapping or (D,) float64, optional
            The middle of the domain unless given.
        phase : float
            0 to 1.
        speed : float
            -10 to 10; 1 is the examples' own.
        playing : bool
        looping : bool, optional
            As the verb unless given. A motion that is no loop starts over with a transition.
        half_life_s : float
            Seconds in which half of the distance to a new goal is covered; 0 moves at once.
        following : bool
            Whether the effector is on its goal while the character is paused within the follow window.

        Raises
        ------
        RequestError
            An adverb is unknown, missing or not finite, or a number is out of range.
        """
        row = self.row(adverbs)
        slot = self._take()
        self.state["speed"][slot] = self.state["fresh"][slot] = 1.0
        crowd = self.crowd
        crowd.goals[slot] = crowd.seen[slot] = row
        crowd.targets[slot] = crowd.shown[slot] = self.verb.domain.chart.points(row[None])[0]
        crowd.velocity[slot], crowd.known[slot] = 0.0, 0
        try:
            loops = self.verb.looping if looping is None else looping
            self.set(
                slot,
                phase=phase,
                speed=speed,
                playing=playing,
                looping=loops,
                half_life_s=half_life_s,
                following=following,
            )
        except OutOfRange:
            self.remove(slot)
            raise
        return slot

    def row(self, adverbs: Mapping[str, float] | F64 | None) -> F64:
        """Checked adverbs (D,); the middle of the domain for None."""
        if adverbs is None:
            domain = self.verb.domain
            rows = domain.chart.adverbs(domain.middle[None])
        elif isinstance(adverbs, Mapping):
            rows = self.evaluator.adverbs(adverbs)
        else:
            rows = self.evaluator.check(np.atleast_2d(adverbs))
        return np.asarray(rows[0])

    def aim(self, slot: int, row: F64) -> None:
        """Give a character another goal: checked adverbs (D,)."""
        self.goals[slot] = row

    def aim_many(self, slots: I64, rows: F64 | F32) -> None:
        """Give characters (n,) other goals (n, D), float32 or float64, which the caller has checked to be finite."""
        copy = _copy_single if rows.dtype == np.float32 else _copy_double
        copy(np.ascontiguousarray(slots, np.int64), np.ascontiguousarray(rows), self.goals)

    def set(
        self,
        slot: int,
        *,
        phase: float | None = None,
        speed: float | None = None,
        playing: bool | None = None,
        looping: bool | None = None,
        half_life_s: float | None = None,
        following: bool | None = None,
    ) -> None:
        """Change how a character plays; a phase applies at once. Raises :class:`OutOfRange`."""
        row = self.state[slot]
        for name, value, low, high in (
            ("phase", phase, 0.0, 1.0),
            ("speed", speed, -MAX_SPEED, MAX_SPEED),
            ("half_life", half_life_s, 0.0, 10.0),
        ):
            if value is not None and not low <= value <= high:  # NaN compares false, so this catches it as well
                raise OutOfRange(f"{name} is {value}; it must lie between {low:g} and {high:g}")
        if phase is not None:
            row["phase"], row["seconds"], row["fresh"] = phase, np.nan, 1.0
        if speed is not None:
            row["speed"] = speed
        if playing is not None:
            row["playing"] = playing
        if looping is not None:
            row["looping"] = looping
        if following is not None:
            row["following"] = following
        if half_life_s is not None:
            row["decay"] = _HALVED / half_life_s if half_life_s > 0 else 0.0

    def phase(self, slot: int) -> float:
        """Phase of a character."""
        return float(self.state["phase"][slot])

    def step(self, slots: I64, step_s: float) -> Frames:
        """The next frame of the characters in ``slots`` (B,), each at most once, ``step_s`` > 0 seconds on."""
        slots = np.ascontiguousarray(slots, np.int64)
        step = self.advance(slots, step_s)
        crowd, size = self.crowd, len(slots)
        weights = crowd.weights[slots, crowd.state["weights"][slots]]
        root, rotations = np.empty((size, 3)), np.empty((size, len(self.verb.skeleton), 4))
        _poses(slots, step.complete, crowd, self.curves, self.striding, root, rotations)
        if len(step.rest):
            weights[step.rest], root[step.rest], rotations[step.rest] = step.weights, step.root, step.rotations
        blend = Blend(self.method, weights, crowd.measured[slots], step.error, step.clamped)
        return Frames(blend, step.progress, root, rotations, step.in_transition)

    def advance(self, slots: I64, step_s: float) -> Step:
        """Move characters (B,) by one step, without computing the poses that are sums of curves alone.

        Parameters
        ----------
        slots : (B,) int64
            C-contiguous; each at most once.
        step_s : float
            Seconds, above 0.
        """
        frame, counts = self._move(self.crowd, slots, step_s)
        complete, rest = frame.complete[: counts[0]], frame.rest[: counts[1]]
        if not len(rest):
            return Step(*frame[:4], complete, rest, *self._nothing)
        among, progress = slots[rest], frame.progress[rest]
        if counts[2]:
            self._restart(among[progress["restarted"] > 0.0], step_s)
        held = self.state["held"][among]
        enter = among[held < 0]
        self._hold(enter, self._displayed(enter))
        error = frame.error[rest]
        found = self._pose(self.crowd, among, step_s, (self.stored.offsets, self.stored.frames), progress, error)
        frame.error[rest], frame.in_transition[rest] = error, self.state["transition_s"][among] > 0
        self._release(among[self.state["calm"][among] >= 2])
        return Step(*frame[:4], complete, rest, *found)

    def go_on(
        self,
        other: Characters,
        slot: int,
        adverbs: Mapping[str, float] | F64 | None = None,
        *,
        phase: float | None = None,
        transition_s: float = RESTART_S,
        same: bool = False,
    ) -> int:
        """A character of this verb that continues from one of another; return its slot. The other stays as it is.

        Parameters
        ----------
        other, slot
            The character it continues from; speed and half-life are taken from there.
        adverbs : optional
            The middle of the domain unless given.
        phase : float, optional
            Phase at which it starts; see :func:`verbs.runtime.transition.start_phase`.
        transition_s : float
            0 to 5; 0 cuts.
        same : bool
            The verb is the same one in another version: goal, phase and position are kept.

        Raises
        ------
        SkeletonMismatch
            The verbs move different joints.
        RequestError
            See :meth:`add`.
        """
        transition.check_skeletons(other.verb, self.verb)
        if not 0.0 <= transition_s <= MAX_TRANSITION_S:
            raise OutOfRange(f"transition_s is {transition_s}; it must lie between 0 and {MAX_TRANSITION_S:g}")
        was = other.state[slot].copy()
        if same:
            adverbs, phase = other.goals[slot], other.phase(slot)
        elif phase is None:
            phase = transition.start_phase(other.verb, other.phase(slot), self.verb, speed=was["speed"])
        new = self.add(adverbs, phase=phase, speed=float(was["speed"]))
        row = self.state[new]
        kept = ["decay", "step_s"]
        if same:
            kept += ["looping", "share", "x", "y", "z", "heading"]
            self._steer_as(new, other, slot)
        for name in kept:
            row[name] = was[name]
        row["playing"] = was["playing"] if same else 1.0
        if was["fresh"] == 1.0 and was["step_s"] == 0.0:
            return new  # the other has had no frame yet
        if same:  # both have the same goal, so compare the next frames of both
            last, row["fresh"] = other._ahead(np.array([slot]), passing=True), 0.0
            inertialization.step_back(last[0])
        else:
            last, row["fresh"] = other._displayed(np.array([slot])), 2.0
            row["y"] = was["y"]
            self._stand(new, other.world(slot))
        self._hold(np.array([new]), last)
        self._begin(new, self._ahead(np.array([new]))[0], transition_s)
        return new

    def world(self, slot: int) -> tuple[float, float, float]:
        """Position of a character's root in its last frame: x, z (m) and heading (rad)."""
        last = self._displayed(np.array([slot]))[0, 1]
        turn = float(self.state["heading"][slot]) if self.striding else transition.heading(last[3:7])
        return float(last[0]), float(last[2]), turn

    def warm(self) -> None:
        """Compile or load every kernel that a step may need."""
        slots = np.array([self.add(playing=False)])
        for kind in (np.float32, np.float64):
            self.aim_many(slots, self.goals[slots].astype(kind))
            self.step(slots, 0.01)
        if self.window:
            self.set(int(slots[0]), phase=self.window[0])
            self.step(slots, 0.01)
        self.set(int(slots[0]), phase=1.0, playing=True, looping=True)
        for _ in range(3):
            self.step(slots, 0.01)
        after = self.go_on(self, int(slots[0]))
        self.step(np.array([after]), 0.01)
        for slot in (after, int(slots[0])):
            self.remove(slot)

    def _move(self, crowd: Crowd, slots: I64, step_s: float) -> tuple[Advanced, tuple[int, int, int]]:
        """Steer, blend and advance characters of any crowd of this verb; see :func:`character_state.advance`."""
        size = len(slots)
        moved = np.empty(size, np.int64)
        count = _steer(slots, step_s, crowd, self.verb.domain.chart.arrays, moved)
        clock = self.evaluator.goal.clock
        if count:
            points = np.empty((count, crowd.shown.shape[1]))
            _gather(slots, moved[:count], crowd.shown, points)
            blend = self._blend_points(points)
            fresh = Blended(
                np.ascontiguousarray(blend.weights), blend.measured, blend.error, blend.clamped.astype(np.float64)
            )
            _keep(slots, moved[:count], fresh, clock, crowd)
        flags, which = np.empty((2, size), np.bool_), np.empty((2, size), np.int64)
        frame = Advanced(np.empty(size, PROGRESS), np.empty(size), *flags, *which)
        window = self.window if self.window and self._following else NO_WINDOW
        return frame, _advance(slots, step_s, crowd, clock, self.verb.strides, window, frame)

    def _blend_points(self, points: F64) -> Blend:
        """Blends at normalised chart coordinates (n, D)."""
        return self.evaluator.blend_points(points, method=self.method)

    def _steer_as(self, slot: int, other: Characters, whose: int) -> None:
        """Give a character the displayed point and velocity of another of the same adverbs."""
        to, source = self.verb.domain.chart, other.verb.domain.chart
        at, velocity, instant = other.crowd.shown[whose][None], other.crowd.velocity[whose], 1e-3
        shown = self.crowd.shown[slot] = to.points(source.adverbs(at))[0]
        self.crowd.velocity[slot] = (to.points(source.adverbs(at + instant * velocity))[0] - shown) / instant

    def _stand(self, slot: int, at: tuple[float, float, float]) -> None:
        """Put a character's next frame at a position (x, z, heading)."""
        row = self.state[slot]
        row["x"] = row["z"] = row["heading"] = 0.0
        first = self._ahead(np.array([slot]))[0, 0]
        turn = 0.0 if self.striding else transition.heading(first[3:7])
        row["x"], row["z"], row["heading"] = transition.aligned(at, np.array([first[0], first[2], turn]))

    def _restart(self, slots: I64, step_s: float) -> None:
        """Let motions that started over pass from their progress to their starts, a jump from where it led."""
        self.state["step_s"][slots] = step_s
        enter = slots[self.state["held"][slots] < 0]
        self._hold(enter, self._displayed(enter))
        if self.verb.measure.kind == measures.JUMP:
            for slot in slots.tolist():
                self._stand(slot, self.world(slot))
        _restart(slots, self.state, self.stored.frames, self.stored.offsets, self._ahead(slots), RESTART_S)

    def _begin(self, slot: int, ahead: F64, transition_s: float) -> None:
        """Start a transition from the stored frames to the two of the motion that is ahead."""
        row = self.state[slot]
        row["since_s"], row["transition_s"], row["calm"] = 0.0, transition_s, 0
        frames, offsets = self.stored.frames[row["held"]], self.stored.offsets[row["held"]]
        if transition_s > 0:
            inertialization.begin(row["step_s"], frames, ahead, offsets)
        else:
            frames[:] = ahead[0]

    def _displayed(self, slots: I64) -> F64:
        """The last two frames (n, 2, 3 + 4·J), latest last; zeros before the first."""
        frames = np.zeros((len(slots), 2, 3 + 4 * len(self.verb.skeleton)))
        held, known = self.state["held"][slots], self.crowd.known[slots] > 0
        stored = held >= 0
        frames[stored] = self.stored.frames[held[stored]]
        if len(again := np.flatnonzero(~stored & known)):
            found = frames[again]
            _redisplay(slots[again], self.crowd, self.curves, self.striding, found)
            frames[again] = found
        return frames

    def _ahead(self, slots: I64, *, passing: bool = False) -> F64:
        """Poses of characters now, and a step on (B, 2, 3 + 4·J); without their transitions unless ``passing``.

        Their last steps were of the same length.
        """
        size, rows = len(slots), np.arange(len(slots))
        crowd = Crowd._make(column[slots] for column in self.crowd)
        state, held = crowd.state, crowd.state["held"].copy()
        step_s = float(state["step_s"][0])
        frames, offsets = (np.zeros((size, *whole.shape[1:])) for whole in (self.stored.frames, self.stored.offsets))
        offsets[held >= 0] = self.stored.offsets[held[held >= 0]]
        state["transition_s"] *= passing
        state["fresh"] = 2.0 * (state["fresh"] > 0)  # both frames are steps, the first of 0 s
        state["held"] = rows
        for step in (0.0, step_s):
            frame, _ = self._move(crowd, rows, step)
            self._pose(crowd, rows, step, (offsets, frames), frame.progress, frame.error)
        return frames

    def _pose(
        self, crowd: Crowd, slots: I64, step_s: float, stored: tuple[F64, F64], progress: Records, error: F64
    ) -> tuple[F64, F64, F64]:
        """Weights (B, N), roots (B, 3) and rotations (B, J, 4) in the world of characters with stored frames.

        ``stored`` are their offsets and frames. Where they follow a goal, the error (B,) becomes that of the pose.
        """
        state = crowd.state
        weights = crowd.weights[slots, state["weights"][slots]]
        if self._following:
            goal, adverbs = self.evaluator.goal, self.verb.domain.chart.adverbs(crowd.shown[slots])
            targets = goal.points(self.evaluator.clamp(adverbs)[0]), goal.points(adverbs)
            _follow(slots, step_s, state, targets, weights, error, self._following)
        if self.striding:
            _walk(slots, state, weights, self.verb.strides, progress)
        root, rotations = np.empty((len(slots), 3)), np.empty((len(slots), len(self.verb.skeleton), 4))
        blend_poses(weights, np.ascontiguousarray(progress["phase"]), self.curves, root, rotations)
        _apply(slots, step_s, state, *stored, self.striding, root, rotations)
        return weights, root, rotations


def _follow_problem(method: Corrected, window: tuple[float, float]) -> FollowProblem:
    """Everything that :func:`verbs.kernels.following.follow` needs of a verb."""
    verb, chain = method.goal.verb, method.goal.chain
    joints = verb.skeleton.chain(verb.measure.effector)[:-1]
    return FollowProblem(*window, verb.curves, joints, method.correction, chain.mode, chain.references, chain.offsets)
