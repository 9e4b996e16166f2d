"""Models of request bodies. Response bodies are in :mod:`service.http.response_models`."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator, with_config
from typing_extensions import TypedDict

from service.fields import STRICT, MapGoal, Name, Space
from verbs.conventions import MAX_ADVERBS, MAX_JOINTS
from verbs.runtime.sequence import MAX_CYCLES, MAX_FPS

__all__ = [
    "BatchItem",
    "BatchRequest",
    "Body",
    "Options",
    "PoseRequest",
    "RefinementRequest",
    "SequenceRequest",
    "TrackPoint",
]

Adverbs = Annotated[
    dict[Name, float],
    Field(
        min_length=1,
        max_length=MAX_ADVERBS,
        description="All adverbs of the verb by name, in their units. Values outside the domain are moved to its edge.",
        examples=[{"x": -0.3, "y": 1.2, "z": 0.4}],
    ),
]
Phase = Annotated[
    float | None,
    Field(
        ge=0, le=1_000, description="Canonical time, 0 to 1; beyond 1 for further cycles of a looping verb. Default 0."
    ),
]
Time = Annotated[
    float | None,
    Field(ge=0, le=3_600, description="Seconds from the start, instead of a phase; a time past the end is the end."),
]


class Body(BaseModel):
    """A request body without unknown fields, conversions and non-finite numbers."""

    model_config = STRICT


class Options(Body):
    """Options of all routes that evaluate poses."""

    method: Annotated[
        Name | None,
        Field(description="Blending method, one of the verb's `methods`. Default: its `default_method`."),
    ] = None
    space: Annotated[
        Space, Field(description="`global` returns rotations in the verb's space, and the joints' positions.")
    ] = "local"
    joints: Annotated[
        list[Name] | None,
        Field(min_length=1, max_length=MAX_JOINTS, description="Joints to return, in this order. Default: all."),
    ] = None
    version: Annotated[
        int | None,
        Field(ge=1, description="The version to evaluate. Default: the current one."),
    ] = None
    weights: Annotated[bool, Field(description="Whether to return the examples' weights.")] = False
    plant: Annotated[
        bool,
        Field(
            description="Whether standing feet are held where they landed and no point of a foot is below the ground. "
            "The effector stays on its goal."
        ),
    ] = True
    map: Annotated[
        Name | None,
        Field(
            description="Skeleton of the answer, instead of the verb's: `vrm` (also Unity's humanoid), `unreal`, "
            "`mixamo` or `smpl`. `joints` are then those of that skeleton; the object `map` of the response names them."
        ),
    ] = None
    map_goal: Annotated[
        MapGoal,
        Field(
            description="With `map`: where the effector's goal is: `scaled` with the body, or where it is for the verb."
        ),
    ] = "scaled"
    support: Annotated[
        bool, Field(description="Whether binary records have the support in their flags. JSON always has it.")
    ] = False


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
            description="Largest acceptable error, metres. rbf, search, corrected and a polish of joints are tried in "
            "this order, from `method` on if given, until the error is met. `tried` lists what was done, and `met` "
            "whether it was enough; the pose is returned either way.",
        ),
    ] = None


@with_config(STRICT)
class BatchItem(TypedDict):
    """One character of a crowd."""  # a plain mapping: a thousand models take three times as long to make

    adverbs: Adverbs
    phase: NotRequired[Phase]
    time: NotRequired[Time]


class BatchRequest(Options):
    """Many poses of one verb. Either all items have a phase, or all have a time."""

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


class TrackPoint(Body):
    """Adverbs at a time."""

    time: Annotated[float, Field(ge=0, le=3_600, description="Seconds from the start.")]
    adverbs: Adverbs


class SequenceRequest(Options):
    """A whole motion, with constant adverbs or along a track of them."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"adverbs": {"x": -0.3, "y": 1.2, "z": 0.4}, "fps": 30}]})

    adverbs: Adverbs | None = None
    track: Annotated[
        list[TrackPoint] | None,
        Field(
            min_length=1,
            max_length=1_000,
            description="Adverbs over time instead of constant ones: linear between points of rising time, constant "
            "before and after them.",
        ),
    ] = None
    fps: Annotated[float, Field(ge=1, le=MAX_FPS, description="Frames per second.")] = 30.0
    cycles: Annotated[int, Field(ge=1, le=MAX_CYCLES, description="Cycles of a looping verb.")] = 1
    mannequin: Annotated[
        bool, Field(description="Of `model/gltf-binary`: whether to add a simple body, which a plain viewer shows.")
    ] = False

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.adverbs is None) == (self.track is None):
            raise ValueError("give either 'adverbs' or 'track'")
        return self


class RefinementRequest(Body):
    """Options of a refinement."""

    aim: Annotated[
        Literal["quality", "error"] | None,
        Field(
            alias="for",
            description="`quality`: better motion by `corrected`, which stays exact. `error`: smaller errors by "
            "`refined` and `hybrid`. Default: `quality` where the verb's default method is `corrected` and no option "
            "for errors is given.",
        ),
    ] = None
    target_error: Annotated[
        float,
        Field(
            gt=0,
            le=10,
            description="For errors: the largest at which to stop, as a share of the diagonal of the examples' goals.",
        ),
    ] = 0.01
    max_pseudo: Annotated[
        int | None,
        Field(ge=0, le=2_000, description="Most pseudo-examples. Default: 8 for quality, at most 64; 300 for errors."),
    ] = None
    budget_s: Annotated[float, Field(gt=0, le=7 * 24 * 3600, description="Most computing time, seconds.")] = 600.0
    method: Annotated[
        Literal["refined", "hybrid"], Field(description="For errors: method by which the result is evaluated.")
    ] = "refined"
    weighted_by_traffic: Annotated[
        bool, Field(description="For errors: whether to refine first where clients request the verb.")
    ] = False
    seed: Annotated[int, Field(ge=0, le=10**6)] = 1
    priority: Annotated[int, Field(ge=1, le=100, description="1 is the highest.")] = 50
