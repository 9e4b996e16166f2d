"""Text messages of a stream, parsed to frozen dataclasses, and its other events. Specification: ``docs/wire.md``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from adverb_client.errors import DecodeError, ResponseError, error_class
from adverb_client.skeleton import Skeleton
from adverb_client.wire import Layout

__all__ = [
    "BudgetReport",
    "ChannelAdverb",
    "ChannelOpened",
    "CommandRejected",
    "ConnectionLost",
    "ConnectionRestored",
    "Hello",
    "KeytimePassed",
    "KeytimesPassed",
    "MotionEnded",
    "Pong",
    "ServerDraining",
    "ServerMessage",
    "StreamEnded",
    "StreamEvent",
    "VersionChanged",
    "parse_message",
]

Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Hello:
    """The server's first message."""

    session: str
    server_time_ns: int
    max_channels: int
    grace_s: float


@dataclass(frozen=True, slots=True)
class Pong:
    """The answer to a ping."""

    t: float
    server_time_ns: int


@dataclass(frozen=True, slots=True)
class ChannelAdverb:
    """One adverb of a channel's verb."""

    name: str
    unit: str
    min: float
    max: float
    style: bool


@dataclass(frozen=True, slots=True, eq=False)
class ChannelOpened:
    """A channel is open, or has switched to another verb; also the description of a channel.

    Parameters
    ----------
    channel : int
    verb : str
    version : int
    method : str
    skeleton : Skeleton
        In the channel's frame; without tips.
    adverbs : tuple of ChannelAdverb
        In the order of binary messages.
    joints : tuple of str
        Joints of a record, in its order.
    encoding, space, frame : str
    fps : int
    looping : bool
    keytimes : mapping of str to float
        Canonical time of each keytime.
    follow : (float, float) or None
        Phases between which the effector of a held channel is on the goal.
    layout : Layout
        Layout of its records.
    resumed : bool
        Whether the channel belongs to a resumed session.
    """

    channel: int
    verb: str
    version: int
    method: str
    skeleton: Skeleton
    adverbs: tuple[ChannelAdverb, ...]
    joints: tuple[str, ...]
    encoding: str
    space: str
    frame: str
    fps: float
    looping: bool
    keytimes: Mapping[str, float]
    follow: tuple[float, float] | None
    layout: Layout
    resumed: bool


@dataclass(frozen=True, slots=True)
class VersionChanged:
    """A channel has changed to a new version of its verb."""

    channel: int
    version: int
    record_bytes: int


@dataclass(frozen=True, slots=True)
class KeytimePassed:
    """A channel passed a keytime."""

    channel: int
    name: str
    phase: float


@dataclass(frozen=True, slots=True)
class KeytimesPassed:
    """Keytimes that channels passed in one tick; the stream reports them one by one."""

    items: tuple[KeytimePassed, ...]


@dataclass(frozen=True, slots=True)
class BudgetReport:
    """What the byte budget of :meth:`Stream.view` sent and left out; once a second.

    Parameters
    ----------
    seconds : float
        Length of the interval.
    kbps, budget_kbps : float
        Rate of pose messages and its limit, 1000 bit/s.
    records, left_out : int
        Records that were sent, and that were due and left out.
    min_fps, max_fps : float
        Lowest and highest rate of a channel.
    """

    seconds: float
    kbps: float
    budget_kbps: float
    records: int
    left_out: int
    min_fps: float
    max_fps: float


@dataclass(frozen=True, slots=True)
class MotionEnded:
    """A channel's motion reached its end and holds there."""

    channel: int


@dataclass(frozen=True, slots=True, eq=False)
class CommandRejected:
    """The server rejected a message; the session continues."""

    channel: int | None
    error: ResponseError


@dataclass(frozen=True, slots=True)
class ServerDraining:
    """The server is about to stop; the stream reconnects automatically."""

    detail: str
    reconnect_after_s: float


@dataclass(frozen=True, slots=True)
class ConnectionLost:
    """The connection is lost; the stream reconnects automatically."""

    detail: str
    close_code: int | None


@dataclass(frozen=True, slots=True)
class ConnectionRestored:
    """The stream is connected again; its session is resumed, or its channels are opened in a new one."""

    resumed: bool
    outage_s: float


@dataclass(frozen=True, slots=True)
class StreamEnded:
    """The stream is closed for good; the last of all events."""

    detail: str
    close_code: int | None


