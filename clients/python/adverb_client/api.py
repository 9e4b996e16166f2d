"""Operations of the REST API, without I/O: each is a generator that yields requests and receives their responses.

Both clients run the same generators, one with blocking and one with asynchronous I/O.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypedDict, TypeVar
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from adverb_client import models, parsing
from adverb_client.errors import DecodeError, FieldError, ResponseError, error_class
from adverb_client.records import joint_count, parse_records
from adverb_client.skeleton import Space

__all__ = [
    "Adverbs",
    "Api",
    "Crowd",
    "Operation",
    "PoseOptions",
    "Request",
    "Response",
    "Track",
    "body_of",
    "error_of",
    "path_of",
    "send",
]

JSON, OCTETS, BVH, PROBLEM = "application/json", "application/octet-stream", "text/x-bvh", "application/problem+json"

T = TypeVar("T")
Numbers = npt.NDArray[Any] | Sequence[float]
Adverbs = Mapping[str, float] | Numbers
"""Adverbs of one pose: by name, or all of them in the verb's order; in their units."""
Crowd = Mapping[str, Numbers] | npt.NDArray[Any] | Sequence[Sequence[float]]
"""Adverbs of many poses: a column (B,) per name (or a number for all), or rows (B, D) in the verb's order."""
Track = Sequence[tuple[float, Adverbs]]
"""Seconds from the start, rising, and the adverbs there."""


class PoseOptions(TypedDict, total=False):
    """Options of all requests for poses.

    Parameters
    ----------
    method : str
        One of the verb's methods; its default where omitted.
    space : str
        ``local`` (rotations relative to the parent) or ``global``.
    joints : sequence of str
        Only these joints, in this order.
    version : int
        The required version of the verb.
    weights : bool
        Whether to return the examples' weights; implies ``full``.
    plant : bool
        Whether standing feet are held where they landed; true where omitted.
    map : str
        Skeleton of the answer instead of the verb's: ``vrm``, ``unreal``, ``mixamo`` or ``smpl``; implies ``full``.
        ``joints`` are then its joints.
    map_goal : str
        With ``map``: ``scaled`` (the effector's goal, scaled with the body) or ``world``.
    support : bool
        Whether to return the support by the examples, in steps of 1/14; full responses always have it, exactly.
    full : bool
        Whether to request JSON, which has more than a binary record: method, measured, positions, weights, events.
    """

    method: str
    space: Space
    joints: Sequence[str]
    version: int
    weights: bool
    plant: bool
    map: str
    map_goal: Literal["scaled", "world"]
    support: bool
    full: bool


