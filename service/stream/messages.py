"""Text messages of ``WS /v1/stream``: client messages are validated, server messages are described.

``docs/wire.md`` is the specification. orjson writes server messages from plain mappings; their models are for the
OpenAPI document, and tests compare the two.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

from service.fields import STRICT, Name, Space
from verbs.conventions import MAX_ADVERBS, MAX_JOINTS, MAX_MAGNITUDE
from verbs.runtime.characters import HALF_LIFE_S, MAX_SPEED, MAX_TRANSITION_S

__all__ = [
    "CLIENT",
    "SERVER",
    "ClientMessage",
    "Close",
    "Drain",
    "End",
    "Error",
    "EventItem",
    "Events",
    "Hello",
    "Open",
    "Opened",
    "Ping",
    "Pong",
    "Resume",
    "ServerMessage",
    "Set",
    "Stats",
    "Switch",
    "Version",
    "View",
]

ChannelNumber = Annotated[int, Field(ge=0, le=65_535, description="Number of a character, chosen by the client.")]
Adverbs = Annotated[
    dict[Name, float], Field(min_length=1, max_length=MAX_ADVERBS, description="By name, in the verb's units.")
]
Fps = Annotated[int, Field(ge=1, le=120, description="Frames per second.")]
Phase = Annotated[float, Field(ge=0, le=1, description="Canonical time.")]
Speed = Annotated[
    float, Field(ge=-MAX_SPEED, le=MAX_SPEED, description="1 is the speed of the examples; may be negative.")
]
HalfLife = Annotated[
    float, Field(ge=0, le=10, description="Half-life of the distance to a new goal, seconds; 0 follows at once.")
]

Encoding = Literal["f32", "q48", "weights", "q32"]
Priority = Annotated[
    float, Field(gt=0, le=1000, description="Weight of the channel where the connection has a byte budget; see `view`.")
]
Coordinate = Annotated[float, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE, description="Metres.")]


class _ClientMessage(BaseModel):
    model_config = STRICT


class Open(_ClientMessage):
    """Start a character."""

    op: Literal["open"]
    channel: ChannelNumber
    verb: Name
    adverbs: Adverbs | None = None
    fps: Fps = 60
    method: Name | None = None
    space: Space = "local"
    encoding: Encoding = "f32"
    frame: Literal["gltf", "unity", "unreal", "zup"] = "gltf"
    joints: Annotated[list[Name] | None, Field(min_length=1, max_length=MAX_JOINTS)] = None
    phase: Phase = 0.0
    speed: Speed = 1.0
    play: bool = True
    loop: bool | None = None
    half_life: HalfLife = HALF_LIFE_S
    follow: bool = True
    plant: Annotated[bool, Field(description="Whether standing feet stay where they landed.")] = True
    events: Annotated[bool, Field(description="Whether keytimes of the channel are reported.")] = True
    support: Annotated[bool, Field(description="Whether records have the support by the examples in their flags.")] = (
        False
    )
    send: Annotated[
        Literal["frames", "changes"],
        Field(
            description="`frames`: a record in every tick. `changes`, with the encoding `weights`: only where more "
            "than phase and time differs from the record before, after `set`, and every few seconds."
        ),
    ] = "frames"
    priority: Priority = 1.0
    vmc: Annotated[
        Name | None, Field(description="Receiver of VMC, of those that the server's operator has named.")
    ] = None

    @model_validator(mode="after")
    def _send_fits(self) -> Self:
        if self.send == "changes" and self.encoding != "weights":
            raise ValueError("'send' may be 'changes' with the encoding 'weights' only")
        return self


class Set(_ClientMessage):
    """Change the given fields of a character."""

    op: Literal["set"]
    channel: ChannelNumber
    adverbs: Adverbs | None = None
    speed: Speed | None = None
    phase: Phase | None = None
    play: bool | None = None
    loop: bool | None = None
    fps: Fps | None = None
    half_life: HalfLife | None = None
    follow: bool | None = None
    priority: Priority | None = None


class Switch(_ClientMessage):
    """Switch to another verb of the same skeleton."""

    op: Literal["switch"]
    channel: ChannelNumber
    verb: Name
    adverbs: Adverbs | None = None
    method: Name | None = None
    phase: Phase | None = None
    transition_s: Annotated[
        float | None,
        Field(ge=0, le=MAX_TRANSITION_S, description="Unless given, chosen by the distance of the poses."),
    ] = None


class Close(_ClientMessage):
    """End a character."""

    op: Literal["close"]
    channel: ChannelNumber


class Ping(_ClientMessage):
    """Request the server's clock."""

    op: Literal["ping"]
    t: float


