"""Models of response bodies, for the OpenAPI document. Request bodies are in :mod:`service.http.request_models`.

Responses are not made with these models: orjson writes them from arrays, since validating a pose takes longer than
evaluating it.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

__all__ = [
    "AccessAnswer",
    "AuditAnswer",
    "Live",
    "PoseAnswer",
    "PosesAnswer",
    "ProblemAnswer",
    "Ready",
    "RefinementAnswer",
    "RefinementList",
    "SequenceAnswer",
    "UploadAnswer",
    "VerbAnswer",
    "VerbList",
    "VerbSummary",
    "VersionAnswer",
    "VersionsAnswer",
]

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class _Span(BaseModel):
    joint: str
    begin: Annotated[float, Field(description="Canonical phase, 0 to 1.")]
    end: Annotated[float, Field(description="Canonical phase; equal to `begin` at a single instant.")]


class _AdverbMeasure(BaseModel):
    kind: Annotated[
        str,
        Field(
            description="position, velocity, speed, orientation, angular_velocity, displacement, root_motion, "
            "foot_speed, time_to or duration."
        ),
    ]
    axis: str
    joint: str | None
    at: Annotated[str | None, Field(description="Keytime; null if it is taken over a span.")]
    between: Annotated[list[str] | None, Field(description="Two keytimes; null if it is taken at one instant.")]
    unit: Annotated[str, Field(description="SI unit of the measured number.")]
    spans: Annotated[list[_Span], Field(description="Where it is measured; several for the stances of feet.")]


class _Adverb(BaseModel):
    name: str
    unit: str
    min: float
    max: float
    style: Annotated[bool, Field(description="True if the adverb cannot be measured from the motion.")]
    description: str
    measure: Annotated[
        _AdverbMeasure | None,
        Field(description="The measure that the adverb names for itself; null if the verb's measure is for all."),
    ]


class _Tip(BaseModel):
    parent: int
    offset: Vector


class _Skeleton(BaseModel):
    names: list[str]
    parents: Annotated[list[int], Field(description="Index of each joint's parent; -1 for the root.")]
    offsets: Annotated[list[Vector], Field(description="Position in the parent's frame, metres.")]
    tips: Annotated[list[_Tip], Field(description="End points of fingers, toes and head, without rotations.")]


class _Example(BaseModel):
    name: str
    adverbs: dict[str, float]
    keytimes: Annotated[list[float], Field(description="Seconds from the first keytime.")]
    point: Annotated[
        Vector | None,
        Field(
            description="Effector position at the keytime, or (x, rise, z) of a jump, metres; null for other measures."
        ),
    ]


class _PseudoExample(BaseModel):
    adverbs: dict[str, float]
    point: Annotated[Vector | None, Field(description="As of an example.")]
    aim: Annotated[
        Literal["error", "quality"], Field(alias="for", description="What the refinement that added it was for.")
    ]


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
    kind: Annotated[str, Field(description="none, joint_position, jump, root_velocity or adverbs.")]
    effector: str | None
    keytime: str | None
    adverbs: Annotated[list[str], Field(description="Adverbs that are measured.")]
    unit: Annotated[str, Field(description="Unit of the error.")]
    origin: Annotated[
        Vector | None, Field(description="For joint_position: the point whose measured adverbs are 0, metres.")
    ]
    frame: Annotated[
        list[list[float]] | None,
        Field(description="For joint_position: 3 rows; a goal is origin + frame · measured adverbs."),
    ]


_Share = Annotated[float, Field(description="Share of canonical time in contact, mean over examples, 0 to 1.")]


class _ContactPoint(BaseModel):
    part: Annotated[str, Field(description="heel, ball, toe, or foot.")]
    joint: Annotated[str, Field(description="Joint that carries the point.")]
    offset: Annotated[Vector, Field(description="Position in the joint's frame, metres.")]
    height: Annotated[float, Field(description="Height while it stands, mean over examples, metres.")]
    share: _Share
    intervals: Annotated[
        list[list[list[float]]],
        Field(description="For each example, its [begin, end] pairs of canonical time; beyond 1 in the next cycle."),
    ]


class _Foot(BaseModel):
    foot: Annotated[str, Field(description="Foot joint.")]
    share: _Share
    intervals: Annotated[int, Field(description="Number of intervals of all points and examples.")]
    points: list[_ContactPoint]


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
    """Description of a verb."""

    name: str
    version: int
    description: str
    looping: bool
    adverbs: list[_Adverb]
    skeleton: _Skeleton
    examples: list[_Example]
    pseudo_examples: Annotated[list[_PseudoExample], Field(description="Pseudo-examples that a refinement added.")]
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
    contacts: Annotated[list[_Foot], Field(description="Contacts of the feet with the ground; empty without feet.")]
    quality: Annotated[dict[str, Any], Field(description="Figures measured when the verb was built.")]


_Table = list[list[float | None]]

_SUPPORT = (
    "How well the examples support the answer: 1 at an example, 0.5 where it is as uncertain as an example predicted "
    "from the others."
)


class QualityAnswer(BaseModel):
    """Error, smoothness and support of a method over a plane of adverbs."""

    verb: str
    version: int
    method: str
    unit: Annotated[str, Field(description="Unit of the error.")]
    across: str
    up: Annotated[str, Field(description="Equal to `across` if the verb has one adverb; then there is one row.")]
    held: Annotated[dict[str, float], Field(description="Values of the other adverbs.")]
    columns: Annotated[list[float], Field(description="Values of `across`.")]
    rows: Annotated[list[float], Field(description="Values of `up`.")]
    error: Annotated[_Table, Field(description="Rows by columns; null outside the domain and if nothing is measured.")]
    error_mean: float | None
    error_max: float | None
    smoothness: Annotated[
        _Table, Field(description="Curvature κ of the weights; null at nodes with a neighbour outside the domain.")
    ]
    smoothness_mean: float | None
    smoothness_max: float | None
    support: Annotated[_Table, Field(description="Support by the examples, 0 to 1; null outside the domain.")]
    support_mean: float | None
    support_min: float | None


class MapAnswer(BaseModel):
    """The skeleton that was requested with `map`."""

    name: str
    goal: Annotated[str, Field(description="`scaled` or `world`.")]
    scale: Annotated[float, Field(description="Lengths of the skeleton per length of the verb's.")]
    joints: Annotated[list[str], Field(description="Names of the joints, in the order of `rotations`.")]


class FiguresAnswer(BaseModel):
    """How well the mapping keeps effector and feet; null where there is nothing to keep."""

    effector_m: Annotated[
        float | None, Field(description="Distance of the effector from its goal at its keytime, metres.")
    ]
    foot_height_m: Annotated[
        float | None, Field(description="Largest distance of a standing foot from the ground, metres.")
    ]
    foot_slide_m: Annotated[
        float | None, Field(description="Largest distance of a standing foot from its place over the ground, metres.")
    ]


_Map = Annotated[MapAnswer | None, Field(description="If a map was requested.")]
_Figures = Annotated[FiguresAnswer | None, Field(description="If a map was requested.")]


class PoseAnswer(BaseModel):
    """One pose and its error."""

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
        Vector | None, Field(description="If the root moves over a cycle: sideways, forward (m/s), turn (rad/s).")
    ] = None
    measured: Annotated[dict[str, float], Field(description="Values of the measured adverbs.")]
    error: Annotated[
        float | None, Field(description="Distance between goal and measured position; null if nothing is measured.")
    ]
    support: Annotated[float, Field(ge=0, le=1, description=_SUPPORT)]
    met: Annotated[bool | None, Field(description="Whether `error` is at most `max_error`, if given.")] = None
    tried: Annotated[list[str] | None, Field(description="Methods tried to meet `max_error`, in order, if given.")] = (
        None
    )
    clamped: Annotated[bool, Field(description="Whether the adverbs were moved to the nearest point of the domain.")]
    weights: Annotated[
        list[float] | None, Field(description="Weights of the examples, if requested; their sum is 1.")
    ] = None
    map: _Map = None
    figures: _Figures = None


class PosesAnswer(BaseModel):
    """Poses in the order of the items."""

    verb: str
    version: int
    method: str
    map: _Map = None
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
    duration: Annotated[float, Field(description="Seconds of the motion, all cycles; with a track, of its frames.")]
    clamped: Annotated[bool, Field(description="Whether the adverbs of any frame were outside the domain.")]
    measured: Annotated[
        dict[str, float] | None, Field(description="Values of the measured adverbs; null with a track.")
    ]
    error: Annotated[float | None, Field(description="With a track, the largest error.")]
    errors: Annotated[list[float | None] | None, Field(description="With a track: the error of each frame.")] = None
    support: Annotated[float, Field(ge=0, le=1, description=f"{_SUPPORT} With a track, the least.")]
    supports: Annotated[list[float] | None, Field(description="With a track: the support of each frame.")] = None
    weights: Annotated[
        list[list[float]] | None, Field(description="If requested: one row, or with a track one for each frame.")
    ] = None
    map: _Map = None
    figures: _Figures = None
    events: Annotated[list[_Event], Field(description="Keytimes within the motion, by name.")]
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
    current: Annotated[bool, Field(description="Whether this version is served.")]
    sha256: str
    bytes: int
    author: Annotated[str, Field(description="Client or refinement that published it.")]
    reason: str
    created_at: Annotated[float, Field(description="Seconds since 1970.")]
    parent: Annotated[int | None, Field(description="The version that it was refined from.")]
    source: Annotated[bool, Field(description="Whether its source is stored, to which an example can be added.")]
    quality: dict[str, Any]


class VersionsAnswer(BaseModel):
    """Versions of a verb, the newest first."""

    verb: str
    current: int | None
    versions: list[VersionAnswer]


class UploadAnswer(VersionAnswer):
    """The version that an upload created."""

    warnings: Annotated[list[str], Field(description="Warnings of the build.")]


class RefinementAnswer(BaseModel):
    """One refinement."""

    id: str
    verb: str
    state: Literal["queued", "running", "published", "not_better", "failed", "cancelled", "given_up"]
    request: Annotated[dict[str, Any], Field(description="Request of the refinement, with its defaults filled in.")]
    progress: Annotated[
        dict[str, Any],
        Field(
            description="`pseudo`; `error_mean` and `error_max`, or `cost_mean` and `cost_p95` for quality; their "
            "`curve`; and `figures` before (`now`) and after (`new`) at goals that were held out."
        ),
    ]
    version_before: int | None
    version_after: int | None
    detail: str
    created_at: float
    updated_at: float


class RefinementList(BaseModel):
    """Refinements, the newest first."""

    refinements: list[RefinementAnswer]


class AccessAnswer(BaseModel):
    """The key of a request."""

    required: Annotated[bool, Field(description="Whether the server requires keys.")]
    id: Annotated[str, Field(description="Id of the key, or subject of the token; empty without.")]
    name: str
    scopes: list[str]
    expires_at: Annotated[float | None, Field(description="Seconds since 1970; null: never.")]


class _ChangeOfVerb(BaseModel):
    id: Annotated[int, Field(description="Number of the change; rises.")]
    verb: str
    kind: Annotated[str, Field(description="publish, activate, delete, refine or cancel.")]
    number: Annotated[
        int,
        Field(description="Version that was published, activated, refined, or current before the deletion."),
    ]
    current: Annotated[int | None, Field(description="Current version after the change; null: none.")]
    author: Annotated[str, Field(description="Who made it; `key ID (NAME)` for a key.")]
    reason: str
    at: Annotated[float, Field(description="Seconds since 1970.")]


class AuditAnswer(BaseModel):
    """Changes of verbs, the newest first."""

    changes: list[_ChangeOfVerb]


class Live(BaseModel):
    """Liveness."""

    live: bool


class _SkippedFile(BaseModel):
    file: str
    problem: str


class Ready(BaseModel):
    """Readiness: verbs are loaded and kernels compiled."""

    ready: bool
    degraded: Annotated[bool, Field(description="The store is unavailable; verbs are served from memory.")]
    problem: Annotated[str | None, Field(description="Reason, if degraded.")]
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
    code: Annotated[str, Field(description="Stable code for programs.")]
    known: Annotated[list[str] | None, Field(description="Names or media types that exist.")] = None
    limit: Annotated[int | None, Field(description="The limit that was exceeded.")] = None
    scope: Annotated[str | None, Field(description="The scope that the key does not have.")] = None
    errors: Annotated[list[_Mistake] | None, Field(description="Places at which a body does not match its schema.")] = (
        None
    )
