"""Units of adverbs, and how numbers are written for people.

An adverb keeps its declared unit everywhere: in ``verb.toml``, in the artifact, in requests and in results. Kernels
need SI (metres, seconds, radians) where adverbs meet the motion: :class:`verbs.verb.Measure` carries the factors.
"""

from __future__ import annotations

import math

__all__ = ["KNOWN", "SI_UNITS", "dimension", "known_of", "quantity", "si"]

_UNITS = {
    "m": ("length", 1.0),
    "cm": ("length", 0.01),
    "mm": ("length", 0.001),
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180.0),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1.0 / 3.6),
    "rad/s": ("angular speed", 1.0),
    "deg/s": ("angular speed", math.pi / 180.0),
    "s": ("time", 1.0),
    "none": ("none", 1.0),
    "1": ("none", 1.0),
}

SI_UNITS = {"length": "m", "angle": "rad", "speed": "m/s", "angular speed": "rad/s", "time": "s"}
"""Unit of each dimension in SI."""

KNOWN = tuple(_UNITS)
"""Units that an adverb may be declared in; the empty text means ``none``."""


def dimension(unit: str) -> str:
    """Dimension of a unit: length, angle, speed, angular speed, time or none; an unknown unit is its own."""
    return _UNITS[unit or "none"][0] if (unit or "none") in _UNITS else unit


def si(unit: str) -> float:
    """SI (metres, seconds, radians) per unit; 1 for an unknown unit, which older artifacts may hold."""
    return _UNITS[unit or "none"][1] if (unit or "none") in _UNITS else 1.0


def known_of(kind: str) -> tuple[str, ...]:
    """Units of one dimension."""
    return tuple(unit for unit, (own, _) in _UNITS.items() if own == kind)


def quantity(value: float, unit: str = "m", digits: int = 3) -> str:
    """A value in SI as text for people: lengths and speeds below 1 m in millimetres, angles in degrees."""
    if not math.isfinite(value):
        return "–"
    shown, prefix = value, unit
    if unit in ("m", "m/s") and abs(value) < 1.0:
        shown, prefix = 1000.0 * value, "m" + unit
    elif unit in ("rad", "rad/s"):
        shown, prefix = math.degrees(value), unit.replace("rad", "deg")
    return f"{shown:.{digits}g} {prefix}".rstrip()
