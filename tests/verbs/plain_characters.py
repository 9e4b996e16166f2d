"""Characters one at a time, in double precision, with every frame stored: what ``Characters`` is tested against.

The rules are those of ``docs/math.md``, section "Live characters", written without batches, sorting, kept keytimes or
kept sums.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from tests.verbs.crowds import NO_LEGS
from verbs import Characters
from verbs.kernels import character_state, following, inertialization, pose, quat, timewarp
from verbs.kernels import measure as measures
from verbs.runtime import transition
from verbs.runtime.characters import MAX_SPEED, RESTART_S
from verbs.verb import Verb

HALVED = 1.6783469900166605
REACHED = character_state.REACHED


def plain_pose(verb: Verb, weights: np.ndarray, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """Root (3,) and rotations (J, 4) of weights (N,) at a phase."""
    taps = np.empty(4)
    first = pose.spline_taps(phase, verb.intervals, taps)
    row = np.einsum("t,i,tic->c", taps, weights, verb.curves[first : first + 4].astype(np.float64))
    rotations = row[4:].reshape(-1, 4)
    for reference, rotation in zip(verb.references, rotations, strict=True):
        pose.finish_rotation(verb.rotation_mode, reference, rotation)
    return row[:3], rotations


@dataclass
class Plain:
    """One character; ``source`` gives its verb, method and follow window."""

    source: Characters
    goal: np.ndarray
    phase: float = 0.0
    speed: float = 1.0
    playing: bool = True
    looping: bool = False
    half_life_s: float = 0.1
    following: bool = True
    fresh: int = 1
    share: float = 0.0
    position: np.ndarray = field(default_factory=lambda: np.zeros(4))  # x, y, z, heading
    since_s: float = 0.0
    transition_s: float = 0.0
    step_s: float = 0.0

    def __post_init__(self) -> None:
        verb = self.source.verb
        self.shown = verb.domain.chart.points(self.goal[None])[0]
        self.velocity = np.zeros_like(self.shown)
        self.frames = np.zeros((2, 3 + 4 * len(verb.skeleton)))
        self.offsets = np.zeros((2, 3 + 3 * len(verb.skeleton)))

    def __deepcopy__(self, memo: dict) -> Plain:
        other = object.__new__(Plain)
        other.__dict__ = {k: v if k == "source" else deepcopy(v, memo) for k, v in self.__dict__.items()}
        return other

    def step(self, step_s: float, *, restarts: bool = True) -> dict:
        """Everything that a frame shows."""
        verb, evaluator = self.source.verb, self.source.evaluator
        self._steer(step_s)
        adverbs = verb.domain.chart.adverbs(self.shown[None])
        blend = evaluator.blend(adverbs, method=self.source.method)
        weights, error = blend.weights.copy(), blend.error.copy()
        shown = self._advance(step_s, weights[0])
        if shown["restarted"] and restarts:
            self._restart(step_s)
        self._follow(step_s, adverbs, weights, error)
        if self.source.striding:
            self._walk(weights, shown["start"], shown["stop"])
        root, rotations = plain_pose(verb, weights[0], self.phase)
        self._display(step_s, root, rotations)
        return {
            **shown,
            "weights": weights[0],
            "error": error[0],
            "clamped": bool(blend.clamped[0]),
            "in_transition": self.transition_s > 0,
            "root": root,
            "rotations": rotations,
        }

    def go_on(self, source: Characters, goal: np.ndarray, transition_s: float, *, same: bool) -> Plain:
        """The character of another verb, or version, that continues from this one."""
        if same:
            new = Plain(source, self.goal.copy(), self.phase, self.speed, self.playing, self.looping)
            to, chart, instant = source.verb.domain.chart, self.source.verb.domain.chart, 1e-3
            new.shown = to.points(chart.adverbs(self.shown[None]))[0]
            moved = to.points(chart.adverbs((self.shown + instant * self.velocity)[None]))[0]
            new.velocity = (moved - new.shown) / instant
            new.share, new.position = self.share, self.position.copy()
        else:
            phase = transition.corresponding_phase(self.source.verb, self.phase, source.verb)
            if phase is None:
                phase = self._nearest(source, goal)
            new = Plain(source, goal, phase, self.speed, True, source.verb.looping)
        new.half_life_s, new.step_s = self.half_life_s, self.step_s
        if self.fresh == 1 and self.step_s == 0.0:
            return new
        if same:
            new.frames, new.fresh = self._ahead(passing=True), 0
            inertialization.step_back(new.frames)
        else:
            new.frames, new.fresh = self.frames.copy(), 2
            new.position[1] = self.position[1]
            new._stand(self._world())
        new._begin(new._ahead(), transition_s)
        return new

    def _nearest(self, source: Characters, goal: np.ndarray) -> float:
        """Phase at which a motion starts that corresponds to no phase of this one's."""
        if source.verb.looping and not (self.fresh == 1 and self.step_s == 0.0):
            blend = source.evaluator.blend(goal[None], method=source.method)
            return transition.closest_phase(self.frames, self.step_s, source.evaluator, blend)
        return 1.0 if self.speed < 0 else 0.0

    def _steer(self, step_s: float) -> None:
        target = self.source.verb.domain.chart.points(self.goal[None])[0]
        rate = HALVED / self.half_life_s if self.half_life_s > 0 else 0.0
        away = self.shown - target
        pull = self.velocity + rate * away
        fall = math.exp(-rate * step_s)
        there = (rate <= 0.0) | ((np.abs(away) < REACHED) & (np.abs(self.velocity) < REACHED))
        self.shown = np.where(there, target, target + (away + pull * step_s) * fall)
        self.velocity = np.where(there, 0.0, (self.velocity - rate * pull * step_s) * fall)

    def _advance(self, step_s: float, weights: np.ndarray) -> dict:
        phases, lengths, verb_loops = self.source.evaluator.goal.clock
        keytimes, slopes = np.empty(len(phases)), np.empty(len(phases))
        timewarp.blend_keytimes(weights, lengths, keytimes)
        timewarp.slopes(phases, keytimes, verb_loops, slopes)
        duration, start = keytimes[-1], self.phase
        gone = 0.0 if self.fresh == 1 else self.playing * self.speed * step_s
        seconds = timewarp.time_at(phases, keytimes, slopes, start) + gone
        cycles, ended, restarted = 0.0, False, False
        if self.looping and gone:
            cycles = np.floor(seconds / duration)
            seconds -= cycles * duration
            restarted = bool(cycles) and not verb_loops
        elif (gone > 0 and seconds >= duration) or (gone < 0 and seconds <= 0):
            ended, self.playing = True, False
        seconds = min(max(seconds, 0.0), duration)
        if gone:
            self.phase = timewarp.phase_at(phases, keytimes, slopes, seconds)
            if self.looping and verb_loops and self.phase >= 1.0:
                self.phase, seconds, cycles = 0.0, 0.0, cycles + 1
        appears = self.fresh > 0 and self.playing
        behind = (1e-9 if self.speed >= 0 else -1e-9) if appears else 0.0
        begin, end = start - behind, self.phase + cycles
        passed = appears or any(
            np.floor(end - p) > np.floor(begin - p) or np.ceil(end - p) < np.ceil(begin - p) for p in phases
        )
        return {
            "phase": self.phase, "time_s": seconds, "duration_s": duration, "start": begin, "stop": end,
            "passed": passed, "ended": ended, "restarted": restarted,
        }  # fmt: skip

    def _follow(self, step_s: float, adverbs: np.ndarray, weights: np.ndarray, error: np.ndarray) -> None:
        if self.source._following is None:
            return
        state = np.zeros(1, character_state.CHARACTER)
        for name in ("phase", "speed", "playing", "fresh", "following", "share"):
            state[name] = getattr(self, name)
        goal, inside = self.source.evaluator.goal, self.source.evaluator.clamp(adverbs)[0]
        targets = goal.points(inside), goal.points(adverbs)
        slot = np.zeros(1, np.int64)
        following.follow(slot, step_s, state, targets, weights, error, self.source._following)
        self.share = float(state["share"][0])

    def _walk(self, weights: np.ndarray, start: float, stop: float) -> None:
        state, progress = np.zeros(1, character_state.CHARACTER), np.zeros(1, character_state.PROGRESS)
        state["x"], state["y"], state["z"], state["heading"] = self.position
        progress["start"], progress["stop"] = start, stop
        character_state.walk(np.zeros(1, np.int64), state, weights, self.source.verb.strides, progress)
        self.position = np.array(state[["x", "y", "z", "heading"]][0].tolist())

    def _display(self, step_s: float, root: np.ndarray, rotations: np.ndarray) -> None:
        """Move a pose into the world, add the transition's offset, and store it; in place."""
        x, y, z, heading = self.position
        turn = quat.exp(np.array([0.0, heading, 0.0]))
        across, along = (0.0, 0.0) if self.source.striding else (root[0], root[2])
        root[1] += y
        root[0] = x + across * math.cos(heading) + along * math.sin(heading)
        root[2] = z - across * math.sin(heading) + along * math.cos(heading)
        rotations[0] = quat.mul(turn, rotations[0])
        if self.transition_s > 0:
            self.since_s += step_s
            u = self.since_s / self.transition_s
            if u >= 1.0 - 1e-9:
                self.transition_s = 0.0
            else:
                keep, carry = inertialization._factors(u)
                offset = keep * self.offsets[0] + carry * self.transition_s * self.offsets[1]
                root += offset[:3]
                rotations[:] = quat.mul(quat.exp(offset[3:].reshape(-1, 3)), rotations)
        here = np.append(root, rotations.ravel())
        self.frames = np.array([here if self.fresh == 1 else self.frames[1], here])
        self.step_s, self.fresh = step_s, 0

    def _ahead(self, *, passing: bool = False) -> np.ndarray:
        """The two frames (2, 3 + 4·J) that come now, and a step on."""
        other = deepcopy(self)
        other.transition_s *= passing
        frames = []
        step_s = self.step_s
        other.fresh = 2 * (self.fresh > 0)
        for length in (0.0, step_s):
            other.step(length, restarts=False)
            frames.append(other.frames[1])
        return np.array(frames)

    def _world(self) -> tuple[float, float, float]:
        last = self.frames[1]
        turn = self.position[3] if self.source.striding else self._heading(last[3:7])
        return float(last[0]), float(last[2]), float(turn)

    def _heading(self, rotation: np.ndarray) -> float:
        return transition.heading(rotation, transition.root_frame(self.source.evaluator))

    def _stand(self, at: tuple[float, float, float]) -> None:
        self.position = self.position * np.array([0.0, 1.0, 0.0, 0.0])
        first = self._ahead()[0]
        turn = 0.0 if self.source.striding else self._heading(first[3:7])
        x, z, heading = transition.aligned(at, np.array([first[0], first[2], turn]))
        self.position = np.array([x, self.position[1], z, heading])

    def _restart(self, step_s: float) -> None:
        self.step_s = step_s
        if self.source.verb.measure.kind == measures.JUMP:
            self._stand(self._world())
        ahead = self._ahead()
        inertialization.step_back(ahead)
        self._begin(ahead, RESTART_S)

    def _begin(self, ahead: np.ndarray, transition_s: float) -> None:
        self.since_s, self.transition_s = 0.0, transition_s
        if transition_s > 0:
            inertialization.begin(self.step_s, self.frames, ahead, NO_LEGS, self.offsets)
        else:
            self.frames = np.array([ahead[0], ahead[0]])


def change(plain: Plain, **values: object) -> None:
    """As :meth:`Characters.set`."""
    assert abs(plain.speed) <= MAX_SPEED
    for name, value in values.items():
        setattr(plain, name, value)
    if "phase" in values:
        plain.fresh = 1
