"""Evaluation of a verb: adverbs and phase to weights, poses, measured adverbs and error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeGuard

import numpy as np
import numpy.typing as npt

from verbs.blend import methods
from verbs.blend.corrected import Corrected
from verbs.conventions import F64, MAX_MAGNITUDE
from verbs.errors import OutOfRange, RequestError, UnknownName, VerbError
from verbs.goal import Goal
from verbs.kernels import chart as charts
from verbs.kernels import measure as measures
from verbs.kernels import pose as kernels
from verbs.kernels import timing
from verbs.kernels.columns import BATCH
from verbs.kernels.compile import direct
from verbs.kernels.corrected_position import Blended, PositionProblem, corrected_position
from verbs.kernels.crowd_pose import blend_sorted, curves_of
from verbs.kernels.legs import COMMAND, plant_poses
from verbs.kernels.position_batch import corrected_position_batch
from verbs.kernels.single_pose import single_pose
from verbs.kernels.stances import plan
from verbs.runtime.follow import follow_window
from verbs.runtime.planting import Planting, planting_of
from verbs.runtime.support import Support
from verbs.verb import Verb

__all__ = ["Blend", "Evaluator", "Poses"]

_clamp, _resolve = direct(charts.clamp), direct(timing.resolve)
_corrected_position, _corrected_position_batch = direct(corrected_position), direct(corrected_position_batch)
blend_poses, _single_pose = direct(blend_sorted), direct(single_pose)
_plan, _plant_poses = direct(plan), direct(plant_poses)

MAX_CYCLES, MAX_TIME_S = 1_000.0, 3_600.0
"""Largest phase of a looping motion, in cycles, and largest time of a pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Blend:
    """Weights at adverbs, and what the blend measures.

    Parameters
    ----------
    method : str
    weights : (B, N) float64
        Each row sums to 1; may be negative.
    measured : (B, m) float64
        Measured adverbs, in the order of ``verb.measure.axes``.
    error : (B,) float64
        Distance between goal and measured point, in the measure's unit; NaN where nothing is measured.
    clamped : (B,) bool
        True where the adverbs were so far outside the domain that they were moved back.
    adverbs : (B, D) float64 or None
        The goals, as requested; None where a crowd has them in chart coordinates only.
    """

    method: str
    weights: F64
    measured: F64
    error: F64
    clamped: npt.NDArray[np.bool_]
    adverbs: F64 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses of a batch.

    Parameters
    ----------
    blend : Blend
    phase : (B,) float64
        Canonical time; beyond 1 in further cycles of a loop.
    time_s, duration_s : (B,) float64
        Seconds since the start, and seconds per motion or cycle.
    root : (B, 3) float64
        Root position, metres.
    rotations : (B, J, 4) float64
        Local rotations, unit quaternions.
    root_velocity : (B, 3) float64 or None
        For a striding root: sideways, forward (m/s) in the frame of its heading, turn (rad/s).
    """

    blend: Blend
    phase: F64
    time_s: F64
    duration_s: F64
    root: F64
    rotations: F64
    root_velocity: F64 | None


class Evaluator:
    """A verb prepared for evaluation, by any number of threads at once.

    Parameters
    ----------
    verb : Verb

    Attributes
    ----------
    measured_names : list of str
        Names of the measured adverbs, in the order of ``verb.measure.axes``.

    Examples
    --------
    >>> from verbs import Evaluator, library
    >>> arm = Evaluator(library.load("arm3"))
    >>> poses = arm.pose({"x": 0.5, "y": 0.2}, phase=0.5)
    >>> poses.rotations.shape
    (1, 4, 4)
    """

    def __init__(self, verb: Verb) -> None:
        self.verb = verb
        self.curves = curves_of(verb.curves, verb.rotation_mode, verb.references)
        self.goal = Goal.of_verb(verb)
        self._default = methods.default_method(verb)
        self._names = [adverb.name for adverb in verb.adverbs]
        self.measured_names = [self._names[axis] for axis in verb.measure.axes.tolist()] if verb.measure.kind else []
        self._shape = (len(verb.examples), len(verb.measure.axes))
        self._problem: PositionProblem | None = None
        self._method = lru_cache(maxsize=None)(lambda name: methods.make(name, verb))
        self._support: Support | None = None

    def method(self, name: str | None = None) -> tuple[str, methods.Method]:
        """A method by name, prepared once; None takes the verb's default."""
        chosen = name or self._default
        return chosen, self._method(chosen)

    def planting(self) -> Planting:
        """The feet, prepared once; none where the verb has no contacts."""
        return self._planting

    def follow_window(self) -> tuple[float, float] | None:
        """Phases (from, to) at which a paused pose can follow its goal, prepared once; None where none can."""
        return self._follow_window

    @cached_property  # a cache of a bound method would refer to the evaluator, and keep replaced versions in memory
    def _planting(self) -> Planting:
        return planting_of(self.verb)

    @cached_property
    def _follow_window(self) -> tuple[float, float] | None:
        if "corrected" not in methods.usable(self.verb):
            return None
        method = self._method("corrected")
        assert isinstance(method, Corrected)
        return follow_window(method)

    def adverbs(self, named: Mapping[str, float] | Sequence[Mapping[str, float]]) -> F64:
        """Adverbs (B, D) from one or several mappings of names to numbers.

        Raises
        ------
        UnknownName
            A name that is no adverb of this verb.
        RequestError
            An adverb is missing.
        OutOfRange
            A value is not finite.
        """
        names = self._names
        if isinstance(named, dict) and len(named) == len(names):
            values = [named.get(name, math.nan) for name in names]
            if all(-MAX_MAGNITUDE <= value <= MAX_MAGNITUDE for value in values):  # NaN compares false
                return np.array([values], np.float64)
        rows = [named] if isinstance(named, Mapping) else named
        try:
            if all(len(row) == len(names) for row in rows):
                return self.check(np.array([[row[name] for name in names] for row in rows], np.float64))
        except KeyError:
            pass  # reported below, by name
        for row in rows:
            for name in row:
                if name not in names:
                    raise UnknownName("adverb", name, names)
        missing = next(name for row in rows for name in names if name not in row)
        raise RequestError(f"missing adverb {missing}; this verb needs {', '.join(names)}")

    def check(self, adverbs: F64) -> F64:
        """Adverbs as a C-contiguous (B, D) array; :class:`OutOfRange` where one is not finite or the shape is wrong."""
        adverbs = np.ascontiguousarray(adverbs, np.float64)
        names = self._names
        if adverbs.ndim != 2 or adverbs.shape[1] != len(names):
            raise OutOfRange(f"adverbs must have shape (batch, {len(names)}): {', '.join(names)}")
        fine = np.abs(adverbs) <= MAX_MAGNITUDE  # NaN compares false, so this catches it as well
        if not fine.all():
            row, column = np.argwhere(~fine)[0]
            raise OutOfRange(
                f"adverb '{names[column]}' is {adverbs[row, column]}; it must be a finite number of magnitude "
                f"{MAX_MAGNITUDE:,.0f} at most"
            )
        return adverbs

    def blend(self, adverbs: F64, *, method: str | None = None) -> Blend:
        """Weights at adverbs (B, D), measured adverbs and error."""
        return self._blend(self.check(adverbs), method)

    def blend_points(self, points: F64, *, method: str | None = None) -> Blend:
        """:meth:`blend` at normalised coordinates (B, D) of the domain's chart, as ``domain.chart.points`` gives them.

        Raises
        ------
        OutOfRange
            A coordinate is not finite, or the shape is wrong.
        """
        points = np.ascontiguousarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != len(self._names) or not np.isfinite(points).all():
            raise OutOfRange(f"points must be finite and have shape (batch, {len(self._names)})")
        _, chosen = self.method(method)
        if len(points) >= BATCH and self._is_position(chosen):
            return self._corrected_position(chosen, points, charted=True)
        return self._blend(self.verb.domain.chart.adverbs(points), method)

    def _blend(self, adverbs: F64, method: str | None) -> Blend:
        name, chosen = self.method(method)
        if self._is_position(chosen):
            return self._corrected_position(chosen, adverbs)
        inside, clamped = self.clamp(adverbs)
        return self.measure(name, chosen.weights(inside), adverbs, clamped)

    def _is_position(self, method: methods.Method) -> TypeGuard[Corrected]:
        """Whether weights, measured adverbs and error come from one compiled call."""
        return isinstance(method, Corrected) and self.verb.measure.kind == measures.POSITION

    def _corrected_position(self, method: Corrected, rows: F64, *, charted: bool = False) -> Blend:
        """The fast path: :meth:`blend` for the default of most verbs, in one compiled call.

        Rows (B, D) are adverbs, or (``charted``, for batches only) normalised coordinates of the domain's chart.
        """
        size, shape = len(rows), self._shape
        out = Blended(np.empty((size, shape[0])), np.empty((size, shape[1])), np.empty(size), np.empty(size))
        if self._problem is None:
            self._problem = method.problem()
        if size < BATCH:
            _corrected_position(rows, self._problem, out)
        else:
            _corrected_position_batch(rows, charted, self._problem, out)
        return Blend("corrected", out.weights, out.measured, out.error, out.moved > 0, None if charted else rows)

    def measure(self, method: str, weights: F64, adverbs: F64, clamped: npt.NDArray[np.bool_]) -> Blend:
        """Measure weights (B, N), and compare them with the goals of adverbs (B, D)."""
        if not self.goal.measurable:
            return Blend(method, weights, np.zeros((len(weights), 0)), np.full(len(weights), np.nan), clamped, adverbs)
        measured, error = self.goal.compare(adverbs, self.goal.measured(weights))
        return Blend(method, weights, measured, error, clamped, adverbs)

    def support(self, blend: Blend) -> F64:
        """How well the examples support a blend: (B,), 0 to 1; see :class:`verbs.runtime.support.Support`.

        Raises
        ------
        RequestError
            The blend has no adverbs.
        """
        if blend.adverbs is None:
            raise RequestError("this blend was made without adverbs, and support is taken at them")
        return self.support_at(blend.adverbs, blend.weights)

    def support_at(self, adverbs: F64, weights: F64) -> F64:
        """Support (B,) of weights (B, N) at goals (B, D); both C-contiguous."""
        if self._support is None:
            self._support = Support.of_verb(self.verb)
        return self._support.of(adverbs, weights)

    def clamp(self, adverbs: F64) -> tuple[F64, npt.NDArray[np.bool_]]:
        """Adverbs (B, D) moved back to the domain's surroundings, and where that moved them (B,)."""
        out, moved = np.empty_like(adverbs), np.empty(len(adverbs))
        _clamp(adverbs, self.verb.domain.arrays, out, moved)
        return out, moved > 0

    def pose(
        self,
        adverbs: Mapping[str, float] | Sequence[Mapping[str, float]] | F64,
        *,
        phase: float | F64 | None = None,
        time_s: float | F64 | None = None,
        method: str | None = None,
        plant: bool = True,
    ) -> Poses:
        """Poses at adverbs, at a phase or a time (the start where neither is given).

        Parameters
        ----------
        adverbs : mapping, sequence of mappings, or (B, D) array
        phase : float or (B,) array, optional
            0 to 1; beyond 1 for further cycles of a looping verb.
        time_s : float or (B,) array, optional
            Seconds from the start; past the end of a motion its last pose.
        method : str, optional
        plant : bool
            Whether standing feet are held where they landed, and nothing of a foot is below the ground.

        Raises
        ------
        RequestError
            See :meth:`adverbs`; or both a phase and a time are given, or one is out of range.
        """
        rows = self.check(adverbs) if isinstance(adverbs, np.ndarray) else self.adverbs(adverbs)
        return self.pose_of(self._blend(rows, method), phase=phase, time_s=time_s, plant=plant)

    def pose_of(
        self,
        blend: Blend,
        *,
        phase: float | F64 | None = None,
        time_s: float | F64 | None = None,
        plant: bool = True,
    ) -> Poses:
        """Poses of a blend (B rows, or one row for several phases); see :meth:`pose`."""
        if phase is not None and time_s is not None:
            raise RequestError("give a phase or a time, not both")
        given = time_s if time_s is not None else 0.0 if phase is None else phase
        if isinstance(given, float) and len(blend.weights) == 1 and self.verb.root_motion != kernels.STRIDE:
            return self._pose_one(blend, given, given_time=time_s is not None, plant=plant)
        at = np.atleast_1d(np.asarray(given, np.float64))
        self._check_instant(at, given_time=time_s is not None)
        weights = blend.weights
        if len({len(weights), len(at), 1}) > 2:
            raise OutOfRange(f"{len(at)} instants for {len(weights)} sets of adverbs; give one each, or one for all")
        verb, size = self.verb, max(len(weights), len(at))
        one_walk = verb.looping and size > 1 and len(weights) == 1 and bool(np.all(np.diff(at) >= 0))
        if len(weights) != size:
            weights = np.ascontiguousarray(np.broadcast_to(weights, (size, weights.shape[1])))
        if len(at) != size:
            at = np.ascontiguousarray(np.broadcast_to(at, size))
        found = timing.instants(size)
        _resolve(weights, self.goal.clock, at, time_s is not None, found)
        phases = found.phase
        root, rotations = np.empty((size, 3)), np.empty((size, len(verb.skeleton), 4))
        local = phases % 1.0 if verb.looping else phases
        blend_poses(weights, local, self.curves, root, rotations)
        if plant:
            self._plant(weights, phases, found.rate, root, rotations)
        velocity = None
        if verb.root_motion == kernels.STRIDE:
            velocity = np.empty((size, 3))
            timing.velocities(weights, verb.strides, phases, found.rate, verb.looping, velocity)
            kernels.travel(weights, verb.strides, phases, verb.looping, one_walk, root, rotations)
        return Poses(blend, phases, found.time_s, found.duration_s, root, rotations, velocity)

    def _plant(self, weights: F64, phases: F64, rates: F64, root: F64, rotations: F64) -> None:
        """Plant the feet of poses (B, 3), (B, J, 4), which have not travelled yet."""
        planting = self.planting()
        if len(planting.joints):
            commands = np.empty((len(root), len(planting.joints), len(COMMAND)))
            _plan(weights, phases, rates, planting.plants, commands)
            _plant_poses(root, rotations, commands, planting.legs)

    def _pose_one(self, blend: Blend, at: float, *, given_time: bool, plant: bool) -> Poses:
        """The fast path: :meth:`pose_of` for one pose of a verb whose root does not stride."""
        instant = np.array([at])
        if not 0.0 <= at <= self._latest(given_time=given_time):
            self._check_instant(instant, given_time=given_time)
        found = timing.instants(1)
        root, rotations = np.empty((1, 3)), np.empty((1, len(self.verb.skeleton), 4))
        _single_pose(blend.weights, self.goal.clock, instant, given_time, self.curves, found, root, rotations)
        if plant:
            self._plant(blend.weights, found.phase, found.rate, root, rotations)
        return Poses(blend, found.phase, found.time_s, found.duration_s, root, rotations, None)

    def _latest(self, *, given_time: bool) -> float:
        """Largest phase or time, seconds."""
        return MAX_TIME_S if given_time else MAX_CYCLES if self.verb.looping else 1.0

    def _check_instant(self, at: F64, *, given_time: bool) -> None:
        name, top = "time" if given_time else "phase", self._latest(given_time=given_time)
        if not (at.min() >= 0.0 and at.max() <= top):  # NaN compares false, so this catches it as well
            wrong = at[~((at >= 0.0) & (at <= top))][0]
            raise OutOfRange(f"{name} is {wrong}; it must lie between 0 and {top:g}")

    def positions(self, poses: Poses) -> tuple[F64, F64]:
        """Global rotations (B, J, 4) and joint positions (B, J, 3) of poses."""
        global_rotations, positions = np.empty_like(poses.rotations), np.empty((*poses.rotations.shape[:2], 3))
        skeleton = self.verb.skeleton
        kernels.forward(poses.root, poses.rotations, skeleton.parents, skeleton.offsets, global_rotations, positions)
        return global_rotations, positions

    def warm(self) -> None:
        """Compile or load every kernel that a request may need."""
        for name in methods.usable(self.verb):
            with suppress(VerbError):  # a method that fails for this verb reports it when it is used
                self.blend(self.verb.values[:1], method=name)
                self.blend(np.resize(self.verb.values, (BATCH, len(self._names))), method=name)
        self.follow_window()
        poses = self.pose(self.verb.values[:1], phase=0.0)
        self.pose_of(poses.blend, time_s=0.0)
        self.positions(poses)
        self.support(poses.blend)
