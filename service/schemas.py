"""What clients send and get. Requests are checked by these models; answers are only described by them.

Answers are written from arrays by orjson, since validating a pose takes longer than blending it.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator, with_config
from typing_extensions import TypedDict

from verbs.conventions import MAX_ADVERBS, MAX_JOINTS
from verbs.sequence import MAX_CYCLES, MAX_FPS

__all__ = [
    "STRICT",
    "BatchItem",
    "BatchRequest",
    "Live",
    "Options",
    "PoseAnswer",
    "PoseRequest",
    "PosesAnswer",
    "ProblemAnswer",
    "Ready",
    "RefinementAnswer",
    "RefinementList",
    "RefinementRequest",
    "SequenceAnswer",
    "SequenceRequest",
    "TrackPoint",
    "UploadAnswer",
    "VerbAnswer",
    "VerbList",
    "VerbSummary",
    "VersionAnswer",
    "VersionsAnswer",
]

Name = Annotated[str, Field(min_length=1, max_length=200)]
Adverbs = Annotated[
    dict[Name, float],
    Field(
        min_length=1,
        max_length=MAX_ADVERBS,
        description="All adverbs of the verb by name, in their units. Values outside the domain are drawn back to it.",
        examples=[{"x": -0.3, "y": 1.2, "z": 0.4}],
    ),
]
Phase = Annotated[
    float | None,
    Field(ge=0, le=1_000, description="Canonical time, 0 to 1; a looping verb's goes on past 1. 0 by default."),
]
Time = Annotated[
    float | None,
    Field(ge=0, le=3_600, description="Seconds from the start, instead of a phase; the end holds."),
]
Space = Literal["local", "global"]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class _Asked(BaseModel):
    """A request body: nothing unknown, nothing converted, nothing that is not finite."""

    model_config = STRICT


class Options(_Asked):
    """What all evaluating routes have in common."""

    method: Annotated[
        Name | None,
        Field(description="Blending method, one of the verb's `methods`; by default its `default_method`."),
    ] = None
    space: Annotated[
        Space, Field(description="`global` gives rotations in the verb's space, and the joints' positions.")
    ] = "local"
    joints: Annotated[
        list[Name] | None,
        Field(min_length=1, max_length=MAX_JOINTS, description="Joints to give, in this order; all by default."),
    ] = None
    version: Annotated[
        int | None,
        Field(ge=1, description="The version that must answer; by default the current one."),
    ] = None
    weights: Annotated[bool, Field(description="Whether to give the examples' weights too.")] = False


class PoseRequest(Options):
    """One pose."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"adverbs": {"x": -0.3, "y": 1.2, "z": 0.4}, "phase": 0.5}]}
    )

    adverbs: Adverbs
    phase: Phase = None
    time: Time = None
    max_error: Annotated[
        float | None,
        Field(
            gt=0,
            description="Largest error that the client can use, metres: rbf, search, corrected and a polish of the "
            "joints are tried in this order, from `method` on where it is given, until it is met. `tried` in the "
            "answer says what was done, `met` whether it was enough; the pose is given either way.",
        ),
    ] = None


@with_config(STRICT)
class BatchItem(TypedDict):
    """One character of a crowd."""  # a plain mapping: a thousand models take three times as long to make

    adverbs: Adverbs
    phase: NotRequired[Phase]
    time: NotRequired[Time]


class BatchRequest(Options):
    """Many poses of one verb. All items give a phase, or all a time."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "items": [
                        {"adverbs": {"x": -0.3, "y": 1.2, "z": 0.4}, "phase": 0.5},
                        {"adverbs": {"x": -0.1, "y": 1.5, "z": 0.3}, "phase": 0.25},
                    ]
                }
            ]
        }
    )

    items: Annotated[list[BatchItem], Field(min_length=1, max_length=10_000)]


class TrackPoint(_Asked):
    """Adverbs at an instant."""

    time: Annotated[float, Field(ge=0, le=3_600, description="Seconds from the start.")]
    adverbs: Adverbs


class SequenceRequest(Options):
    """A whole motion: at constant adverbs, or along a track of them."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"adverbs": {"x": -0.3, "y": 1.2, "z": 0.4}, "fps": 30}]})

    adverbs: Adverbs | None = None
    track: Annotated[
        list[TrackPoint] | None,
        Field(
            min_length=1,
            max_length=1_000,
            description="Adverbs over time instead of constant ones: linear between the points, whose times rise, and "
            "held before and after them.",
        ),
    ] = None
    fps: Annotated[float, Field(ge=1, le=MAX_FPS, description="Frames per second.")] = 30.0
    cycles: Annotated[int, Field(ge=1, le=MAX_CYCLES, description="Cycles of a looping verb.")] = 1

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.adverbs is None) == (self.track is None):
            raise ValueError("give either 'adverbs' or 'track'")
        return self


