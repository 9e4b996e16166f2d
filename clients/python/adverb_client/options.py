"""Options of stream messages and their bounds. Invalid values raise before anything is sent."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict, get_args

import numpy as np

from adverb_client.skeleton import Space

__all__ = ["Encoding", "Frame", "OpenOptions", "Sending", "checked", "finite"]

Encoding = Literal["f32", "q48", "q32", "weights"]
Frame = Literal["gltf", "unity", "unreal", "zup"]
Sending = Literal["frames", "changes"]

_BOUNDS = {
    "fps": (1, 120),
    "phase": (0, 1),
    "speed": (-10, 10),
    "half_life": (0, 10),
    "transition_s": (0, 5),
    "priority": (0, 1000),
    "x": (-1e9, 1e9),
    "y": (-1e9, 1e9),
    "z": (-1e9, 1e9),
    "budget_kbps": (1, 10_000_000),
}
"""Bounds of docs/wire.md."""

_CHOICES = {
    "encoding": get_args(Encoding),
    "space": get_args(Space),
    "frame": get_args(Frame),
    "send": get_args(Sending),
}
_FLAGS = ("play", "loop", "follow", "plant", "events", "support")


class OpenOptions(TypedDict, total=False):
    """Optional settings of a channel; the server has defaults for all of them.

    Parameters
    ----------
    adverbs : mapping of str to float
        All adverbs of the verb, in their units.
    fps : int
        Frames per second, 1–120.
    method : str
    space : str
        ``local`` or ``global``.
    encoding : str
        ``f32``, ``q48`` (two fifths of the bytes, within 0.00015 rad), ``q32`` (a third, within 0.0048 rad) or
        ``weights`` (the client blends).
    frame : str
        Axes and unit of length: ``gltf``, ``unity``, ``unreal`` or ``zup``.
    joints : sequence of str
        Only these joints, in this order.
    phase : float
        Start phase, 0–1.
    speed : float
        Playback rate, −10 to 10: 1 is as captured, negative is backwards.
    play : bool
        Whether the phase advances.
    loop : bool
        Whether to start again at the end.
    half_life : float
        Time in which half the distance between the displayed adverbs and the goal is covered, seconds, 0–10.
    follow : bool
        Whether the effector of a held channel stays on the goal.
    plant : bool
        Whether standing feet stay where they landed.
    events : bool
        Whether keytimes are reported.
    support : bool
        Whether records have the support by the examples.
    send : str
        ``frames``, or ``changes`` with the encoding ``weights``: records only where more than phase and time differs.
        Poses are not interpolated then; ``channel.buffer.last`` has the newest record.
    priority : float
        Weight of the channel where the stream has a byte budget, above 0, up to 1000; see ``Stream.view``.
    vmc : str
        Receiver of VMC that the server's operator has named; it gets the poses too.
    """

    adverbs: Mapping[str, float]
    fps: int
    method: str
    space: Space
    encoding: Literal["f32", "q48", "q32", "weights"]
    frame: Literal["gltf", "unity", "unreal", "zup"]
    joints: Sequence[str]
    phase: float
    speed: float
    play: bool
    loop: bool
    half_life: float
    follow: bool
    plant: bool
    events: bool
    support: bool
    send: Sending
    priority: float
    vmc: str


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options without those that are None, as JSON values.

    Parameters
    ----------
    options : mapping
        Fields of ``open``, ``set``, ``switch`` or ``view``.

    Raises
    ------
    ValueError
        If an option is unknown, out of range, not finite, or not one of its choices.
    """
    return {name: _checked(name, value) for name, value in options.items() if value is not None}


def finite(numbers: Mapping[str, float]) -> dict[str, float]:
    """Numbers by name as floats; raises ValueError if one of them is not finite."""
    found = {name: float(number) for name, number in numbers.items()}
    if not all(math.isfinite(number) for number in found.values()):
        raise ValueError(f"numbers must be finite: {found}")
    return found


def _checked(name: str, value: Any) -> Any:
    if name in _BOUNDS:
        return _number(name, value)
    if name in _CHOICES:
        if value not in _CHOICES[name]:
            raise ValueError(f"{name} {value!r}; expected one of {', '.join(_CHOICES[name])}")
        return str(value)
    if name in _FLAGS:
        if not isinstance(value, bool | np.bool_):
            raise ValueError(f"{name} {value!r}; expected True or False")
        return bool(value)
    if name == "adverbs":
        return finite(value)
    if name == "joints":
        return [str(joint) for joint in value]
    if name in ("method", "vmc"):
        return str(value)
    raise ValueError(f"unknown option {name!r}")


def _number(name: str, value: Any) -> float:
    low, high = _BOUNDS[name]
    whole = name == "fps"
    expected = f"{'an integer from ' if whole else ''}{low} to {high}"
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if name == "priority" and number == 0.0:
        raise ValueError("priority 0; expected a positive number")
    if isinstance(value, str | bool) or not low <= number <= high or (whole and number != int(number)):
        raise ValueError(f"{name} {value!r}; expected {expected}")
    return int(number) if whole else number
