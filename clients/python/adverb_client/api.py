"""Questions to the server, without any network: each is a generator that yields calls and is sent their answers.

Both clients run the same generators; only who waits, and how, differs.
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
from adverb_client.errors import DecodeError, Mistake, Refused, refusal
from adverb_client.records import joints_of, read_records
from adverb_client.skeleton import Space

__all__ = ["Adverbs", "Answer", "Asking", "Call", "Crowd", "Options", "Question", "Track", "refused"]

JSON, OCTETS, BVH, PROBLEM = "application/json", "application/octet-stream", "text/x-bvh", "application/problem+json"

T = TypeVar("T")
Numbers = npt.NDArray[Any] | Sequence[float]
Adverbs = Mapping[str, float] | Numbers
"""Adverbs of one pose: by name, or all of them in the verb's order; in their units."""
Crowd = Mapping[str, Numbers] | npt.NDArray[Any] | Sequence[Sequence[float]]
"""Adverbs of many poses: a column (B,) per name (or a number for all), or rows (B, D) in the verb's order."""
Track = Sequence[tuple[float, Adverbs]]
"""Seconds from the start, rising, and the adverbs there."""


class Options(TypedDict, total=False):
    """What all questions for poses have in common.

    Parameters
    ----------
    method : str
        One of the verb's methods; its default where left out.
    space : str
        ``local`` (rotations relative to the parent) or ``global``.
    joints : sequence of str
        Only these joints, in this order.
    version : int
        The version that must answer.
    weights : bool
        Whether to tell the examples' weights; makes the answer a full one.
    full : bool
        Whether to ask for JSON, which tells more than a binary record: method, measured, positions, weights, events.
    """

    method: str
    space: Space
    joints: Sequence[str]
    version: int
    weights: bool
    full: bool