class Resume(_ClientMessage):
    """Resume a session whose connection was lost."""

    op: Literal["resume"]
    session: Annotated[str, Field(min_length=1, max_length=64)]
    last_seq: Annotated[int, Field(ge=0, le=2**32 - 1)]


class View(_ClientMessage):
    """Set the viewpoint and the byte budget of the connection; replaces both."""

    op: Literal["view"]
    x: Coordinate | None = None
    y: Coordinate | None = None
    z: Coordinate | None = None
    budget_kbps: Annotated[
        float | None,
        Field(ge=1, le=10_000_000, description="Limit of pose messages, 1000 bit/s; null: unlimited."),
    ] = None

    @model_validator(mode="after")
    def _viewpoint_is_complete(self) -> Self:
        if len({number is None for number in (self.x, self.y, self.z)}) > 1:
            raise ValueError("x, y and z are given together, or none of them")
        return self


ClientMessage = Annotated[Open | Set | Switch | Close | Ping | Resume | View, Field(discriminator="op")]
CLIENT: TypeAdapter[Open | Set | Switch | Close | Ping | Resume | View] = TypeAdapter(ClientMessage)


class _ServerMessage(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Hello(_ServerMessage):
    """First message of a connection."""

    op: Literal["hello"]
    session: str
    server_time_ns: int
    max_channels: int
    grace_s: float


class StreamSkeleton(_ServerMessage):
    """Joints, in the order of the verb; offsets in the channel's frame."""

    names: list[str]
    parents: list[int]
    offsets: list[list[float]]


class StreamAdverb(_ServerMessage):
    """One adverb, and its range over the examples."""

    name: str
    unit: str
    min: float
    max: float
    style: bool
    goal: float


class StreamKeytime(_ServerMessage):
    """A keytime and its phase."""

    name: str
    phase: float


class Opened(_ServerMessage):
    """A channel was opened, switched or resumed."""

    op: Literal["opened"]
    channel: int
    verb: str
    version: int
    method: str
    skeleton: StreamSkeleton
    adverbs: list[StreamAdverb]
    joints: list[str]
    encoding: Encoding
    space: Space
    frame: Literal["gltf", "unity", "unreal", "zup"]
    fps: int
    looping: bool
    keytimes: list[StreamKeytime]
    follow: Annotated[list[float] | None, Field(min_length=2, max_length=2)]
    record_bytes: int
    resumed: bool


class Version(_ServerMessage):
    """A channel continues with another version of its verb."""

    op: Literal["version"]
    channel: int
    version: int
    record_bytes: int


class EventItem(_ServerMessage):
    """A channel passed a keytime."""

    channel: int
    name: str
    phase: float


class Events(_ServerMessage):
    """Keytimes that channels passed in one tick, in order."""

    op: Literal["events"]
    items: Annotated[list[EventItem], Field(min_length=1)]


class End(_ServerMessage):
    """A motion that does not loop reached its end."""

    op: Literal["end"]
    channel: int


class Pong(_ServerMessage):
    """The server's clock."""

    op: Literal["pong"]
    t: float
    server_time_ns: int


class Stats(_ServerMessage):
    """What a byte budget sent and left out in an interval."""

    op: Literal["stats"]
    seconds: float
    kbps: float
    budget_kbps: float
    records: int
    left_out: int
    min_fps: float
    max_fps: float


class Error(_ServerMessage):
    """A message was rejected; nothing changed."""

    op: Literal["error"]
    channel: int | None
    code: str
    detail: str


class Drain(_ServerMessage):
    """The server is shutting down."""

    op: Literal["drain"]
    detail: str
    reconnect_after_s: float


ServerMessage = Annotated[
    Hello | Opened | Version | Events | End | Pong | Stats | Error | Drain, Field(discriminator="op")
]
SERVER: TypeAdapter[Hello | Opened | Version | Events | End | Pong | Stats | Error | Drain] = TypeAdapter(ServerMessage)
