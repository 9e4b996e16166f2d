"""Operations for files, maps of quality, and poses of drafts; without I/O, as in ``api``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any
from urllib.parse import quote

from adverb_client import models, parsing
from adverb_client.api import (
    BVH,
    JSON,
    OCTETS,
    Adverbs,
    Api,
    Operation,
    PoseOptions,
    Request,
    Track,
    body_of,
    path_of,
    send,
)
from adverb_client.authoring_models import Refinement
from adverb_client.errors import DecodeError

__all__ = ["EVENTS", "FORMATS", "MotionApi", "events_path", "refinements_of"]

FORMATS = {
    "bvh": BVH,
    "glb": "model/gltf-binary",
    "vrma": "application/x-vrma",
    "npz": "application/x-npz",
}
"""Media types of motion files, by their endings."""

EVENTS = "text/event-stream"


class MotionApi:
    """The operations.

    Parameters
    ----------
    api : Api
        Its cache of descriptions is shared.
    """

    def __init__(self, api: Api) -> None:
        self._api = api

    def export(
        self, verb: str, form: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int,
        mannequin: bool, options: PoseOptions,
    ) -> Operation[bytes]:  # fmt: skip
        """A whole motion as a file."""
        body = yield from self._body(verb, adverbs, track, fps, cycles, options)
        return (yield from _file(path_of(verb, "sequence"), form, body, mannequin))

    def artifact(self, verb: str) -> Operation[bytes]:
        """The artifact of the served version."""
        return (yield from send(Request("GET", path_of(verb, "artifact"), OCTETS))).content

    def quality(
        self, verb: str, method: str | None, across: str | None, up: str | None, at: Mapping[str, float] | None,
        nodes: int | None, version: int | None,
    ) -> Operation[models.QualityMap]:  # fmt: skip
        """A map of quality."""
        held = None if at is None else ",".join(f"{name}={float(value)!r}" for name, value in at.items())
        given = {"method": method, "across": across, "up": up, "at": held, "nodes": nodes, "version": version}
        query = tuple((name, str(value)) for name, value in given.items() if value is not None)
        response = yield from send(Request("GET", path_of(verb, "quality"), query=query))
        return parsing.parse_json(response.content, parsing.quality)

    def draft_pose(
        self, id: str, adverbs: Mapping[str, float], phase: float | None, time_s: float | None,
        max_error: float | None, options: PoseOptions,
    ) -> Operation[models.Pose]:  # fmt: skip
        """One pose of a draft's verb."""
        given = {"phase": phase, "time": time_s, "max_error": max_error}
        body = body_of(options)[0] | {name: float(value) for name, value in given.items() if value is not None}
        body["adverbs"] = {name: float(value) for name, value in adverbs.items()}
        response = yield from _posted(_draft(id, "pose"), body, JSON)
        return parsing.parse_json(response, parsing.pose)

    def draft_sequence(
        self, id: str, adverbs: Mapping[str, float] | None, track: Track | None, fps: float, cycles: int,
        options: PoseOptions,
    ) -> Operation[models.Sequence]:  # fmt: skip
        """A whole motion of a draft's verb."""
        body = yield from self._body(id, adverbs, track, fps, cycles, options)
        return parsing.parse_json((yield from _posted(_draft(id, "sequence"), body, JSON)), parsing.sequence)

    def draft_motion(self, id: str) -> Operation[bytes]:
        """Poses of all readable clips of a draft, for display."""
        return (yield from send(Request("GET", _draft(id, "motion"), "*/*"))).content

    def live(self) -> Operation[bool]:
        """Liveness."""
        return bool(json.loads((yield from send(Request("GET", "/livez", retry=False))).content)["live"])

    def metrics(self) -> Operation[str]:
        """Metrics as Prometheus text."""
        return (yield from send(Request("GET", "/metrics", "text/plain", retry=False))).content.decode()

    def _body(
        self, verb: str, adverbs: Adverbs | None, track: Track | None, fps: float, cycles: int, options: PoseOptions
    ) -> Operation[dict[str, Any]]:
        return body_of(options)[0] | (yield from self._api.motion_body(verb, adverbs, track, fps, cycles))


def events_path(id: str) -> str:
    """Path of the events of a refinement."""
    return f"/v1/refinements/{quote(id, safe='')}/events"


def refinements_of(lines: Iterable[str]) -> Iterator[Refinement]:
    """The states of a refinement in lines of server-sent events."""
    for line in lines:
        if line.startswith("data:"):
            yield parsing.parse_json(line.removeprefix("data:").encode(), Refinement.of_json)


def _draft(id: str, noun: str) -> str:
    return f"/v1/drafts/{quote(id, safe='')}/{noun}"


def _file(path: str, form: str, body: dict[str, Any], mannequin: bool) -> Operation[bytes]:
    if form not in FORMATS:
        raise ValueError(f"format {form!r}; expected one of {', '.join(FORMATS)}")
    if mannequin:
        body["mannequin"] = True
    content = yield from _posted(path, body, FORMATS[form])
    if not content:
        raise DecodeError(f"an empty {form} file")
    return content


def _posted(path: str, body: Mapping[str, Any], accept: str) -> Operation[bytes]:
    content = json.dumps(body, allow_nan=False).encode()
    return (yield from send(Request("POST", path, accept, content, JSON))).content
