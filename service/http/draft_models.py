"""Models of the bodies of requests and responses of drafts, and of added examples."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from service.fields import Name
from service.http.request_models import Body
from service.http.response_models import UploadAnswer, VerbAnswer
from verbs.conventions import MAX_ADVERBS

__all__ = ["DraftAnswer", "DraftChange", "DraftList", "DraftPublication", "ExampleAnswer"]

Texts = Annotated[str, Field(max_length=2_000)]
VerbNames = Annotated[str, Field(pattern="^[a-z][a-z0-9_-]{0,62}$")]


class DraftAdverb(Body):
    """An adverb of a draft; what is left out stays. `style` is true for one that is added."""

    name: Name | None = None
    unit: Annotated[str, Field(max_length=20)] | None = None
    description: Texts | None = None
    style: bool | None = None


class DraftMend(Body):
    """A mend of a clip: with `index`, one of the listed ones is switched; with `kind`, one is added."""

    index: Annotated[int, Field(ge=0, le=1_000)] | None = None
    kind: Name | None = None
    joint: Name | None = None
    start: Annotated[float, Field(ge=0, le=1e6)] | None = None
    end: Annotated[float, Field(ge=0, le=1e6)] | None = None
    options: Annotated[dict[Name, Annotated[float, Field(ge=-1e6, le=1e6)]], Field(max_length=8, default_factory=dict)]
    apply: bool = True


class DraftClip(Body):
    """Changes of one clip of a draft."""

    keytimes: Annotated[
        list[Annotated[float, Field(ge=0, le=1e6)]] | None,
        Field(max_length=64, description="Seconds of the file; null returns to the proposal."),
    ] = None
    excluded: bool | None = None
    adverbs: Annotated[
        dict[Name, Annotated[float, Field(ge=-1e9, le=1e9)]] | None,
        Field(max_length=MAX_ADVERBS, description="Values of style adverbs."),
    ] = None
    mends: Annotated[list[DraftMend] | None, Field(max_length=100)] = None


class DraftChange(Body):
    """Changes of a draft; what is left out stays as it is."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"clips": {"far_left": {"keytimes": [0.0, 1.1, 2.3], "excluded": False}}}]}
    )

    name: VerbNames | None = None
    description: Texts | None = None
    looping: bool | None = None
    measure: Name | None = None
    effector: Name | None = None
    effector_keytime_index: Annotated[int, Field(ge=-1, le=63)] | None = None
    keytime_names: Annotated[list[Name] | None, Field(max_length=64)] = None
    adverbs: Annotated[
        list[DraftAdverb] | None,
        Field(max_length=MAX_ADVERBS, description="All adverbs in their order; further rows add style adverbs."),
    ] = None
    clips: Annotated[
        dict[Annotated[str, Field(max_length=300)], DraftClip] | None,
        Field(max_length=2_000, description="Changes by name of the clip."),
    ] = None
    propose: Annotated[
        bool, Field(description="Whether keytimes that were not set are proposed again, from those that were.")
    ] = False


class DraftPublication(Body):
    """Options of a publication."""

    name: Annotated[VerbNames | None, Field(description="Name of the verb. Default: of the draft.")] = None


class _AddedExample(BaseModel):
    name: str
    keytimes: Annotated[list[float], Field(description="Seconds of the file.")]
    confidence: Annotated[list[float], Field(description="Of each keytime, 0 to 1; 1 where it was given.")]
    adverbs: Annotated[dict[str, float], Field(description="As measured.")]


class ExampleAnswer(UploadAnswer):
    """The version that an added example created."""

    example: _AddedExample


class _DraftHead(BaseModel):
    id: str
    revision: int
    created_at: Annotated[float, Field(description="Seconds since 1970.")]
    changed_at: float
    expires_at: Annotated[float, Field(description="When the draft is removed, if it is not changed until then.")]
    name: Annotated[str, Field(description="Name of the verb that it becomes.")]


class _ListedDraft(_DraftHead):
    clips: Annotated[int, Field(description="Clips in the verb.")]
    excluded: Annotated[int, Field(description="All others.")]
    built: Annotated[bool, Field(description="Whether the clips make a verb.")]
    bytes: int


class DraftList(BaseModel):
    """Drafts, the last changed first."""

    limit: Annotated[int, Field(description="Largest number of drafts.")]
    drafts: list[_ListedDraft]


class _DraftAdverb(BaseModel):
    name: str
    unit: str
    description: str
    style: bool


class _DraftMend(BaseModel):
    index: int
    kind: str
    joint: str | None
    start: Annotated[float | None, Field(description="Seconds of the file.")]
    end: float | None
    options: dict[str, float]
    text: Annotated[str, Field(description="What was found, and what the mend does.")]
    apply: bool


class _DraftClip(BaseModel):
    name: str
    file: str
    animation: Annotated[str, Field(description="Name of the animation, of a file with several.")]
    readable: bool
    problem: Annotated[str, Field(description="Why it cannot be used, and what to do.")]
    frames: int | None
    fps: float | None
    duration: float | None
    start: Annotated[float | None, Field(description="Earliest keytime that is possible, seconds of the file.")]
    end: Annotated[float | None, Field(description="Latest keytime that is possible.")]
    keytimes: list[float] | None
    confidence: list[float] | None
    evidence: list[str] | None
    set: Annotated[bool, Field(description="Whether the keytimes were given.")]
    adverbs: dict[str, float] | None
    excluded: bool
    reason: Annotated[str, Field(description="Why it is excluded, or included by hand.")]
    mends: list[_DraftMend]
    warnings: list[str]
    left_out: Annotated[
        float | None,
        Field(description="Mean joint angle between the clip and its prediction from the others, degrees."),
    ]


class _DraftProblem(BaseModel):
    code: str
    detail: str


class DraftAnswer(_DraftHead):
    """One draft."""

    description: str
    measure: str
    effector: str | None
    effector_keytime_index: int
    looping: bool
    keytime_names: list[str]
    unit: Annotated[str, Field(description="Unit of length of the files.")]
    up_axis: str
    forward_axis: str
    joints: list[str]
    measures: Annotated[list[str], Field(description="Measures that can be proposed.")]
    evidence: Annotated[dict[str, str], Field(description="What the proposal rests on, by field.")]
    adverbs: list[_DraftAdverb]
    clips: list[_DraftClip]
    left_out_mean: Annotated[float | None, Field(description="Mean of `left_out`, degrees.")]
    warnings: Annotated[list[str], Field(description="Warnings of the build.")]
    motion: Annotated[str, Field(description="Changes when the answer of `/motion` does.")]
    verb: Annotated[VerbAnswer | None, Field(description="The verb of the draft; null where its clips make none.")]
    problem: Annotated[_DraftProblem | None, Field(description="Why they make none.")]
    toml: Annotated[str, Field(description="The verb.toml.")]
