"""Moving characters of one verb, each with goal, phase, position and transition, stepped together.

A server's tick and a game's frame are one call of :meth:`Characters.step`: adverbs follow their goals, phases advance,
poses result, in a few compiled calls for any number of characters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from verbs.blend.corrected import Corrected
from verbs.conventions import F64, I64
from verbs.errors import OutOfRange
from verbs.kernels import character_state, inertialization
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.character_state import PROGRESS, FollowProblem, Records
from verbs.kernels.compile import direct
from verbs.runtime import transition
from verbs.runtime.character_pool import CharacterPool, Frames
from verbs.runtime.evaluate import Blend, Evaluator

__all__ = ["HALF_LIFE_S", "MAX_SPEED", "MAX_TRANSITION_S", "RESTART_S", "VERSION_S", "Characters", "Frames"]

_advance, _follow = direct(character_state.advance), direct(character_state.follow)

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
    ((1, 3), (1, 22, 4))
    """

    def __init__(self, evaluator: Evaluator, method: str | None = None) -> None:
        super().__init__(evaluator.verb)
        self.evaluator = evaluator
        self.method, prepared = evaluator.method(method)
        self.window = evaluator.follow_window() if isinstance(prepared, Corrected) else None
        self._striding = self.verb.root_motion == poses.STRIDE
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
        self.goals[slot] = row
        self._shown[slot] = self.verb.domain.chart.points(row[None])[0]
        self._velocity[slot] = 0.0
        self._known[slot] = 0
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
            row["phase"], row["fresh"] = phase, 1.0
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
        size = len(slots)
        adverbs, blend = self._blend(slots, step_s)
        progress = np.empty(size, PROGRESS)
        self._advance(slots, step_s, self.state, blend.weights, progress)
        if len(over := np.flatnonzero(progress["restarted"])):
            self._restart(slots[over], step_s)
        if self._following and character_state.any_following(slots, self.state):
            self._follow(slots, step_s, self.state, adverbs, blend)
        displayed = self.state, self._offsets, self._last
        root, rotations = self._pose(slots, step_s, displayed, blend.weights, progress)
        return Frames(blend, progress, root, rotations, self.state["transition_s"][slots] > 0)

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
            kept += ["looping", "share", "x", "z", "heading"]
            self._steer_as(new, other, slot)
        for name in kept:
            row[name] = was[name]
        row["playing"] = was["playing"] if same else 1.0
        if was["fresh"] == 1.0 and was["step_s"] == 0.0:
            return new  # the other has had no frame yet
        if same:  # both have the same goal, so compare the next frames of both
            self._last[new], row["fresh"] = other._ahead(np.array([slot]), passing=True)[0], 0.0
            inertialization.step_back(self._last[new])
        else:
            self._last[new], row["fresh"] = other._last[slot], 2.0
            self._stand(new, other.world(slot))
        self._begin(new, self._ahead(np.array([new]))[0], transition_s)
        return new

    def world(self, slot: int) -> tuple[float, float, float]:
        """Position of a character's root in its last frame: x, z (m) and heading (rad)."""
        last = self._last[slot, 1]
        turn = float(self.state["heading"][slot]) if self._striding else transition.heading(last[3:7])
        return float(last[0]), float(last[2]), turn

    def warm(self) -> None:
        """Compile or load every kernel that a step may need."""
        slots = np.array([self.add(playing=False)])
        for _ in range(2):
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

    def _blend(self, slots: I64, step_s: float) -> tuple[F64, Blend]:
        """Adverbs (B, D) that are displayed now, and their blend; evaluated only where they moved."""
        chart, size = self.verb.domain.chart, len(slots)
        points, moved = np.empty((size, len(self.verb.adverbs))), np.empty(size, np.int64)
        goals = chart.points(self.goals[slots])
        count = character_state.steer(
            slots, step_s, self.state, goals, self._shown, self._velocity, self._known, points, moved
        )
        adverbs = chart.adverbs(points)
        self._seen[slots] = self.goals[slots]
        if count:
            rows = moved[:count]
            fresh = self.evaluator.blend(adverbs[rows], method=self.method)
            if count == size:
                self._keep(slots, fresh)
                return adverbs, fresh
            self._keep(slots[rows], fresh)
        return adverbs, self._kept(slots)

    def _keep(self, slots: I64, blend: Blend) -> None:
        self._weights[slots], self._measured[slots] = blend.weights, blend.measured
        self._error[slots], self._clamped[slots] = blend.error, blend.clamped

    def _kept(self, slots: I64) -> Blend:
        kept = self._weights[slots], self._measured[slots], self._error[slots], self._clamped[slots] > 0
        return Blend(self.method, *kept)

    def _steer_as(self, slot: int, other: Characters, whose: int) -> None:
        """Give a character the displayed point and velocity of another of the same adverbs."""
        to, source = self.verb.domain.chart, other.verb.domain.chart
        at, velocity, instant = other._shown[whose][None], other._velocity[whose], 1e-3
        self._shown[slot] = to.points(source.adverbs(at))[0]
        self._velocity[slot] = (to.points(source.adverbs(at + instant * velocity))[0] - self._shown[slot]) / instant

    def _stand(self, slot: int, at: tuple[float, float, float]) -> None:
        """Put a character's next frame at a position (x, z, heading)."""
        row = self.state[slot]
        row["x"] = row["z"] = row["heading"] = 0.0
        first = self._ahead(np.array([slot]))[0, 0]
        turn = 0.0 if self._striding else transition.heading(first[3:7])
        row["x"], row["z"], row["heading"] = transition.aligned(at, np.array([first[0], first[2], turn]))

    def _restart(self, slots: I64, step_s: float) -> None:
        """Let motions that started over pass from their progress to their starts, a jump from where it led."""
        self.state["step_s"][slots] = step_s
        if self.verb.measure.kind == measures.JUMP:
            for slot in slots.tolist():
                self._stand(slot, self.world(slot))
        for slot, ahead in zip(slots.tolist(), self._ahead(slots), strict=True):
            inertialization.step_back(ahead)  # it is already less than a step further
            self._begin(slot, ahead, RESTART_S)

    def _begin(self, slot: int, ahead: F64, transition_s: float) -> None:
        """Start a transition from the last frames to the two of the motion that is ahead."""
        row = self.state[slot]
        row["since_s"], row["transition_s"] = 0.0, transition_s
        if transition_s > 0:
            inertialization.begin(row["step_s"], self._last[slot], ahead, self._offsets[slot])
        else:
            self._last[slot] = ahead[0]

    def _ahead(self, slots: I64, *, passing: bool = False) -> F64:
        """Poses of characters now, and a step on (B, 2, 3 + 4·J); without their transitions unless ``passing``.

        Their last steps were of the same length.
        """
        size, verb = len(slots), self.verb
        state, shown, velocity = self.state[slots], self._shown[slots], self._velocity[slots]
        step_s, chart, known = float(state["step_s"][0]), verb.domain.chart, self._known[slots]
        state["transition_s"] *= passing
        state["fresh"] = 2.0 * (state["fresh"] > 0)  # both frames are steps, the first of 0 s
        goals, points = chart.points(self.goals[slots]), np.empty_like(shown)
        progress = np.empty(size, PROGRESS)
        last, rows, moved = np.zeros((size, *self._last.shape[1:])), np.arange(size), np.empty(size, np.int64)
        kept, offsets = self._kept(slots), self._offsets[slots]
        for step in (0.0, step_s):
            if character_state.steer(rows, step, state, goals, shown, velocity, known, points, moved):
                kept = self.evaluator.blend(chart.adverbs(points), method=self.method)
            blend = kept
            self._advance(rows, step, state, blend.weights, progress)
            if self._following and character_state.any_following(rows, state):
                blend = replace(kept, weights=kept.weights.copy(), error=kept.error.copy())
                self._follow(rows, step, state, chart.adverbs(points), blend)
            self._pose(rows, step, (state, offsets, last), blend.weights, progress)
        return last

    def _advance(self, slots: I64, step_s: float, state: Records, weights: F64, progress: Records) -> None:
        _advance(slots, step_s, state, weights, self.evaluator.goal.clock, progress)

    def _pose(
        self, slots: I64, step_s: float, displayed: tuple[Records, F64, F64], weights: F64, progress: Records
    ) -> tuple[F64, F64]:
        """Root (B, 3) and rotations (B, J, 4) in the world; ``displayed`` are state, offsets and last frames."""
        verb, (state, offsets, last) = self.verb, displayed
        root, rotations = np.empty((len(slots), 3)), np.empty((len(slots), len(verb.skeleton), 4))
        if self._striding:
            character_state.walk(slots, state, weights, verb.strides, progress)
        phases = np.ascontiguousarray(progress["phase"])
        poses.blend_single(weights, phases, verb.curves, verb.rotation_mode, verb.references, root, rotations)
        inertialization.apply(slots, step_s, state, offsets, last, self._striding, root, rotations)
        return root, rotations

    def _follow(self, slots: I64, step_s: float, state: Records, adverbs: F64, blend: Blend) -> None:
        """Correct the weights of characters that are paused in the follow window, in place."""
        goal, inside = self.evaluator.goal, self.evaluator.clamp(adverbs)[0]
        targets = goal.points(inside), goal.points(adverbs)
        assert self._following is not None  # else no character follows
        _follow(slots, step_s, state, targets, blend.weights, blend.error, self._following)


def _follow_problem(method: Corrected, window: tuple[float, float]) -> FollowProblem:
    """Everything that :func:`verbs.kernels.character_state.follow` needs of a verb."""
    verb, chain = method.goal.verb, method.goal.chain
    joints = verb.skeleton.chain(verb.measure.effector)[:-1]
    return FollowProblem(*window, verb.curves, joints, method.correction, chain.mode, chain.references, chain.offsets)
