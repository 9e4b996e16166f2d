"""Profiles: what a load consists of, read from TOML."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from adverb_load.schedule import ARRIVALS

__all__ = ["ENCODINGS", "GOALS", "ROUTES", "Profile", "ProfileError", "Requests", "Streams", "built_in", "read"]

ENCODINGS = ("f32", "q48", "q32", "weights")
GOALS = ("jump", "walk", "hold")
ROUTES = ("pose", "poses", "sequence", "quality", "verb", "verbs", "health")
ACCEPTS = ("json", "binary")
PHASES = ("keytime", "random")

T = TypeVar("T")


class ProfileError(Exception):
    """A profile that cannot be used; the message has the key and what is allowed."""


@dataclass(frozen=True, slots=True)
class Streams:
    """A group of sockets that receive poses; the keys are documented in docs/load.md."""

    name: str
    verbs: tuple[str, ...] = ("reach",)
    sockets: int = 10
    channels: int = 1
    fps: int = 60
    encoding: str = "f32"
    method: str = ""
    goals: str = "jump"
    steer_hz: float = 2.0
    arrivals: str = "poisson"
    half_life_s: float = 0.1
    measured: int = 1
    events: bool = True
    budget_kbps: float = 0.0
    slow: float = 0.0
    slow_pause_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Requests:
    """A group of HTTP requests; the keys are documented in docs/load.md."""

    name: str
    route: str = "pose"
    verb: str = "reach"
    rate: float = 10.0
    arrivals: str = "poisson"
    accept: str = "binary"
    phase: str = "random"
    batch: int = 20
    nodes: int = 21
    method: str = ""
    timeout_s: float = 10.0
    connections: int = 256


@dataclass(frozen=True, slots=True)
class Profile:
    """A load: groups of streams and of requests, and how long they last."""

    name: str = "profile"
    description: str = ""
    duration_s: float = 30.0
    warmup_s: float = 2.0
    interval_s: float = 1.0
    streams: tuple[Streams, ...] = ()
    requests: tuple[Requests, ...] = ()

    def scaled(self, scale: float) -> Profile:
        """The profile with that many times as many sockets and requests, at least one socket a group."""
        return replace(
            self,
            streams=tuple(replace(row, sockets=max(1, round(row.sockets * scale))) for row in self.streams),
            requests=tuple(replace(row, rate=row.rate * scale) for row in self.requests),
        )

    def at_rate(self, rate: float) -> Profile:
        """The profile with that many requests a second in all, in the same shares.

        Raises
        ------
        ProfileError
            If it has no requests.
        """
        total = sum(row.rate for row in self.requests)
        if not total:
            raise ProfileError(f"profile '{self.name}' has no requests whose rate could be {rate:g}")
        return replace(self, requests=tuple(replace(row, rate=row.rate * rate / total) for row in self.requests))

    def checked(self) -> Profile:
        """The profile, if all its numbers are within their bounds; raises :class:`ProfileError`."""
        self._check(self.name, self)
        groups: list[Streams | Requests] = [*self.streams, *self.requests]
        for group in groups:
            self._check(f"{self.name}: {group.name}", group)
        return self

    @staticmethod
    def _check(where: str, row: Profile | Streams | Requests) -> None:
        for key, value in asdict(row).items():
            if key in _BOUNDS:
                _number(key, value, type(value), where)

    def to_json(self) -> dict[str, Any]:
        """The profile as a JSON object."""
        return asdict(self)


_BOUNDS: dict[str, tuple[float, float]] = {
    "duration_s": (0.5, 86_400), "warmup_s": (0, 600), "interval_s": (0.1, 600), "sockets": (1, 20_000),
    "channels": (1, 65_535), "fps": (1, 120), "steer_hz": (0, 120), "half_life_s": (0, 10), "measured": (0, 1_000),
    "budget_kbps": (0, 10_000_000), "slow": (0, 1), "slow_pause_s": (0.01, 60), "rate": (0.001, 100_000),
    "batch": (1, 10_000), "nodes": (3, 101), "timeout_s": (0.05, 600), "connections": (1, 10_000),
}  # fmt: skip
_CHOICES = {
    "encoding": ENCODINGS, "goals": GOALS, "arrivals": ARRIVALS, "route": ROUTES, "accept": ACCEPTS, "phase": PHASES,
}  # fmt: skip


def built_in() -> dict[str, str]:
    """The built-in profiles: texts by name."""
    folder = resources.files("adverb_load") / "profiles"
    names = sorted(row.name for row in folder.iterdir() if row.name.endswith(".toml"))
    return {name.removesuffix(".toml"): (folder / name).read_text("utf-8") for name in names}


def read(name: str) -> Profile:
    """A profile by the name of a built-in one, or from a file; raises :class:`ProfileError`."""
    known = built_in()
    if name in known:
        return parse(known[name], name)
    path = Path(name)
    if path.suffix != ".toml":
        raise ProfileError(f"unknown profile '{name}'; built in: {', '.join(known)}; or the path of a .toml file")
    try:
        return parse(path.read_text("utf-8"), path.stem)
    except (OSError, UnicodeDecodeError) as err:
        raise ProfileError(f"{name}: {err}") from err


def parse(text: str, name: str) -> Profile:
    """A profile from TOML; raises :class:`ProfileError`."""
    try:
        given = tomllib.loads(text)
    except tomllib.TOMLDecodeError as err:
        raise ProfileError(f"{name}: not TOML: {err}") from err
    groups = {key: given.pop(key, []) for key in ("streams", "requests")}
    for key, rows in groups.items():
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise ProfileError(f"{name}: '{key}' must be tables: [[{key}]]")
    found = replace(
        _table(Profile, {"name": name, **given}, name),
        streams=tuple(_group(Streams, row, f"{name}: streams[{k}]", k) for k, row in enumerate(groups["streams"])),
        requests=tuple(_group(Requests, row, f"{name}: requests[{k}]", k) for k, row in enumerate(groups["requests"])),
    )
    names = [row.name for row in found.streams] + [row.name for row in found.requests]
    if not names:
        raise ProfileError(f"{name}: no [[streams]] and no [[requests]]")
    if len(set(names)) < len(names):
        raise ProfileError(f"{name}: names of groups must differ: {', '.join(names)}")
    return found


def _group(kind: type[T], row: Mapping[str, Any], where: str, number: int) -> T:
    return _table(kind, {"name": f"{kind.__name__.lower()}-{number + 1}", **row}, where)


def _table(kind: type[T], given: Mapping[str, Any], where: str) -> T:
    hints = get_type_hints(kind)
    allowed = [key for key in hints if key not in ("streams", "requests")]
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise ProfileError(f"{where}: unknown key '{unknown[0]}'; known: {', '.join(allowed)}")
    return kind(**{key: _value(key, value, hints[key], where) for key, value in given.items()})


def _value(key: str, value: Any, kind: Any, where: str) -> Any:
    if get_args(kind):  # a tuple of texts
        rows = [value] if isinstance(value, str) else value
        if not isinstance(rows, list) or not rows or not all(isinstance(row, str) for row in rows):
            raise ProfileError(f"{where}: '{key}' must be a name or a list of names")
        return tuple(rows)
    if kind in (int, float):
        return _number(key, value, kind, where)
    if not isinstance(value, kind):
        raise ProfileError(f"{where}: '{key}' must be a {'text' if kind is str else 'true or false'}")
    if key in _CHOICES and value not in _CHOICES[key]:
        raise ProfileError(f"{where}: '{key}' is '{value}'; expected {', '.join(_CHOICES[key])}")
    return value


def _number(key: str, value: Any, kind: type[int] | type[float], where: str) -> int | float:
    low, high = _BOUNDS[key]
    whole = "an integer" if kind is int else "a number"
    right = isinstance(value, int) if kind is int else isinstance(value, int | float)
    if isinstance(value, bool) or not right or not math.isfinite(value) or not low <= value <= high:
        raise ProfileError(f"{where}: '{key}' must be {whole} from {low:g} to {high:g}, not {value!r}")
    return kind(value)