class _Adverb(BaseModel):
    name: str
    unit: str
    min: float
    max: float
    style: Annotated[bool, Field(description="True where the motion cannot be measured for it.")]
    description: str


class _Tip(BaseModel):
    parent: int
    offset: Vector


class _Skeleton(BaseModel):
    names: list[str]
    parents: Annotated[list[int], Field(description="Index of each joint's parent; -1 for the root.")]
    offsets: Annotated[list[Vector], Field(description="Position in the parent's frame, metres.")]
    tips: Annotated[list[_Tip], Field(description="Ends of fingers, toes, crown: they have no rotation.")]


class _Example(BaseModel):
    name: str
    adverbs: dict[str, float]
    keytimes: Annotated[list[float], Field(description="Seconds from the first keytime.")]
    point: Annotated[
        Vector | None,
        Field(description="Where its effector is at the keytime, or (x, rise, z) of a jump, metres; null elsewhere."),
    ]


class _PseudoExample(BaseModel):
    adverbs: dict[str, float]
    point: Annotated[Vector | None, Field(description="As of an example.")]


class _Range(BaseModel):
    min: float
    max: float


class _Domain(BaseModel):
    text: str
    chart: str
    chart_axes: list[int]
    chart_bend: list[float]
    shift: list[float]
    scale: list[float]
    facets: list[list[float]]
    middle: list[float]


class _Measure(BaseModel):
    kind: Annotated[str, Field(description="none, joint_position, jump or root_velocity.")]
    effector: str | None
    keytime: str | None
    adverbs: Annotated[list[str], Field(description="Adverbs that are measured.")]
    unit: Annotated[str, Field(description="Unit of the error.")]
    origin: Annotated[Vector | None, Field(description="Of joint_position: where measured adverbs of 0 are, metres.")]
    frame: Annotated[
        list[list[float]] | None,
        Field(description="Of joint_position: 3 rows; a goal is origin + frame · measured adverbs."),
    ]


class VerbSummary(BaseModel):
    """One verb of the list."""

    name: str
    version: int
    description: str
    looping: bool
    adverbs: list[str]
    joints: int
    examples: int
    duration: Annotated[_Range, Field(description="Shortest and longest example, seconds.")]
    default_method: str


class VerbList(BaseModel):
    """The verbs that are served."""

    verbs: list[VerbSummary]


class VerbAnswer(BaseModel):
    """All that a client needs to know about a verb."""

    name: str
    version: int
    description: str
    looping: bool
    adverbs: list[_Adverb]
    skeleton: _Skeleton
    examples: list[_Example]
    pseudo_examples: Annotated[list[_PseudoExample], Field(description="Where refinement put some.")]
    keytime_names: list[str]
    keytime_phases: list[float]
    duration: _Range
    domain: Annotated[
        _Domain,
        Field(description="{u : facets · (u - middle) ≤ 1}, u = (chart(adverbs) - shift) · scale."),
    ]
    methods: list[str]
    default_method: str
    measure: _Measure
    quality: Annotated[dict[str, Any], Field(description="Figures that were measured when the verb was built.")]


_Table = list[list[float | None]]


class QualityAnswer(BaseModel):
    """What a method does over a plane of adverbs."""

    verb: str
    version: int
    method: str
    unit: Annotated[str, Field(description="Unit of the error.")]
    across: str
    up: Annotated[str, Field(description="The same as `across` where the verb has one adverb: one row.")]
    held: Annotated[dict[str, float], Field(description="The other adverbs.")]
    columns: Annotated[list[float], Field(description="Values of `across`.")]
    rows: Annotated[list[float], Field(description="Values of `up`.")]
    error: Annotated[
        _Table, Field(description="Rows by columns; null outside the domain and where nothing is measured.")
    ]
    error_mean: float | None
    error_max: float | None
    smoothness: Annotated[_Table, Field(description="κ of the weights; null where not all neighbours lie inside.")]
    smoothness_mean: float | None
    smoothness_max: float | None


class PoseAnswer(BaseModel):
    """One pose, and how far it is from what was asked."""

    verb: str
    version: int
    method: str
    phase: Annotated[float, Field(description="Canonical time.")]
    time: Annotated[float, Field(description="Seconds from the start.")]
    duration: Annotated[float, Field(description="Seconds of the whole motion, or of one cycle.")]
    root: Annotated[Vector, Field(description="Position of the root joint, metres.")]
    rotations: Annotated[list[Quaternion], Field(description="Unit quaternions x, y, z, w in the order of the joints.")]
    positions: Annotated[list[Vector] | None, Field(description="In global space: joint positions, metres.")] = None
    root_velocity: Annotated[
        Vector | None, Field(description="Of a striding root: sideways, forward (m/s), turn (rad/s).")
    ] = None
    measured: Annotated[dict[str, float], Field(description="What the measured adverbs come to.")]
    error: Annotated[float | None, Field(description="Distance between asked and measured; null where nothing is.")]
    met: Annotated[bool | None, Field(description="Whether `error` is within `max_error`, where given.")] = None
    tried: Annotated[
        list[str] | None, Field(description="What was done to meet `max_error`, in order, where it was given.")
    ] = None
    clamped: Annotated[bool, Field(description="Whether the adverbs were drawn back to the domain.")]
    weights: Annotated[list[float] | None, Field(description="Weights of the examples, where asked for; sum 1.")] = None


