"""Text messages of a stream: JSON in, frozen dataclasses out. ``docs/wire.md`` is the specification."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from adverb_client.errors import DecodeError, Refused, refusal
from adverb_client.skeleton import Skeleton
from adverb_client.wire import Layout

__all__ = [
    "Closed",
    "Draining",
    "Ended",
    "Found",
    "Hello",
    "Lost",
    "Note",
    "Opened",
    "Passed",
    "Pong",
    "Published",
    "Rejected",
    "StreamAdverb",
    "Text",
    "read_text",
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
class StreamAdverb:
    """One adverb of a channel's verb."""

    name: str
    unit: str
    min: float
    max: float
    style: bool


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A channel is open, or shows another verb from now on.

    Parameters
    ----------
    channel : int
    verb : str
    version : int
    method : str
    skeleton : Skeleton
        In the channel's frame; without tips.
    adverbs : tuple of StreamAdverb
        In the order of binary messages.
    joints : tuple of str
        Those of a record, in its order.
    encoding, space, frame : str
    fps : int
    looping : bool
    keytimes : mapping of str to float
        Canonical time of each.
    follow : (float, float) or None
        Phases between which a held channel follows its goal.
    layout : Layout
        Of its records.
    resumed : bool
        Whether it went on from a session that had lost its connection.
    """

    channel: int
    verb: str
    version: int
    method: str
    skeleton: Skeleton
    adverbs: tuple[StreamAdverb, ...]
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
class Published:
    """A new version of a channel's verb is shown from now on."""

    channel: int
    version: int
    record_bytes: int


@dataclass(frozen=True, slots=True)
class Passed:
    """A channel passed a keytime."""

    channel: int
    name: str
    phase: float


@dataclass(frozen=True, slots=True)
class Ended:
    """A channel's motion reached its end and holds there."""

    channel: int


@dataclass(frozen=True, slots=True, eq=False)
class Rejected:
    """The server refused something; the session goes on."""

    channel: int | None
    error: Refused


@dataclass(frozen=True, slots=True)
class Draining:
    """The server is about to stop; the stream comes back by itself."""

    detail: str
    reconnect_after_s: float


@dataclass(frozen=True, slots=True)
class Lost:
    """The connection broke; the stream tries to come back by itself."""

    detail: str
    close_code: int | None


@dataclass(frozen=True, slots=True)
class Found:
    """The stream is connected again: the session goes on (``resumed``), or its channels were opened anew."""

    resumed: bool
    away_s: float


@dataclass(frozen=True, slots=True)
class Closed:
    """The stream is closed and does not come back; the last of all notes."""

    detail: str
    close_code: int | None


Text = Hello | Pong | Opened | Published | Passed | Ended | Rejected | Draining
Note = Opened | Published | Passed | Ended | Rejected | Draining | Lost | Found | Closed
"""What a stream tells apart from poses."""


def read_text(content: str) -> Text | None:
    """Read a text message from the server.

    Returns
    -------
    Text or None
        None where the ``op`` is not known: a newer server may have more to say.

    Raises
    ------
    DecodeError
        If it is no JSON object with an ``op``, or a field is missing or of another type.
    """
    try:
        told = json.loads(content)
        read = _READERS.get(told["op"])
        return None if read is None else read(told)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as err:
        raise DecodeError(f"a message that cannot be read: {type(err).__name__}: {err}"[:500]) from err


def _hello(told: Json) -> Hello:
    return Hello(str(told["session"]), int(told["server_time_ns"]), int(told["max_channels"]), _finite(told["grace_s"]))


def _pong(told: Json) -> Pong:
    return Pong(_finite(told["t"]), int(told["server_time_ns"]))


def _opened(told: Json) -> Opened:
    joints = tuple(str(name) for name in told["joints"])
    follow = told["follow"]
    fps = _finite(told["fps"])
    if not fps > 0.0:
        raise ValueError(f"fps {fps}")
    return Opened(
        int(told["channel"]),
        str(told["verb"]),
        int(told["version"]),
        str(told["method"]),
        Skeleton.from_json(told["skeleton"]),
        tuple(_adverb(row) for row in told["adverbs"]),
        joints,
        str(told["encoding"]),
        str(told["space"]),
        str(told["frame"]),
        fps,
        bool(told["looping"]),
        {str(row["name"]): _finite(row["phase"]) for row in told["keytimes"]},
        None if follow is None else (_finite(follow[0]), _finite(follow[1])),
        Layout.promised(told["encoding"], len(joints), int(told["record_bytes"])),
        bool(told["resumed"]),
    )


def _adverb(row: Json) -> StreamAdverb:
    return StreamAdverb(str(row["name"]), str(row["unit"]), float(row["min"]), float(row["max"]), bool(row["style"]))


def _published(told: Json) -> Published:
    return Published(int(told["channel"]), int(told["version"]), int(told["record_bytes"]))


def _passed(told: Json) -> Passed:
    return Passed(int(told["channel"]), str(told["name"]), _finite(told["phase"]))


def _rejected(told: Json) -> Rejected:
    channel, code = told.get("channel"), str(told["code"])
    channel = None if channel is None else int(channel)
    known = told.get("known")
    names = tuple(str(name) for name in known) if isinstance(known, list) else ()
    error = refusal(code)(str(told["detail"]), code=code, channel=channel, known=names)
    return Rejected(channel, error)


def _finite(number: Any) -> float:
    found = float(number)
    if not math.isfinite(found):  # Python's JSON lets them pass
        raise ValueError(f"{found} where a number should be")
    return found


_READERS: dict[str, Callable[[Json], Text]] = {
    "hello": _hello,
    "pong": _pong,
    "opened": _opened,
    "version": _published,
    "event": _passed,
    "end": lambda told: Ended(int(told["channel"])),
    "error": _rejected,
    "drain": lambda told: Draining(str(told["detail"]), _finite(told["reconnect_after_s"])),
}