@dataclass(frozen=True, slots=True)
class Call:
    """One HTTP request; a patient one is asked again where the server answers 503."""

    method: Literal["GET", "POST"]
    path: str
    accept: str = JSON
    content: bytes = b""
    content_type: str | None = None
    query: tuple[tuple[str, str], ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    patient: bool = True


@dataclass(frozen=True, slots=True)
class Answer:
    """One HTTP response; names of headers in lower case."""

    status: int
    headers: Mapping[str, str]
    content: bytes


Question = Generator[Call, Answer, T]


class Asking:
    """All questions; remembers what verbs are like, since binary rows and records do not say it."""

    def __init__(self) -> None:
        self._verbs: dict[str, tuple[str, models.Verb]] = {}

    def health(self) -> Question[models.Health]:
        """Whether it is ready."""
        return parsing.parsed((yield from _send(Call("GET", "/readyz", patient=False))).content, parsing.health)

    def verbs(self) -> Question[tuple[models.VerbSummary, ...]]:
        """The verbs that are there."""
        return parsing.parsed((yield from _get("/v1/verbs")).content, parsing.verbs)

    def verb(self, name: str) -> Question[models.Verb]:
        """What a verb is like. What has not changed is not sent again."""
        tag, known = self._verbs.get(name, ("", None))
        answer = yield from _get(_path(name), {"if-none-match": tag} if tag else {})
        if answer.status == 304 and known is not None:
            return known
        found = parsing.parsed(answer.content, parsing.verb)
        self._verbs[name] = (answer.headers.get("etag", ""), found)
        return found

    def pose(
        self,
        verb: str,
        adverbs: Adverbs,
        phase: float | None,
        time_s: float | None,
        max_error: float | None,
        options: Options,
    ) -> Question[models.Pose]:
        """One pose."""
        body, full = _body(options)
        body |= {"adverbs": (yield from self._named(verb, adverbs))}
        given = {"phase": phase, "time": time_s, "max_error": max_error}
        body |= {name: float(number) for name, number in given.items() if number is not None}
        full = full or max_error is not None
        answer = yield from _post(_path(verb, "pose"), body, JSON if full else OCTETS)
        if full:
            return parsing.parsed(answer.content, parsing.pose)
        return parsing.pose_of_records(verb, read_records(answer.content, joints_of(answer.content, 1)))

    def poses(
        self,
        verb: str,
        adverbs: Crowd,
        phases: Numbers | float | None,
        times_s: Numbers | float | None,
        options: Options,
    ) -> Question[models.Poses]:
        """Many poses: binary rows in, unless they are at times or weights are asked for, which rows cannot say."""
        rows = yield from self._rows(verb, adverbs)
        if phases is not None and times_s is not None:
            raise ValueError("give phases or times_s, not both")
        at = np.broadcast_to(np.asarray(0.0 if phases is None else phases, np.float32), len(rows))
        body, full = _body(options)
        accept = JSON if full else OCTETS
        if times_s is None and not body.get("weights"):
            content = np.column_stack([rows, at]).astype("<f4").tobytes()
            query = tuple((name, str(one)) for name, value in body.items() for one in _listed(value))
            answer = yield from _send(Call("POST", _path(verb, "poses"), accept, content, OCTETS, query))
        else:
            names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
            when, numbers = ("phase", at) if times_s is None else ("time", np.broadcast_to(times_s, len(rows)))
            body["items"] = [
                {"adverbs": dict(zip(names, row, strict=True)), when: number}
                for row, number in zip(rows.tolist(), numbers.tolist(), strict=True)
            ]
            answer = yield from _post(_path(verb, "poses"), body, accept)
        if full:
            return parsing.parsed(answer.content, parsing.poses)
        return parsing.poses_of_records(verb, read_records(answer.content, joints_of(answer.content, len(rows))))

    def sequence(
        self,
        verb: str,
        adverbs: Adverbs | None,
        track: Track | None,
        fps: float,
        cycles: int,
        options: Options,
    ) -> Question[models.Sequence]:
        """A whole motion."""
        body, full = _body(options)
        body |= yield from self._motion(verb, adverbs, track, fps, cycles)
        answer = yield from _post(_path(verb, "sequence"), body, JSON if full else OCTETS)
        if full:
            return parsing.parsed(answer.content, parsing.sequence)
        joints = len(body["joints"]) if "joints" in body else (yield from self._joints(verb, answer.content))
        rows = read_records(answer.content, joints)
        return parsing.sequence_of_records(verb, rows, fps=fps, cycles=cycles if track is None else None)

    def bvh(
        self, verb: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int, options: Options
    ) -> Question[str]:
        """A whole motion as a BVH file."""
        body, _ = _body(options)
        body |= yield from self._motion(verb, adverbs, track, fps, cycles)
        answer = yield from _post(_path(verb, "sequence"), body, BVH)
        try:
            return answer.content.decode()
        except UnicodeDecodeError as err:
            raise DecodeError(f"a BVH file that is no UTF-8: {err}") from err

    def _motion(
        self, verb: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int
    ) -> Question[dict[str, Any]]:
        if (adverbs is None) == (track is None):
            raise ValueError("give either adverbs or track")
        body: dict[str, Any] = {"fps": float(fps), "cycles": cycles}
        if adverbs is not None:
            return body | {"adverbs": (yield from self._named(verb, adverbs))}
        points = []
        for time_s, there in track or ():
            points.append({"time": float(time_s), "adverbs": (yield from self._named(verb, there))})
        return body | {"track": points}

    def _known(self, name: str) -> Question[models.Verb]:
        """What the verb is like, asked for once."""
        if name in self._verbs:
            return self._verbs[name][1]
        return (yield from self.verb(name))

    def _joints(self, verb: str, content: bytes) -> Question[int]:
        """Joints of the version that answered; what is remembered may be of an older one."""
        found = yield from self._known(verb)
        if int.from_bytes(content[4:8], "little") != found.version:
            found = yield from self.verb(verb)
        return len(found.skeleton)

    def _named(self, verb: str, adverbs: Adverbs) -> Question[dict[str, float]]:
        if isinstance(adverbs, Mapping):
            return {name: float(number) for name, number in adverbs.items()}
        names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
        numbers = np.asarray(adverbs, np.float64).ravel().tolist()
        if len(names) != len(numbers):
            raise ValueError(f"{len(numbers)} adverbs are given; {verb!r} has {len(names)}: {', '.join(names)}")
        return dict(zip(names, numbers, strict=True))

    def _rows(self, verb: str, adverbs: Crowd) -> Question[npt.NDArray[np.float32]]:
        if not isinstance(adverbs, Mapping):
            rows = np.asarray(adverbs, np.float32)
            if rows.ndim != 2 or not len(rows):
                raise ValueError(f"adverbs of many poses are rows (B, D), at least one: {rows.shape}")
            return rows
        names = [adverb.name for adverb in (yield from self._known(verb)).adverbs]
        if set(names) != set(adverbs):
            detail = f"adverbs {', '.join(adverbs)} are given; {verb!r} has {', '.join(names)}"
            raise refusal("unknown_adverb")(detail, known=tuple(names))
        return np.column_stack(np.broadcast_arrays(*(np.atleast_1d(adverbs[name]) for name in names))).astype("<f4")


def refused(answer: Answer) -> Refused:
    """The error that stands for an answer that is none."""
    try:
        told = json.loads(answer.content)
    except (ValueError, RecursionError):
        told = None
    if not isinstance(told, dict):
        told = {}
    code, limit = str(told.get("code", "")), told.get("limit")
    mistakes = [row for row in _list(told, "errors") if isinstance(row, dict)]
    return refusal(code)(
        str(told.get("detail") or f"the server answered {answer.status}"),
        code=code or f"http_{answer.status}",
        status=answer.status,
        title=str(told.get("title", "")),
        known=tuple(str(name) for name in _list(told, "known")),
        limit=limit if isinstance(limit, int) else None,
        mistakes=tuple(Mistake(str(row.get("at", "")), str(row.get("problem", ""))) for row in mistakes),
        request_id=answer.headers.get("x-request-id"),
        retry_after_s=_seconds(answer.headers.get("retry-after")),
    )


def _list(told: Mapping[str, Any], name: str) -> list[Any]:
    value = told.get(name)
    return value if isinstance(value, list) else []


def _seconds(text: str | None) -> float | None:
    try:
        return None if text is None else max(0.0, float(text))
    except ValueError:
        return None  # an HTTP date; this server writes seconds


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _path(verb: str, noun: str = "") -> str:
    return f"/v1/verbs/{quote(verb, safe='')}" + (f"/{noun}" if noun else "")


def _body(options: Options) -> tuple[dict[str, Any], bool]:
    """Options as JSON fields, and whether a full answer is asked for."""
    body: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    full = bool(body.pop("full", False))
    if "joints" in body:
        body["joints"] = list(body["joints"])
    if not body.get("weights"):
        body.pop("weights", None)
    return body, full or "weights" in body


def _get(path: str, headers: Mapping[str, str] | None = None) -> Question[Answer]:
    return (yield from _send(Call("GET", path, headers=headers or {})))


def _post(path: str, body: Mapping[str, Any], accept: str) -> Question[Answer]:
    try:
        content = json.dumps(body, allow_nan=False).encode()
    except ValueError as err:
        raise ValueError(f"adverbs, phases and times are finite numbers: {err}") from err
    return (yield from _send(Call("POST", path, accept, content, JSON)))


def _send(call: Call) -> Question[Answer]:
    answer = yield call
    if answer.status >= 300 and answer.status != 304:
        raise refused(answer)
    return answer