class PosesAnswer(BaseModel):
    """Poses in the order of the items."""

    verb: str
    version: int
    method: str
    poses: list[PoseAnswer]


class _Event(BaseModel):
    name: str
    phase: float
    time: float


class SequenceAnswer(BaseModel):
    """A whole motion, column by column."""

    verb: str
    version: int
    method: str
    fps: float
    frames: int
    duration: Annotated[float, Field(description="Seconds of the motion, all cycles; of a track: of its frames.")]
    clamped: Annotated[bool, Field(description="Whether the adverbs of any frame were drawn back to the domain.")]
    measured: Annotated[dict[str, float] | None, Field(description="What measured adverbs come to; not of a track.")]
    error: Annotated[float | None, Field(description="Of a track, the largest.")]
    errors: Annotated[list[float | None] | None, Field(description="Of a track: the error of each frame.")] = None
    weights: Annotated[
        list[list[float]] | None, Field(description="Where asked for: one row, or of a track one per frame.")
    ] = None
    events: Annotated[list[_Event], Field(description="Keytimes that pass, by name.")]
    times: list[float]
    phases: list[float]
    root: list[Vector]
    root_velocity: list[Vector] | None = None
    positions: list[list[Vector]] | None = None
    rotations: list[list[Quaternion]]


class VersionAnswer(BaseModel):
    """One version of a verb."""

    verb: str
    version: int
    current: Annotated[bool, Field(description="Whether it is the one that is served.")]
    sha256: str
    bytes: int
    who: Annotated[str, Field(description="Who published it.")]
    why: str
    created_at: Annotated[float, Field(description="Seconds since 1970.")]
    parent: Annotated[int | None, Field(description="The version that it was refined from.")]
    quality: dict[str, Any]


class VersionsAnswer(BaseModel):
    """Versions of a verb, the newest first."""

    verb: str
    current: int | None
    versions: list[VersionAnswer]


class UploadAnswer(VersionAnswer):
    """The version that an upload became."""

    warnings: Annotated[list[str], Field(description="What its author should know.")]


class RefinementRequest(_Asked):
    """What a refinement should come to."""

    target_error: Annotated[
        float,
        Field(gt=0, le=10, description="Largest error at which to stop, as a share of the goals' diagonal."),
    ] = 0.01
    max_pseudo: Annotated[int, Field(ge=0, le=2_000, description="Most pseudo-examples.")] = 300
    budget_s: Annotated[float, Field(gt=0, le=7 * 24 * 3600, description="Most computing time, seconds.")] = 600.0
    method: Annotated[Literal["refined", "hybrid"], Field(description="Method by which the result is judged.")] = (
        "refined"
    )
    weighted_by_traffic: Annotated[bool, Field(description="Whether to look first where the verb is asked.")] = False
    seed: Annotated[int, Field(ge=0, le=10**6)] = 1
    priority: Annotated[int, Field(ge=1, le=100, description="1 is served first.")] = 50


class RefinementAnswer(BaseModel):
    """One refinement."""

    id: str
    verb: str
    state: Literal["queued", "running", "published", "not_better", "failed", "cancelled", "given_up"]
    asked: dict[str, Any]
    progress: Annotated[dict[str, Any], Field(description="`pseudo`, `error_mean`, `error_max`, and the `curve`.")]
    version_before: int | None
    version_after: int | None
    detail: str
    created_at: float
    updated_at: float


class RefinementList(BaseModel):
    """Refinements, the newest first."""

    refinements: list[RefinementAnswer]


class Live(BaseModel):
    """The process answers."""

    live: bool


class _SkippedFile(BaseModel):
    file: str
    problem: str


class Ready(BaseModel):
    """Verbs are loaded and kernels warm."""

    ready: bool
    degraded: Annotated[bool, Field(description="Verbs are served as they were: the store cannot be reached now.")]
    problem: Annotated[str | None, Field(description="What is wrong, where it is degraded.")]
    verbs: int
    skipped: Annotated[list[_SkippedFile], Field(description="Files of the data folder that cannot be served.")]


class _Mistake(BaseModel):
    at: str
    problem: str


class ProblemAnswer(BaseModel):
    """RFC 9457 problem details."""

    type: str
    title: str
    status: int
    detail: str
    code: Annotated[str, Field(description="Stable: programs may compare it.")]
    known: Annotated[list[str] | None, Field(description="Names or media types that exist.")] = None
    limit: Annotated[int | None, Field(description="What is allowed at most.")] = None
    errors: Annotated[list[_Mistake] | None, Field(description="Where a body does not fit its schema.")] = None