@dataclass(frozen=True, slots=True)
class Request:
    """One HTTP request.

    ``retry`` allows further attempts after status 429 or 503; ``timeout_s`` replaces the client's where the server has
    to compute for long.
    """

    method: Literal["GET", "POST", "PATCH", "DELETE"]
    path: str
    accept: str = JSON
    content: bytes = b""
    content_type: str | None = None
    query: tuple[tuple[str, str], ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    retry: bool = True
    timeout_s: float | None = None


@dataclass(frozen=True, slots=True)
class Response:
    """One HTTP response; names of headers in lower case."""

    status: int
    headers: Mapping[str, str]
    content: bytes


Operation = Generator[Request, Response, T]


class Api:
    """All operations; caches descriptions of verbs, which binary rows and records need."""

    def __init__(self) -> None:
        self._verbs: dict[str, tuple[str, models.Verb]] = {}

    def health(self) -> Operation[models.Health]:
        """Readiness of the server."""
        return parsing.parse_json((yield from send(Request("GET", "/readyz", retry=False))).content, parsing.health)

    def verbs(self) -> Operation[tuple[models.VerbSummary, ...]]:
        """The list of verbs."""
        return parsing.parse_json((yield from _get("/v1/verbs")).content, parsing.verbs)

    def verb(self, name: str) -> Operation[models.Verb]:
        """The description of a verb; an unchanged one is not transferred again."""
        tag, known = self._verbs.get(name, ("", None))
        response = yield from _get(path_of(name), {"if-none-match": tag} if tag else {})
        if response.status == 304 and known is not None:
            return known
        found = parsing.parse_json(response.content, parsing.verb)
        self._verbs[name] = (response.headers.get("etag", ""), found)
        return found

    def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        phase: float | None,
        time_s: float | None,
        max_error: float | None,
        options: PoseOptions,
    ) -> Operation[models.Pose]:
        """One pose."""
        body, full = body_of(options)
        body |= {"adverbs": (yield from self._named(verb, adverbs))}
        given = {"phase": phase, "time": time_s, "max_error": max_error}
        body |= {name: float(number) for name, number in given.items() if number is not None}
        full = full or max_error is not None
        response = yield from _post(path_of(verb, "pose"), body, JSON if full else OCTETS)
        if full:
            return parsing.parse_json(response.content, parsing.pose)
        return parsing.pose_of_records(verb, parse_records(response.content, joint_count(response.content, 1)))

    def poses(
        self,
        verb: str,
        adverbs: Crowd,
        phases: Numbers | float | None,
        times_s: Numbers | float | None,
        options: PoseOptions,
    ) -> Operation[models.Poses]:
        """Many poses: the request has binary rows, or JSON with ``times_s`` or weights, which rows cannot express."""
        rows = yield from self._rows(verb, adverbs)
        if phases is not None and times_s is not None:
            raise ValueError("give phases or times_s, not both")
        at = np.broadcast_to(np.asarray(0.0 if phases is None else phases, np.float32), len(rows))
        body, full = body_of(options)
        accept = JSON if full else OCTETS
        if times_s is None and not body.get("weights"):
            content = np.column_stack([rows, at]).astype("<f4").tobytes()
            query = tuple((name, _text(one)) for name, value in body.items() for one in _listed(value))
            response = yield from send(Request("POST", path_of(verb, "poses"), accept, content, OCTETS, query))
        else:
            names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
            when, numbers = ("phase", at) if times_s is None else ("time", np.broadcast_to(times_s, len(rows)))
            body["items"] = [
                {"adverbs": dict(zip(names, row, strict=True)), when: number}
                for row, number in zip(rows.tolist(), numbers.tolist(), strict=True)
            ]
            response = yield from _post(path_of(verb, "poses"), body, accept)
        if full:
            return parsing.parse_json(response.content, parsing.poses)
        return parsing.poses_of_records(verb, parse_records(response.content, joint_count(response.content, len(rows))))

    def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None,
        track: Track | None,
        fps: float,
        cycles: int,
        options: PoseOptions,
    ) -> Operation[models.Sequence]:
        """A whole motion."""
        body, full = body_of(options)
        body |= yield from self.motion_body(verb, adverbs, track, fps, cycles)
        response = yield from _post(path_of(verb, "sequence"), body, JSON if full else OCTETS)
        if full:
            return parsing.parse_json(response.content, parsing.sequence)
        joints = len(body["joints"]) if "joints" in body else (yield from self._joints(verb, response.content))
        rows = parse_records(response.content, joints)
        return parsing.sequence_of_records(verb, rows, fps=fps, cycles=cycles if track is None else None)

    def bvh(
        self, verb: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int, options: PoseOptions
    ) -> Operation[str]:
        """A whole motion as a BVH file."""
        body, _ = body_of(options)
        body |= yield from self.motion_body(verb, adverbs, track, fps, cycles)
        response = yield from _post(path_of(verb, "sequence"), body, BVH)
        try:
            return response.content.decode()
        except UnicodeDecodeError as err:
            raise DecodeError(f"a BVH file that is not UTF-8: {err}") from err

    def motion_body(
        self, verb: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int
    ) -> Operation[dict[str, Any]]:
        """The JSON fields of a whole motion."""
        if (adverbs is None) == (track is None):
            raise ValueError("give either adverbs or track")
        body: dict[str, Any] = {"fps": float(fps), "cycles": cycles}
        if adverbs is not None:
            return body | {"adverbs": (yield from self._named(verb, adverbs))}
        points = []
        for time_s, there in track or ():
            points.append({"time": float(time_s), "adverbs": (yield from self._named(verb, there))})
        return body | {"track": points}

    def _known(self, name: str) -> Operation[models.Verb]:
        """The description of a verb, requested once."""
        if name in self._verbs:
            return self._verbs[name][1]
        return (yield from self.verb(name))

    def _joints(self, verb: str, content: bytes) -> Operation[int]:
        """Number of joints in the version of the response; the cached one may be older."""
        found = yield from self._known(verb)
        if int.from_bytes(content[4:8], "little") != found.version:
            found = yield from self.verb(verb)
        return len(found.skeleton)

    def _named(self, verb: str, adverbs: Adverbs) -> Operation[dict[str, float]]:
        if isinstance(adverbs, Mapping):
            return {name: float(number) for name, number in adverbs.items()}
        names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
        numbers = np.asarray(adverbs, np.float64).ravel().tolist()
        if len(names) != len(numbers):
            raise ValueError(f"{len(numbers)} adverbs given; {verb!r} has {len(names)}: {', '.join(names)}")
        return dict(zip(names, numbers, strict=True))

    def _rows(self, verb: str, adverbs: Crowd) -> Operation[npt.NDArray[np.float32]]:
        if not isinstance(adverbs, Mapping):
            rows = np.asarray(adverbs, np.float32)
            if rows.ndim != 2 or not len(rows):
                raise ValueError(f"expected rows (B, D) of adverbs, at least one, not {rows.shape}")
            return rows
        names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
        if set(names) != set(adverbs):
            detail = f"adverbs {', '.join(adverbs)} given; {verb!r} has {', '.join(names)}"
            raise error_class("unknown_adverb")(detail, known=tuple(names))
        return np.column_stack(np.broadcast_arrays(*(np.atleast_1d(adverbs[name]) for name in names))).astype("<f4")


