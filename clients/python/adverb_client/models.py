"""Responses of the REST API as frozen dataclasses; ``parsing`` creates them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from adverb_client.skeleton import Skeleton

__all__ = [
    "Adverb",
    "Example",
    "Health",
    "KeytimeEvent",
    "Mapped",
    "Pose",
    "Poses",
    "QualityMap",
    "Sequence",
    "SkippedFile",
    "Verb",
    "VerbSummary",
]

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Adverb:
    """One parameter of a verb: name, unit, range; ``style`` marks one that cannot be measured in a motion."""

    name: str
    unit: str
    min: float
    max: float
    style: bool
    description: str = ""


@dataclass(frozen=True, slots=True)
class VerbSummary:
    """One verb of the list; ``duration_s`` has the shortest and the longest duration of its examples."""

    name: str
    version: int
    description: str
    looping: bool
    adverbs: tuple[str, ...]
    joints: int
    examples: int
    duration_s: tuple[float, float]
    default_method: str


@dataclass(frozen=True, slots=True)
class Example:
    """One example of a verb: its adverbs, and its keytimes in seconds from the first."""

    name: str
    adverbs: Mapping[str, float]
    keytimes_s: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Verb:
    """Description of one verb.

    Parameters
    ----------
    name, description, default_method : str
    version : int
    looping : bool
    adverbs : tuple of Adverb
        In the order of binary rows.
    skeleton : Skeleton
    examples : tuple of Example
    keytimes : mapping of str to float
        Canonical time of each keytime.
    methods : tuple of str
    measure : mapping
        How errors are measured: ``kind``, ``effector``, ``keytime``, ``adverbs``, ``unit``.
    quality : mapping
        Quality figures that were measured when the verb was built.
    info : mapping
        The whole JSON response, including fields without an attribute here (the domain's facets, …).
    """

    name: str
    version: int
    description: str
    looping: bool
    adverbs: tuple[Adverb, ...]
    skeleton: Skeleton
    examples: tuple[Example, ...]
    keytimes: Mapping[str, float]
    methods: tuple[str, ...]
    default_method: str
    measure: Json
    quality: Json
    info: Json


@dataclass(frozen=True, slots=True)
class Mapped:
    """The skeleton of a mapped answer, and how well it keeps effector and feet.

    Parameters
    ----------
    name, goal : str
        As requested.
    scale : float
        Lengths of the skeleton per length of the verb's.
    joints : tuple of str
        Names of the joints, in the order of the rotations.
    effector_m, foot_height_m, foot_slide_m : float or None
        Distance of the effector from its goal at its keytime; largest distance of a standing foot from the ground, and
        from its place over the ground; metres. None where there is none.
    """

    name: str
    goal: str
    scale: float
    joints: tuple[str, ...]
    effector_m: float | None
    foot_height_m: float | None
    foot_slide_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """One pose.

    Parameters
    ----------
    verb : str
    version : int
    phase, time_s, duration_s : float
        Canonical time; seconds from the start; duration of the whole motion, or of one cycle, seconds.
    root : (3,) float32
        Position of the root joint, metres.
    rotations : (J, 4) float32
        Unit quaternions x, y, z, w, in the requested space and of the requested joints.
    error : float or None
        Distance between requested and measured adverbs, metres (or the measure's unit); None where not measured.
    clamped : bool
        Whether the adverbs were clamped to the domain.
    method, measured, positions, root_velocity, weights, met, tried, support
        In full responses only, else None: the method; the measured adverbs; in global space the joints' positions
        (J, 3), metres; of a locomotion root sideways and forward velocity, m/s, and yaw rate, rad/s, (3,); the
        examples' weights (E,); whether the error is within ``max_error``; the methods that were tried; how well
        the examples support the answer, 0 to 1 (of binary records where ``support`` is requested).
    mapped : Mapped or None
        Where ``map`` was requested.
    """

    verb: str
    version: int
    phase: float
    time_s: float
    duration_s: float
    root: F32
    rotations: F32
    error: float | None
    clamped: bool
    method: str | None = None
    measured: Mapping[str, float] | None = None
    positions: F32 | None = None
    root_velocity: F32 | None = None
    weights: F64 | None = None
    met: bool | None = None
    tried: tuple[str, ...] | None = None
    support: float | None = None
    mapped: Mapped | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Many poses as columns; ``poses[k]`` is one of them.

    Parameters
    ----------
    verb : str
    version : int
    phases, times_s, durations_s : (B,) float32
    root : (B, 3) float32
    rotations : (B, J, 4) float32
    errors : (B,) float32
        NaN where nothing is measured.
    clamped : (B,) bool
    method, measured, positions, root_velocity, weights, support
        As in :class:`Pose`, with a leading axis (B).
    mapped : tuple of Mapped, or None
        Of each pose, where ``map`` was requested.
    """

    verb: str
    version: int
    phases: F32
    times_s: F32
    durations_s: F32
    root: F32
    rotations: F32
    errors: F32
    clamped: npt.NDArray[np.bool_]
    method: str | None = None
    measured: Mapping[str, F64] | None = None
    positions: F32 | None = None
    root_velocity: F32 | None = None
    weights: F64 | None = None
    support: F64 | None = None
    mapped: tuple[Mapped, ...] | None = None

    def __len__(self) -> int:
        return len(self.phases)

    def __iter__(self) -> Iterator[Pose]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: int) -> Pose:
        error = float(self.errors[k])
        return Pose(
            self.verb,
            self.version,
            float(self.phases[k]),
            float(self.times_s[k]),
            float(self.durations_s[k]),
            self.root[k],
            self.rotations[k],
            None if np.isnan(error) else error,
            bool(self.clamped[k]),
            self.method,
            None if self.measured is None else {name: float(column[k]) for name, column in self.measured.items()},
            None if self.positions is None else self.positions[k],
            None if self.root_velocity is None else self.root_velocity[k],
            None if self.weights is None else self.weights[k],
            support=None if self.support is None else float(self.support[k]),
            mapped=None if self.mapped is None else self.mapped[k],
        )


@dataclass(frozen=True, slots=True)
class KeytimeEvent:
    """A keytime in a motion: name, canonical time, seconds from the start."""

    name: str
    phase: float
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """A whole motion, frame by frame.

    Parameters
    ----------
    verb : str
    version : int
    fps : float
    duration_s : float
        Duration of the motion with all cycles, or of a track's frames.
    phases, times_s : (F,) float64
    root : (F, 3) float32
    rotations : (F, J, 4) float32
    errors : (F,) float64
        NaN where nothing is measured.
    clamped : bool
        Whether the adverbs of any frame were clamped to the domain.
    method, measured, events, positions, root_velocity, weights, support
        In full responses only, else None. Weights are (1, E), or (F, E) along a track; support is (F,).
    mapped : Mapped or None
        Where ``map`` was requested; the figures are the largest of all frames.
    """

    verb: str
    version: int
    fps: float
    duration_s: float
    phases: F64
    times_s: F64
    root: F32
    rotations: F32
    errors: F64
    clamped: bool
    method: str | None = None
    measured: Mapping[str, float] | None = None
    events: tuple[KeytimeEvent, ...] | None = None
    positions: F32 | None = None
    root_velocity: F32 | None = None
    weights: F64 | None = None
    support: F64 | None = None
    mapped: Mapped | None = None

    def __len__(self) -> int:
        return len(self.phases)

    @property
    def error(self) -> float | None:
        """The largest error of any frame; None where nothing is measured."""
        return None if np.isnan(self.errors).all() else float(np.nanmax(self.errors))


@dataclass(frozen=True, slots=True, eq=False)
class QualityMap:
    """Quality of a method over a plane of two adverbs.

    Parameters
    ----------
    verb : str
    version : int
    method : str
    unit : str
        Of errors.
    across, up : str
        Adverbs of columns and rows; ``up`` is empty where the verb has one adverb.
    held : mapping of str to float
        Values of the other adverbs.
    columns : (C,) float64
    rows : (R,) float64
    error, smoothness, support : (R, C) float64
        NaN outside the domain, and errors where nothing is measured. Smoothness is the curvature κ of the weights.
    info : mapping
        The whole JSON response, with means and extremes.
    """

    verb: str
    version: int
    method: str
    unit: str
    across: str
    up: str
    held: Mapping[str, float]
    columns: F64
    rows: F64
    error: F64
    smoothness: F64
    support: F64
    info: Json


@dataclass(frozen=True, slots=True)
class SkippedFile:
    """A file that the server cannot load, and the reason."""

    file: str
    problem: str


@dataclass(frozen=True, slots=True)
class Health:
    """Readiness: the number of verbs, and the files that could not be loaded."""

    ready: bool
    verbs: int
    skipped: tuple[SkippedFile, ...]
