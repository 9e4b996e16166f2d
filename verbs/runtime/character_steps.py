"""One step of many characters: adverbs follow goals, phases advance, feet stand, transitions decay, poses result."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from verbs.blend.corrected import Corrected
from verbs.conventions import F64, I64
from verbs.kernels import character_state, inertialization, quat
from verbs.kernels import measure as measures
from verbs.kernels import pose as poses
from verbs.kernels.character_state import PROGRESS, Advanced, Crowd, Records
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Blended
from verbs.kernels.feet import hold, release
from verbs.kernels.following import NO_WINDOW, FollowProblem, follow
from verbs.runtime import transition
from verbs.runtime.character_pool import CharacterPool, Step
from verbs.runtime.evaluate import Blend, Evaluator, blend_poses

__all__ = ["RESTART_S", "CharacterSteps"]

_steer, _gather, _keep = (direct(one) for one in (character_state.steer, character_state.gather, character_state.keep))
_advance, _follow, _walk = (direct(one) for one in (character_state.advance, follow, character_state.walk))
_apply, _redisplay = direct(inertialization.apply), direct(inertialization.redisplay)
_at_rest = direct(character_state.at_rest)
_restart, _hold, _release = direct(inertialization.restart), direct(hold), direct(release)

RESTART_S = 0.3
"""Length of the transition with which a motion that does not loop starts over."""


class CharacterSteps(CharacterPool):
    """Characters of one verb and method, and how they are stepped; see :class:`verbs.runtime.characters.Characters`.

    Parameters
    ----------
    evaluator : Evaluator
    method : str, optional
        The verb's own unless given.
    """

    def __init__(self, evaluator: Evaluator, method: str | None = None) -> None:
        self.planting = evaluator.planting()
        super().__init__(evaluator.verb, len(self.planting.joints))
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
        self._hold_feet(slots, complete, step_s, frame.progress)
        if not len(rest):
            return Step(*frame[:4], complete, rest, *self._nothing)
        among, progress = slots[rest], frame.progress[rest]
        if counts[2]:
            self._restart(among[progress["restarted"] > 0.0], step_s)
        held = self.state["held"][among]
        enter = among[held < 0]
        self._hold(enter, self._displayed(enter))
        error = frame.error[rest]
        stored = self.stored.offsets, self.stored.frames
        found = self._pose(self.crowd, among, step_s, stored, progress, error, plant=True)
        frame.error[rest], frame.in_transition[rest] = error, self.state["transition_s"][among] > 0
        self._release(among[self.state["calm"][among] >= 2])
        return Step(*frame[:4], complete, rest, *found)

    def at_rest(self, slots: I64) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Characters (B,) of which a step changes phase and position alone; and those that are paused, at rest or not.

        Without another goal or setting, one long step of such a character is the same as many short ones.
        """
        still, paused = np.empty((2, len(slots)), np.bool_)
        window = self.window if self.window and self._following else NO_WINDOW
        _at_rest(slots, self.crowd, self.verb.looping, window, still, paused)
        return still, paused

    def advance_at_rest(self, slots: I64, step_s: float) -> None:
        """Move characters (B,) that are at rest by ``step_s`` seconds, although they may have other goals by now."""
        goals = self.goals[slots]
        self.goals[slots] = self.crowd.seen[slots]
        self.advance(slots, step_s)
        self.goals[slots] = goals

    def world(self, slot: int) -> tuple[float, float, float]:
        """Position of a character's root in its last frame: x, z (m) and heading (rad)."""
        last = self._displayed(np.array([slot]))[0, 1]
        turn = float(self.state["heading"][slot]) if self.striding else self._heading(last[3:7])
        return float(last[0]), float(last[2]), turn

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

    def _stand(self, slot: int, at: tuple[float, float, float]) -> None:
        """Put a character's next frame at a position (x, z, heading)."""
        row = self.state[slot]
        row["x"] = row["z"] = row["heading"] = 0.0
        first = self._ahead(np.array([slot]))[0, 0]
        turn = 0.0 if self.striding else self._heading(first[3:7])
        row["x"], row["z"], row["heading"] = transition.aligned(at, np.array([first[0], first[2], turn]))

    def _heading(self, rotation: F64) -> float:
        """Heading (rad) of a root rotation (4,) of this verb."""
        return transition.heading(rotation, transition.root_frame(self.evaluator))

    def _hold_feet(self, slots: I64, chosen: I64, step_s: float, progress: Records) -> None:
        """Write where the feet of the characters ``slots[chosen]`` are in this frame."""
        if len(self.planting.joints):
            _hold(slots, chosen, step_s, self.crowd, self.evaluator.goal.clock, self.planting.plants, progress)

    def _release_feet(self, slot: int, displayed: F64) -> None:
        """Prepare the feet of a character for a transition from a frame (3 + 4·J,)."""
        skeleton, (points, joints) = self.verb.skeleton, (self.planting.legs.points, self.planting.legs.chains)
        rotations = displayed[3:].reshape(1, -1, 4)
        turned, positions = np.empty_like(rotations), np.empty((1, rotations.shape[1], 3))
        poses.forward(displayed[None, :3], rotations, skeleton.parents, skeleton.offsets, turned, positions)
        carriers = np.stack([joints[:, -2], joints[:, -2], np.where(joints[:, -1] >= 0, joints[:, -1], joints[:, -2])])
        found = positions[0, carriers.T] + quat.rotate(turned[0, carriers.T], points)
        levels = self.planting.levels + self.state["y"][slot]
        _release(self.crowd.feet[slot], found, levels, self.planting.plants.flat)

    def _restart(self, slots: I64, step_s: float) -> None:
        """Let motions that started over pass from their progress to their starts, a jump from where it led."""
        self.state["step_s"][slots] = step_s
        enter = slots[self.state["held"][slots] < 0]
        self._hold(enter, self._displayed(enter))
        if len(self.planting.joints):
            for slot, row in zip(slots.tolist(), self.state["held"][slots].tolist(), strict=True):
                self._release_feet(slot, self.stored.frames[row, 1])
        if self.verb.measure.kind == measures.JUMP:
            for slot in slots.tolist():
                self._stand(slot, self.world(slot))
        legs = self.planting.legs
        _restart(slots, self.state, self.stored.frames, self.stored.offsets, self._ahead(slots), legs, RESTART_S)

    def displayed(self, slots: I64) -> F64:
        """Poses (n, 3 + 4·J) of the last frames: root, then local rotations, the root's in the world."""
        return self._displayed(slots)[:, 1]

    def _displayed(self, slots: I64) -> F64:
        """The last two frames (n, 2, 3 + 4·J), latest last; zeros before the first."""
        frames = np.zeros((len(slots), 2, 3 + 4 * len(self.verb.skeleton)))
        held, known = self.state["held"][slots], self.crowd.known[slots] > 0
        stored = held >= 0
        frames[stored] = self.stored.frames[held[stored]]
        if len(again := np.flatnonzero(~stored & known)):
            found = frames[again]
            _redisplay(slots[again], self.crowd, self.curves, self.striding, self.planting.legs, found)
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
        state["footed"] = 0.0  # feet are planted in what is displayed, not in what it comes from
        state["held"] = rows
        for step in (0.0, step_s):
            frame, _ = self._move(crowd, rows, step)
            self._pose(crowd, rows, step, (offsets, frames), frame.progress, frame.error, plant=False)
        return frames

    def _pose(
        self, crowd: Crowd, slots: I64, step_s: float, stored: tuple[F64, F64], progress: Records, error: F64, *,
        plant: bool,
    ) -> tuple[F64, F64, F64]:  # fmt: skip
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
        if plant:
            self._hold_feet(slots, np.arange(len(slots)), step_s, progress)
        root, rotations = np.empty((len(slots), 3)), np.empty((len(slots), len(self.verb.skeleton), 4))
        blend_poses(weights, np.ascontiguousarray(progress["phase"]), self.curves, root, rotations)
        _apply(slots, step_s, crowd, *stored, self.striding, self.planting.legs, root, rotations)
        return weights, root, rotations


def _follow_problem(method: Corrected, window: tuple[float, float]) -> FollowProblem:
    """Everything that :func:`verbs.kernels.following.follow` needs of a verb."""
    verb, chain = method.goal.verb, method.goal.chain
    joints = verb.skeleton.chain(verb.measure.effector)[:-1]
    return FollowProblem(*window, verb.curves, joints, method.correction, chain.mode, chain.references, chain.offsets)