ServerMessage = (
    Hello
    | Pong
    | ChannelOpened
    | VersionChanged
    | KeytimesPassed
    | MotionEnded
    | BudgetReport
    | CommandRejected
    | ServerDraining
)
StreamEvent = (
    ChannelOpened
    | VersionChanged
    | KeytimePassed
    | MotionEnded
    | BudgetReport
    | CommandRejected
    | ServerDraining
    | ConnectionLost
    | ConnectionRestored
    | StreamEnded
)
"""Everything that a stream reports besides poses."""


def parse_message(content: str) -> ServerMessage | None:
    """Parse a text message from the server.

    Returns
    -------
    ServerMessage or None
        None where the ``op`` is unknown, as in messages of a newer server.

    Raises
    ------
    DecodeError
        If the message is not a JSON object with an ``op``, or a field is missing or of the wrong type.
    """
    try:
        fields = json.loads(content)
        parse = _PARSERS.get(fields["op"])
        return None if parse is None else parse(fields)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as err:
        raise DecodeError(f"malformed message: {type(err).__name__}: {err}"[:500]) from err


def _hello(fields: Json) -> Hello:
    return Hello(
        str(fields["session"]), int(fields["server_time_ns"]), int(fields["max_channels"]), _finite(fields["grace_s"])
    )


def _pong(fields: Json) -> Pong:
    return Pong(_finite(fields["t"]), int(fields["server_time_ns"]))


def _opened(fields: Json) -> ChannelOpened:
    joints = tuple(str(name) for name in fields["joints"])
    follow = fields["follow"]
    fps = _finite(fields["fps"])
    if not fps > 0.0:
        raise ValueError(f"fps {fps}")
    return ChannelOpened(
        int(fields["channel"]),
        str(fields["verb"]),
        int(fields["version"]),
        str(fields["method"]),
        Skeleton.from_json(fields["skeleton"]),
        tuple(_adverb(row) for row in fields["adverbs"]),
        joints,
        str(fields["encoding"]),
        str(fields["space"]),
        str(fields["frame"]),
        fps,
        bool(fields["looping"]),
        {str(row["name"]): _finite(row["phase"]) for row in fields["keytimes"]},
        None if follow is None else (_finite(follow[0]), _finite(follow[1])),
        Layout.from_opened(fields["encoding"], len(joints), int(fields["record_bytes"])),
        bool(fields["resumed"]),
    )


def _adverb(row: Json) -> ChannelAdverb:
    return ChannelAdverb(str(row["name"]), str(row["unit"]), float(row["min"]), float(row["max"]), bool(row["style"]))


def _version_changed(fields: Json) -> VersionChanged:
    return VersionChanged(int(fields["channel"]), int(fields["version"]), int(fields["record_bytes"]))


def _keytimes_passed(fields: Json) -> KeytimesPassed:
    return KeytimesPassed(tuple(_keytime_passed(row) for row in fields["items"]))


def _budget_report(fields: Json) -> BudgetReport:
    seconds, kbps, budget, low, high = (
        _finite(fields[name]) for name in ("seconds", "kbps", "budget_kbps", "min_fps", "max_fps")
    )
    return BudgetReport(seconds, kbps, budget, int(fields["records"]), int(fields["left_out"]), low, high)


def _keytime_passed(fields: Json) -> KeytimePassed:
    return KeytimePassed(int(fields["channel"]), str(fields["name"]), _finite(fields["phase"]))


def _rejected(fields: Json) -> CommandRejected:
    channel, code = fields.get("channel"), str(fields["code"])
    channel = None if channel is None else int(channel)
    known = fields.get("known")
    names = tuple(str(name) for name in known) if isinstance(known, list) else ()
    error = error_class(code)(str(fields["detail"]), code=code, channel=channel, known=names)
    return CommandRejected(channel, error)


def _finite(number: Any) -> float:
    found = float(number)
    if not math.isfinite(found):  # Python's JSON parser accepts NaN and Infinity
        raise ValueError(f"expected a finite number, got {found}")
    return found


_PARSERS: dict[str, Callable[[Json], ServerMessage]] = {
    "hello": _hello,
    "pong": _pong,
    "opened": _opened,
    "version": _version_changed,
    "events": _keytimes_passed,
    "stats": _budget_report,
    "end": lambda fields: MotionEnded(int(fields["channel"])),
    "error": _rejected,
    "drain": lambda fields: ServerDraining(str(fields["detail"]), _finite(fields["reconnect_after_s"])),
}