def error_of(response: Response) -> ResponseError:
    """The error of a response with an error status."""
    try:
        fields = json.loads(response.content)
    except (ValueError, RecursionError):
        fields = None
    if not isinstance(fields, dict):
        fields = {}
    code, limit = str(fields.get("code", "")), fields.get("limit")
    field_errors = [row for row in _list(fields, "errors") if isinstance(row, dict)]
    return error_class(code)(
        str(fields.get("detail") or f"the server responded with status {response.status}"),
        code=code or f"http_{response.status}",
        status=response.status,
        title=str(fields.get("title", "")),
        known=tuple(str(name) for name in _list(fields, "known")),
        limit=limit if isinstance(limit, int) else None,
        field_errors=tuple(FieldError(str(row.get("at", "")), str(row.get("problem", ""))) for row in field_errors),
        request_id=response.headers.get("x-request-id"),
        retry_after_s=_seconds(response.headers.get("retry-after")),
    )


def _list(fields: Mapping[str, Any], name: str) -> list[Any]:
    value = fields.get(name)
    return value if isinstance(value, list) else []


def _seconds(text: str | None) -> float | None:
    try:
        return None if text is None else max(0.0, float(text))
    except ValueError:
        return None  # an HTTP date; this server writes seconds


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def path_of(verb: str, noun: str = "") -> str:
    """Path of a verb, or of something of it."""
    return f"/v1/verbs/{quote(verb, safe='')}" + (f"/{noun}" if noun else "")


def body_of(options: PoseOptions) -> tuple[dict[str, Any], bool]:
    """Options as JSON fields, and whether a full response is requested."""
    body: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    full = bool(body.pop("full", False))
    if "joints" in body:
        body["joints"] = list(body["joints"])
    if not body.get("weights"):
        body.pop("weights", None)
    for name in ("plant", "support"):
        if name in body:
            body[name] = bool(body[name])
    return body, full or "weights" in body or "map" in body


def _get(path: str, headers: Mapping[str, str] | None = None) -> Operation[Response]:
    return (yield from send(Request("GET", path, headers=headers or {})))


def _post(path: str, body: Mapping[str, Any], accept: str) -> Operation[Response]:
    try:
        content = json.dumps(body, allow_nan=False).encode()
    except ValueError as err:
        raise ValueError(f"adverbs, phases and times must be finite: {err}") from err
    return (yield from send(Request("POST", path, accept, content, JSON)))


def send(request: Request) -> Operation[Response]:
    """Yield a request, and check its response; raises :class:`ResponseError`."""
    response = yield request
    if response.status >= 300 and response.status != 304:
        raise error_of(response)
    return response
