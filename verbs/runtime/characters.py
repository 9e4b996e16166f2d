"""Moving characters of one verb, each with goal, phase, position and transition, stepped together.

A server's tick and a game's frame are one call of :meth:`Characters.step`: adverbs follow their goals, phases advance,
poses result, in a few compiled calls for any number of characters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from verbs.conventions import F32, F64, I64
from verbs.errors import OutOfRange
from verbs.kernels import character_state, inertialization
from verbs.kernels.compile import direct
from verbs.kernels.foot_state import FOOT
from verbs.runtime import transition
from verbs.runtime.character_pool import Frames, Step
from verbs.runtime.character_steps import RESTART_S, CharacterSteps
from verbs.runtime.evaluate import Blend

__all__ = ["HALF_LIFE_S", "MAX_SPEED", "MAX_TRANSITION_S", "RESTART_S", "VERSION_S", "Characters", "Frames", "Step"]

_copy_single, _copy_double = direct(character_state.copy_rows), direct(character_state.copy_rows)
_poses = direct(inertialization.poses)

HALF_LIFE_S = 0.1
MAX_SPEED = 10.0
MAX_TRANSITION_S = 5.0
VERSION_S = 0.15
"""Length of the transition from one version of a verb to the next."""

_HALVED = 1.6783469900166605
"""Where (1 + x) · exp(-x) is one half: a critically damped spring from rest has covered half its distance."""


class Characters(CharacterSteps):
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
        plant: bool = True,
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
        plant : bool
            Whether standing feet stay where they landed.

        Raises
        ------
        RequestError
            An adverb is unknown, missing or not finite, or a number is out of range.
        """
        row = self.row(adverbs)
        slot = self._take()
        self.state["speed"][slot] = self.state["fresh"][slot] = 1.0
        self.state["planting"][slot] = float(plant and len(self.planting.joints) > 0)
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
            row["phase"], row["seconds"], row["fresh"], row["footed"] = phase, np.nan, 1.0, 0.0
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
        _poses(slots, step.complete, crowd, self.curves, self.striding, self.planting.legs, root, rotations)
        if len(step.rest):
            weights[step.rest], root[step.rest], rotations[step.rest] = step.weights, step.root, step.rotations
        blend = Blend(self.method, weights, crowd.measured[slots], step.error, step.clamped)
        return Frames(blend, step.progress, root, rotations, step.in_transition)

    def go_on(
        self,
        other: Characters,
        slot: int,
        adverbs: Mapping[str, float] | F64 | None = None,
        *,
        phase: float | None = None,
        transition_s: float | None = None,
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
            Phase at which it starts. Unless given: where both loop and name the same keytimes, the phase that
            corresponds; in another loop the one whose pose is closest; otherwise the start, or the end if it is played
            backwards.
        transition_s : float, optional
            0 to 5; 0 cuts. Unless given, it is chosen by the distance of poses and velocities, 0.3 to 1.
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
        if transition_s is not None and not 0.0 <= transition_s <= MAX_TRANSITION_S:
            raise OutOfRange(f"transition_s is {transition_s}; it must lie between 0 and {MAX_TRANSITION_S:g}")
        was = other.state[slot].copy()
        if same:
            adverbs, phase = other.goals[slot], other.phase(slot)
        elif phase is None:
            phase = self._start_phase(other, slot, adverbs)
        new = self.add(adverbs, phase=phase, speed=float(was["speed"]))
        row = self.state[new]
        kept = ["decay", "step_s"]
        if same:
            kept += ["looping", "share", "x", "y", "z", "heading"]
            self._steer_as(new, other, slot)
        for name in kept:
            row[name] = was[name]
        row["playing"] = was["playing"] if same else 1.0
        row["planting"] = was["planting"] if len(self.planting.joints) else 0.0
        if was["fresh"] == 1.0 and was["step_s"] == 0.0:
            return new  # the other has had no frame yet
        if same:  # both have the same goal, so compare the next frames of both
            last, row["fresh"] = other._ahead(np.array([slot]), passing=True), 0.0
            inertialization.step_back(last[0])
        else:
            last, row["fresh"] = other._displayed(np.array([slot])), 2.0
            row["y"] = was["y"]
            self._stand(new, other.world(slot))
        self._keep_feet(new, other, slot, None if same else last[0, 1])
        self._hold(np.array([new]), last)
        ahead = self._ahead(np.array([new]))[0]
        if transition_s is None:
            own = max(
                transition.peak(other.evaluator, other.blend(slot)), transition.peak(self.evaluator, self.blend(new))
            )
            transition_s = transition.length_s(last[0], ahead, float(was["step_s"]), self.verb, own)
        if transition_s == 0.0:  # a cut: feet are where the motion has them
            row["footed"] = 0.0
        self._begin(new, ahead, transition_s)
        return new

    def blend(self, slot: int) -> Blend:
        """Weights and measured adverbs of a character, at its displayed adverbs."""
        return self._blend_points(self.crowd.shown[slot][None])

    def support(self, slots: I64) -> F64:
        """How well the examples support the displayed blends of characters (B,): (B,), 0 to 1."""
        adverbs = np.ascontiguousarray(self.verb.domain.chart.adverbs(self.crowd.shown[slots]))
        weights = self.crowd.weights[slots, self.state["weights"][slots]]
        return self.evaluator.support_at(adverbs, weights)

    def _start_phase(self, other: Characters, slot: int, adverbs: Mapping[str, float] | F64 | None) -> float:
        """Phase at which a character that continues from another starts."""
        found = transition.corresponding_phase(other.verb, other.phase(slot), self.verb)
        if found is not None:
            return found
        if self.verb.looping and other.crowd.known[slot]:
            displayed = other._displayed(np.array([slot]))[0]
            blend = self.evaluator.blend(self.row(adverbs)[None], method=self.method)
            return transition.closest_phase(displayed, float(other.state["step_s"][slot]), self.evaluator, blend)
        return 1.0 if other.state["speed"][slot] < 0 else 0.0

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

    def _steer_as(self, slot: int, other: Characters, whose: int) -> None:
        """Give a character the displayed point and velocity of another of the same adverbs."""
        to, source = self.verb.domain.chart, other.verb.domain.chart
        at, velocity, instant = other.crowd.shown[whose][None], other.crowd.velocity[whose], 1e-3
        shown = self.crowd.shown[slot] = to.points(source.adverbs(at))[0]
        self.crowd.velocity[slot] = (to.points(source.adverbs(at + instant * velocity))[0] - shown) / instant

    def _keep_feet(self, slot: int, other: Characters, whose: int, displayed: F64 | None) -> None:
        """Let the feet of a character stand where those of another stand, in a transition where they are displayed."""
        ours, theirs = self.planting.joints.tolist(), other.planting.joints.tolist()
        if other.state["footed"][whose] == 0.0 or not set(ours) & set(theirs):
            return
        for foot, joint in enumerate(ours):
            if joint in theirs:
                source = theirs.index(joint)
                self.crowd.feet[slot, foot] = other.crowd.feet[whose, source]
                self.crowd.commands[slot, :, foot] = other.crowd.commands[whose, :, source]
            else:
                self.crowd.feet[slot, foot] = np.zeros((), FOOT)
        self.state["footed"][slot] = 1.0
        if displayed is not None:
            self._release_feet(slot, displayed)

    def _begin(self, slot: int, ahead: F64, transition_s: float) -> None:
        """Start a transition from the stored frames to the two of the motion that is ahead."""
        row = self.state[slot]
        row["since_s"], row["transition_s"], row["calm"] = 0.0, transition_s, 0
        frames, offsets = self.stored.frames[row["held"]], self.stored.offsets[row["held"]]
        if transition_s > 0:
            inertialization.begin(row["step_s"], frames, ahead, self.planting.legs, offsets)
        else:
            frames[:] = ahead[0]
